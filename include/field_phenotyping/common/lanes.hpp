#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

// Four values at once, in the vectors that every 64-bit processor has.

namespace field_phenotyping {

constexpr std::size_t kLanes = 4U;
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

/// Whether a comparison holds in any lane.
inline bool anyOf(const Integers& holds) {
  return (holds[0] | holds[1] | holds[2] | holds[3]) != 0;
}

/// A bit for each lane in which a comparison holds, that of the first lane lowest.
inline unsigned bitsOf(const Integers& holds) {
#ifdef __SSE__
  Floats lanes;  // of which the instruction takes the signs
  std::memcpy(&lanes, &holds, sizeof lanes);
  return static_cast<unsigned>(__builtin_ia32_movmskps(lanes));
#else
  return (static_cast<unsigned>(holds[0]) & 1U) | (static_cast<unsigned>(holds[1]) & 2U) |
         (static_cast<unsigned>(holds[2]) & 4U) | (static_cast<unsigned>(holds[3]) & 8U);
#endif
}

/// The larger value of each lane.
inline Floats largerOf(const Floats& a, const Floats& b) {
  return a > b ? a : b;
}

/// Exponentials of values in [-87, 87], exact to six digits.
inline Floats exponentialOf(const Floats& values) {
  constexpr float kLog2e = 1.44269504F;
  constexpr float kRound = 12582912.0F;  // 1.5 * 2^23: what is added to it becomes whole
  const Floats power = values * kLog2e;
  const Floats whole = (power + kRound) - kRound;
  const Floats rest = (power - whole) * 0.693147181F;  // in [-0.35, 0.35]
  const Floats series =
      1.0F +
      rest * (1.0F + rest * (0.5F + rest * (1.0F / 6.0F + rest * (1.0F / 24.0F +
                                                                  rest * (1.0F / 120.0F +
                                                                          rest * 1.0F / 720.0F)))));
  constexpr std::int32_t kBias = 127;  // of a float's exponent, which begins at bit 23
  const Integers bits = (__builtin_convertvector(whole, Integers) + kBias) << 23;
  Floats scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return series * scale;
}

/// 1 / square root of values > 0, exact to six digits.
inline Floats inverseRootOf(const Floats& values) {
  Integers bits;
  std::memcpy(&bits, &values, sizeof bits);
  bits = 0x5F3759DF - (bits >> 1);  // half the exponent, negated: good to one digit
  Floats root;
  std::memcpy(&root, &bits, sizeof root);
  const Floats half = 0.5F * values;
  for (int round = 0; round < 3; ++round) root *= 1.5F - half * root * root;
  return root;
}

}  // namespace field_phenotyping
