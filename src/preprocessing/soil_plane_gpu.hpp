#pragma once

#include <cstdint>

#include "field_phenotyping/preprocessing/soil_plane_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// scorePlane() of each plane. The result is the stream's and holds until it is given back.
/// @param candidates in the host's memory
/// @throws GpuError
const int* planeScoresOnGpu(GpuStream& stream, const SoilPlane* planes, std::uint32_t count,
                            const SoilCandidates& candidates, float tolerance);

}  // namespace field_phenotyping
