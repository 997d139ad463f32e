#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"

namespace field_phenotyping {

/// Which square tile of the scene; tile (i, j) covers [i, i+1) x [j, j+1) tile sizes from the
/// corner of tile (0, 0).
struct BlockIndex {
  std::int32_t x = 0;
  std::int32_t y = 0;

  friend bool operator==(const BlockIndex& a, const BlockIndex& b) {
    return a.x == b.x && a.y == b.y;
  }
  friend bool operator<(const BlockIndex& a, const BlockIndex& b) {
    return a.x != b.x ? a.x < b.x : a.y < b.y;
  }
};

/// Whether two tiles are the same, or share an edge or a corner.
inline bool areNeighbors(const BlockIndex& a, const BlockIndex& b) {
  return std::abs(a.x - b.x) <= 1 && std::abs(a.y - b.y) <= 1;
}

/// What every value that travels from stage to stage says about itself.
struct BlockHeader {
  std::uint64_t stamp_ns = 0U;  ///< time of the newest scan in the block [ns since the epoch]
  std::uint64_t began_ns = 0U;  ///< time of its first scan: names the pass that it was seen in
  std::uint64_t due_ns = 0U;    ///< wall time at which it was worth working; 0: not known
  std::string frame_id;         ///< frame of all positions: z up, metres
  BlockIndex index;
  std::uint32_t revision = 0U;  ///< counts how often this block has been handed on, from 1
  bool final = false;           ///< no further scan is expected to reach this block
  bool draft = false;           ///< thinned so that first values come soon; better ones follow
  double tile_size = 4.0;       ///< [m]
  Eigen::Vector2d tile_corner = Eigen::Vector2d::Zero();  ///< of tile (0, 0) [m], in the map frame
  double margin = 0.6;  ///< [m] of what is around, that goes with the tile or its part
  /// What a draft is about [m], in the map frame, where it is a part of the tile: the tile's other
  /// plants are what they were last said to be. Empty: the whole tile.
  Eigen::AlignedBox2d part;

  /// Least x and y of the tile in the map frame [m].
  Eigen::Vector2d lowCorner() const {
    return tile_corner + tile_size * Eigen::Vector2d(index.x, index.y);
  }

  bool isPart() const { return !part.isEmpty(); }

  /// What it is about: the tile, or the part of it.
  Eigen::AlignedBox2d extent() const {
    if (isPart()) return part;
    const Eigen::Vector2d low = lowCorner();
    return {low, low + Eigen::Vector2d::Constant(tile_size)};
  }

  /// Whether (x, y) of the map frame lies in what it is about, or within `tolerance` [m] of it.
  bool holds(double x, double y, double tolerance = 0.0) const {
    const Eigen::AlignedBox2d box = extent();
    return x >= box.min().x() - tolerance && x < box.max().x() + tolerance &&
           y >= box.min().y() - tolerance && y < box.max().y() + tolerance;
  }
};

/// One tile of the scene with a margin of its neighbours, ready for segmentation: denoised, the
/// soil taken out. Or several tiles that adjoin, with one margin about all of them, for what lies
/// between them is worked once then. Immutable once handed on.
struct Block {
  BlockHeader header;                ///< of joined tiles: of the first, as old as the youngest
  std::vector<BlockHeader> joined;   ///< what each of joined tiles says of itself; empty: one tile
  PointCloud cloud;                  ///< above-ground points only; large ones in spatialOrder()
  GroundModel ground;                ///< in the local frame of `cloud`
  std::uint32_t ground_points = 0U;  ///< soil points that were taken out
  PointCloud feet;                   ///< those beside what stands there: its foot may be among them
  PointCloud isolated;  ///< above the soil, taken out as outliers: sparse organs may be among them

  /// What its tiles say of themselves: one, unless several were joined.
  std::vector<BlockHeader> tiles() const {
    return joined.empty() ? std::vector<BlockHeader>{header} : joined;
  }

  /// Whether (x, y) of the map frame lies in one of its tiles, or within `tolerance` [m] of one.
  bool holds(double x, double y, double tolerance = 0.0) const {
    const auto has = [&](const BlockHeader& tile) { return tile.holds(x, y, tolerance); };
    return joined.empty() ? has(header) : std::any_of(joined.begin(), joined.end(), has);
  }
};

}  // namespace field_phenotyping
