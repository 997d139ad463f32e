#include "field_phenotyping/measurement/stem_coverage.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace field_phenotyping {

double arcCoverage(std::vector<double> angles) {
  constexpr double kTurn = 2.0 * M_PI;
  constexpr double kGap = 40.0 * M_PI / 180.0;
  if (angles.empty()) return 0.0;
  for (double& angle : angles) angle -= kTurn * std::floor(angle / kTurn);
  std::sort(angles.begin(), angles.end());
  double unseen = 0.0;
  for (std::size_t i = 0; i < angles.size(); ++i) {
    const double next = i + 1 < angles.size() ? angles[i + 1] : angles.front() + kTurn;
    if (next - angles[i] > kGap) unseen += next - angles[i];
  }
  return 1.0 - unseen / kTurn;
}

double stemCompleteness(const SegmentedBlock& block, const Plant& plant) {
  constexpr double kCell = 0.01;  // [m]
  if (plant.axis.empty()) return std::numeric_limits<double>::quiet_NaN();
  double radius = 0.0;
  for (const StemAxis::Node& node : plant.axis.nodes()) radius += node.radius;
  radius /= static_cast<double>(plant.axis.nodes().size());

  const double length = plant.axis.length();
  const int rows = std::max(1, static_cast<int>(std::lround(length / kCell)));
  const int columns = std::max(4, static_cast<int>(std::lround(2.0 * M_PI * radius / kCell)));
  std::vector<bool> seen(static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns));
  for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
    const StemAxis::Projection foot = plant.axis.project(block.cloud.points[i]);
    const int row = static_cast<int>(std::floor(foot.arc_length / length * rows));
    if (row < 0 || row >= rows) continue;
    const Eigen::Vector3f offset = block.cloud.points[i] - foot.foot;
    const double turn = std::atan2(offset.y(), offset.x()) / (2.0 * M_PI) + 0.5;
    const int column = std::min(static_cast<int>(turn * columns), columns - 1);
    seen[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) +
         static_cast<std::size_t>(column)] = true;
  }
  return static_cast<double>(std::count(seen.begin(), seen.end(), true)) /
         static_cast<double>(seen.size());
}

}  // namespace field_phenotyping
