#include "field_phenotyping/common/bounds.hpp"

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {

Bounds boundsOf(const std::vector<Eigen::Vector3f>& points) {
  constexpr std::size_t kChunk = 32768U;
  std::vector<Bounds> of_chunk(chunksOf(points.size(), kChunk), {points.front(), points.front()});
  parallelChunks(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    Bounds own = of_chunk[begin / kChunk];
    for (std::size_t i = begin; i < end; ++i) {
      own.low = own.low.cwiseMin(points[i]);
      own.high = own.high.cwiseMax(points[i]);
    }
    of_chunk[begin / kChunk] = own;
  });
  Bounds bounds = of_chunk.front();
  for (const Bounds& own : of_chunk) {
    bounds.low = bounds.low.cwiseMin(own.low);
    bounds.high = bounds.high.cwiseMax(own.high);
  }
  return bounds;
}

}  // namespace field_phenotyping
