#include "field_phenotyping/common/neighbor_grid.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "field_phenotyping/common/bounds.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/partitioned.hpp"

namespace field_phenotyping {
namespace {

constexpr int kMaxCellsPerAxis = 1 << 21;

}  // namespace

GridGeometry gridGeometry(const std::vector<Eigen::Vector3f>& points, float cell) {
  if (!(cell > 0.0F)) throw std::invalid_argument("NeighborGrid: the cell size must be positive");
  const Bounds nowhere{Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()};
  const auto [low, high] = points.empty() ? nowhere : boundsOf(points);
  if (!((high - low).array() / cell < static_cast<float>(kMaxCellsPerAxis)).all()) {
    throw std::invalid_argument("NeighborGrid: extent over 2^21 cells, or a point is not finite");
  }
  GridGeometry geometry;
  geometry.cell = cell;
  geometry.inverse_cell = 1.0F / cell;
  for (int axis = 0; axis < 3; ++axis) {
    geometry.corner[axis] = low[axis];
    geometry.last[axis] = std::floor((high[axis] - low[axis]) / cell);
  }
  constexpr float kRounding = 1e-6F;  // of the coordinates: several units in the last place
  geometry.slack =
      kRounding * ((high - low).maxCoeff() + low.cwiseAbs().cwiseMax(high.cwiseAbs()).maxCoeff());
  geometry.rows_y = static_cast<std::uint64_t>(geometry.last[1]) + 1U;

  const std::uint64_t rows = geometry.rows_y * (static_cast<std::uint64_t>(geometry.last[2]) + 1U);
  constexpr std::uint64_t kBucketsPerPoint = 8U;
  constexpr std::uint64_t kMostBuckets = 0xFFFFFFFFU;  // that their numbers hold
  const std::uint64_t most_buckets =
      std::min(kBucketsPerPoint * points.size() + 4096U, kMostBuckets);
  geometry.has_table = rows <= most_buckets;
  if (!geometry.has_table) return geometry;
  const auto buckets = [&] {
    return (static_cast<std::uint64_t>(geometry.last[0]) >> geometry.bucket_shift) + 1U;
  };
  while (rows * buckets() > most_buckets) ++geometry.bucket_shift;
  geometry.buckets_x = buckets();
  geometry.buckets = rows * geometry.buckets_x;
  return geometry;
}

NeighborGrid::NeighborGrid(const std::vector<Eigen::Vector3f>& points, float cell)
    : geometry_(gridGeometry(points, cell)) {
  if (points.empty()) return;
  order_.resize(points.size());
  if (!geometry_.has_table || geometry_.bucket_shift > 0U) cell_x_.resize(points.size());
  for (UnsetVector<float>* values : {&x_, &y_, &z_}) {
    values->resize(points.size() + kLanes);
    std::fill(values->end() - kLanes, values->end(), 0.0F);
  }
  if (geometry_.has_table) {
    sortByBuckets(points);
  } else {
    sortByRows(points);
  }
}

/// Copies the points number `begin` ... `end` - 1 of those that are sorted.
void NeighborGrid::copyPoints(const std::vector<Eigen::Vector3f>& points, std::size_t begin,
                              std::size_t end) {
  for (std::size_t k = begin; k < end; ++k) {
    const Eigen::Vector3f& point = points[order_[k]];
    if (!cell_x_.empty()) cell_x_[k] = geometry_.cellOf(point.x(), 0);
    x_[k] = point.x();
    y_[k] = point.y();
    z_[k] = point.z();
  }
}

std::uint64_t NeighborGrid::rowOf(const Eigen::Vector3f& point) const {
  return geometry_.rowOf(geometry_.cellOf(point.y(), 1), geometry_.cellOf(point.z(), 2));
}

void NeighborGrid::sortByBuckets(const std::vector<Eigen::Vector3f>& points) {
  // Points are partitioned by ranges of buckets, each a power of two long.
  constexpr std::size_t kFew = 16384U;  // points that one thread sorts
  constexpr std::uint64_t kMostPartitions = 128U;
  const std::uint64_t most = points.size() <= kFew ? 1U : kMostPartitions;
  unsigned shift = 0U;
  while ((geometry_.buckets - 1U) >> shift >= most) ++shift;
  struct Member {
    std::uint32_t bucket;
    std::uint32_t point;
  };
  const Partitioned<Member> members(points.size(), ((geometry_.buckets - 1U) >> shift) + 1U,
                                    [&](std::size_t begin, std::size_t end, const auto& give) {
                                      for (std::size_t i = begin; i < end; ++i) {
                                        const std::uint64_t bucket = geometry_.bucketOf(
                                            geometry_.cellOf(points[i].x(), 0), rowOf(points[i]));
                                        give(bucket >> shift, {static_cast<std::uint32_t>(bucket),
                                                               static_cast<std::uint32_t>(i)});
                                      }
                                    });
  std::vector<std::uint32_t> first(members.partitions() + 1U, 0U);  // point of each
  for (std::size_t p = 0; p < members.partitions(); ++p) {
    first[p + 1U] = first[p] + static_cast<std::uint32_t>(members.sizeOf(p));
  }
  begin_.resize(geometry_.buckets + 1U);
  begin_.back() = first.back();
  const auto before = [&](std::uint32_t a, std::uint32_t b) {
    const int cell_a = geometry_.cellOf(points[a].x(), 0);
    const int cell_b = geometry_.cellOf(points[b].x(), 0);
    return cell_a != cell_b ? cell_a < cell_b : a < b;
  };
  parallelFor(members.partitions(), [&](std::size_t p) {
    const std::size_t low = p << shift;
    const std::size_t high = std::min(low + (std::size_t{1} << shift), geometry_.buckets);
    std::fill(begin_.data() + low, begin_.data() + high, 0U);
    members.forEachOf(p, [&](const Member& member) { ++begin_[member.bucket]; });
    // Where each bucket ends is counted back while it is filled, to where it begins.
    std::uint32_t end = first[p];
    for (std::size_t bucket = low; bucket < high; ++bucket) {
      end += begin_[bucket];
      begin_[bucket] = end;
    }
    members.forEachBackwards(
        p, [&](const Member& member) { order_[--begin_[member.bucket]] = member.point; });
    for (std::size_t bucket = low; geometry_.bucket_shift > 0U && bucket < high; ++bucket) {
      const std::uint32_t next = bucket + 1U < high ? begin_[bucket + 1U] : first[p + 1U];
      std::sort(order_.begin() + begin_[bucket], order_.begin() + next, before);
    }
    copyPoints(points, first[p], first[p + 1U]);
  });
}

void NeighborGrid::sortByRows(const std::vector<Eigen::Vector3f>& points) {
  std::vector<std::uint64_t> row_of(points.size());
  std::vector<int> cell_x(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    row_of[i] = rowOf(points[i]);
    cell_x[i] = geometry_.cellOf(points[i].x(), 0);
  }
  std::iota(order_.begin(), order_.end(), 0U);
  std::sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
    if (row_of[a] != row_of[b]) return row_of[a] < row_of[b];
    return cell_x[a] != cell_x[b] ? cell_x[a] < cell_x[b] : a < b;
  });
  rows_.resize(points.size());
  for (std::size_t k = 0; k < order_.size(); ++k) rows_[k] = row_of[order_[k]];
  copyPoints(points, 0U, points.size());
}

}  // namespace field_phenotyping
