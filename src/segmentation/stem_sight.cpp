#include "field_phenotyping/segmentation/stem_sight.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {

BandSight seeBand(const std::vector<Eigen::Vector3f>& points, const NeighborGrid& grid,
                  const Midline& midline, float middle, float height) {
  const float skin = midline.axis.radiusAt(middle) + 2.0F * midline.spread;
  const Eigen::Vector3f center = midline.axis.pointAt(middle);
  const Eigen::Vector3f direction = midline.axis.directionAt(middle);
  BandSight sight;
  grid.forEachWithin(center, std::hypot(2.0F * skin, 0.5F * height),
                     [&](std::uint32_t i, float squared) {
                       const float along = direction.dot(points[i] - center);
                       if (std::abs(along) > 0.5F * height) return;
                       const float away = std::sqrt(std::max(squared - along * along, 0.0F));
                       if (away < skin) {
                         sight.inside += 1.0F;
                       } else if (away < 2.0F * skin) {
                         sight.around += 1.0F;
                       }
                     });
  return sight;
}

}  // namespace field_phenotyping
