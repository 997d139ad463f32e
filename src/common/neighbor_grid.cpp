#include "field_phenotyping/common/neighbor_grid.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>

namespace field_phenotyping {
namespace {

constexpr int kMaxCellsPerAxis = 1 << 21;

}  // namespace

NeighborGrid::NeighborGrid(const std::vector<Eigen::Vector3f>& points, float cell) : cell_(cell) {
  if (!(cell > 0.0F)) throw std::invalid_argument("NeighborGrid: the cell size must be positive");
  if (points.empty()) return;

  Eigen::Array3f low = points.front().array();
  Eigen::Array3f high = low;
  for (const Eigen::Vector3f& point : points) {
    low = low.min(point.array());
    high = high.max(point.array());
  }
  if (!((high - low) / cell_ < static_cast<float>(kMaxCellsPerAxis)).all()) {
    throw std::invalid_argument("NeighborGrid: extent over 2^21 cells, or a point is not finite");
  }
  corner_ = low;
  cells_ = ((high - low) / cell_).floor().cast<int>() + 1;

  const auto nx = static_cast<std::uint64_t>(cells_.x());
  const auto ny = static_cast<std::uint64_t>(cells_.y());
  std::vector<std::uint64_t> keys(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Array3i c = clampedCell(points[i].array());
    keys[i] = (static_cast<std::uint64_t>(c.z()) * ny + static_cast<std::uint64_t>(c.y())) * nx +
              static_cast<std::uint64_t>(c.x());
  }
  order_.resize(points.size());
  std::iota(order_.begin(), order_.end(), 0U);
  // Ties by source index, so that the order depends on the points alone.
  std::sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
    return keys[a] != keys[b] ? keys[a] < keys[b] : a < b;
  });
  keys_.resize(points.size());
  points_.resize(points.size());
  for (std::size_t k = 0; k < order_.size(); ++k) {
    keys_[k] = keys[order_[k]];
    points_[k] = points[order_[k]];
  }

  const std::uint64_t columns = ny * static_cast<std::uint64_t>(cells_.z());
  constexpr std::uint64_t kColumnsPerPoint = 8U;
  if (columns > kColumnsPerPoint * points.size() + 4096U) return;
  column_begin_.assign(columns + 1U, 0U);
  for (const std::uint64_t key : keys_) ++column_begin_[key / nx + 1U];
  std::partial_sum(column_begin_.begin(), column_begin_.end(), column_begin_.begin());
}

Eigen::Array3i NeighborGrid::clampedCell(const Eigen::Array3f& position) const {
  const Eigen::Array3f scaled = ((position - corner_) / cell_).floor();
  return scaled.max(Eigen::Array3f::Zero()).min((cells_ - 1).cast<float>()).cast<int>();
}

NeighborGrid::Run NeighborGrid::findRun(int low_x, int high_x, int y, int z) const {
  if (points_.empty()) return {0U, 0U};
  const auto nx = static_cast<std::uint64_t>(cells_.x());
  const std::uint64_t column =
      static_cast<std::uint64_t>(z) * static_cast<std::uint64_t>(cells_.y()) +
      static_cast<std::uint64_t>(y);
  auto first = keys_.begin();
  auto last = keys_.end();
  if (!column_begin_.empty()) {
    first = keys_.begin() + column_begin_[column];
    last = keys_.begin() + column_begin_[column + 1U];
  }
  const auto begin = std::lower_bound(first, last, column * nx + static_cast<std::uint64_t>(low_x));
  const auto end = std::upper_bound(begin, last, column * nx + static_cast<std::uint64_t>(high_x));
  return {static_cast<std::uint32_t>(begin - keys_.begin()),
          static_cast<std::uint32_t>(end - keys_.begin())};
}

}  // namespace field_phenotyping
