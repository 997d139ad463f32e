#include "field_phenotyping/segmentation/crown_points.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <utility>

#include "field_phenotyping/common/neighbor_grid.hpp"

namespace field_phenotyping {
namespace {

constexpr float kTube = 0.06F;     // [m] round a stem's line
constexpr float kHighest = 1.5F;   // [m] above a stem's end
constexpr float kMostGap = 0.25F;  // [m] along the line, without a point of the plant

/// A stem's line above its end.
struct Line {
  Eigen::Vector3f end = Eigen::Vector3f::Zero();
  Eigen::Vector3f direction = Eigen::Vector3f::UnitZ();

  explicit Line(const StemAxis& axis) {
    if (axis.empty()) return;
    end = axis.pointAt(axis.length());
    direction = (end - axis.pointAt(0.5F * axis.length())).normalized();
  }
  float along(const Eigen::Vector3f& point) const { return (point - end).dot(direction); }
};

}  // namespace

void giveCrownPoints(const Block& block, const std::vector<StemAxis>& axes,
                     std::vector<std::int32_t>& owner) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  std::vector<std::uint32_t> free;
  std::vector<Eigen::Vector3f> places;  // of them
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    if (owner[i] >= 0) continue;
    free.push_back(i);
    places.push_back(points[i]);
  }
  if (free.empty()) return;
  std::vector<Line> lines;
  for (const StemAxis& axis : axes) lines.emplace_back(axis);
  std::vector<float> reached(axes.size(), 0.0F);  // along each line, by points of its plant
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (owner[i] < 0) continue;
    const auto plant = static_cast<std::size_t>(owner[i]);
    reached[plant] = std::max(reached[plant], lines[plant].along(points[i]));
  }

  // Each goes to the line that it is nearest to.
  const NeighborGrid grid(places, kTube);
  constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> nearest(free.size(), kNone);
  std::vector<float> least(free.size(), kTube);
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    if (axes[plant].empty()) continue;
    const Line& line = lines[plant];
    grid.forEachWithinOfLine(
        line.end, line.end + kHighest * line.direction, kTube, [&](std::uint32_t k) {
          const float along = line.along(places[k]);
          const float aside = (places[k] - line.end - along * line.direction).norm();
          if (along < 0.0F || aside >= least[k]) return;
          least[k] = aside;
          nearest[k] = plant;
        });
  }
  std::vector<std::vector<std::pair<float, std::uint32_t>>> crowns(axes.size());  // upwards
  for (std::uint32_t k = 0; k < free.size(); ++k) {
    if (nearest[k] == kNone) continue;
    crowns[nearest[k]].emplace_back(lines[nearest[k]].along(places[k]), free[k]);
  }
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    std::sort(crowns[plant].begin(), crowns[plant].end());
    for (const auto& [along, i] : crowns[plant]) {
      if (along > reached[plant] + kMostGap) break;
      reached[plant] = std::max(reached[plant], along);
      owner[i] = static_cast<std::int32_t>(plant);
    }
  }
}

}  // namespace field_phenotyping
