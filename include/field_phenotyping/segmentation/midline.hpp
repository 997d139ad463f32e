#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// A stem's midline with what the points round it look like.
struct Midline {
  StemAxis axis;
  float spread = 0.0F;  ///< robust standard deviation of the points about the stem surface [m]
};

/// Fits the curved midline of a stem and its radius profile (2.4.2, Step 1; Eq 15 made piecewise):
/// a robust circle across the axis in every height band, smoothed along the stem. Half-seen stems
/// are centred by their curvature as far as the points carry it, else by the neighbouring bands.
///
/// @param points     candidates, local frame [m]
/// @param members    indices of the stem's points (leaf points among them are survived)
/// @param prior      rough axis; its direction frames the bands
/// @param max_radius thickest stem that is believed [m]
/// Gives back the prior where there are too few points.
Midline fitMidline(const std::vector<Eigen::Vector3f>& points,
                   const std::vector<std::uint32_t>& members, const StemAxis& prior,
                   float max_radius);

/// Removes over-segmented points (2.4.2, Steps 2-4): those farther from the midline than `factor`
/// times the median distance of their height band (Eq 16). Keeps the order.
std::vector<std::uint32_t> pruneByMidline(const std::vector<Eigen::Vector3f>& points,
                                          const std::vector<std::uint32_t>& members,
                                          const StemAxis& axis, float factor);

}  // namespace field_phenotyping
