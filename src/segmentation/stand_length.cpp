#include "field_phenotyping/segmentation/stand_length.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

/// Density of a stem's length [1/m].
double lengthDensity(const StandLength& stand, double length) {
  const double z = (length - stand.typical) / stand.spread;
  return std::exp(-0.5 * z * z) / (std::sqrt(2.0 * M_PI) * stand.spread);
}

/// Density of the length shown where the axis runs on [1/m]: normal and exponential convolved.
double excessDensity(const StandLength& stand, double shown) {
  const double rate = 1.0 / stand.excess;
  const double shift = rate * stand.spread * stand.spread;
  const double below = stand.typical - shown;
  constexpr double kMostExponent = 50.0;  // far below, where the other factor vanishes
  return rate * std::exp(std::min(rate * (below + 0.5 * shift), kMostExponent)) * 0.5 *
         std::erfc((below + shift) / (std::sqrt(2.0) * stand.spread));
}

}  // namespace

double StandLength::logPrior(double length) const {
  constexpr double kFreedom = 4.0;  // of Student's t
  if (!known()) return 0.0;
  const double z = (length - typical) / spread;
  return -0.5 * (kFreedom + 1.0) * std::log1p(z * z / kFreedom);
}

double StandLength::likelyLength(double shown) const {
  if (!known()) return shown;
  const double ran_on = excess_share * excessDensity(*this, shown);
  const double ended = (1.0 - excess_share) * lengthDensity(*this, shown);
  if (!(ran_on > ended)) return shown;
  return std::min(shown, typical + spread * spread / excess);
}

StandLength fitStandLength(const std::vector<double>& shown) {
  constexpr std::size_t kLeastStems = 8U;
  constexpr double kSpread = 0.06;   // of the length, that plants of one stand differ by
  constexpr double kStrange = 0.03;  // share of stems that are nothing of the kind
  constexpr double kLowest = 0.5;    // of the median shown
  constexpr double kHighest = 1.15;
  constexpr int kSteps = 65;
  StandLength best;
  if (shown.size() < kLeastStems) return best;
  std::vector<double> sorted = shown;
  const double median = medianOf(sorted);
  double most = -std::numeric_limits<double>::infinity();
  for (int k = 0; k <= kSteps; ++k) {
    StandLength stand;
    stand.typical = median * (kLowest + (kHighest - kLowest) * k / kSteps);
    stand.spread = kSpread * stand.typical;
    for (const double excess : {0.03, 0.06, 0.1, 0.2, 0.35}) {
      stand.excess = excess * stand.typical;
      std::vector<double> ended;
      std::vector<double> ran_on;
      for (const double length : shown) {
        ended.push_back(lengthDensity(stand, length));
        ran_on.push_back(excessDensity(stand, length));
      }
      for (const double share : {0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9}) {
        stand.excess_share = share;
        double sum = 0.0;
        for (std::size_t i = 0; i < shown.size(); ++i) {
          sum += std::log((1.0 - kStrange) * ((1.0 - share) * ended[i] + share * ran_on[i]) +
                          kStrange / (2.0 * median));
        }
        if (sum <= most) continue;
        most = sum;
        best = stand;
      }
    }
  }
  return best;
}

}  // namespace field_phenotyping
