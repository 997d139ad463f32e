#pragma once

#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"

namespace field_phenotyping {

class GpuStream;

/// Searches for the neighbours of points in the GPU's memory. What it returns is the stream's and
/// holds until that is given back. All calls throw GpuError.
class GpuNeighborSearch {
 public:
  /// @param xyz the points as x y z x y z ...
  GpuNeighborSearch(GpuStream& stream, const float* xyz, std::uint32_t count);

  /// Prepares for searches with a radius near the cell's edge.
  void build(const GridGeometry& geometry);
  /// How many points lie within `radius` [m] of every `step`-th point, itself included.
  const std::uint32_t* sampleCounts(float radius, std::uint32_t step);
  /// 1 for each point with at least `wanted` within `radius` [m], itself included, else 0.
  const std::uint8_t* company(float radius, std::uint32_t wanted);

 private:
  GpuStream& stream_;
  const Place* points_;
  std::uint32_t count_;
  GridView grid_;
};

}  // namespace field_phenotyping
