#include "field_phenotyping/common/point_cloud.hpp"

#include "field_phenotyping/common/indices_where.hpp"

namespace field_phenotyping {

PointCloud taken(const PointCloud& from, const std::vector<std::uint32_t>& indices) {
  PointCloud out = from.emptyAlike();
  out.points = valuesAt(from.points, indices);
  if (from.hasColors()) out.colors = valuesAt(from.colors, indices);
  if (from.hasScanOrigins()) out.scan_origin = valuesAt(from.scan_origin, indices);
  return out;
}

}  // namespace field_phenotyping
