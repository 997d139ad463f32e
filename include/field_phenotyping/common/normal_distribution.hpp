#pragma once

#include <cmath>

namespace field_phenotyping {

/// Standard deviation of normal values, to the median of their absolute deviations from the middle:
/// a few wild ones hardly change that.
constexpr double kMadToSigma = 1.4826;

/// Density of normal values at `off` from their mean; `stddev` > 0.
template <class Number>
Number normalDensity(Number off, Number stddev) {
  constexpr double kPi = 3.1415926535897932;
  const Number z = off / stddev;
  return std::exp(Number(-0.5) * z * z) / (std::sqrt(Number(2.0 * kPi)) * stddev);
}

/// Share of normal values of mean 0 and standard deviation 1 that lie below `value`.
template <class Number>
Number normalShareBelow(Number value) {
  return Number(0.5) * std::erfc(-value / std::sqrt(Number(2)));
}

}  // namespace field_phenotyping
