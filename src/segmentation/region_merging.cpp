#include "field_phenotyping/segmentation/region_merging.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

namespace field_phenotyping {
namespace {

/// A region's place along its own line.
struct Extent {
  Eigen::Vector3f centroid = Eigen::Vector3f::Zero();
  Eigen::Vector3f lower_end = Eigen::Vector3f::Zero();
  Eigen::Vector3f upper_end = Eigen::Vector3f::Zero();
  float length() const { return (upper_end - lower_end).norm(); }
};

Extent extentOf(const std::vector<Eigen::Vector3f>& points, const GrowthRegion& region) {
  Extent extent;
  const Eigen::Vector3f along = (region.end - region.start).normalized();
  for (const std::uint32_t i : region.points) extent.centroid += points[i];
  extent.centroid /= static_cast<float>(region.points.size());
  float low = 0.0F;
  float high = 0.0F;
  for (const std::uint32_t i : region.points) {
    const float at = along.dot(points[i] - extent.centroid);
    low = std::min(low, at);
    high = std::max(high, at);
  }
  extent.lower_end = extent.centroid + low * along;
  extent.upper_end = extent.centroid + high * along;
  return extent;
}

/// Smallest distance between the points of two regions; 0 where they share one.
float pointDistance(const std::vector<Eigen::Vector3f>& points, const GrowthRegion& a,
                    const GrowthRegion& b) {
  std::vector<std::uint32_t> shared;
  std::set_intersection(a.points.begin(), a.points.end(), b.points.begin(), b.points.end(),
                        std::back_inserter(shared));
  if (!shared.empty()) return 0.0F;
  float least = std::numeric_limits<float>::max();
  for (const std::uint32_t i : a.points) {
    for (const std::uint32_t k : b.points) {
      least = std::min(least, (points[i] - points[k]).squaredNorm());
    }
  }
  return std::sqrt(least);
}

/// Indices of the regions that have points.
std::vector<std::size_t> withPoints(const std::vector<GrowthRegion>& regions) {
  std::vector<std::size_t> found;
  for (std::size_t r = 0; r < regions.size(); ++r) {
    if (!regions[r].points.empty()) found.push_back(r);
  }
  return found;
}

}  // namespace

float regionDistance(const std::vector<Eigen::Vector3f>& points, const GrowthRegion& low,
                     const GrowthRegion& high) {
  if (low.points.empty() || high.points.empty()) return std::numeric_limits<float>::infinity();
  const Extent below = extentOf(points, low);
  const Extent above = extentOf(points, high);
  const float centroids = (above.centroid - below.centroid).norm();
  const float touching =
      (below.upper_end - below.centroid).norm() + (above.centroid - above.lower_end).norm();
  // Regions that overlap are not apart at their ends, however far one reaches into the other.
  const Eigen::Vector3f along = (high.end - low.start).normalized();
  Eigen::Vector3f between = above.lower_end - below.upper_end;
  between -= std::min(along.dot(between), 0.0F) * along;
  constexpr float kCentroids = 0.3F;  // w1, w2, w3 of Eq 6
  constexpr float kEnds = 0.3F;
  constexpr float kPoints = 0.4F;
  return kCentroids * std::max(centroids - touching, 0.0F) + kEnds * between.norm() +
         kPoints * pointDistance(points, low, high);
}

std::vector<float> neighborDistances(const std::vector<Eigen::Vector3f>& points,
                                     const std::vector<GrowthRegion>& regions) {
  const std::vector<std::size_t> filled = withPoints(regions);
  std::vector<float> distances;
  for (std::size_t k = 0; k + 1U < filled.size(); ++k) {
    distances.push_back(regionDistance(points, regions[filled[k]], regions[filled[k + 1U]]));
  }
  return distances;
}

float initialMergingThreshold(std::vector<float> distances, float least, float most) {
  if (distances.empty()) return least;
  constexpr double kPercentile = 0.875;
  const auto at = distances.begin() +
                  static_cast<std::ptrdiff_t>(
                      std::lround(kPercentile * static_cast<double>(distances.size() - 1U)));
  std::nth_element(distances.begin(), at, distances.end());
  return std::max(least, std::min(*at, most));
}

float adaptMergingThreshold(float threshold, float quality, float target) {
  constexpr float kEta = 0.3F;
  constexpr float kLeast = 0.5F;
  constexpr float kMost = 1.5F;
  const float ratio = target > 0.0F ? std::clamp(quality / target, kLeast, kMost) : kMost;
  return (1.0F - kEta) * threshold + kEta * threshold * ratio;
}

std::vector<std::uint8_t> mergeRegions(const std::vector<GrowthRegion>& regions,
                                       const std::vector<float>& distances, float threshold) {
  const std::vector<std::size_t> filled = withPoints(regions);
  std::vector<std::uint8_t> merged(regions.size(), 0U);
  std::size_t most = 0U;
  for (std::size_t first = 0; first < filled.size();) {
    std::size_t last = first;
    std::size_t count = regions[filled[first]].points.size();
    while (last + 1U < filled.size() && distances[last] < threshold) {
      ++last;
      count += regions[filled[last]].points.size();
    }
    if (count > most) {
      most = count;
      std::fill(merged.begin(), merged.end(), std::uint8_t{0});
      for (std::size_t k = first; k <= last; ++k) merged[filled[k]] = 1U;
    }
    first = last + 1U;
  }
  return merged;
}

}  // namespace field_phenotyping
