#include "field_phenotyping/segmentation/row_model.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <limits>
#include <stdexcept>

#include "field_phenotyping/common/log_sum.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr double kClosest = 0.25;        // [m] between rows that are looked for
constexpr double kWidest = 1.5;          // [m]
constexpr double kLeastScatter = 0.012;  // [m] about a row: no drill is finer
constexpr double kMostScatter = 0.15;    // share of the row spacing: beyond it there are no rows
constexpr double kHintError = 0.15;      // share by which a hint may be wrong

Eigen::Vector2d across(const Eigen::Vector2d& along) {
  return {-along.y(), along.x()};
}

struct Range {
  double low;
  double high;
};

Range hinted(double hint, double low, double high) {
  if (!(hint > 0.0)) return {low, high};
  return {(1.0 - kHintError) * hint, (1.0 + kHintError) * hint};
}

}  // namespace

/// Rows while they are being fitted to places.
struct RowModel::Fit {
  double angle = 0.0;  // [rad] of the direction across the rows
  double spacing = 0.0;
  double offset = 0.0;
  double scatter = 0.0;
  double in_rows = 0.5;
  double evidence = -std::numeric_limits<double>::infinity();

  /// Of every direction with every spacing those where the phases of the places agree best, as they
  /// do where there are rows.
  /// @param reach of the places from the origin [m]
  static std::vector<Fit> likely(const std::vector<PlantPlace>& places, double reach,
                                 const Range& spacings);

  Eigen::Vector2d normal() const { return {std::cos(angle), std::sin(angle)}; }
  /// The nearest row and the signed distance from it, of a place so far across the rows.
  struct InRows {
    double row;
    double off;
  };
  InRows inRows(double at) const {
    const double row = std::round((at - offset) / spacing);
    return {row, at - offset - row * spacing};
  }
  /// Density of places against an even one.
  double odds(double off_row) const {
    return in_rows * spacing * normalDensity(off_row, scatter) + 1.0 - in_rows;
  }

  /// Expectation maximisation from a rough start.
  void refine(const std::vector<PlantPlace>& places, const Range& spacings) {
    constexpr int kRounds = 20;
    scatter = kMostScatter * spacing;
    for (int round = 0; round < kRounds; ++round) {
      // A weak prior holds what the places do not determine: the spacing of a single row.
      Eigen::Matrix3d matrix = Eigen::Vector3d(1e-3, 1e-6, 1e-3).asDiagonal();
      Eigen::Vector3d right = Eigen::Vector3d::Zero();
      double total = 0.0;
      double on = 0.0;
      double squares = 0.0;
      const Eigen::Vector2d across_rows = normal();
      const Eigen::Vector2d tangent = across(across_rows);
      for (const PlantPlace& place : places) {
        const auto [row, away] = inRows(across_rows.dot(place.position));
        const double in = 1.0 - (1.0 - in_rows) / odds(away);
        const Eigen::Vector3d slope(tangent.dot(place.position), -1.0, -row);
        matrix += place.weight * in * slope * slope.transpose();
        right -= place.weight * in * away * slope;
        total += place.weight;
        on += place.weight * in;
        squares += place.weight * in * away * away;
      }
      const Eigen::Vector3d change = matrix.ldlt().solve(right);
      angle += change[0];
      offset += change[1];
      spacing = std::clamp(spacing + change[2], spacings.low, spacings.high);
      // One plant more in a row and one more anywhere keep few plants from being sure.
      in_rows = (on + 1.0) / (total + 2.0);
      constexpr double kParameters = 3.0;  // that the same places have determined
      scatter = std::sqrt(squares / std::max(on - kParameters, 1.0));
      scatter = std::clamp(scatter, kLeastScatter, kMostScatter * spacing);
    }
    evidence = 0.0;
    for (const PlantPlace& place : places) {
      evidence += place.weight * std::log(odds(inRows(normal().dot(place.position)).off));
    }
  }
};

std::vector<RowModel::Fit> RowModel::Fit::likely(const std::vector<PlantPlace>& places,
                                                 double reach, const Range& spacings) {
  // Steps so fine that the outermost places stay within a quarter of a row.
  constexpr double kSteps = 4.0;  // of a row
  const double turn = spacings.low / (kSteps * reach);
  const auto turns = static_cast<std::size_t>(std::ceil(M_PI / turn));
  const double lowest = 1.0 / spacings.high;
  const double highest = 1.0 / spacings.low;
  const auto steps = std::max<std::size_t>(
      static_cast<std::size_t>(std::ceil((highest - lowest) * kSteps * reach)), 1U);
  const double step = (highest - lowest) / static_cast<double>(steps);  // [1/m]
  struct Rough {
    Fit fit;
    std::complex<double> sum;
    double squared;
  };
  std::vector<Rough> all(turns * (steps + 1U));
  parallelFor(turns, [&](std::size_t i) {
    Fit fit;
    fit.angle = M_PI * static_cast<double>(i) / static_cast<double>(turns);
    // Each place's phase at a spacing, and by how much it turns from one spacing to the next.
    const std::size_t count = places.size();
    std::vector<double> real(count);
    std::vector<double> imaginary(count);
    std::vector<double> turn_real(count);
    std::vector<double> turn_imaginary(count);
    for (std::size_t p = 0; p < count; ++p) {
      const double phase = 2.0 * M_PI * fit.normal().dot(places[p].position);
      real[p] = places[p].weight * std::cos(phase * lowest);
      imaginary[p] = places[p].weight * std::sin(phase * lowest);
      turn_real[p] = std::cos(phase * step);
      turn_imaginary[p] = std::sin(phase * step);
    }
    for (std::size_t k = 0; k <= steps; ++k) {
      fit.spacing = 1.0 / (lowest + static_cast<double>(k) * step);
      double sum_real = 0.0;
      double sum_imaginary = 0.0;
      for (std::size_t p = 0; p < count; ++p) {
        sum_real += real[p];
        sum_imaginary += imaginary[p];
        const double next = real[p] * turn_real[p] - imaginary[p] * turn_imaginary[p];
        imaginary[p] = real[p] * turn_imaginary[p] + imaginary[p] * turn_real[p];
        real[p] = next;
      }
      all[i * (steps + 1U) + k] = {
          fit, {sum_real, sum_imaginary}, sum_real * sum_real + sum_imaginary * sum_imaginary};
    }
  });
  constexpr std::size_t kTried = 60U;
  const std::size_t tried = std::min(kTried, all.size());
  std::partial_sort(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(tried), all.end(),
                    [](const Rough& a, const Rough& b) {
                      return a.squared != b.squared       ? a.squared > b.squared
                             : a.fit.angle != b.fit.angle ? a.fit.angle < b.fit.angle
                                                          : a.fit.spacing < b.fit.spacing;
                    });
  std::vector<Fit> best;
  for (std::size_t k = 0; k < tried; ++k) {
    best.push_back(all[k].fit);
    best.back().offset = std::arg(all[k].sum) / (2.0 * M_PI) * best.back().spacing;
  }
  return best;
}

std::optional<RowModel> RowModel::find(const std::vector<PlantPlace>& places,
                                       const RowHints& hints) {
  if (hints.row_spacing < 0.0 || hints.plant_spacing < 0.0) {
    throw std::invalid_argument("RowModel: a spacing is negative");
  }
  constexpr std::size_t kLeastPlaces = 8U;
  if (places.size() < kLeastPlaces) return std::nullopt;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const PlantPlace& place : places) middle += place.position;
  middle /= static_cast<double>(places.size());
  std::vector<PlantPlace> centred = places;
  double reach = kClosest;
  for (PlantPlace& place : centred) {
    place.position -= middle;
    reach = std::max(reach, place.position.norm());
  }

  // 1. The likeliest of every direction with every spacing, each fitted.
  const Range spacings = hinted(hints.row_spacing, kClosest, kWidest);
  std::vector<Fit> starts = Fit::likely(centred, reach, spacings);
  Fit best;
  parallelFor(starts.size(), [&](std::size_t k) { starts[k].refine(centred, spacings); });
  for (const Fit& fit : starts) {
    if (fit.evidence > best.evidence) best = fit;
  }
  // So many directions and spacings fit some places by chance; fewer do when one is given.
  constexpr double kLeastEvidence = 16.0;
  constexpr double kLeastHinted = 12.0;
  if (!(best.evidence > (hints.row_spacing > 0.0 ? kLeastHinted : kLeastEvidence))) {
    return std::nullopt;
  }

  RowModel rows;
  rows.direction_ = -across(best.normal());
  const bool along_y = std::abs(rows.direction_.x()) < 0.5;
  if (along_y ? rows.direction_.y() < 0.0 : rows.direction_.x() < 0.0) rows.direction_ *= -1.0;
  const double side = across(rows.direction_).dot(best.normal()) > 0.0 ? 1.0 : -1.0;
  rows.row_spacing_ = best.spacing;
  rows.row_offset_ = side * best.offset + across(rows.direction_).dot(middle);
  rows.row_scatter_ = best.scatter;
  rows.in_rows_ = best.in_rows;
  for (const PlantPlace& place : places) rows.plants_[rows.rowOf(place.position)] += place.weight;
  rows.fitSpacing(places, hints.plant_spacing);
  return rows;
}

int RowModel::rowOf(const Eigen::Vector2d& position) const {
  return static_cast<int>(
      std::lround((across(direction_).dot(position) - row_offset_) / row_spacing_));
}

double RowModel::offRow(const Eigen::Vector2d& position) const {
  return across(direction_).dot(position) - row_offset_ - rowOf(position) * row_spacing_;
}

double RowModel::alongRow(const Eigen::Vector2d& position) const {
  return direction_.dot(position);
}

double RowModel::rowOdds(const Eigen::Vector2d& position) const {
  constexpr double kLeastPlants = 2.0;
  const auto row = plants_.find(rowOf(position));
  if (row == plants_.end() || row->second < kLeastPlants) return 1.0;
  return in_rows_ * row_spacing_ * normalDensity(offRow(position), row_scatter_) + 1.0 - in_rows_;
}

/// Plants follow at the spacing, or at two, three, ... spacings where some are missing.
RowModel::Multiples RowModel::multiplesOf(double interval) const {
  Multiples densities;
  for (std::size_t k = 0; k < densities.size(); ++k) {
    const auto spacings = static_cast<double>(k + 1U);
    densities[k] = normalDensity(interval - spacings * plant_spacing_,
                                 std::sqrt(spacings) * spacing_scatter_ * plant_spacing_);
  }
  return densities;
}

double RowModel::intervalDensity(double interval, const Multiples& multiples) const {
  constexpr double kAnyhow = 0.1;  // share that keeps to no spacing
  constexpr double kLongest = 4.0;
  double density = interval < kLongest * plant_spacing_ ? 1.0 / (kLongest * plant_spacing_) : 0.0;
  density *= kAnyhow;
  double share = (1.0 - kAnyhow) * (1.0 - missing_);
  for (const double multiple : multiples) {
    density += share * multiple;
    share *= missing_;
  }
  constexpr double kNever = 1e-3;
  return std::max(density, kNever / plant_spacing_);
}

void RowModel::fitSpacing(const std::vector<PlantPlace>& places, double hint) {
  constexpr double kNear = 3.0;  // standard deviations from the row
  std::map<int, std::vector<double>> rows;
  for (const PlantPlace& place : places) {
    if (std::abs(offRow(place.position)) > kNear * row_scatter_) continue;
    rows[rowOf(place.position)].push_back(alongRow(place.position));
  }
  std::vector<double> intervals;
  for (auto& [row, at] : rows) {
    std::sort(at.begin(), at.end());
    for (std::size_t i = 1; i < at.size(); ++i) intervals.push_back(at[i] - at[i - 1U]);
  }
  constexpr std::size_t kLeastIntervals = 5U;
  if (intervals.size() < kLeastIntervals) {
    if (!(hint > 0.0)) return;
    plant_spacing_ = hint;
    spacing_scatter_ = 0.3;
    missing_ = 0.2;
    return;
  }
  constexpr double kSmallest = 0.05;  // [m]
  constexpr double kLargest = 1.0;
  const Range spacings = hinted(hint, kSmallest, kLargest);
  struct Best {
    double likelihood = -std::numeric_limits<double>::infinity();
    double spacing = 0.0;
    double scatter = 0.0;
    double missing = 0.0;
  };
  std::vector<Best> of_spacings;
  for (double spacing = spacings.low; spacing <= spacings.high; spacing *= 1.03) {
    of_spacings.emplace_back();
    of_spacings.back().spacing = spacing;
  }
  parallelFor(of_spacings.size(), [&](std::size_t s) {
    Best& best = of_spacings[s];
    RowModel trial;
    trial.plant_spacing_ = best.spacing;
    std::vector<Multiples> multiples(intervals.size());
    for (const double scatter : {0.08, 0.14, 0.2, 0.3, 0.4}) {
      trial.spacing_scatter_ = scatter;
      for (std::size_t i = 0; i < intervals.size(); ++i) {
        multiples[i] = trial.multiplesOf(intervals[i]);
      }
      for (const double missing : {0.03, 0.1, 0.2, 0.35, 0.5}) {
        trial.missing_ = missing;
        LogSum likelihood;
        for (std::size_t i = 0; i < intervals.size(); ++i) {
          likelihood.add(trial.intervalDensity(intervals[i], multiples[i]));
        }
        if (likelihood.value() <= best.likelihood) continue;
        best.likelihood = likelihood.value();
        best.scatter = scatter;
        best.missing = missing;
      }
    }
  });
  const auto best =
      std::max_element(of_spacings.begin(), of_spacings.end(), [](const Best& a, const Best& b) {
        return a.likelihood < b.likelihood;
      });  // the first of the best
  if (best == of_spacings.end() || std::isinf(best->likelihood)) return;
  plant_spacing_ = best->spacing;
  spacing_scatter_ = best->scatter;
  missing_ = best->missing;
}

RowModel::Neighbors RowModel::neighborsOf(const Eigen::Vector2d& position,
                                          const std::vector<Eigen::Vector2d>& others) const {
  const int row = rowOf(position);
  Neighbors next{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  for (const Eigen::Vector2d& other : others) {
    if (rowOf(other) != row) continue;
    const double ahead = alongRow(other) - alongRow(position);
    double& side = ahead > 0.0 ? next.after : next.before;
    side = std::min(side, std::abs(ahead));
  }
  return next;
}

double RowModel::intervalOdds(const Eigen::Vector2d& position,
                              const std::vector<Eigen::Vector2d>& others) const {
  if (!(plant_spacing_ > 0.0)) return 1.0;
  constexpr double kFar = 4.0;  // spacings: beyond it a neighbour tells nothing
  const auto [before, after] = neighborsOf(position, others);
  double odds = 1.0;
  for (const double interval : {before, after}) {
    const double seen = std::min(interval, kFar * plant_spacing_);
    odds *= plant_spacing_ * intervalDensity(seen, multiplesOf(seen));
  }
  return odds;
}

double RowModel::mostRowOdds() const {
  return std::max(in_rows_ * row_spacing_ * normalDensity(0.0, row_scatter_) + 1.0 - in_rows_, 1.0);
}

double RowModel::mostIntervalOdds() const {
  if (!(plant_spacing_ > 0.0)) return 1.0;
  Multiples highest;
  for (std::size_t k = 0; k < highest.size(); ++k) {
    highest[k] = normalDensity(
        0.0, std::sqrt(static_cast<double>(k + 1U)) * spacing_scatter_ * plant_spacing_);
  }
  const double one_side = plant_spacing_ * intervalDensity(0.0, highest);
  return one_side * one_side;
}

double RowModel::spacingOdds(const Eigen::Vector2d& position,
                             const std::vector<Eigen::Vector2d>& others) const {
  if (!(plant_spacing_ > 0.0)) return 1.0;
  const auto [before, after] = neighborsOf(position, others);
  const bool alone = !std::isfinite(before) && !std::isfinite(after);
  if (alone) return 1.0;
  // Plants of a row keep apart; where they leave room, one more was sown.
  const auto room = [&](double distance) {
    constexpr double kTooNear = 0.6;    // of the spacing
    constexpr double kSoftness = 0.08;  // likewise
    constexpr double kDouble = 0.05;    // share of plants with another beside them
    const double apart = (distance / plant_spacing_ - kTooNear) / kSoftness;
    return kDouble + (1.0 - kDouble) / (1.0 + std::exp(-apart));
  };
  constexpr double kSown = 4.0;
  return kSown * room(before) * room(after);
}

}  // namespace field_phenotyping
