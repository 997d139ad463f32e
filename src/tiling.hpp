#pragma once

#include <Eigen/Core>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// How a whole cloud is cut into square tiles.
struct Tiling {
  double edge;             ///< [m]
  Eigen::Vector2d corner;  ///< of tile (0, 0) [m], in the map frame
};

/// Margins are worked by all tiles that they lie in: tiles begin where fewest cover the cloud, and
/// are up to half as wide again as `block_size` where that leaves less to work, and up to twice as
/// wide where it leaves much less: they are also what processors share. There are no scans to wait
/// for. What lies outside of the crop box does not count.
Tiling leastWork(const PointCloud& cloud, const PreprocessingParameters& parameters);

}  // namespace field_phenotyping
