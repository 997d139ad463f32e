#include "field_phenotyping/completion/topology_repair.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {

std::vector<GapRegion> findDefects(const GapsToFill& given, std::vector<CompletedPoint>& filled,
                                   double most_deviation) {
  filled.erase(std::remove_if(filled.begin(), filled.end(),
                              [&](const CompletedPoint& point) {
                                return !(std::abs(point.deviation) <= most_deviation);
                              }),
               filled.end());
  GapsToFill left = given;
  for (const CompletedPoint& point : filled) left.measured.push_back(point.position);
  return findGaps(left);
}

std::vector<CompletedPoint> repairDefect(const GapRegion& defect,
                                         const std::vector<CompletedPoint>& points, double density,
                                         double mean_radius, const RbfOptions& options) {
  constexpr double kBoundary = 3.0;  // spacings
  constexpr std::size_t kMostBoundaryPoints = 60;
  const double reach = kBoundary / std::sqrt(density);
  const SurfaceIndex cells(defect.cells, mean_radius);
  std::vector<SurfaceSample> boundary;
  for (const CompletedPoint& point : points) {
    if (cells.nearestWithin<1>(point.position, reach).count > 0) {
      boundary.push_back({point.position, point.deviation, 1.0});
    }
  }
  if (boundary.empty()) return {};
  const std::size_t stride = 1U + (boundary.size() - 1U) / kMostBoundaryPoints;
  std::vector<SurfaceSample> centers;
  for (std::size_t i = 0; i < boundary.size(); i += stride) centers.push_back(boundary[i]);
  const RbfSurface surface(centers, mean_radius, options);
  std::vector<CompletedPoint> repaired;
  for (const SurfacePosition& cell : defect.cells)
    repaired.push_back({cell, surface.valueAt(cell), 0.0});
  return repaired;
}

}  // namespace field_phenotyping
