#include "field_phenotyping/measurement/stand_summary.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

constexpr double kRowGap = 0.15;      // [m] across the rows, between the plants of two rows
constexpr double kGapSpacings = 1.5;  // of the median spacing
constexpr std::size_t kLeastPlants = 3U;

using Points = std::vector<Eigen::Vector2d>;

Eigen::Vector2d directionAt(double angle) {
  return {std::cos(angle), std::sin(angle)};
}

/// How closely the points crowd into lines along `angle`: the sum, over neighbours across the
/// lines, of their distance, those between lines being cut short.
double crowding(const Points& points, double angle) {
  constexpr double kLine = 0.05;  // [m]
  const Eigen::Vector2d across(-std::sin(angle), std::cos(angle));
  std::vector<double> offsets;
  for (const Eigen::Vector2d& point : points) offsets.push_back(point.dot(across));
  std::sort(offsets.begin(), offsets.end());
  double sum = 0.0;
  for (std::size_t i = 1; i < offsets.size(); ++i) {
    sum += std::min(offsets[i] - offsets[i - 1U], kLine);
  }
  return sum;
}

/// Direction of the rows, in (-90, 90] degrees from x.
double rowAngle(const Points& points) {
  constexpr int kCoarse = 180;  // of a degree each
  constexpr int kFine = 40;
  const double degree = M_PI / 180.0;
  double best = 0.0;
  double least = crowding(points, best);
  const auto attempt = [&](double angle) {
    const double value = crowding(points, angle);
    if (value >= least) return;
    least = value;
    best = angle;
  };
  for (int i = 0; i < kCoarse; ++i) attempt((i - 89) * degree);
  const double middle = best;
  for (int i = -kFine; i <= kFine; ++i) attempt(middle + degree * i / kFine);
  return best;
}

/// A plant along and across the rows.
struct Place {
  double along = 0.0;
  double across = 0.0;
  bool doubtful = false;
};

RowSummary summarise(std::vector<Place> row, double angle, const Eigen::Vector2d& origin) {
  std::sort(row.begin(), row.end(),
            [](const Place& a, const Place& b) { return a.along < b.along; });
  RowSummary summary;
  double across = 0.0;
  double doubtful = 0.0;
  for (const Place& place : row) {
    across += place.across / static_cast<double>(row.size());
    doubtful += place.doubtful ? 1.0 : 0.0;
  }
  summary.plants = static_cast<std::uint32_t>(row.size());
  summary.plants_stddev = 0.5 * std::sqrt(doubtful);
  summary.length = row.back().along - row.front().along;
  const Eigen::Vector2d direction = directionAt(angle);
  const Eigen::Vector2d left(-direction.y(), direction.x());
  summary.start = origin + row.front().along * direction + across * left;
  summary.end = origin + row.back().along * direction + across * left;
  if (row.size() < kLeastPlants) return summary;

  std::vector<double> spacings;
  for (std::size_t i = 1; i < row.size(); ++i) {
    spacings.push_back(row[i].along - row[i - 1U].along);
  }
  const double median = medianOf(spacings);
  std::vector<double> deviations;
  for (const double spacing : spacings) {
    deviations.push_back(std::abs(spacing - median));
    summary.longest_gap = std::max(summary.longest_gap, spacing);
    if (spacing <= kGapSpacings * median) continue;
    ++summary.gaps;
    summary.missing += static_cast<std::uint32_t>(std::lround(spacing / median) - 1L);
  }
  // A median of n is known to 1.25 / sqrt(n) of the spread, which is 1.48 median deviations.
  const double spread = 1.48 * medianOf(deviations);
  summary.spacing = {median, 1.25 * spread / std::sqrt(static_cast<double>(spacings.size()))};
  return summary;
}

/// Distance between the middles of two rows, by how far their plants stand off their lines.
Trait distanceBetween(const std::vector<Place>& row, const std::vector<Place>& next) {
  const auto line = [](const std::vector<Place>& places) -> Trait {
    const double count = static_cast<double>(places.size());
    double mean = 0.0;
    for (const Place& place : places) mean += place.across / count;
    double squares = 0.0;
    for (const Place& place : places) squares += std::pow(place.across - mean, 2);
    // Of few plants hardly anything is known but that they are of one row.
    const double prior = std::pow(0.25 * kRowGap, 2);
    return {mean, std::sqrt((squares + prior) / count / count)};
  };
  const Trait a = line(row);
  const Trait b = line(next);
  return {b.value - a.value, std::hypot(a.stddev, b.stddev)};
}

}  // namespace

std::vector<RowSummary> summariseRows(const std::vector<Phenotype>& plants) {
  std::vector<RowSummary> rows;
  if (plants.size() < kLeastPlants) return rows;
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  for (const Phenotype& plant : plants) {
    origin += plant.base.head<2>() / static_cast<double>(plants.size());
  }
  Points points;
  for (const Phenotype& plant : plants) points.push_back(plant.base.head<2>() - origin);
  const double angle = rowAngle(points);
  const Eigen::Vector2d direction = directionAt(angle);
  std::vector<Place> places;
  for (std::size_t i = 0; i < plants.size(); ++i) {
    places.push_back({points[i].dot(direction),
                      points[i].dot(Eigen::Vector2d(-direction.y(), direction.x())),
                      (plants[i].flags & kLowConfidence) != 0U});
  }
  std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) {
    return a.across != b.across ? a.across < b.across : a.along < b.along;
  });
  std::vector<std::vector<Place>> groups(1);
  for (const Place& place : places) {
    if (!groups.back().empty() && place.across - groups.back().back().across > kRowGap) {
      groups.emplace_back();
    }
    groups.back().push_back(place);
  }
  for (std::size_t i = 0; i < groups.size(); ++i) {
    RowSummary row = summarise(groups[i], angle, origin);
    row.row = static_cast<std::int32_t>(i);
    if (i + 1U < groups.size()) row.row_spacing = distanceBetween(groups[i], groups[i + 1U]);
    rows.push_back(row);
  }
  return rows;
}

std::vector<CanopyLayer> canopyProfile(
    const std::vector<std::shared_ptr<const CompletedBlock>>& blocks) {
  constexpr double kCell = 0.2;   // [m]
  constexpr double kLayer = 0.1;  // [m]
  std::map<std::pair<long, long>, double> tops;
  for (const auto& completed : blocks) {
    const SegmentedBlock& block = *completed->segmented;
    for (const Plant& plant : block.plants) {
      for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
        const Eigen::Vector3d point = block.cloud.mapPoint(i);
        if (!block.header.holds(point.x(), point.y())) continue;
        const std::pair<long, long> cell{std::lround(std::floor(point.x() / kCell)),
                                         std::lround(std::floor(point.y() / kCell))};
        const double height = static_cast<double>(block.ground.heightAbove(block.cloud.points[i]));
        double& top = tops.insert({cell, height}).first->second;
        top = std::max(top, height);
      }
    }
  }
  std::vector<CanopyLayer> layers;
  if (tops.empty()) return layers;
  double highest = 0.0;
  for (const auto& [cell, top] : tops) highest = std::max(highest, top);
  const double count = static_cast<double>(tops.size());
  for (int k = 0; k * kLayer <= highest; ++k) {
    CanopyLayer layer;
    layer.height = k * kLayer;
    const auto covered = std::count_if(
        tops.begin(), tops.end(), [&](const auto& entry) { return entry.second >= layer.height; });
    const double share = static_cast<double>(covered) / count;
    // With one cell more of each kind: neither all nor none is known for certain.
    const double smooth = (static_cast<double>(covered) + 1.0) / (count + 2.0);
    layer.cover = {share, std::sqrt(smooth * (1.0 - smooth) / (count + 2.0))};
    layers.push_back(layer);
  }
  return layers;
}

}  // namespace field_phenotyping
