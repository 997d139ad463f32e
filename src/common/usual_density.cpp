#include "field_phenotyping/common/usual_density.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <utility>
#include <vector>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {

std::size_t usualDensity(const PointCloud& cloud) {
  constexpr std::size_t kAsked = 1000U;
  const auto square = [](const Eigen::Vector3f& point) {
    const auto at = [](float value) {
      constexpr float kFar = 1e9F;  // numbers of squares fit into 32 bits
      return static_cast<std::uint32_t>(
          static_cast<std::int32_t>(std::floor(std::clamp(value, -kFar, kFar))));
    };
    return std::uint64_t{at(point.x())} << 32U | at(point.y());
  };
  std::unordered_map<std::uint64_t, std::size_t> counts;
  std::vector<std::uint64_t> asked;
  for (std::size_t i = 0; i < cloud.size(); i += 1U + cloud.size() / kAsked) {
    if (!cloud.points[i].allFinite()) continue;
    asked.push_back(square(cloud.points[i]));
    counts[asked.back()] = 0U;
  }
  if (asked.empty()) return 0U;
  for (const Eigen::Vector3f& point : cloud.points) {
    if (!point.allFinite()) continue;
    const auto counted = counts.find(square(point));
    if (counted != counts.end()) ++counted->second;
  }
  std::vector<std::size_t> densities;
  densities.reserve(asked.size());
  for (const std::uint64_t key : asked) densities.push_back(counts[key]);
  return medianOf(std::move(densities));
}

}  // namespace field_phenotyping
