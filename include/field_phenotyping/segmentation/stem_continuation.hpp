#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Where the organ that carries on a stem ends.
struct OrganEnd {
  Eigen::Vector3f place = Eigen::Vector3f::Zero();
  Eigen::Vector3f direction = Eigen::Vector3f::UnitZ();  ///< of its last 10 cm
  bool is_clear = false;  ///< whether points show it all along, straight on to this end
};

/// Gives the organ that carries on each stem's axis beyond its end to that stem's plant: the spike
/// of a tassel, or the innermost leaves of a whorl. It is followed upwards from the end, turning
/// as it turns, and over gaps behind which it goes on. What crosses its end, of which more lies
/// beside its line than on it, is not its own.
///
/// Pure function. All lengths in metres, in the local frame of the block's cloud.
///
/// @param axes  stem axis of each plant; a plant that owns no point gets none
/// @param noise standard deviation of the points across a surface
/// @param owner per point of `block.cloud`: index of the plant whose stem holds it, or -1; filled
/// in
/// @return of each plant; the end of its axis where nothing carries it on
std::vector<OrganEnd> followStemsUp(const Block& block, const std::vector<StemAxis>& axes,
                                    float noise, std::vector<std::int32_t>& owner);

}  // namespace field_phenotyping
