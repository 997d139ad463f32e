#include "field_phenotyping/segmentation/region_growth.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "field_phenotyping/common/sorted_indices.hpp"

namespace field_phenotyping {
namespace {

/// w_p of Eq 1: points in dense, little curved surroundings say more about where the stem goes.
float directionWeight(const LocalShape& shape) {
  constexpr float kFullDensity = 20.0F;  // neighbours beyond which density adds nothing
  const float density = std::min(static_cast<float>(shape.neighbors) / kFullDensity, 1.0F);
  return density * (1.0F - 3.0F * shape.curvature);
}

/// Eq 1: the weighted mean direction from s_k to the candidates; zero when there are none.
Eigen::Vector3f meanDirection(const GrowthScene& scene,
                              const std::vector<std::uint32_t>& candidates,
                              const Eigen::Vector3f& s_k) {
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  float total = 0.0F;
  for (const std::uint32_t i : candidates) {
    const Eigen::Vector3f away = scene.points[i] - s_k;
    const float distance = away.norm();
    if (!(distance > 0.0F)) continue;
    const float weight = directionWeight(scene.shapes[i]);
    sum += weight / distance * away;
    total += weight;
  }
  return total > 0.0F ? Eigen::Vector3f(sum / total) : Eigen::Vector3f::Zero();
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

float similarity(const GrowthScene& scene, std::uint32_t i, const Midline& midline) {
  return similarity(scene.shapes[i], midline.axis.project(scene.points[i]), midline.spread);
}

float similarity(const LocalShape& shape, const StemAxis::Projection& at, float spread) {
  // Distance beyond the stem's surface, in units of what noise and out-of-roundness explain.
  // Nothing but the stem itself lies within.
  const float scale = std::hypot(spread, 0.07F * at.radius);
  const float away = std::max(at.distance - at.radius, 0.0F) / scale;
  constexpr float kSoftness = 0.10F;  // similarity 0.5 at two and a half standard deviations
  const float on_surface = std::exp(-kSoftness * away * away);

  const float across = 1.0F - std::abs(shape.normal.dot(at.direction));
  const float along = shape.linearity * std::abs(shape.direction.dot(at.direction)) +
                      (1.0F - shape.linearity) * 0.5F;
  constexpr float kSurface = 0.5F;
  constexpr float kAcross = 0.2F;
  constexpr float kAlong = 0.3F;
  return on_surface * (kSurface + kAcross * across + kAlong * along);
}

StemScene::StemScene(const GrowthScene& scene, Midline midline, LeafBases leaf_bases)
    : cloud_(scene), midline_(std::move(midline)), leaf_bases_(std::move(leaf_bases)) {}

StemScene::Place StemScene::placeOf(std::uint32_t i) const {
  const auto [known, is_new] = known_.tryEmplace(i, {});
  if (!is_new) return *known;
  const Eigen::Vector3f& point = cloud_.points[i];
  const StemAxis::Projection at = midline_.axis.project(point);
  const Eigen::Vector3f away = point - at.foot;
  constexpr float kThinnest = 1e-4F;  // [m]
  const float radius = std::max(at.radius, kThinnest);
  // Noise moves points outwards on average, across a curved surface.
  const float noise = midline_.spread / radius;
  known->sighting = {std::atan2(away.y(), away.x()),
                     at.distance / radius - 1.0F - 0.5F * noise * noise};
  known->similarity = similarity(cloud_.shapes[i], at, midline_.spread) *
                      (1.0F - leaf_bases_.leafShare(point, midline_.axis));
  return *known;
}

GrowthRegion growRegion(const StemScene& scene, const Eigen::Vector3f& start,
                        const Eigen::Vector3f& end, const GrowthSettings& settings) {
  GrowthRegion region;
  region.start = start;
  region.end = end;
  const Eigen::Vector3f line = end - start;
  if (!(line.squaredNorm() > 0.0F)) return region;

  Eigen::Vector3f s_k = start;
  std::vector<std::uint32_t> candidates;
  for (int step = 0; step < settings.max_steps; ++step) {
    // Points inside the sphere B(s_k, r1) that are like the stem are candidates and join.
    candidates.clear();
    scene.cloud().grid.forEachWithin(s_k, settings.r1, [&](std::uint32_t i, float) {
      if (scene.similarityOf(i) >= settings.M) candidates.push_back(i);
    });
    region.points.insert(region.points.end(), candidates.begin(), candidates.end());
    ++region.steps;

    // a. Growth direction (Eq 1, 2).
    const Eigen::Vector3f to_end = end - s_k;
    const Eigen::Vector3f v_k = settings.alpha * meanDirection(scene.cloud(), candidates, s_k) +
                                settings.beta * to_end.normalized();
    // b. New seed (Eq 3); the step stays within [0.5, 1] r1 so that it can neither stall nor skip.
    const float speed = v_k.norm();
    if (!(speed > 0.0F)) break;
    s_k += settings.r1 * std::clamp(speed, 0.5F, 1.0F) / speed * v_k;
    // c. Termination (Eq 4, 5).
    const float t_proj = (s_k - start).dot(line) / line.squaredNorm();
    if (t_proj < 0.0F || t_proj > 1.0F) break;
  }
  sortUnique(region.points);
  return region;
}

}  // namespace field_phenotyping
