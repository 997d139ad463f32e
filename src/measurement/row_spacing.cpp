#include "field_phenotyping/measurement/row_spacing.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace field_phenotyping {
namespace {

constexpr double kMaxDeviation = 30.0 * M_PI / 180.0;
constexpr double kMinAgreement = 0.5;  // of the nearest neighbours' directions, 1: all alike

Eigen::Vector2d baseOf(const Plant& plant) {
  return plant.base.head<2>().cast<double>();
}

/// Vector to the plant nearest to plant `i`; zero when it is alone.
Eigen::Vector2d toNearest(const std::vector<Plant>& plants, std::size_t i) {
  Eigen::Vector2d nearest = Eigen::Vector2d::Zero();
  for (std::size_t j = 0; j < plants.size(); ++j) {
    const Eigen::Vector2d offset = baseOf(plants[j]) - baseOf(plants[i]);
    if (j == i || !(offset.norm() > 0.0)) continue;
    if (nearest.isZero() || offset.norm() < nearest.norm()) nearest = offset;
  }
  return nearest;
}

/// Common direction of the rows; zero when there is none.
Eigen::Vector2d rowDirection(const std::vector<Plant>& plants) {
  // Doubling the angle makes opposite directions one.
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double count = 0.0;
  for (std::size_t i = 0; i < plants.size(); ++i) {
    const Eigen::Vector2d offset = toNearest(plants, i);
    if (offset.isZero()) continue;
    const double angle = 2.0 * std::atan2(offset.y(), offset.x());
    sum += Eigen::Vector2d(std::cos(angle), std::sin(angle));
    count += 1.0;
  }
  if (count < 3.0 || sum.norm() < kMinAgreement * count) return Eigen::Vector2d::Zero();
  const double angle = 0.5 * std::atan2(sum.y(), sum.x());  // in (-pi/2, pi/2]: x is not negative
  const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
  const bool along_y = std::abs(direction.x()) < 0.5 && direction.y() < 0.0;
  return along_y ? Eigen::Vector2d(-direction) : direction;
}

double meanRadius(const Plant& plant) {
  return plant.axis.empty() ? 0.0 : static_cast<double>(plant.axis.nodes().front().radius);
}

/// Distance across the rows to the nearest plants beside plant `i`.
Trait toNextRow(const std::vector<Plant>& plants, std::size_t i, const Eigen::Vector2d& direction) {
  constexpr double kSameRow = 1.25;  // times the distance to the nearest of them
  const Eigen::Vector2d across(-direction.y(), direction.x());
  std::vector<double> distances;
  double nearest = std::numeric_limits<double>::infinity();
  for (const Plant& other : plants) {
    const Eigen::Vector2d offset = baseOf(other) - baseOf(plants[i]);
    const double distance = std::abs(offset.dot(across));
    if (!(distance > std::abs(offset.dot(direction)))) continue;
    distances.push_back(distance);
    nearest = std::min(nearest, distance);
  }
  double sum = 0.0, squares = 0.0, count = 0.0;
  for (const double distance : distances) {
    if (distance > kSameRow * nearest) continue;
    sum += distance;
    squares += distance * distance;
    count += 1.0;
  }
  if (!(count > 0.0)) return {};
  const double mean = sum / count;
  const double scatter = count > 1.0 ? std::max(squares - count * mean * mean, 0.0) / (count - 1.0)
                                     : std::pow((kSameRow - 1.0) * mean, 2);
  return {mean, std::hypot(std::sqrt(scatter / count), 0.5 * meanRadius(plants[i]))};
}

}  // namespace

std::vector<PlantSpacing> measureRowSpacing(const SegmentedBlock& block) {
  std::vector<PlantSpacing> spacings(block.plants.size());
  const Eigen::Vector2d direction = rowDirection(block.plants);
  if (direction.isZero()) return spacings;
  for (std::size_t i = 0; i < block.plants.size(); ++i) {
    Trait& spacing = spacings[i].in_row;
    for (const Plant& other : block.plants) {
      const Eigen::Vector2d offset = baseOf(other) - baseOf(block.plants[i]);
      const double distance = offset.norm();
      if (!(distance > 0.0) || offset.dot(direction) < std::cos(kMaxDeviation) * distance) continue;
      if (distance >= spacing.value) continue;  // false while it is NaN
      // Each base counts as known to half the stem's radius.
      spacing = {distance, 0.5 * std::hypot(meanRadius(block.plants[i]), meanRadius(other))};
    }
    spacings[i].to_row = toNextRow(block.plants, i, direction);
  }
  return spacings;
}

}  // namespace field_phenotyping
