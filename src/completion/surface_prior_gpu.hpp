#pragma once

#include <cstddef>
#include <cstdint>

#include "field_phenotyping/completion/surface_prior_team.hpp"

namespace field_phenotyping {

class GpuStream;

/// A stem among others, whose points and nodes lie one after the other.
struct SurfacePriorPiece {
  SurfacePriorTask task;  ///< its pointers are not used
  std::uint32_t first_point;
  std::uint32_t first_node;
};

struct SurfacePriorPieces {
  const SurfacePriorPiece* pieces;
  std::size_t count;  ///< at least one
  const double* places;
  std::size_t points;  ///< of all pieces
  const double* curves;
  std::size_t nodes;  ///< of all pieces
  const NoiseEffect* effects;
  const std::uint32_t* draws;
};

/// The results are the stream's and hold until it is given back.
struct GpuSurfacePriors {
  const SurfacePriorFit* fits;
  const double* curves;        ///< x, y, z of each node
  const double* coefficients;  ///< kMostCoefficients of each piece
  const double* covariances;   ///< the square of that
};

/// SurfacePriorFitter of all pieces at once, a thread block each. @throws GpuError
GpuSurfacePriors surfacePriorsOnGpu(GpuStream& stream, const SurfacePriorPieces& stems);

}  // namespace field_phenotyping
