#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Points made up for one stem, in the local frame of the block's cloud.
struct SyntheticPoints {
  std::vector<Eigen::Vector3f> points;  ///< [m]
  std::vector<std::uint32_t> colors;    ///< 0x00RRGGBB; empty when the cloud has none
  std::vector<float> stddev;            ///< of each one's distance to the true surface [m]
  double density = 0.0;                 ///< that gaps were filled to [1/m^2]; 0: nothing was filled
};

/// Fills the gaps of one stem (paper 2.5, Eq 17-23). A stem whose points do not carry a surface
/// gives no points. The cost is bounded by `max_centers`. Thread-safe; deterministic.
SyntheticPoints completeStem(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                             const GroundModel& ground, const CompletionParameters& parameters);

}  // namespace field_phenotyping
