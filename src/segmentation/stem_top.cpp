#include "field_phenotyping/segmentation/stem_top.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace field_phenotyping {
namespace {

struct Place {
  double arc_length;
  double distance;
  double core;     // [m] radius within which hardly anything but the stem has points
  double skin;     // [m] radius within which points may be the stem's
  double azimuth;  // [rad] about the axis
};

std::vector<Place> placesOf(const std::vector<Eigen::Vector3f>& points,
                            const std::vector<std::uint32_t>& members, const Midline& midline) {
  std::vector<Place> places;
  places.reserve(members.size());
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    if (at.arc_length < 0.0F || at.arc_length > midline.axis.length()) continue;
    const Eigen::Vector3f away = points[i] - at.foot;
    places.push_back({static_cast<double>(at.arc_length), static_cast<double>(at.distance),
                      static_cast<double>(at.radius + 0.5F * midline.spread),
                      static_cast<double>(at.radius + 2.0F * midline.spread),
                      std::atan2(static_cast<double>(away.y()), static_cast<double>(away.x()))});
  }
  return places;
}

/// Log probability of a count under a negative binomial with that mean: stems hide behind leaves,
/// so counts vary far more than by chance alone.
double logCount(double count, double mean, double shape) {
  const double share = mean / (mean + shape);
  return std::lgamma(count + shape) - std::lgamma(shape) - std::lgamma(count + 1.0) +
         count * std::log(share) + shape * std::log1p(-share);
}

std::vector<double> coreCounts(const std::vector<Place>& places, double length,
                               double band_height) {
  std::vector<double> counts(static_cast<std::size_t>(std::ceil(length / band_height)) + 1U, 0.0);
  for (const Place& place : places) {
    if (place.distance < place.core) {
      counts[static_cast<std::size_t>(place.arc_length / band_height)] += 1.0;
    }
  }
  return counts;
}

double medianSeen(const std::vector<double>& counts) {
  std::vector<double> seen;
  for (const double count : counts) {
    if (count > 0.0) seen.push_back(count);
  }
  if (seen.empty()) return 0.0;
  const auto middle = seen.begin() + static_cast<std::ptrdiff_t>(seen.size() / 2U);
  std::nth_element(seen.begin(), middle, seen.end());
  return *middle;
}

/// Where the axis stops being one: the cut that best parts bands with a stem from bands without.
double occupiedLength(const std::vector<Place>& places, double length) {
  // Bands so high that a stem shows some points in each.
  constexpr double kLowest = 0.05;  // [m]
  constexpr double kHighest = 0.20;
  constexpr double kPoints = 5.0;
  const double seen = medianSeen(coreCounts(places, length, kHighest));
  if (!(seen > 0.0)) return length;
  const double band_height = std::clamp(kHighest * kPoints / seen, kLowest, kHighest);
  const std::vector<double> counts = coreCounts(places, length, band_height);
  const double stem_mean = std::max(medianSeen(counts), 1.0);
  constexpr double kOtherShare = 0.12;
  constexpr double kStemShape = 0.8;
  constexpr double kOtherShape = 0.5;

  double sum = 0.0;
  double best = 0.0;
  double end = 0.0;
  for (std::size_t k = 0; k < counts.size(); ++k) {
    sum += logCount(counts[k], stem_mean, kStemShape) -
           logCount(counts[k], kOtherShare * stem_mean, kOtherShape);
    if (sum <= best) continue;
    best = sum;
    end = static_cast<double>(k + 1U) * band_height;
  }
  return end > 0.0 ? std::min(end, length) : length;
}

/// Where the tassel's side branches begin: a bare stretch of stem below, and above it points all
/// round. `occupied` if there is no such place near the end of the axis.
double tasselBase(const std::vector<Place>& places, double occupied) {
  constexpr double kStep = 0.0125;      // [m]
  constexpr double kReach = 0.025;      // [m] of the branches beyond the stem's skin
  constexpr std::size_t kWindow = 8U;   // steps compared
  constexpr double kEmergence = 0.015;  // [m] of stem that branches need to leave its skin
  constexpr double kLongest = 0.55;     // [m] of a tassel
  constexpr double kLeastStem = 0.6;    // of stem and tassel together
  constexpr double kShortest = 0.13;
  constexpr std::size_t kBranchedSteps = 16U;  // that side branches come out of the skin in
  constexpr std::size_t kSectors = 8U;
  constexpr std::size_t kLeastSectors = 5U;
  constexpr std::size_t kFewSectors = 4U;  // where few points show them
  constexpr double kManyPoints = 60.0;
  constexpr double kSectorShare = 0.02;  // of the points, for a sector to count
  constexpr double kStray = 1.0;         // points that noise may put there
  constexpr double kLeastContrast = 4.0;
  constexpr double kLeastPoints = 6.0;
  const auto steps = static_cast<std::size_t>(std::ceil(occupied / kStep)) + 1U;
  std::vector<double> counts(steps, 0.0);
  std::vector<std::array<double, kSectors>> sectors(steps);
  for (auto& slot : sectors) slot.fill(0.0);
  for (const Place& place : places) {
    if (place.arc_length >= occupied || place.distance < place.skin ||
        place.distance > place.skin + kReach) {
      continue;
    }
    const auto step = static_cast<std::size_t>(place.arc_length / kStep);
    counts[step] += 1.0;
    const double turn = (place.azimuth + M_PI) / (2.0 * M_PI);
    sectors[step][std::min(static_cast<std::size_t>(turn * kSectors), kSectors - 1U)] += 1.0;
  }
  // From the top down: the last such place is the tassel's, those below are ears' and leaves'.
  double best = kLeastContrast;
  double base = occupied;
  for (std::size_t k = steps - std::min(steps, kWindow); k >= kWindow; --k) {
    const double at = static_cast<double>(k) * kStep;
    if (at > occupied - kShortest) continue;
    constexpr double kSamePlace = 0.10;  // [m]
    if (at < std::max(occupied - kLongest, kLeastStem * occupied) ||
        (best > kLeastContrast && at < base - kSamePlace))
      break;
    double below = 0.0;
    double above = 0.0;
    std::array<double, kSectors> seen{};
    for (std::size_t j = 0; j < kWindow; ++j) {
      below += counts[k - 1U - j];
      above += counts[k + j];
      for (std::size_t a = 0; a < kSectors; ++a) seen[a] += sectors[k + j][a];
    }
    const auto all_round =
        static_cast<std::size_t>(std::count_if(seen.begin(), seen.end(), [&](double count) {
          return count > std::max(kSectorShare * above, kStray);
        }));
    if (above < kLeastPoints) continue;
    if (all_round < (above < kManyPoints ? kFewSectors : kLeastSectors)) continue;
    // Beyond its branches the tassel is a bare spike; leaves go on.
    double most_beyond = 0.0;
    for (std::size_t j = k + kBranchedSteps; j + kWindow <= steps; ++j) {
      most_beyond =
          std::max(most_beyond,
                   std::accumulate(counts.begin() + static_cast<std::ptrdiff_t>(j),
                                   counts.begin() + static_cast<std::ptrdiff_t>(j + kWindow), 0.0));
    }
    constexpr double kMostBeyond = 0.35;  // of what the branches show
    if (most_beyond > kMostBeyond * above) continue;
    const double contrast = (above + 1.0) / (below + 1.0);
    if (contrast <= best) continue;
    best = contrast;
    base = at - kEmergence;
  }
  return base;
}

}  // namespace

float findStemTop(const std::vector<Eigen::Vector3f>& points,
                  const std::vector<std::uint32_t>& members, const Midline& midline) {
  const std::vector<Place> places = placesOf(points, members, midline);
  const double occupied = occupiedLength(places, static_cast<double>(midline.axis.length()));
  return static_cast<float>(tasselBase(places, occupied));
}

}  // namespace field_phenotyping
