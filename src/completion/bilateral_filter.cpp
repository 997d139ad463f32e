#include "field_phenotyping/completion/bilateral_filter.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kReach = 2.0;  // standard deviations

/// Shares of the four nodes round a place.
struct Corners {
  int row;     // of the lower two
  int column;  // of the left two
  int next_column;
  std::array<double, 4> share;  // lower left, lower right, upper left, upper right
};

Corners cornersOf(const FilterGrid& grid, const SurfacePosition& place) {
  const double up = place.s / grid.row_height - 0.5;
  const double turn = (place.theta + kPi) / (2.0 * kPi);
  const double round = (turn - std::floor(turn)) * grid.columns - 0.5;
  Corners corners{};
  corners.row = static_cast<int>(std::floor(up));
  const auto left = static_cast<int>(std::floor(round));
  const double b = up - corners.row;
  const double a = round - left;
  corners.column = left < 0 ? left + grid.columns : left;
  corners.next_column = left + 1 >= grid.columns ? 0 : left + 1;
  corners.share = {(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b};
  return corners;
}

/// Sums of what lies about the nodes of the grid and of some rows below and above it.
struct Sums {
  FilterGrid grid;
  int below;  // rows
  std::vector<double> weight;
  std::vector<double> value;
  std::vector<char> is_read;
  std::vector<Eigen::Vector3f> color;

  Sums(const FilterGrid& of, int beyond, bool by_color)
      : grid(of),
        below(beyond),
        weight(static_cast<std::size_t>((of.rows + 2 * beyond) * of.columns), 0.0),
        value(weight.size(), 0.0),
        is_read(weight.size(), 0),
        color(by_color ? weight.size() : 0U, Eigen::Vector3f::Zero()) {}

  int rows() const { return grid.rows + 2 * below; }
  std::size_t at(int row, int column) const {
    return static_cast<std::size_t>((row + below) * grid.columns + column);
  }

  void add(const FilterPoint& point) {
    const Corners corners = cornersOf(grid, point.position);
    if (corners.row < -below || corners.row + 1 >= grid.rows + below) return;
    addTo(at(corners.row, corners.column), corners.share[0], point);
    addTo(at(corners.row, corners.next_column), corners.share[1], point);
    addTo(at(corners.row + 1, corners.column), corners.share[2], point);
    addTo(at(corners.row + 1, corners.next_column), corners.share[3], point);
    if (point.is_read) noteRead(point.position);
  }

 private:
  /// What lies in a cell is read off the nodes of that cell and of those round it.
  void noteRead(const SurfacePosition& place) {
    const auto row = static_cast<int>(std::floor(place.s / grid.row_height));
    const double turn = (place.theta + kPi) / (2.0 * kPi);
    const auto column = static_cast<int>((turn - std::floor(turn)) * grid.columns);
    for (int r = std::max(row - 1, -below); r <= std::min(row + 1, grid.rows + below - 1); ++r) {
      for (int c = column - 1; c <= column + 1; ++c) {
        is_read[at(r, (c + grid.columns) % grid.columns)] = 1;
      }
    }
  }

  void addTo(std::size_t node, double share, const FilterPoint& point) {
    const double w = share * point.weight;
    weight[node] += w;
    value[node] += w * point.deviation;
    if (!color.empty()) color[node] += static_cast<float>(w) * point.color;
  }
};

/// Weights of the nodes 0, 1, ... to one side.
struct Kernel {
  std::vector<double> along;   // the stem
  std::vector<double> around;  // it
};

/// @param per_attribute of squared differences of normals; 0: they do not count
Kernel kernelOf(const FilterGrid& grid, double radius, double sigma, double per_attribute) {
  // Points are shared out to the nodes and read off between them linearly: each widens the filter
  // by a triangle, whose variance is a sixth of the squared step.
  constexpr double kTriangles = 2.0 / 6.0;
  constexpr double kLeastVariance = 1e-3;  // of the squared step
  const auto variance = [&](double step) {
    return std::max(sigma * sigma - kTriangles * step * step, kLeastVariance * step * step);
  };
  Kernel kernel;
  const double up = grid.row_height;
  const auto rows = static_cast<int>(std::ceil(kReach * sigma / up));
  for (int k = 0; k <= rows; ++k) {
    kernel.along.push_back(std::exp(-0.5 * k * k * up * up / variance(up)));
  }
  const double turn_a_column = 2.0 * kPi / grid.columns;
  const double side = radius * turn_a_column;
  const int columns =
      std::min(static_cast<int>(std::ceil(kReach * sigma / side)), (grid.columns - 1) / 2);
  for (int k = 0; k <= columns; ++k) {
    // Normals that differ by an angle are a chord of the unit circle apart.
    const double chord = 2.0 * std::sin(0.5 * k * turn_a_column);
    kernel.around.push_back(
        std::exp(-0.5 * k * k * side * side / variance(side) - per_attribute * chord * chord));
  }
  return kernel;
}

/// Sums round the stem, in place.
void blurAround(const FilterGrid& grid, const std::vector<double>& kernel,
                std::vector<double>& values) {
  const int columns = grid.columns;
  std::vector<double> row(static_cast<std::size_t>(3 * columns));
  for (std::size_t first = 0; first < values.size(); first += static_cast<std::size_t>(columns)) {
    const auto begin = values.begin() + static_cast<std::ptrdiff_t>(first);
    for (int turn = 0; turn < 3; ++turn) {
      std::copy(begin, begin + columns, row.begin() + turn * columns);
    }
    for (int column = 0; column < columns; ++column) {
      const double* middle = &row[static_cast<std::size_t>(columns + column)];
      double sum = kernel[0] * middle[0];
      for (int k = 1; k < static_cast<int>(kernel.size()); ++k) {
        sum += kernel[static_cast<std::size_t>(k)] * (middle[k] + middle[-k]);
      }
      begin[column] = sum;
    }
  }
}

}  // namespace

BilateralFilter::BilateralFilter(const std::vector<FilterPoint>& points, const FilterGrid& grid,
                                 double radius, const FilterOptions& options)
    : grid_(grid) {
  const bool by_color = options.attribute == FilterAttribute::kColor;
  const double per_attribute = 0.5 / (options.sigma_attribute * options.sigma_attribute);
  const Kernel kernel = kernelOf(grid, radius, options.sigma_space, by_color ? 0.0 : per_attribute);
  const auto rows = static_cast<int>(kernel.along.size()) - 1;
  const auto columns = static_cast<int>(kernel.around.size()) - 1;
  Sums sums(grid, rows + 1, by_color);
  for (const FilterPoint& point : points) sums.add(point);
  nodes_.resize(static_cast<std::size_t>((grid.rows + 2) * grid.columns));
  if (by_color) {
    per_attribute_ = per_attribute;
    colors_.resize(nodes_.size(), Eigen::Vector3f::Zero());
    for (std::size_t i = 0; i < sums.weight.size(); ++i) {
      if (sums.weight[i] > 0.0) sums.color[i] /= static_cast<float>(sums.weight[i]);
    }
  } else {
    blurAround(grid, kernel.around, sums.weight);
    blurAround(grid, kernel.around, sums.value);
  }
  for (int row = -1; row <= grid.rows; ++row) {
    for (int column = 0; column < grid.columns; ++column) {
      double weight = 0.0;
      double value = 0.0;
      const std::size_t here = sums.at(row, column);
      if (sums.is_read[here] == 0) continue;
      for (int up = -rows; up <= rows; ++up) {
        const double along = kernel.along[static_cast<std::size_t>(std::abs(up))];
        if (!by_color) {
          const std::size_t i = sums.at(row + up, column);
          weight += along * sums.weight[i];
          value += along * sums.value[i];
          continue;
        }
        for (int side = -columns; side <= columns; ++side) {
          const int other = (column + side + grid.columns) % grid.columns;
          const std::size_t i = sums.at(row + up, other);
          if (!(sums.weight[i] > 0.0)) continue;
          const double w =
              along * kernel.around[static_cast<std::size_t>(std::abs(side))] *
              std::exp(-per_attribute *
                       static_cast<double>((sums.color[i] - sums.color[here]).squaredNorm()));
          weight += w * sums.weight[i];
          value += w * sums.value[i];
        }
      }
      const auto node = static_cast<std::size_t>((row + 1) * grid.columns + column);
      if (!(weight > 0.0)) continue;
      nodes_[node] = {static_cast<float>(value / weight), 1.0F};
      if (by_color) colors_[node] = sums.color[here];
    }
  }
}

double BilateralFilter::at(const SurfacePosition& place, const Eigen::Vector3f& color) const {
  if (nodes_.empty()) return 0.0;
  const Corners corners = cornersOf(grid_, place);
  if (corners.row < -1 || corners.row >= grid_.rows) return 0.0;
  const auto lower = static_cast<std::size_t>((corners.row + 1) * grid_.columns);
  const auto left = static_cast<std::size_t>(corners.column);
  const auto right = static_cast<std::size_t>(corners.next_column);
  const auto upper = lower + static_cast<std::size_t>(grid_.columns);
  const std::array<std::size_t, 4> nodes{lower + left, lower + right, upper + left, upper + right};
  double sum = 0.0;
  double total = 0.0;
  for (std::size_t k = 0; k < nodes.size(); ++k) {
    const Node& node = nodes_[nodes[k]];
    constexpr double kLeast = 1e-12;  // so that one of another colour is better than none
    double w = corners.share[k] * static_cast<double>(node.weight);
    if (!colors_.empty()) {
      w *= kLeast + std::exp(-per_attribute_ *
                             static_cast<double>((colors_[nodes[k]] - color).squaredNorm()));
    }
    sum += w * static_cast<double>(node.deviation);
    total += w;
  }
  return total > 0.0 ? sum / total : 0.0;
}

}  // namespace field_phenotyping
