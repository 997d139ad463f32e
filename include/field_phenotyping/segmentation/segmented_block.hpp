#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// One region of a stem's growth: what was decided about it, for whoever wants to see.
struct RegionSummary {
  Eigen::Vector3f start = Eigen::Vector3f::Zero();  ///< s_0, local frame [m]
  Eigen::Vector3f end = Eigen::Vector3f::Zero();    ///< s_n [m]
  float M = 0.0F;                                   ///< similarity threshold of the segment
  bool branching = false;                           ///< at a node or where an organ leaves the stem
  bool merged = false;                              ///< joined the stem
  std::uint32_t points = 0U;                        ///< grown, before pruning
};

/// How well a stem was segmented, and with which parameters (paper Eq 7-14).
struct GrowthSummary {
  float quality = 0.0F;  ///< Q of Eq 9, in [0, 1]
  std::uint32_t iterations = 0U;
  float r1 = 0.0F;  ///< growth radius [m]
  float M = 0.0F;   ///< similarity threshold; segments have a share of it
  float alpha = 0.0F;
  float beta = 0.0F;
  /// From the base up. For people to look at: no stage reads them, and between processes they are
  /// not sent, so that they are empty there.
  std::vector<RegionSummary> regions;
};

/// One plant of a block.
struct Plant {
  std::int32_t id = -1;  ///< unique in the map frame; -1 before the registry has named it
  bool owned = true;     ///< this block reports it; if not, it is a neighbouring block's plant
  IndexSpan points;      ///< all its points in the block's cloud; the stem's come first
  IndexSpan stem;        ///< its stem points: a prefix of `points`
  StemAxis axis;
  Eigen::Vector3f base = Eigen::Vector3f::Zero();  ///< where the axis meets the soil [m], local
  /// Standard deviation of its highest point, by the doubt whose the organs up there are [m].
  float top_stddev = 0.0F;
  GrowthSummary growth;
};

/// A block whose points have been given to plants. `cloud` holds the block's points reordered:
/// plant by plant, stem points first, what belongs to no plant last; and the stems' lowest points,
/// out of the block's `feet`, and plants' points out of its `isolated`. Immutable once handed on.
struct SegmentedBlock {
  BlockHeader header;
  PointCloud cloud;
  GroundModel ground;
  std::vector<Plant> plants;
  /// Of each point, in the `Block`: of its cloud, or, counted on, of its `feet` or its `isolated`.
  std::vector<std::uint32_t> source_index;
};

}  // namespace field_phenotyping
