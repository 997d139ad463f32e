#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#ifdef __SSE__
#include <xmmintrin.h>
#endif

#include "field_phenotyping/common/team.hpp"

// Four values at once, in the vectors that every 64-bit processor has.

namespace field_phenotyping {

using Floats = float __attribute__((vector_size(kLanes * sizeof(float))));
using Integers = std::int32_t __attribute__((vector_size(kLanes * sizeof(std::int32_t))));

inline Floats allOf(float value) {
  return Floats{} + value;
}
inline Integers allOf(std::int32_t value) {
  return Integers{} + value;
}

/// Of kLanes values that lie side by side.
inline Floats loadFloats(const float* values) {
  Floats lanes;
  std::memcpy(&lanes, values, sizeof lanes);
  return lanes;
}
inline Integers loadIntegers(const std::int32_t* values) {
  Integers lanes;
  std::memcpy(&lanes, values, sizeof lanes);
  return lanes;
}
inline void store(const Floats& lanes, float* values) {
  std::memcpy(values, &lanes, sizeof lanes);
}

inline float total(const Floats& lanes) {
  return (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]);
}

/// Holds in the first `count` lanes.
inline Integers lanesBefore(std::size_t count) {
  return Integers{0, 1, 2, 3} < static_cast<std::int32_t>(count);
}

/// A bit for each lane in which a comparison holds, that of the first lane lowest.
inline unsigned bitsOf(const Integers& holds) {
#ifdef __SSE__
  Floats lanes;  // of which the instruction takes the signs
  std::memcpy(&lanes, &holds, sizeof lanes);
  return static_cast<unsigned>(_mm_movemask_ps(lanes));
#else
  return (static_cast<unsigned>(holds[0]) & 1U) | (static_cast<unsigned>(holds[1]) & 2U) |
         (static_cast<unsigned>(holds[2]) & 4U) | (static_cast<unsigned>(holds[3]) & 8U);
#endif
}

/// Whether a comparison holds in any lane.
inline bool anyOf(const Integers& holds) {
  return bitsOf(holds) != 0U;
}

// Instructions that the compiler does not find by itself.
/// The larger value of each lane.
inline Floats largerOf(const Floats& a, const Floats& b) {
#ifdef __SSE__
  return _mm_max_ps(a, b);
#else
  return a > b ? a : b;
#endif
}
/// The smaller value of each lane.
inline Floats smallerOf(const Floats& a, const Floats& b) {
#ifdef __SSE__
  return _mm_min_ps(a, b);
#else
  return a < b ? a : b;
#endif
}
inline Floats squareRootOf(const Floats& values) {
#ifdef __SSE__
  return _mm_sqrt_ps(values);
#else
  return Floats{std::sqrt(values[0]), std::sqrt(values[1]), std::sqrt(values[2]),
                std::sqrt(values[3])};
#endif
}
/// The nearest values in [low, high].
inline Floats clampedTo(const Floats& values, float low, float high) {
  return smallerOf(largerOf(values, allOf(low)), allOf(high));
}
inline Floats magnitudeOf(const Floats& values) {
  return largerOf(values, -values);
}

/// exponentialOf() for vectors of any length.
template <class Values, class Whole>
[[gnu::always_inline]] inline Values exponentialOfLanes(const Values& values) {
  Values whole;
  const Values series = exponentialOver(values, whole);
  constexpr std::int32_t kBias = 127;  // of a float's exponent, which begins at bit 23
  const Whole bits = (__builtin_convertvector(whole, Whole) + kBias) << 23;
  Values scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return series * scale;
}

/// Exponentials of values in [-87, 87], exact to six digits.
inline Floats exponentialOf(const Floats& values) {
  return exponentialOfLanes<Floats, Integers>(values);
}

/// Logarithms of values >= 1, exact to 1e-6 of them or of 1.
inline Floats logarithmOf(const Floats& values) {
  Integers bits;
  std::memcpy(&bits, &values, sizeof bits);
  constexpr std::int32_t kBias = 127;  // of a float's exponent, which begins at bit 23
  constexpr std::int32_t kMantissa = 0x007FFFFF;
  const Floats exponent = __builtin_convertvector((bits >> 23) - kBias, Floats);
  bits = (bits & kMantissa) | (kBias << 23);
  Floats mantissa;  // in [1, 2)
  std::memcpy(&mantissa, &bits, sizeof mantissa);
  // log m = 2 artanh((m - 1) / (m + 1)); half the range of m makes the series short.
  constexpr float kRootTwo = 1.41421356F;
  const Integers large = mantissa > kRootTwo;
  mantissa = large ? 0.5F * mantissa : mantissa;
  const Floats power = exponent + (large ? allOf(1.0F) : Floats{});
  const Floats ratio = (mantissa - 1.0F) / (mantissa + 1.0F);
  const Floats square = ratio * ratio;
  const Floats series =
      2.0F + square * (2.0F / 3.0F +
                       square * (2.0F / 5.0F + square * (2.0F / 7.0F + square * 2.0F / 9.0F)));
  return power * 0.693147181F + ratio * series;
}

/// Angles [rad] whose tangents are `rise` / `run`, both >= 0; 0 where both are. Exact to 1e-6.
inline Floats arctangentOf(const Floats& rise, const Floats& run) {
  constexpr float kHalfPi = 1.57079633F;
  constexpr float kTiny = 1e-30F;
  const Floats larger = largerOf(largerOf(rise, run), allOf(kTiny));
  const Floats tangent = smallerOf(rise, run) / larger;
  const Floats square = tangent * tangent;
  // Abramowitz and Stegun, 4.4.49.
  const Floats series =
      1.0F +
      square *
          (-0.3333314528F +
           square *
               (0.1999355085F +
                square * (-0.1420889944F +
                          square * (0.1065626393F +
                                    square * (-0.0752896400F +
                                              square * (0.0429096138F +
                                                        square * (-0.0161657367F +
                                                                  square * 0.0028662257F)))))));
  const Floats angle = tangent * series;
  return rise > run ? kHalfPi - angle : angle;
}

/// Arcsines [rad] of values in [0, 1], exact to 1e-6: a square root carries the steep end, and the
/// rest is smooth.
inline Floats arcsineOf(const Floats& values) {
  constexpr float kHalfPi = 1.57079633F;
  return kHalfPi - squareRootOf(1.0F - values) * arcsineSeries(values);
}

}  // namespace field_phenotyping
