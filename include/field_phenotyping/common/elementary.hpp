#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "field_phenotyping/common/team.hpp"

// Functions that have the same bits on the CPU and on the GPU, whose libraries differ in the last
// digit: nothing but + - * / and the square root.

namespace field_phenotyping {

FIELD_PHENOTYPING_HD inline double largerOf(double a, double b) {
  return a > b ? a : b;
}
FIELD_PHENOTYPING_HD inline double smallerOf(double a, double b) {
  return a < b ? a : b;
}
FIELD_PHENOTYPING_HD inline double magnitudeOf(double a) {
  return a < 0.0 ? -a : a;
}
FIELD_PHENOTYPING_HD inline double lengthOf(double x, double y) {
  return std::sqrt(x * x + y * y);
}

/// Where the pair (a, b), b <= a, is among all pairs.
FIELD_PHENOTYPING_HD constexpr int pairOf(int a, int b) {
  return a * (a + 1) / 2 + b;
}

/// Exponential of a value below 700, exact to 4e-16 of it; 0 below -700. NaN stays NaN.
FIELD_PHENOTYPING_HD inline double exponential(double value) {
  constexpr double kLog2e = 1.4426950408889634;
  constexpr double kLogTwoHigh = 0.69314718055989033;  // the last 11 bits are 0
  constexpr double kLogTwoLow = 5.4979230187083712e-14;
  constexpr double kRound = 6755399441055744.0;  // 1.5 * 2^52: what is added to it becomes whole
  constexpr double kLeast = -700.0;
  const double bounded = value < kLeast ? kLeast : value;
  const double shifted = bounded * kLog2e + kRound;
  const double power = shifted - kRound;
  const double rest = (bounded - power * kLogTwoHigh) - power * kLogTwoLow;  // in [-0.35, 0.35]
  const double square = rest * rest;
  // The series to the 13th power: its even and its odd terms.
  const double even =
      1.0 / 2.0 +
      square * (1.0 / 24.0 +
                square * (1.0 / 720.0 +
                          square * (1.0 / 40320.0 +
                                    square * (1.0 / 3628800.0 + square * (1.0 / 479001600.0)))));
  const double odd =
      1.0 / 6.0 +
      square * (1.0 / 120.0 +
                square * (1.0 / 5040.0 +
                          square * (1.0 / 362880.0 +
                                    square * (1.0 / 39916800.0 + square * (1.0 / 6227020800.0)))));
  const double series = 1.0 + (rest + square * (even + rest * odd));
  std::uint64_t bits;
  std::memcpy(&bits, &shifted, sizeof bits);
  constexpr std::uint64_t kBias = 1023U;  // of a double's exponent, which begins at bit 52
  bits = (bits + kBias) << 52U;
  double scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return value < kLeast ? 0.0 : series * scale;
}

/// Logarithm of a value above 1e-300, exact to 4e-16 of it or of 1. NaN and infinity stay.
FIELD_PHENOTYPING_HD inline double logarithm(double value) {
  constexpr double kMost = 1.7e308;
  if (!(value < kMost)) return value;
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  constexpr std::uint64_t kBias = 1023U;  // of a double's exponent, which begins at bit 52
  constexpr std::uint64_t kMantissa = 0x000FFFFFFFFFFFFFU;
  auto power = static_cast<double>(static_cast<std::int64_t>(bits >> 52U) -
                                   static_cast<std::int64_t>(kBias));
  bits = (bits & kMantissa) | (kBias << 52U);
  double mantissa;  // in [1, 2)
  std::memcpy(&mantissa, &bits, sizeof mantissa);
  constexpr double kRootTwo = 1.4142135623730951;
  if (mantissa > kRootTwo) {
    mantissa *= 0.5;
    power += 1.0;
  }
  // log m = 2 artanh((m - 1) / (m + 1)).
  const double excess = mantissa - 1.0;
  const double ratio = excess / (2.0 + excess);
  const double square = ratio * ratio;
  const double fourth = square * square;
  const double even =
      2.0 / 3.0 +
      fourth * (2.0 / 7.0 + fourth * (2.0 / 11.0 + fourth * (2.0 / 15.0 + fourth * (2.0 / 19.0))));
  const double odd =
      2.0 / 5.0 +
      fourth * (2.0 / 9.0 + fourth * (2.0 / 13.0 + fourth * (2.0 / 17.0 + fourth * (2.0 / 21.0))));
  const double series = 2.0 * ratio + ratio * square * (even + square * odd);
  constexpr double kLogTwoHigh = 0.69314718055989033;
  constexpr double kLogTwoLow = 5.4979230187083712e-14;
  return power * kLogTwoHigh + (series + power * kLogTwoLow);
}

/// A unit vector in the plane.
struct Direction {
  double x;
  double y;
};

/// A direction turned by quarters of a turn from x towards y.
FIELD_PHENOTYPING_HD inline Direction turnedBy(int quarters, const Direction& direction) {
  switch (quarters & 3) {
    case 0:
      return direction;
    case 1:
      return {-direction.y, direction.x};
    case 2:
      return {-direction.x, -direction.y};
    default:
      return {direction.y, -direction.x};
  }
}

/// The `k`-th of `count` directions that part the circle evenly, from x towards y; k < count.
FIELD_PHENOTYPING_HD inline Direction directionOf(int k, int count) {
  // From the nearest quarter of a turn.
  const int quarter = (4 * k + count / 2) / count;
  constexpr double kHalfPi = 1.5707963267948966;
  const double angle = kHalfPi * (4 * k - quarter * count) / count;  // at most an eighth of a turn
  const double square = angle * angle;
  double sine = 0.0;  // series, from their ends
  double cosine = 0.0;
  constexpr int kTerms = 10;
  for (int term = kTerms; term > 0; --term) {
    const double n = 2.0 * term;
    sine = (1.0 + sine) * (-square / (n * (n + 1.0)));
    cosine = (1.0 + cosine) * (-square / (n * (n - 1.0)));
  }
  sine = angle + angle * sine;
  cosine = 1.0 + cosine;
  return turnedBy(quarter, {cosine, sine});
}

/// The unit vector at an angle in [-100, 100] from x towards y, exact to 2e-16 for those of a turn.
FIELD_PHENOTYPING_HD inline Direction directionAt(double angle) {
  constexpr double kHalfPiHigh = 1.5707963267948966;
  constexpr double kHalfPiLow = 6.123233995736766e-17;
  const double quarters = std::floor(angle * (1.0 / kHalfPiHigh) + 0.5);
  const double rest = (angle - quarters * kHalfPiHigh) - quarters * kHalfPiLow;
  const double square = rest * rest;  // at most (pi / 4)^2
  const double sine =
      rest +
      rest * square *
          (-1.0 / 6.0 +
           square * (1.0 / 120.0 +
                     square * (-1.0 / 5040.0 +
                               square * (1.0 / 362880.0 +
                                         square * (-1.0 / 39916800.0 +
                                                   square * (1.0 / 6227020800.0 -
                                                             square * (1.0 / 1307674368000.0)))))));
  const double cosine =
      1.0 +
      square *
          (-0.5 +
           square *
               (1.0 / 24.0 +
                square *
                    (-1.0 / 720.0 +
                     square *
                         (1.0 / 40320.0 +
                          square * (-1.0 / 3628800.0 +
                                    square * (1.0 / 479001600.0 +
                                              square * (-1.0 / 87178291200.0 +
                                                        square * (1.0 / 20922789888000.0))))))));
  return turnedBy(static_cast<int>(quarters), {cosine, sine});
}

/// The angle of a vector from x towards y, in [-pi, pi], exact to 1e-15; 0 of one without length.
FIELD_PHENOTYPING_HD inline double angleOf(double x, double y) {
  constexpr double kPi = 3.1415926535897932;
  const double wide = largerOf(magnitudeOf(x), magnitudeOf(y));
  if (!(wide > 0.0)) return 0.0;
  const double slope = smallerOf(magnitudeOf(x), magnitudeOf(y)) / wide;
  // tan a = t is tan(a - pi / 4) = (t - 1) / (t + 1) and tan(a / 2) = t / (1 + sqrt(1 + t^2)).
  constexpr double kSteep = 0.41421356237309503;  // tan(pi / 8)
  const bool is_steep = slope > kSteep;
  const double turned = is_steep ? (slope - 1.0) / (slope + 1.0) : slope;
  const double half = turned / (1.0 + std::sqrt(1.0 + turned * turned));  // at most 0.2
  const double square = half * half;
  double series = 0.0;
  constexpr int kTerms = 11;
  constexpr double kInverse[kTerms] = {1.0 / 3.0,  1.0 / 5.0,  1.0 / 7.0,  1.0 / 9.0,
                                       1.0 / 11.0, 1.0 / 13.0, 1.0 / 15.0, 1.0 / 17.0,
                                       1.0 / 19.0, 1.0 / 21.0, 1.0 / 23.0};
  for (int term = kTerms - 1; term >= 0; --term) series = square * (kInverse[term] - series);
  const double low = 2.0 * (half - half * series) + (is_steep ? 0.25 * kPi : 0.0);
  const double in_quarter = magnitudeOf(y) > magnitudeOf(x) ? 0.5 * kPi - low : low;
  const double above = x < 0.0 ? kPi - in_quarter : in_quarter;
  return y < 0.0 ? -above : above;
}

}  // namespace field_phenotyping
