#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/completion/rbf_surface_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// A surface to be solved and read; its arrays are the host's.
struct RbfReading {
  RbfTask task;
  const Vector3* places;
  std::size_t place_count;
  std::size_t most_matrix;  ///< values that the matrix of its system may have
};

/// RbfSolver and rbf::valueAt() of all surfaces at once, a thread block each. @throws GpuError
/// @param readings at least one
/// @return of all places of all surfaces, one after the other [m]; the stream's, and holds until it
///         is given back
const double* readSurfacesOnGpu(GpuStream& stream, const std::vector<RbfReading>& readings);

}  // namespace field_phenotyping
