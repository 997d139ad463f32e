#include "field_phenotyping/common/point_cloud.hpp"

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {

PointCloud taken(const PointCloud& from, const std::vector<std::uint32_t>& indices) {
  constexpr std::size_t kChunk = 16384U;
  PointCloud out = from.emptyAlike();
  out.points.resize(indices.size());
  if (from.hasColors()) out.colors.resize(indices.size());
  if (from.hasScanOrigins()) out.scan_origin.resize(indices.size());
  parallelChunks(indices.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) out.points[k] = from.points[indices[k]];
    if (from.hasColors()) {
      for (std::size_t k = begin; k < end; ++k) out.colors[k] = from.colors[indices[k]];
    }
    if (!from.hasScanOrigins()) return;
    for (std::size_t k = begin; k < end; ++k) out.scan_origin[k] = from.scan_origin[indices[k]];
  });
  return out;
}

}  // namespace field_phenotyping
