#include "field_phenotyping/segmentation/region_quality.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace field_phenotyping {

float consistency(const std::vector<float>& values, const std::vector<float>& neighbor_means) {
  if (values.empty()) return 0.0F;
  constexpr float kLambda = 0.5F;
  constexpr float kBeta = 2.0F;
  const float mean =
      std::accumulate(values.begin(), values.end(), 0.0F) / static_cast<float>(values.size());
  if (!(mean > 0.0F)) return 1.0F;
  float sum = 0.0F;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const float off_mean = std::abs(values[i] - mean) / mean;
    const float off_neighbors = std::abs(values[i] - neighbor_means[i]) / mean;
    sum += 1.0F / (1.0F + off_mean) + kLambda * std::exp(-kBeta * off_neighbors);
  }
  return sum / static_cast<float>(values.size()) / (1.0F + kLambda);
}

namespace {

/// Of every value the mean of its neighbours in that order, on either side.
std::vector<float> neighborMeans(const std::vector<float>& values,
                                 const std::vector<std::size_t>& order) {
  constexpr std::size_t kNeighbors = 4U;  // on either side
  std::vector<float> means(values.size());
  for (std::size_t k = 0; k < order.size(); ++k) {
    const std::size_t first = k - std::min(k, kNeighbors);
    const std::size_t last = std::min(k + kNeighbors, order.size() - 1U);
    float sum = -values[order[k]];
    for (std::size_t j = first; j <= last; ++j) sum += values[order[j]];
    means[order[k]] = last > first ? sum / static_cast<float>(last - first) : values[order[k]];
  }
  return means;
}

}  // namespace

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

RegionQuality evaluateRegion(const GrowthScene& scene, std::size_t grown,
                             const std::vector<std::uint32_t>& kept, const Midline& midline,
                             std::size_t crowd) {
  const StemAxis& axis = midline.axis;
  RegionQuality quality;
  if (kept.empty() || grown == 0U) return quality;

  // Q_g: curvature and density, each against the region and against the nearest points of it.
  std::vector<float> curvature;
  std::vector<float> density;
  std::vector<float> arc_length;
  float distances = 0.0F;
  float farthest = 0.0F;
  for (const std::uint32_t i : kept) {
    curvature.push_back(scene.shapes[i].curvature);
    density.push_back(static_cast<float>(scene.shapes[i].neighbors));
    const StemAxis::Projection at = axis.project(scene.points[i]);
    arc_length.push_back(at.arc_length);
    const float distance = std::abs(at.distance - at.radius);
    distances += distance;
    farthest = std::max(farthest, distance);
  }
  std::vector<std::size_t> order(kept.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return arc_length[a] != arc_length[b] ? arc_length[a] < arc_length[b] : a < b;
  });
  constexpr float kCurvature = 0.5F;  // w1, w2 of Eq 7
  constexpr float kDensity = 0.5F;
  quality.geometric = kCurvature * consistency(curvature, neighborMeans(curvature, order)) +
                      kDensity * consistency(density, neighborMeans(density, order));

  // Q_s.
  constexpr float kOutliers = 0.5F;  // w3, w4 of Eq 8
  constexpr float kDistance = 0.5F;
  const auto count = static_cast<float>(kept.size());
  const float near_axis = farthest > 0.0F ? 1.0F - distances / count / farthest : 1.0F;
  quality.structural =
      kOutliers * count / static_cast<float>(grown + crowd) + kDistance * near_axis;

  constexpr float kGeometric = 0.2F;  // the weights of Eq 9
  constexpr float kStructural = 0.8F;
  quality.overall = kGeometric * quality.geometric + kStructural * quality.structural;
  return quality;
}

}  // namespace field_phenotyping
