#include "field_phenotyping/segmentation/stand_tops.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

/// The points of each plant: indices.
using PointsOfPlants = std::vector<std::vector<std::uint32_t>>;

constexpr std::size_t kHighest = 3U;  // points that show where a top is
constexpr float kFarthest = 1.5F;     // [m] of a plant's points from its base, level

/// The straight line from a stem's base through its end and on.
class StemLine {
 public:
  explicit StemLine(const StemAxis& axis) {
    if (axis.empty()) return;
    base_ = axis.nodes().front().position;
    const Eigen::Vector3f rise = axis.nodes().back().position - base_;
    if (!(rise.z() > 0.0F)) return;
    known_ = true;
    slope_ = rise.head<2>() / rise.z();
  }
  bool known() const { return known_; }
  const Eigen::Vector3f& base() const { return base_; }
  Eigen::Vector2f at(float z) const { return base_.head<2>() + (z - base_.z()) * slope_; }
  float distanceTo(const Eigen::Vector3f& place) const {
    return (place.head<2>() - at(place.z())).norm();  // [m], level
  }

 private:
  Eigen::Vector3f base_ = Eigen::Vector3f::Zero();
  Eigen::Vector2f slope_ = Eigen::Vector2f::Zero();
  bool known_ = false;
};

/// What is at the upper end of a plant.
struct Top {
  float z = 0.0F;
  float off_line = 0.0F;     // [m] median of its highest points
  bool is_known = false;     // whether there are so many
  bool is_disputed = false;  // whether most of them are
  float undisputed = 0.0F;   // height of the highest point that is not
};

class Stand {
 public:
  Stand(const std::vector<Eigen::Vector3f>& points, std::vector<StemLine> lines,
        const PointsOfPlants& of_plants)
      : points_(points), of_plants_(of_plants), lines_(std::move(lines)), tops_(lines_.size()) {
    std::vector<Eigen::Vector3f> bases;
    for (const StemLine& line : lines_) bases.emplace_back(line.base().x(), line.base().y(), 0.0F);
    grid_.emplace(bases, kFarthest);
    parallelFor(size(), [&](std::size_t plant) { tops_[plant] = findTop(plant); });
    std::vector<float> off;
    for (const Top& top : tops_) {
      if (top.is_known) off.push_back(top.off_line);
      if (top.is_disputed) ++disputed_;
    }
    known_ = off.size();
    if (!off.empty()) median_off_ = medianOf(off);
  }

  std::size_t size() const { return lines_.size(); }
  std::size_t known() const { return known_; }        // tops
  std::size_t disputed() const { return disputed_; }  // of these
  const Top& top(std::size_t plant) const { return tops_[plant]; }
  const StemLine& line(std::size_t plant) const { return lines_[plant]; }

  /// Whether a plant's top is farther off its line than most, and than that [m].
  bool isFarOff(std::size_t plant, float least) const {
    constexpr float kMost = 1.5F;  // medians
    return tops_[plant].is_known && tops_[plant].off_line > std::max(kMost * median_off_, least);
  }

  /// Calls visit(other, index, distance) for others' points above a plant's top that are nearer to
  /// its line than to theirs, plant by plant. @param distance [m] from its line
  template <class Visit>
  void forEachHeldByOthers(std::size_t plant, Visit&& visit) const {
    const StemLine& own = lines_[plant];
    for (std::size_t other = 0; other < size(); ++other) {
      const StemLine& line = lines_[other];
      if (other == plant || !line.known()) continue;
      if ((line.base() - own.base()).head<2>().norm() > 2.0F * kFarthest) continue;
      for (const std::uint32_t i : of_plants_[other]) {
        const Eigen::Vector3f& place = points_[i];
        if (place.z() <= tops_[plant].z) continue;
        const float distance = own.distanceTo(place);
        if (distance < line.distanceTo(place)) visit(other, i, distance);
      }
    }
  }

  /// [m] about a line, within which a plant's top usually is.
  float tube() const {
    constexpr float kMedians = 2.0F;
    constexpr float kLeast = 0.05F;  // [m]
    return std::max(kMedians * median_off_, kLeast);
  }

  /// Share of tops that would be disputed if all were right.
  double disputedByChance() const {
    constexpr std::size_t kDistances = 5U;
    constexpr std::size_t kDirections = 8U;
    constexpr float kWholeTurn = 6.2831853F;
    const float scale = median_off_ / std::sqrt(2.0F * std::log(2.0F));
    std::vector<std::size_t> disputed(size(), 0U);
    parallelFor(size(), [&](std::size_t plant) {
      const Top& top = tops_[plant];
      if (!top.is_known) return;
      const Eigen::Vector2f middle = lines_[plant].at(top.z);
      for (std::size_t k = 0; k < kDistances * kDirections; ++k) {
        const float share =
            (static_cast<float>(k / kDirections) + 0.5F) / static_cast<float>(kDistances);
        const float distance = scale * std::sqrt(-2.0F * std::log(1.0F - share));
        const float angle =
            kWholeTurn * static_cast<float>(k % kDirections) / static_cast<float>(kDirections);
        const Eigen::Vector2f place =
            middle + distance * Eigen::Vector2f(std::cos(angle), std::sin(angle));
        if (isNearOther({place.x(), place.y(), top.z}, plant, distance)) ++disputed[plant];
      }
    });
    return std::accumulate(disputed.begin(), disputed.end(), 0.0) /
           static_cast<double>(kDistances * kDirections * std::max<std::size_t>(known_, 1U));
  }

 private:
  /// Whether another plant's line is nearer than so far [m].
  bool isNearOther(const Eigen::Vector3f& place, std::size_t plant, float distance) const {
    bool nearer = false;
    grid_->forEachWithin({place.x(), place.y(), 0.0F}, kFarthest, [&](std::uint32_t other, float) {
      nearer = nearer || (other != plant && lines_[other].known() &&
                          lines_[other].distanceTo(place) < distance);
    });
    return nearer;
  }

  Top findTop(std::size_t plant) const {
    Top top;
    const std::vector<std::uint32_t>& own = of_plants_[plant];
    if (!lines_[plant].known() || own.size() < kHighest) return top;
    const auto isLower = [&](std::uint32_t a, std::uint32_t b) {
      return points_[a].z() < points_[b].z();
    };
    top.is_known = true;
    top.z = points_[*std::max_element(own.begin(), own.end(), isLower)].z();
    top.undisputed = 0.5F * (top.z + lines_[plant].base().z());  // no top is lower
    std::vector<std::uint32_t> downwards;
    for (const std::uint32_t i : own) {
      if (points_[i].z() > top.undisputed) downwards.push_back(i);
    }
    std::make_heap(downwards.begin(), downwards.end(), isLower);
    std::vector<float> off;
    std::size_t disputed = 0U;
    bool settled = false;
    for (auto end = downwards.end();
         end != downwards.begin() && !(settled && off.size() == kHighest); --end) {
      const Eigen::Vector3f& place = points_[downwards.front()];
      std::pop_heap(downwards.begin(), end, isLower);
      const float distance = lines_[plant].distanceTo(place);
      const bool is_disputed = isNearOther(place, plant, distance);
      if (off.size() < kHighest) {
        off.push_back(distance);
        if (is_disputed) ++disputed;
      }
      if (!is_disputed && !settled) {
        settled = true;
        top.undisputed = place.z();
      }
    }
    top.off_line = off.empty() ? 0.0F : medianOf(off);
    top.is_disputed = 2U * disputed > kHighest;
    return top;
  }

  const std::vector<Eigen::Vector3f>& points_;
  const PointsOfPlants& of_plants_;
  std::vector<StemLine> lines_;
  std::optional<NeighborGrid> grid_;  // of their bases, level
  std::vector<Top> tops_;
  std::size_t known_ = 0U;
  std::size_t disputed_ = 0U;
  float median_off_ = 0.0F;  // [m] of tops from their lines
};

/// Probability that a disputed top is wrong.
double shareOfWrong(const Stand& stand) {
  // As if two more had been disputed, of which half a one is wrong: few tell little.
  constexpr double kBefore = 2.0;
  constexpr double kWrongBefore = 0.5;
  const auto disputed = static_cast<double>(stand.disputed());
  const double by_chance = static_cast<double>(stand.known()) * stand.disputedByChance();
  return (std::max(0.0, disputed - by_chance) + kWrongBefore) / (disputed + kBefore);
}

/// Heights of the highest points, from the top.
class HighestPoints {
 public:
  explicit HighestPoints(float least) { heights_.fill(least); }
  void add(float z) {
    if (z <= heights_.back()) return;
    heights_.back() = z;
    std::sort(heights_.begin(), heights_.end(), std::greater<>());
  }
  float last() const { return heights_.back(); }

 private:
  std::array<float, kHighest> heights_;
};

}  // namespace

std::vector<float> giveTopsBack(const std::vector<Eigen::Vector3f>& points,
                                const std::vector<StemAxis>& axes, PointOwners& owners) {
  constexpr double kMostByChance = 0.2;  // share of tops
  constexpr float kAside = 0.15F;        // [m] no tassel, however it bends, but a leaf
  constexpr float kLeastRise = 0.15F;    // [m]
  constexpr std::size_t kFewest = 20U;   // points within the tube
  constexpr float kWrong = 0.5F;         // share of what was given, in fields of real plants
  PointsOfPlants of_plants(axes.size());
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    const std::int32_t plant = owners.of(i);
    if (plant >= 0) of_plants[static_cast<std::size_t>(plant)].push_back(i);
  }
  const Stand stand(points, std::vector<StemLine>(axes.begin(), axes.end()), of_plants);
  std::vector<float> doubts(axes.size(), 0.0F);
  if (stand.disputedByChance() > kMostByChance) return doubts;
  bool has_given = false;
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    if (!stand.isFarOff(plant, kAside)) continue;
    HighestPoints highest(stand.top(plant).z);
    std::size_t count = 0U;
    std::vector<std::uint32_t> held;
    stand.forEachHeldByOthers(plant, [&](std::size_t other, std::uint32_t i, float distance) {
      if (owners.stem[i] >= 0 || owners.plant[i] != static_cast<std::int32_t>(other)) return;
      held.push_back(i);
      if (distance > stand.tube()) return;
      ++count;
      highest.add(points[i].z());
    });
    if (count < kFewest || highest.last() - stand.top(plant).z < kLeastRise) continue;
    for (const std::uint32_t i : held) owners.plant[i] = static_cast<std::int32_t>(plant);
    has_given = true;
  }
  if (!has_given) return doubts;
  std::vector<float> tops(axes.size(), std::numeric_limits<float>::lowest());
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    if (owners.of(i) < 0) continue;
    float& top = tops[static_cast<std::size_t>(owners.of(i))];
    top = std::max(top, points[i].z());
  }
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    if (!stand.top(plant).is_known) continue;
    doubts[plant] = std::sqrt(kWrong) * std::abs(tops[plant] - stand.top(plant).z);
  }
  return doubts;
}

std::vector<float> doubtTops(const SegmentedBlock& block) {
  constexpr float kMostRise = 0.6F;  // [m] of a tassel
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  PointsOfPlants of_plants;
  std::vector<StemLine> lines;
  for (const Plant& plant : block.plants) {
    lines.emplace_back(plant.axis);
    of_plants.emplace_back(plant.points.size());
    std::iota(of_plants.back().begin(), of_plants.back().end(), plant.points.begin);
  }
  const Stand stand(points, std::move(lines), of_plants);
  std::vector<float> doubts(stand.size(), 0.0F);
  if (stand.known() < 2U) return doubts;
  const auto wrong = static_cast<float>(shareOfWrong(stand));
  parallelFor(stand.size(), [&](std::size_t plant) {
    const Top& top = stand.top(plant);
    if (!top.is_known) return;
    float rise = 0.0F;
    if (stand.isFarOff(plant, 0.0F)) {
      HighestPoints highest(top.z);
      stand.forEachHeldByOthers(plant, [&](std::size_t, std::uint32_t i, float distance) {
        if (distance <= stand.tube()) highest.add(points[i].z());
      });
      rise = std::min(highest.last() - top.z, kMostRise);
    }
    doubts[plant] = std::sqrt(wrong) * std::hypot(top.z - top.undisputed, rise);
  });
  return doubts;
}

}  // namespace field_phenotyping
