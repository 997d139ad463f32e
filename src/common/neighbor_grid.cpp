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
  rows_y_ = static_cast<std::size_t>(last_.y()) + 1U;

  std::vector<std::uint64_t> row_of(points.size());
  std::vector<int> cell_x(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::array<int, 3> cell = cellsOf(points[i]);
    cell_x[i] = cell[0];
    row_of[i] = static_cast<std::uint64_t>(cell[2]) * rows_y_ + static_cast<std::uint64_t>(cell[1]);
  }

  // By row, then by cell; ties by source index, so that the order depends on the points alone.
  const auto before = [&](std::uint32_t a, std::uint32_t b) {
    if (row_of[a] != row_of[b]) return row_of[a] < row_of[b];
    return cell_x[a] != cell_x[b] ? cell_x[a] < cell_x[b] : a < b;
  };
  order_.resize(points.size());
  const std::size_t rows = rows_y_ * (static_cast<std::size_t>(last_.z()) + 1U);
  constexpr std::size_t kBucketsPerPoint = 8U;
  const std::size_t most_buckets = kBucketsPerPoint * points.size() + 4096U;
  if (rows <= most_buckets) {
    const auto buckets = [&] {
      return (static_cast<std::size_t>(last_.x()) >> bucket_shift_) + 1U;
    };
    while (rows * buckets() > most_buckets) ++bucket_shift_;
    buckets_x_ = buckets();
    const auto bucketOf = [&](std::uint32_t i) {
      return row_of[i] * buckets_x_ + (static_cast<std::size_t>(cell_x[i]) >> bucket_shift_);
    };
    begin_.assign(rows * buckets_x_ + 1U, 0U);
    for (std::uint32_t i = 0; i < points.size(); ++i) ++begin_[bucketOf(i) + 1U];
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    std::vector<std::uint32_t> next(begin_.begin(), begin_.end() - 1);
    for (std::uint32_t i = 0; i < points.size(); ++i) order_[next[bucketOf(i)]++] = i;
    if (bucket_shift_ > 0U) {
      for (std::size_t bucket = 0; bucket + 1U < begin_.size(); ++bucket) {
        if (begin_[bucket + 1U] - begin_[bucket] < 2U) continue;
        std::sort(order_.begin() + begin_[bucket], order_.begin() + begin_[bucket + 1U], before);
      }
    }
  } else {
    std::iota(order_.begin(), order_.end(), 0U);
    std::sort(order_.begin(), order_.end(), before);
    rows_.resize(points.size());
    for (std::size_t k = 0; k < order_.size(); ++k) rows_[k] = row_of[order_[k]];
  }
  cell_x_.resize(points.size());
  for (std::vector<float>* values : {&x_, &y_, &z_}) values->resize(points.size() + kLanes);
  for (std::size_t k = 0; k < order_.size(); ++k) {
    const Eigen::Vector3f& point = points[order_[k]];
    cell_x_[k] = cell_x[order_[k]];
    x_[k] = point.x();
    y_[k] = point.y();
    z_[k] = point.z();
  }
}

NeighborGrid::Run NeighborGrid::searchRun(int low_x, int high_x, std::size_t row) const {
  const auto range = std::equal_range(rows_.begin(), rows_.end(), row);
  const auto first = cell_x_.begin() + (range.first - rows_.begin());
  const auto last = cell_x_.begin() + (range.second - rows_.begin());
  const auto begin = std::lower_bound(first, last, low_x);
  const auto end = std::upper_bound(begin, last, high_x);
  return {static_cast<std::uint32_t>(begin - cell_x_.begin()),
          static_cast<std::uint32_t>(end - cell_x_.begin())};
}

}  // namespace field_phenotyping
