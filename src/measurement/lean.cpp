#include "field_phenotyping/measurement/lean.hpp"

#include <cmath>

namespace field_phenotyping {

Lean measureLean(const Plant& plant) {
  Lean lean;
  if (plant.axis.empty()) return lean;
  const StemAxis::Node& top = plant.axis.nodes().back();
  const Eigen::Vector3d chord = (top.position - plant.base).cast<double>();
  const double length = chord.norm();
  if (!(length > 0.0) || !(chord.z() > 0.0)) return lean;
  const double radius = 0.5 * (plant.axis.nodes().front().radius + top.radius);
  lean.axis = chord / length;
  lean.angle.value = std::atan2(chord.head<2>().norm(), chord.z());
  lean.angle.stddev = std::sqrt(2.0) * 0.5 * radius / length;
  lean.azimuth = std::atan2(chord.y(), chord.x());
  return lean;
}

}  // namespace field_phenotyping
