#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <map>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/preprocessing/voxel_slots.hpp"
#include "field_phenotyping/preprocessing/voxel_team.hpp"

namespace field_phenotyping {

/// Key of a voxel within its tile: 21 bits an axis, so coordinates of 0.003 m voxels may lie within
/// +-3145 m of the tile's local origin.
using VoxelKey = std::uint64_t;

/// Whether local position `p` can have a key.
bool hasVoxelKey(const Eigen::Vector3f& p, float voxel_size);

/// Key of the voxel that holds local position `p`.
/// @throws std::out_of_range when it can have none
VoxelKey voxelKey(const Eigen::Vector3f& p, float voxel_size);

/// The voxels of one square tile: each keeps the centroid of all points that ever fell into it
/// (2.3.1). Positions are local to the tile's origin.
class VoxelTile {
 public:
  /// Adds a point; returns whether it opened a new voxel. `color` is ignored without `with_color`.
  bool insert(const Eigen::Vector3f& p, float voxel_size, bool with_color, std::uint32_t color);

  /// Adds points without colour, with the same result as one after the other. All must have a key.
  /// A GPU takes those of a tile that holds none yet.
  void insertAll(const std::vector<Eigen::Vector3f>& points, float voxel_size,
                 const ComputeDevice& device);

  /// Notes where the sensor was when it saw the point that opened the newest voxel [m].
  void noteOrigin(const Eigen::Vector3f& sensor);

  /// Gives back what memory only further points would need; they can be added all the same, the
  /// first of them at the cost of all voxels.
  void rest();

  /// Centroids in the order in which their voxels were opened.
  Eigen::Vector3f centroid(std::size_t i) const {
    const Place& mean = voxels_[i].mean;
    return {mean.x, mean.y, mean.z};
  }
  std::uint32_t color(std::size_t i) const;

  /// Where the sensor was, scan by scan, as far as scans opened voxels.
  const std::vector<Eigen::Vector3f>& origins() const { return origins_; }
  /// Of a voxel's first point, in origins(); kNoScanOrigin: not known.
  std::uint16_t origin(std::size_t i) const {
    return i < origin_.size() ? origin_[i] : kNoScanOrigin;
  }

  std::size_t size() const { return voxels_.size(); }
  bool hasColors() const { return !colors_.empty(); }

 private:
  void fill(const std::vector<Eigen::Vector3f>& points, float voxel_size);

  VoxelSlots slots_;            // of all voxels or, where no point is added, none
  std::vector<VoxelKey> keys_;  // of voxels_
  std::vector<VoxelMean> voxels_;
  std::vector<std::array<std::uint64_t, 4>> colors_;  // sums of red, green, blue; how many
  std::vector<Eigen::Vector3f> origins_;
  std::vector<std::uint16_t> origin_;  // of the voxels, as far as any is known
};

/// Tiles by index, each with its place in the map frame. Tiles open as points arrive.
class VoxelMap {
 public:
  /// @param tile_corner of tile (0, 0) [m], in the map frame
  VoxelMap(double tile_size, double voxel_size,
           const Eigen::Vector2d& tile_corner = Eigen::Vector2d::Zero());

  /// Index of the tile that holds (x, y) of the map frame.
  BlockIndex tileAt(double x, double y) const;
  /// Local origin of a tile in the map frame: its centre, at the map's height datum.
  Eigen::Vector3d originOf(const BlockIndex& index) const;

  /// Points of tiles and of their neighbours, as far as they lie within `margin` [m] of one of the
  /// tiles. The cloud's origin is in the middle of the tiles.
  PointCloud extract(const std::vector<BlockIndex>& wanted, double margin) const;

  VoxelTile& tile(const BlockIndex& index) { return tiles_[index]; }
  const VoxelTile* find(const BlockIndex& index) const;
  void erase(const BlockIndex& index);

  /// The datum keeps local z small; set it once, before the first point.
  void setHeightDatum(double z) { height_datum_ = z; }
  double tileSize() const { return tile_size_; }
  float voxelSize() const { return static_cast<float>(voxel_size_); }
  const std::map<BlockIndex, VoxelTile>& tiles() const { return tiles_; }

 private:
  double tile_size_;
  double voxel_size_;
  Eigen::Vector2d tile_corner_;
  double height_datum_ = 0.0;
  std::map<BlockIndex, VoxelTile> tiles_;
};

}  // namespace field_phenotyping
