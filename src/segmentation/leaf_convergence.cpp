#include "field_phenotyping/segmentation/leaf_convergence.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "field_phenotyping/common/bounds.hpp"

namespace field_phenotyping {
namespace {

constexpr float kCell = 0.01F;   // [m]
constexpr float kBlur = 0.015F;  // [m] by which a tangent misses the stem

/// Votes by place: how many, and from which sides.
class VoteMap {
 public:
  explicit VoteMap(const Bounds& bounds)
      : corner_(bounds.low.head<2>()),
        columns_(cellsOver(bounds.high.x() - bounds.low.x())),
        rows_(cellsOver(bounds.high.y() - bounds.low.y())),
        votes_(columns_ * rows_, Eigen::Vector3f::Zero()) {}

  std::size_t columns() const { return columns_; }
  std::size_t rows() const { return rows_; }

  /// @param from horizontal vector towards where the vote comes from, at most 1 long
  void add(const Eigen::Vector2f& at, const Eigen::Vector2f& from, float weight) {
    const Eigen::Vector2f cell = (at - corner_) / kCell;
    if (!(cell.minCoeff() >= 0.0F)) return;
    const auto column = static_cast<std::size_t>(cell.x());
    const auto row = static_cast<std::size_t>(cell.y());
    if (column >= columns_ || row >= rows_) return;
    votes_[row * columns_ + column] += weight * Eigen::Vector3f(1.0F, from.x(), from.y());
  }

  void blur() {
    std::vector<Eigen::Vector3f> line;
    for (std::size_t row = 0; row < rows_; ++row) blurLine(row * columns_, 1U, columns_, line);
    for (std::size_t column = 0; column < columns_; ++column) {
      blurLine(column, columns_, rows_, line);
    }
  }

  /// Votes of a cell that others from across balance.
  float balanced(std::size_t column, std::size_t row) const {
    const Eigen::Vector3f& votes = votes_[row * columns_ + column];
    return votes.x() - votes.tail<2>().norm();
  }

  /// Middle of a cell, moved by parts of one.
  Eigen::Vector2f placeOf(std::size_t column, std::size_t row, const Eigen::Vector2f& moved) const {
    const Eigen::Vector2f cell(static_cast<float>(column), static_cast<float>(row));
    return corner_ + kCell * (cell + Eigen::Vector2f::Constant(0.5F) + moved);
  }

 private:
  static constexpr std::size_t kReach = 4U;  // cells, beyond which the blur ends

  static std::size_t cellsOver(float length) {
    return static_cast<std::size_t>(std::floor(length / kCell)) + 1U;
  }

  void blurLine(std::size_t first, std::size_t step, std::size_t count,
                std::vector<Eigen::Vector3f>& line) {
    std::array<float, kReach + 1U> kernel{};
    for (std::size_t k = 0; k <= kReach; ++k) {
      const float off = static_cast<float>(k) * kCell / kBlur;
      kernel[k] = std::exp(-0.5F * off * off);
    }
    line.assign(count + 2U * kReach, Eigen::Vector3f::Zero());
    for (std::size_t k = 0; k < count; ++k) line[k + kReach] = votes_[first + k * step];
    for (std::size_t k = 0; k < count; ++k) {
      Eigen::Vector3f sum = kernel[0] * line[k + kReach];
      for (std::size_t off = 1; off <= kReach; ++off) {
        sum += kernel[off] * (line[k + kReach - off] + line[k + kReach + off]);
      }
      votes_[first + k * step] = sum;
    }
  }

  Eigen::Vector2f corner_;
  std::size_t columns_;
  std::size_t rows_;
  std::vector<Eigen::Vector3f> votes_;  // weight, and its horizontal moment; row by row
};

void vote(const Eigen::Vector3f& point, const LocalShape& shape, float height, float plant_height,
          VoteMap& map) {
  constexpr float kLeastLine = 0.5F;   // linearity
  constexpr float kLeastRise = 0.25F;  // of a tangent, by its length: leaf tips hang
  constexpr float kReach = 0.3F;       // of the plants' height: leaves bend farther out
  constexpr float kHighest = 0.5F;     // of the plants' height: no leaf begins above
  if (shape.linearity <= kLeastLine || shape.direction.z() <= kLeastRise) return;
  const float rise = shape.direction.z();
  const Eigen::Vector2f out = shape.direction.head<2>();
  for (float back = 0.0F; back < kReach * plant_height; back += kCell) {
    const float at = height - back * rise;
    if (at <= 0.0F) return;
    if (at < kHighest * plant_height) {
      map.add(point.head<2>() - back * out, out, shape.linearity);
    }
  }
}

/// How far the top of a parabola through three values lies from the middle one, in steps.
float topOf(float before, float middle, float after) {
  const float bend = 2.0F * middle - before - after;
  return bend > 0.0F ? std::clamp(0.5F * (after - before) / bend, -0.5F, 0.5F) : 0.0F;
}

std::vector<LeafConvergence> peaksOf(const VoteMap& map) {
  std::vector<LeafConvergence> peaks;
  for (std::size_t row = 1; row + 1U < map.rows(); ++row) {
    for (std::size_t column = 1; column + 1U < map.columns(); ++column) {
      const float votes = map.balanced(column, row);
      if (!(votes > 0.0F)) continue;
      bool highest = true;
      for (std::size_t y = row - 1U; y <= row + 1U && highest; ++y) {
        for (std::size_t x = column - 1U; x <= column + 1U && highest; ++x) {
          highest = map.balanced(x, y) <= votes;
        }
      }
      if (!highest) continue;
      const Eigen::Vector2f moved(
          topOf(map.balanced(column - 1U, row), votes, map.balanced(column + 1U, row)),
          topOf(map.balanced(column, row - 1U), votes, map.balanced(column, row + 1U)));
      peaks.push_back({map.placeOf(column, row, moved), votes});
    }
  }
  return peaks;
}

}  // namespace

std::vector<LeafConvergence> findLeafConvergences(const Block& block,
                                                  const std::vector<LocalShape>& shapes,
                                                  float plant_height, float least_distance) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  if (points.empty()) return {};
  VoteMap map(boundsOf(points));
  for (std::size_t i = 0; i < points.size(); ++i) {
    vote(points[i], shapes[i], block.ground.heightAbove(points[i]), plant_height, map);
  }
  map.blur();
  std::vector<LeafConvergence> peaks = peaksOf(map);
  std::stable_sort(peaks.begin(), peaks.end(),
                   [](const auto& a, const auto& b) { return a.votes > b.votes; });
  std::vector<LeafConvergence> apart;
  for (const LeafConvergence& peak : peaks) {
    const bool near = std::any_of(apart.begin(), apart.end(), [&](const auto& stronger) {
      return (stronger.place - peak.place).norm() < least_distance;
    });
    if (!near) apart.push_back(peak);
  }
  return apart;
}

}  // namespace field_phenotyping
