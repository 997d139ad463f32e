#include "field_phenotyping/segmentation/growth_scene.hpp"

#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/sorted_indices.hpp"
#include "field_phenotyping/segmentation/growth_task.hpp"

namespace field_phenotyping {
namespace {

/// Appends the points within `radius` [m] of a straight line, piece by piece: boxes round short
/// ones hold little else.
void addAround(const GrowthScene& scene, const Eigen::Vector3f& begin, const Eigen::Vector3f& end,
               float radius, std::vector<std::uint32_t>& found) {
  const auto pieces =
      std::max(static_cast<int>(std::ceil((end - begin).norm() / (2.0F * radius))), 1);
  Eigen::Vector3f from = begin;
  for (int k = 1; k <= pieces; ++k) {
    const Eigen::Vector3f to =
        begin + static_cast<float>(k) / static_cast<float>(pieces) * (end - begin);
    scene.grid.forEachWithinOfLine(from, to, radius, [&](std::uint32_t i) { found.push_back(i); });
    from = to;
  }
}

}  // namespace

GrowthSettings::GrowthSettings(const SegmentationParameters& parameters)
    : r1(static_cast<float>(parameters.r1)),
      M(static_cast<float>(parameters.M)),
      alpha(static_cast<float>(parameters.alpha)),
      beta(static_cast<float>(parameters.beta)),
      max_steps(parameters.max_growth_steps) {}

std::vector<std::uint32_t> pointsAround(const GrowthScene& scene, const StemAxis& axis,
                                        float radius) {
  std::vector<std::uint32_t> found;
  constexpr float kStep = 1.0F;  // of the radius
  const int steps = std::max(static_cast<int>(std::ceil(axis.length() / (kStep * radius))), 1);
  for (int k = 0; k < steps; ++k) {
    const float part = axis.length() / static_cast<float>(steps);
    const Eigen::Vector3f begin = axis.pointAt(part * static_cast<float>(k));
    const Eigen::Vector3f end = axis.pointAt(part * static_cast<float>(k + 1));
    scene.grid.forEachWithinOfLine(begin, end, radius,
                                   [&](std::uint32_t i) { found.push_back(i); });
  }
  sortUnique(found);
  return found;
}

std::vector<std::uint32_t> pointsAlong(const GrowthScene& scene, const StemAxis& axis, float radius,
                                       float beyond) {
  constexpr float kRounding = 1.001F;  // of the distances
  std::vector<std::uint32_t> found;
  Eigen::Vector3f from = axis.pointAt(-beyond);
  for (const StemAxis::Node& node : axis.nodes()) {
    addAround(scene, from, node.position, kRounding * radius, found);
    from = node.position;
  }
  addAround(scene, from, axis.pointAt(axis.length() + beyond), kRounding * radius, found);
  sortUnique(found);
  return found;
}

std::size_t countCrowd(const GrowthScene& scene, const Midline& midline) {
  const StemAxis& axis = midline.axis;
  const auto skinAt = [&](float radius) { return radius + 2.0F * midline.spread; };
  float widest = 0.0F;
  for (const StemAxis::Node& node : axis.nodes()) widest = std::max(widest, skinAt(node.radius));
  std::size_t count = 0U;
  for (const std::uint32_t i : pointsAround(scene, axis, 2.0F * widest)) {
    const StemAxis::Projection at = axis.project(scene.points[i]);
    if (at.arc_length < 0.0F || at.arc_length > axis.length()) continue;
    if (at.distance > skinAt(at.radius) && at.distance < 2.0F * skinAt(at.radius)) ++count;
  }
  return count;
}

}  // namespace field_phenotyping
