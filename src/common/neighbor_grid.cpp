#include "field_phenotyping/common/neighbor_grid.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>

namespace field_phenotyping {
namespace {

constexpr int kMaxCellsPerAxis = 1 << 21;

}  // namespace

NeighborGrid::NeighborGrid(const std::vector<Eigen::Vector3f>& points, float cell)
    : cell_(cell), inverse_cell_(1.0F / cell) {
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
  last_ = ((high - low) / cell_).floor();
  constexpr float kRounding = 1e-6F;  // of the coordinates: several units in the last place
  slack_ = kRounding * ((high - low).maxCoeff() + low.abs().max(high.abs()).maxCoeff());
  columns_y_ = static_cast<std::size_t>(last_.y()) + 1U;

  const std::size_t columns = columns_y_ * (static_cast<std::size_t>(last_.z()) + 1U);
  std::vector<std::uint64_t> column_of(points.size());
  std::vector<int> cell_x(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Array3f at = (points[i].array() - corner_) / cell_;
    cell_x[i] = static_cast<int>(at.x());
    column_of[i] =
        static_cast<std::uint64_t>(at.z()) * columns_y_ + static_cast<std::uint64_t>(at.y());
  }

  // By column, then by cell; ties by source index, so that the order depends on the points alone.
  order_.resize(points.size());
  constexpr std::size_t kColumnsPerPoint = 8U;
  if (columns <= kColumnsPerPoint * points.size() + 4096U) {
    column_begin_.assign(columns + 1U, 0U);
    for (const std::uint64_t column : column_of) ++column_begin_[column + 1U];
    std::partial_sum(column_begin_.begin(), column_begin_.end(), column_begin_.begin());
    std::vector<std::uint32_t> next(column_begin_.begin(), column_begin_.end() - 1);
    for (std::uint32_t i = 0; i < points.size(); ++i) order_[next[column_of[i]]++] = i;
    for (std::size_t column = 0; column < columns; ++column) {
      std::sort(order_.begin() + column_begin_[column], order_.begin() + column_begin_[column + 1U],
                [&](std::uint32_t a, std::uint32_t b) {
                  return cell_x[a] != cell_x[b] ? cell_x[a] < cell_x[b] : a < b;
                });
    }
  } else {
    std::iota(order_.begin(), order_.end(), 0U);
    std::sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
      if (column_of[a] != column_of[b]) return column_of[a] < column_of[b];
      return cell_x[a] != cell_x[b] ? cell_x[a] < cell_x[b] : a < b;
    });
    columns_.resize(points.size());
    for (std::size_t k = 0; k < order_.size(); ++k) columns_[k] = column_of[order_[k]];
  }
  cell_x_.resize(points.size());
  points_.resize(points.size());
  for (std::size_t k = 0; k < order_.size(); ++k) {
    cell_x_[k] = cell_x[order_[k]];
    points_[k] = points[order_[k]];
  }
}

NeighborGrid::Run NeighborGrid::narrowRun(const Run& column, int low_x, int high_x) const {
  const auto first = cell_x_.begin() + column.begin;
  const auto last = cell_x_.begin() + column.end;
  const auto begin = std::lower_bound(first, last, low_x);
  const auto end = std::upper_bound(begin, last, high_x);
  return {static_cast<std::uint32_t>(begin - cell_x_.begin()),
          static_cast<std::uint32_t>(end - cell_x_.begin())};
}

NeighborGrid::Run NeighborGrid::searchRun(int low_x, int high_x, int y, int z) const {
  const std::uint64_t column =
      static_cast<std::uint64_t>(z) * columns_y_ + static_cast<std::uint64_t>(y);
  const auto range = std::equal_range(columns_.begin(), columns_.end(), column);
  return narrowRun({static_cast<std::uint32_t>(range.first - columns_.begin()),
                    static_cast<std::uint32_t>(range.second - columns_.begin())},
                   low_x, high_x);
}

}  // namespace field_phenotyping
