#include "field_phenotyping/preprocessing/voxel_groups.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "common/xyz.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/preprocessing/voxel_slots.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kChunk = 16384U;  // points of a task

}  // namespace

VoxelGroups::VoxelGroups(const std::vector<Eigen::Vector3f>& points, float edge)
    : points_(points), members_(partition(edge)), voxels_(members_.partitions()) {
  parallelFor(voxels_.size(), [&](std::size_t p) { numberWithin(p); });
  numberAll();
}

/// A column of 16 by 16 voxels is in one partition: what is near lies side by side in its tables.
Partitioned<VoxelGroups::Member> VoxelGroups::partition(float edge) const {
  constexpr std::size_t kUsual = 8192U;  // points of a partition
  constexpr unsigned kMostBits = 7U;
  unsigned bits = 0U;  // of a partition's number
  while (bits < kMostBits && (kUsual << bits) < points_.size()) ++bits;
  const auto partitionOf = [bits](std::uint64_t key) {
    constexpr unsigned kAxisBits = 21U;
    constexpr unsigned kColumnBits = 4U;
    constexpr std::uint64_t kWithin = ((1U << kColumnBits) - 1U) << (kAxisBits - kColumnBits);
    const std::uint64_t column = key >> (kAxisBits + kColumnBits) & ~kWithin;
    return VoxelSlots::hashOf(column) >> 1U >> (63U - bits);
  };
  const float* xyz = xyzOf(points_);
  return {points_.size(), std::size_t{1} << bits,
          [&](std::size_t begin, std::size_t end, const auto& give) {
            constexpr std::size_t kBatch = 64U;  // whose voxels are computed several at once
            std::array<std::int32_t, 3U * kBatch> cells;
            for (; begin < end; begin += kBatch) {
              const std::size_t count = std::min(kBatch, end - begin);
              for (std::size_t c = 0; c < 3U * count; ++c) {
                cells[c] = voxelOnAxis(xyz[3U * begin + c], edge);
              }
              for (std::size_t k = 0; k < count; ++k) {
                const std::uint64_t key =
                    voxelKeyOf(cells[3U * k], cells[3U * k + 1U], cells[3U * k + 2U]);
                give(partitionOf(key), {key, static_cast<std::uint32_t>(begin + k), 0U});
              }
            }
          }};
}

/// Numbers a partition's voxels as its points meet them, and notes the first point of each.
void VoxelGroups::numberWithin(std::size_t partition) {
  const std::size_t count = members_.sizeOf(partition);
  std::vector<std::uint64_t> keys(count);
  std::vector<std::uint32_t> first(count);
  VoxelSlots slots;
  slots.makeRoom({}, count);
  std::uint32_t next = 0U;
  members_.forEachOf(partition, [&](Member& member) {
    member.voxel = slots.find(member.key, VoxelSlots::hashOf(member.key), keys);
    if (member.voxel < next) return;
    keys[next] = member.key;
    first[next++] = member.point;
  });
  first.resize(next);
  voxels_[partition] = std::move(first);
}

/// Numbers all voxels by their first points, which `voxels_` holds so far.
void VoxelGroups::numberAll() {
  std::vector<std::uint32_t> number(points_.size(), 0U);  // of the voxel that a point opens
  parallelFor(voxels_.size(), [&](std::size_t p) {
    for (const std::uint32_t point : voxels_[p]) number[point] = 1U;
  });
  std::vector<std::uint32_t> before(chunksOf(points_.size(), kChunk) + 1U, 0U);  // each chunk
  parallelChunks(points_.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    std::uint32_t opened = 0U;
    for (std::size_t i = begin; i < end; ++i) opened += number[i];
    before[begin / kChunk + 1U] = opened;
  });
  for (std::size_t c = 1U; c < before.size(); ++c) before[c] += before[c - 1U];
  first_.resize(before.back());
  parallelChunks(points_.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    std::uint32_t next = before[begin / kChunk];
    for (std::size_t i = begin; i < end; ++i) {
      if (number[i] == 0U) continue;
      first_[next] = static_cast<std::uint32_t>(i);
      number[i] = next++;
    }
  });
  parallelFor(voxels_.size(), [&](std::size_t p) {
    for (std::uint32_t& voxel : voxels_[p]) voxel = number[voxel];
  });
}

std::vector<std::uint32_t> VoxelGroups::ofPoints() const {
  std::vector<std::uint32_t> of_point(points_.size());
  parallelFor(voxels_.size(), [&](std::size_t p) {
    members_.forEachOf(
        p, [&](const Member& member) { of_point[member.point] = voxels_[p][member.voxel]; });
  });
  return of_point;
}

std::vector<VoxelMean> VoxelGroups::means() const {
  std::vector<VoxelMean> means(size());
  parallelFor(voxels_.size(), [&](std::size_t p) {
    members_.forEachOf(p, [&](const Member& member) {
      const Eigen::Vector3f& point = points_[member.point];
      const Place place{point.x(), point.y(), point.z()};
      VoxelMean& mean = means[voxels_[p][member.voxel]];
      if (mean.count == 0U) {
        mean = VoxelMean::of(place);
      } else {
        mean.add(place);
      }
    });
  });
  return means;
}

}  // namespace field_phenotyping
