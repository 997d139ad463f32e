#include "field_phenotyping/segmentation/stand_length.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <limits>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

/// Density of a stem's length [1/m].
double lengthDensity(const StandLength& stand, double length) {
  return normalDensity(length - stand.typical, stand.spread);
}

/// Density of a normal deviate of that spread with an exponential one added [1/m].
double exGaussianDensity(double value, double spread, double mean_added) {
  const double rate = 1.0 / mean_added;
  const double shift = rate * spread * spread;
  constexpr double kMostExponent = 50.0;  // far below, where the other factor vanishes
  return rate * std::exp(std::min(rate * (0.5 * shift - value), kMostExponent)) *
         normalShareBelow((value - shift) / spread);
}

/// Density of the length shown where the axis runs on [1/m].
double excessDensity(const StandLength& stand, double shown) {
  return exGaussianDensity(shown - stand.typical, stand.spread, stand.excess);
}

/// Density of the length shown where the axis stops short [1/m].
double deficitDensity(const StandLength& stand, double shown) {
  constexpr double kDeficit = 0.15;  // of the length, on average
  return exGaussianDensity(stand.typical - shown, stand.spread, kDeficit * stand.typical);
}

/// Share of the stems that stop short, by how densely what is as high as their ends is sampled.
double shortShare(double sampling) {
  constexpr double kClear = 0.18;  // sampled well enough to see every end
  constexpr double kMost = 0.5;
  return kMost * std::max(0.0, 1.0 - sampling / kClear);
}

}  // namespace

double StandLength::logPrior(double length) const {
  constexpr double kFreedom = 4.0;  // of Student's t
  if (!known()) return 0.0;
  const double z = (length - typical) / spread;
  return -0.5 * (kFreedom + 1.0) * std::log1p(z * z / kFreedom);
}

double StandLength::logPriorWithin(double length) const {
  return length < typical ? logPrior(length) : 0.0;
}

double StandLength::likelyLength(double shown) const {
  if (!known()) return shown;
  const double ran_on = excess_share * excessDensity(*this, shown);
  const double ended = (1.0 - excess_share) * lengthDensity(*this, shown);
  if (!(ran_on > ended)) return shown;
  return std::min(shown, typical + spread * spread / excess);
}

StandLength StandLength::scaledBy(double factor) const {
  return {typical * factor, spread * factor, excess * factor, excess_share};
}

StandFit fitStandLength(const std::vector<double>& shown, double relative_spread,
                        double short_share) {
  constexpr std::size_t kLeastStems = 5U;
  constexpr double kStrange = 0.03;  // share of stems that are nothing of the kind
  constexpr double kLowest = 0.5;    // of the median shown
  constexpr double kHighest = 1.15;
  constexpr std::size_t kSteps = 65U;
  constexpr double kExcesses[] = {0.03, 0.06, 0.1, 0.2, 0.35};
  constexpr double kWider[] = {1.0, 1.5};  // where the ends themselves are uncertain
  if (shown.size() < kLeastStems) return {};
  const double median = medianOf(shown);
  /// How likely the lengths are, whatever the stems' excess.
  struct Densities {
    std::vector<double> ended;
    std::vector<double> other;
  };
  const auto densitiesOf = [&](const StandLength& stand) {
    Densities densities;
    for (const double length : shown) {
      densities.ended.push_back(lengthDensity(stand, length));
      const double stopped = short_share > 0.0 ? short_share * deficitDensity(stand, length) : 0.0;
      densities.other.push_back((1.0 - kStrange) * stopped + kStrange / (2.0 * median));
    }
    return densities;
  };
  const auto tryOne = [&](StandLength stand, const Densities& densities, StandFit& best) {
    std::vector<double> ran_on;
    for (const double length : shown) ran_on.push_back(excessDensity(stand, length));
    for (const double share : {0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9}) {
      stand.excess_share = share;
      double sum = 0.0;
      for (std::size_t i = 0; i < shown.size(); ++i) {
        sum += std::log((1.0 - kStrange) * (1.0 - short_share) *
                            ((1.0 - share) * densities.ended[i] + share * ran_on[i]) +
                        densities.other[i]);
      }
      if (sum > best.log_likelihood) best = {stand, sum};
    }
  };
  StandFit none;
  none.log_likelihood = -std::numeric_limits<double>::infinity();
  std::vector<StandFit> fits(kSteps + 1U, none);  // the best of each typical length
  parallelFor(fits.size(), [&](std::size_t k) {
    const double typical =
        median * (kLowest + (kHighest - kLowest) * static_cast<double>(k) / kSteps);
    const auto standOf = [&](double wider, double excess) {
      return StandLength{typical, wider * relative_spread * typical, excess * typical, 0.0};
    };
    const Densities densities[] = {densitiesOf(standOf(kWider[0], 0.0)),
                                   densitiesOf(standOf(kWider[1], 0.0))};
    for (const double excess : kExcesses) {
      for (std::size_t w = 0; w < std::size(kWider); ++w) {
        tryOne(standOf(kWider[w], excess), densities[w], fits[k]);
      }
    }
  });
  // The first of the best.
  return *std::max_element(fits.begin(), fits.end(), [](const StandFit& a, const StandFit& b) {
    return a.log_likelihood < b.log_likelihood;
  });
}

std::vector<StandLength> standLengths(const std::vector<double>& shown,
                                      const std::vector<double>& heights,
                                      const SamplingProfile& sampling) {
  std::vector<double> shares;
  double log_scale = 0.0;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    shares.push_back(shown[i] / heights[i]);
    log_scale += std::log(heights[i]);
  }
  constexpr double kLengthSpread = 0.06;  // of the length, that plants of one stand differ by
  constexpr double kShareSpread = 0.03;   // of the share, where the heights say much
  const double short_share = shown.empty() ? 0.0 : shortShare(sampling.ofStems(medianOf(shown)));
  const StandFit alike = fitStandLength(shown, kLengthSpread, short_share);
  const StandFit in_proportion = fitStandLength(shares, kShareSpread, short_share);
  const bool proportional = in_proportion.log_likelihood - log_scale > alike.log_likelihood;
  std::vector<StandLength> stands;
  for (const double height : heights) {
    stands.push_back(proportional ? in_proportion.stand.scaledBy(height) : alike.stand);
  }
  return stands;
}

}  // namespace field_phenotyping
