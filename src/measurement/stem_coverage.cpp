#include "field_phenotyping/measurement/stem_coverage.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {

namespace {

constexpr double kTurn = 2.0 * M_PI;

/// For every angle, how many lie within `reach` of it.
/// @param angles sorted, in [0, 2 pi)
std::vector<double> neighbours(const std::vector<double>& angles, double reach) {
  std::vector<double> unrolled;
  for (const int turn : {-1, 0, 1}) {
    for (const double angle : angles) unrolled.push_back(angle + turn * kTurn);
  }
  std::vector<double> counts;
  for (const double angle : angles) {
    const auto first = std::lower_bound(unrolled.begin(), unrolled.end(), angle - reach);
    const auto last = std::upper_bound(first, unrolled.end(), angle + reach);
    counts.push_back(static_cast<double>(last - first));
  }
  return counts;
}

}  // namespace

double arcCoverage(std::vector<double> angles) {
  constexpr double kGap = 40.0 * M_PI / 180.0;
  constexpr double kStray = 0.2;  // of the median density: the noise carries points round the ends
  if (angles.empty()) return 0.0;
  for (double& angle : angles) angle -= kTurn * std::floor(angle / kTurn);
  std::sort(angles.begin(), angles.end());
  const std::vector<double> counts = neighbours(angles, 0.5 * kGap);
  const double least = kStray * medianOf(counts);
  std::vector<double> kept;
  for (std::size_t i = 0; i < angles.size(); ++i) {
    if (counts[i] >= least) kept.push_back(angles[i]);
  }
  angles = std::move(kept);
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
