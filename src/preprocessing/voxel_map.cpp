#include "field_phenotyping/preprocessing/voxel_map.hpp"

#include <cmath>
#include <stdexcept>

#include "common/gpu_streams.hpp"
#include "common/xyz.hpp"
#include "preprocessing/voxel_gpu.hpp"

namespace field_phenotyping {
namespace {

Place placeOf(const Eigen::Vector3f& p) {
  return {p.x(), p.y(), p.z()};
}

}  // namespace

bool hasVoxelKey(const Eigen::Vector3f& p, float voxel_size) {
  return (p.array() / voxel_size).abs().maxCoeff() < kVoxelHalfRange - 1.0F;
}

VoxelKey voxelKey(const Eigen::Vector3f& p, float voxel_size) {
  if (!((p.array() / voxel_size).abs() < kVoxelHalfRange).all()) {
    throw std::out_of_range("a point lies over 2^20 voxels from its tile's origin");
  }
  return voxelKeyOf(placeOf(p), voxel_size);
}

bool VoxelTile::insert(const Eigen::Vector3f& p, float voxel_size, bool with_color,
                       std::uint32_t color) {
  indexVoxels();
  const auto [entry, is_new] =
      index_.tryEmplace(voxelKey(p, voxel_size), static_cast<std::uint32_t>(voxels_.size()));
  if (is_new) voxels_.emplace_back();
  voxels_[*entry].add(placeOf(p));
  if (with_color) {
    colors_.resize(voxels_.size());
    auto& sums = colors_[*entry];
    for (std::size_t channel = 0; channel < 3U; ++channel) {
      sums[channel] += color >> (16U - 8U * channel) & 0xFFU;
    }
    ++sums[3];
  }
  return is_new;
}

void VoxelTile::insertAll(const std::vector<Eigen::Vector3f>& points, float voxel_size,
                          const ComputeDevice& device) {
  if constexpr (kWithCuda) {
    const bool done = voxels_.empty() && device.attempt([&](GpuStream& stream) {
      const GpuVoxels found =
          voxelsOnGpu(stream, xyzOf(points), static_cast<std::uint32_t>(points.size()), voxel_size);
      voxels_.assign(found.voxels, found.voxels + found.count);
      not_indexed_.assign(found.keys, found.keys + found.count);
    });
    if (done) return;
  }
  for (const Eigen::Vector3f& p : points) insert(p, voxel_size, false, 0U);
}

void VoxelTile::indexVoxels() {
  for (std::uint32_t i = 0; i < not_indexed_.size(); ++i) index_.tryEmplace(not_indexed_[i], i);
  not_indexed_ = {};
}

void VoxelTile::noteOrigin(const Eigen::Vector3f& sensor) {
  if (origins_.empty() || origins_.back() != sensor) {
    if (origins_.size() >= kNoScanOrigin) return;
    origins_.push_back(sensor);
  }
  origin_.resize(voxels_.size(), kNoScanOrigin);
  origin_.back() = static_cast<std::uint16_t>(origins_.size() - 1U);
}

std::uint32_t VoxelTile::color(std::size_t i) const {
  if (i >= colors_.size() || colors_[i][3] == 0U) return 0U;
  const std::uint64_t count = colors_[i][3];
  const auto mean = [&](std::size_t channel) {
    return static_cast<std::uint32_t>(colors_[i][channel] / count);
  };
  return mean(0) << 16U | mean(1) << 8U | mean(2);
}

VoxelMap::VoxelMap(double tile_size, double voxel_size, const Eigen::Vector2d& tile_corner)
    : tile_size_(tile_size), voxel_size_(voxel_size), tile_corner_(tile_corner) {}

BlockIndex VoxelMap::tileAt(double x, double y) const {
  return {static_cast<std::int32_t>(std::floor((x - tile_corner_.x()) / tile_size_)),
          static_cast<std::int32_t>(std::floor((y - tile_corner_.y()) / tile_size_))};
}

Eigen::Vector3d VoxelMap::originOf(const BlockIndex& index) const {
  return {tile_corner_.x() + (index.x + 0.5) * tile_size_,
          tile_corner_.y() + (index.y + 0.5) * tile_size_, height_datum_};
}

const VoxelTile* VoxelMap::find(const BlockIndex& index) const {
  const auto found = tiles_.find(index);
  return found == tiles_.end() ? nullptr : &found->second;
}

void VoxelMap::erase(const BlockIndex& index) {
  tiles_.erase(index);
}

PointCloud VoxelMap::extract(const BlockIndex& index, double margin) const {
  PointCloud cloud;
  cloud.origin = originOf(index);
  const auto reach = static_cast<float>(0.5 * tile_size_ + margin);
  const int rings = static_cast<int>(std::ceil(margin / tile_size_));
  bool any_color = false;
  bool any_origin = false;
  for (int dy = -rings; dy <= rings; ++dy) {
    for (int dx = -rings; dx <= rings; ++dx) {
      const BlockIndex neighbor{index.x + dx, index.y + dy};
      const VoxelTile* tile = find(neighbor);
      if (tile == nullptr) continue;
      any_color = any_color || tile->hasColors();
      any_origin = any_origin || !tile->origins().empty();
      std::vector<std::uint16_t> place_of(tile->origins().size(), kNoScanOrigin);
      const Eigen::Vector3f shift = (originOf(neighbor) - cloud.origin).cast<float>();
      for (std::size_t i = 0; i < tile->size(); ++i) {
        const Eigen::Vector3f p = tile->centroid(i) + shift;
        if (std::abs(p.x()) > reach || std::abs(p.y()) > reach) continue;
        cloud.points.push_back(p);
        cloud.colors.push_back(tile->color(i));
        cloud.scan_origin.push_back(kNoScanOrigin);
        const std::uint16_t origin = tile->origin(i);
        if (origin == kNoScanOrigin) continue;
        std::uint16_t& place = place_of[origin];
        if (place == kNoScanOrigin && cloud.scan_origins.size() < kNoScanOrigin) {
          place = static_cast<std::uint16_t>(cloud.scan_origins.size());
          cloud.scan_origins.push_back(tile->origins()[origin] + shift);
        }
        cloud.scan_origin.back() = place;
      }
    }
  }
  if (!any_color) cloud.colors.clear();
  if (!any_origin) cloud.scan_origin.clear();
  return cloud;
}

}  // namespace field_phenotyping
