#include "field_phenotyping/preprocessing/voxel_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <set>
#include <stdexcept>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/xyz.hpp"
#include "preprocessing/voxel_gpu.hpp"

namespace field_phenotyping {
namespace {

Place placeOf(const Eigen::Vector3f& p) {
  return {p.x(), p.y(), p.z()};
}

/// Appends one with a quarter of room at most, where vectors by themselves leave up to a half: most
/// of the memory of a drive is that of voxels.
template <class Value>
void appendTight(std::vector<Value>& values, const Value& value) {
  constexpr std::size_t kLeast = 64U;
  if (values.size() == values.capacity()) {
    values.reserve(values.size() + values.size() / 4U + kLeast);
  }
  values.push_back(value);
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
  const VoxelKey key = voxelKey(p, voxel_size);
  slots_.makeRoom(keys_, 1U);
  const std::uint32_t voxel = slots_.find(key, VoxelSlots::hashOf(key), keys_);
  const bool is_new = voxel == voxels_.size();
  if (is_new) {
    appendTight(keys_, key);
    appendTight(voxels_, VoxelMean());
  }
  voxels_[voxel].add(placeOf(p));
  if (with_color) {
    colors_.resize(voxels_.size());
    auto& sums = colors_[voxel];
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
      keys_.assign(found.keys, found.keys + found.count);
    });
    if (done) return;
  }
  if (voxels_.empty()) {
    fill(points, voxel_size);
    return;
  }
  for (const Eigen::Vector3f& p : points) insert(p, voxel_size, false, 0U);
}

void VoxelTile::fill(const std::vector<Eigen::Vector3f>& points, float voxel_size) {
  voxels_.reserve(points.size());
  keys_.reserve(points.size());
  VoxelSlots slots;  // not kept: hardly any point follows
  slots.makeRoom(keys_, points.size());
  const float* xyz = xyzOf(points);
  constexpr std::size_t kBatch = 64U;  // of slots that are on their way from memory at once
  std::array<std::int32_t, 3U * kBatch> cells;
  std::array<VoxelKey, kBatch> keys;
  std::array<std::uint64_t, kBatch> hashes;
  for (std::size_t begin = 0; begin < points.size(); begin += keys.size()) {
    const std::size_t count = std::min(keys.size(), points.size() - begin);
    for (std::size_t c = 0; c < 3U * count; ++c) {
      cells[c] = voxelOnAxis(xyz[3U * begin + c], voxel_size);
    }
    for (std::size_t k = 0; k < count; ++k) {
      keys[k] = voxelKeyOf(cells[3U * k], cells[3U * k + 1U], cells[3U * k + 2U]);
      hashes[k] = VoxelSlots::hashOf(keys[k]);
      slots.fetch(hashes[k]);
    }
    for (std::size_t k = 0; k < count; ++k) {
      const std::uint32_t voxel = slots.find(keys[k], hashes[k], keys_);
      if (voxel == voxels_.size()) {
        keys_.push_back(keys[k]);
        // Put together where it stays: from the stack it would be read while it is still written.
        VoxelMean& mean = voxels_.emplace_back();
        mean = VoxelMean::of(placeOf(points[begin + k]));
      } else {
        voxels_[voxel].add(placeOf(points[begin + k]));
      }
    }
  }
}

void VoxelTile::rest() {
  slots_ = {};
  keys_.shrink_to_fit();
  voxels_.shrink_to_fit();
  colors_.shrink_to_fit();
  origins_.shrink_to_fit();
  origin_.shrink_to_fit();
}

void VoxelTile::noteOrigin(const Eigen::Vector3f& sensor) {
  if (origins_.empty() || origins_.back() != sensor) {
    if (origins_.size() >= kNoScanOrigin) return;
    origins_.push_back(sensor);
  }
  while (origin_.size() < voxels_.size()) appendTight(origin_, kNoScanOrigin);
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
  // Rounded down by hand, which takes a fraction of a call of std::floor().
  const auto along = [this](double from_corner) {
    const double at = from_corner / tile_size_;
    const auto whole = static_cast<std::int32_t>(at);
    return whole - (static_cast<double>(whole) > at ? 1 : 0);
  };
  return {along(x - tile_corner_.x()), along(y - tile_corner_.y())};
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

PointCloud VoxelMap::extract(const std::vector<BlockIndex>& wanted, double margin) const {
  PointCloud cloud;
  if (wanted.empty()) return cloud;
  const int rings = static_cast<int>(std::ceil(margin / tile_size_));
  std::set<std::pair<std::int32_t, std::int32_t>> near;  // y, x: row by row
  BlockIndex low = wanted.front();
  BlockIndex high = wanted.front();
  for (const BlockIndex& index : wanted) {
    low = {std::min(low.x, index.x), std::min(low.y, index.y)};
    high = {std::max(high.x, index.x), std::max(high.y, index.y)};
    for (int dy = -rings; dy <= rings; ++dy) {
      for (int dx = -rings; dx <= rings; ++dx) near.emplace(index.y + dy, index.x + dx);
    }
  }
  cloud.origin = 0.5 * (originOf(low) + originOf(high));
  const auto reach = static_cast<float>(0.5 * tile_size_ + margin);
  const bool any_color = std::any_of(near.begin(), near.end(), [&](const auto& index) {
    const VoxelTile* tile = find({index.second, index.first});
    return tile != nullptr && tile->hasColors();
  });
  bool any_origin = false;
  for (const auto& [y, x] : near) {
    const VoxelTile* tile = find({x, y});
    if (tile == nullptr) continue;
    any_origin = any_origin || !tile->origins().empty();
    std::vector<Eigen::Vector2f> centers;  // of the wanted tiles that may reach its points
    for (const BlockIndex& index : wanted) {
      if (std::max(std::abs(index.x - x), std::abs(index.y - y)) > rings) continue;
      centers.push_back((originOf(index) - cloud.origin).head<2>().cast<float>());
    }
    std::vector<std::uint16_t> place_of(tile->origins().size(), kNoScanOrigin);
    const Eigen::Vector3f shift = (originOf({x, y}) - cloud.origin).cast<float>();
    for (std::size_t i = 0; i < tile->size(); ++i) {
      const Eigen::Vector3f p = tile->centroid(i) + shift;
      const bool reached = std::any_of(centers.begin(), centers.end(), [&](const auto& center) {
        return (p.head<2>() - center).cwiseAbs().maxCoeff() <= reach;
      });
      if (!reached) continue;
      cloud.points.push_back(p);
      if (any_color) cloud.colors.push_back(tile->color(i));
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
  if (!any_origin) cloud.scan_origin.clear();
  return cloud;
}

}  // namespace field_phenotyping
