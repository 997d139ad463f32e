#pragma once

#include <cstddef>
#include <cstdint>

#include "field_phenotyping/measurement/surface_mixture_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// A piece of stem among others, whose points lie one after the other.
struct CrossSectionPiece {
  CrossSectionTask task;
  std::uint32_t first_point;
  int count;
};

/// startCrossSection() and fitSurfaceMixture() of all pieces at once, a thread block each. The
/// results are the stream's and hold until it is given back.
struct GpuCrossSections {
  const CrossSectionStart* starts;
  const SurfaceMixtureFit* fits;
};
/// @param places x, y, height of each point of the first piece, then of the next ...
/// @param pieces at least one
/// @throws GpuError
GpuCrossSections crossSectionsOnGpu(GpuStream& stream, const double* places, std::size_t points,
                                    const CrossSectionPiece* pieces, std::uint32_t count);

}  // namespace field_phenotyping
