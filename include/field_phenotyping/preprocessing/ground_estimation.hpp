#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"

namespace field_phenotyping {

/// Models the soil below a cloud (2.3.2, made local): a plane by RANSAC over the lowest points,
/// held near horizontal by gravity, then a robust plane round every node of a grid, so that slopes
/// and roughness are followed, then the middle of the soil points round twice as many nodes along x
/// and y, so that ridges are.
///
/// Where too little of the seen area shows soil (it was cropped away) the model is marked as not
/// observed and follows the lowest plant points instead. Deterministic. An empty cloud gives an
/// empty model. A device may score the planes, with the same result.
GroundModel estimateGround(const PointCloud& cloud, const PreprocessingParameters& parameters,
                           const ComputeDevice& device = {});

/// Marks soil points (1): those nearer to the model than its own roughness explains, at most
/// `ground_distance`, but for the feet of what stands on it. Nothing is soil where the model was
/// not observed.
std::vector<std::uint8_t> classifyGround(const PointCloud& cloud, const GroundModel& ground,
                                         const PreprocessingParameters& parameters);

/// Marks the soil points (1) right beside what stands on the soil: some of them are its lowest
/// points, which are told from soil once its surface is known.
/// @param is_ground of classifyGround()
std::vector<std::uint8_t> soilAtFeet(const PointCloud& cloud, const GroundModel& ground,
                                     const std::vector<std::uint8_t>& is_ground);

}  // namespace field_phenotyping
