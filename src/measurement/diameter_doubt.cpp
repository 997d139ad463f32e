#include "field_phenotyping/measurement/diameter_doubt.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kLeastStems = 6U;
// Plants of one stand differ by 6 to 10 % in diameter; that is worth so many stems.
constexpr double kUsualSpread = 0.08;
constexpr double kUsualStems = 20.0;
// Wrong fits, and odd plants, scatter by this share of the mean diameter.
constexpr double kWideSpread = 0.25;
constexpr double kOddPlants = 0.05;  // share: runts, tillers
// So many right fits are taken as seen in any stand: a few plants make no wrong ones likely.
constexpr double kRightFits = 20.0;
// A fit whose own standard deviation is this share of the mean or more is as likely wrong as any;
// one that is better known much less.
constexpr double kRoughFit = 0.06;

double square(double value) {
  return value * value;
}

/// What a stand's diameters are like.
struct Stand {
  double mean = 0.0;         ///< [m]
  double variance = 0.0;     ///< of true diameters
  double wrong_share = 0.0;  ///< of rough fits

  double wideVariance() const { return square(kWideSpread * mean); }
};

/// Probabilities of what a diameter is; the rest is odd.
struct Kind {
  double usual = 0.0;  ///< a right fit of one of the stand
  double wrong = 0.0;
};

double roughness(const Trait& diameter, const Stand& stand) {
  return std::min(square(square(diameter.stddev / (kRoughFit * stand.mean))), 1.0);
}

Kind kindOf(const Trait& diameter, const Stand& stand) {
  const double deviation = diameter.value - stand.mean;
  const double narrow = stand.variance + square(diameter.stddev);
  const double wrong_share = stand.wrong_share * roughness(diameter, stand);
  const double of_stand = normalDensity(deviation, std::sqrt(narrow));
  const double anything = normalDensity(deviation, std::sqrt(narrow + stand.wideVariance()));
  const double usual = (1.0 - wrong_share) * (1.0 - kOddPlants) * of_stand;
  const double odd = (1.0 - wrong_share) * kOddPlants * anything;
  const double wrong = wrong_share * anything;
  const double sum = usual + odd + wrong;
  if (!(sum > 0.0)) return {0.0, wrong_share / (wrong_share + kOddPlants)};  // far from all
  return {usual / sum, wrong / sum};
}

/// What is known of a value with a normal prior from a measurement: mean and variance.
struct Posterior {
  double mean = 0.0;
  double variance = 0.0;
};
Posterior posteriorOf(const Stand& stand, double measured, double variance) {
  const double sum = stand.variance + variance;
  return {(measured * stand.variance + stand.mean * variance) / sum,
          stand.variance * variance / sum};
}

Stand standOf(const std::vector<Trait>& diameters) {
  constexpr int kSteps = 60;
  std::vector<double> values;
  for (const Trait& diameter : diameters) values.push_back(diameter.value);
  Stand stand;
  stand.mean = medianOf(values);
  stand.variance = square(kUsualSpread * stand.mean);
  stand.wrong_share = 0.05;  // where to begin
  for (int step = 0; step < kSteps; ++step) {
    double weights = 0.0, sum = 0.0, usual = 0.0, scatter = 0.0, wrong = 0.0, rough = 0.0;
    for (const Trait& diameter : diameters) {
      const Kind kind = kindOf(diameter, stand);
      const double weight = kind.usual / (stand.variance + square(diameter.stddev));
      weights += weight;
      sum += weight * diameter.value;
      usual += kind.usual;
      const Posterior truth = posteriorOf(stand, diameter.value, square(diameter.stddev));
      scatter += kind.usual * (square(truth.mean - stand.mean) + truth.variance);
      wrong += kind.wrong;
      rough += roughness(diameter, stand);
    }
    if (weights > 0.0) stand.mean = sum / weights;
    stand.variance =
        (scatter + kUsualStems * square(kUsualSpread * stand.mean)) / (usual + kUsualStems);
    stand.wrong_share = wrong / (rough + kRightFits);
  }
  return stand;
}

DiameterDoubt doubtOf(const Trait& diameter, const Stand& stand) {
  DiameterDoubt doubt;
  doubt.wrong = kindOf(diameter, stand).wrong;
  const double variance = square(diameter.stddev);
  const Posterior truth = posteriorOf(stand, diameter.value, variance + stand.wideVariance());
  const double if_wrong = square(diameter.value - truth.mean) + truth.variance;
  // Not less than it was: being wrong makes nothing better known.
  doubt.diameter = {diameter.value,
                    std::sqrt(variance + doubt.wrong * std::max(if_wrong - variance, 0.0))};
  return doubt;
}

}  // namespace

std::vector<DiameterDoubt> doubtDiameters(const std::vector<Trait>& diameters) {
  std::vector<Trait> measured;
  for (const Trait& diameter : diameters) {
    if (diameter.value > 0.0 && diameter.stddev > 0.0) measured.push_back(diameter);
  }
  std::vector<DiameterDoubt> doubts;
  if (measured.size() < kLeastStems) {
    for (const Trait& diameter : diameters) doubts.push_back({0.0, diameter});
    return doubts;
  }
  const Stand stand = standOf(measured);
  for (const Trait& diameter : diameters) {
    const bool known = diameter.value > 0.0 && diameter.stddev > 0.0;
    doubts.push_back(known ? doubtOf(diameter, stand) : DiameterDoubt{0.0, diameter});
  }
  return doubts;
}

}  // namespace field_phenotyping
