#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "field_phenotyping/common/lanes.hpp"

// Two groups of kLanes values at once, for loops that withWideVectors() runs; elsewhere each is
// worked as two of kLanes. How such vectors are passed depends on the instructions that a function
// is compiled with, which -Wpsabi warns of: here none is passed, for what withWideVectors() runs is
// inlined.

namespace field_phenotyping {

using WideFloats = float __attribute__((vector_size(2 * kLanes * sizeof(float))));
using WideIntegers = std::int32_t __attribute__((vector_size(2 * kLanes * sizeof(std::int32_t))));

/// kLanes of them: the first half or the second.
[[gnu::always_inline]] inline Floats halfOf(const WideFloats& lanes, std::size_t half) {
  Floats values;
  std::memcpy(&values, reinterpret_cast<const char*>(&lanes) + half * sizeof values, sizeof values);
  return values;
}
[[gnu::always_inline]] inline Integers halfOf(const WideIntegers& lanes, std::size_t half) {
  Integers values;
  std::memcpy(&values, reinterpret_cast<const char*>(&lanes) + half * sizeof values, sizeof values);
  return values;
}

/// What VectorLanes are, of twice as many values.
struct WideLanes {
  using Float = WideFloats;
  using Mask = WideIntegers;

  [[gnu::always_inline]] static Float all(float value) { return Float{} + value; }
  [[gnu::always_inline]] static Float load(const float* values, std::size_t i, std::size_t) {
    Float lanes;
    std::memcpy(&lanes, values + i, sizeof lanes);
    return lanes;
  }
  [[gnu::always_inline]] static Mask atMost(const Float& a, const Float& b) { return a <= b; }
  [[gnu::always_inline]] static Mask both(const Mask& a, const Mask& b) { return a & b; }
  [[gnu::always_inline]] static Float where(const Mask& mask, const Float& value) {
    return mask ? value : Float{};
  }
  [[gnu::always_inline]] static Float choose(const Mask& mask, const Float& a, const Float& b) {
    return mask ? a : b;
  }
  [[gnu::always_inline]] static Float larger(const Float& a, const Float& b) {
    return a > b ? a : b;
  }
  [[gnu::always_inline]] static Float smaller(const Float& a, const Float& b) {
    return a < b ? a : b;
  }
  [[gnu::always_inline]] static Float magnitude(const Float& value) {
    return larger(value, -value);
  }
  [[gnu::always_inline]] static Float clamped(const Float& value, float low, float high) {
    return smaller(larger(value, all(low)), all(high));
  }
  [[gnu::always_inline]] static Float squareRoot(const Float& value) {
    return Float{std::sqrt(value[0]), std::sqrt(value[1]), std::sqrt(value[2]),
                 std::sqrt(value[3]), std::sqrt(value[4]), std::sqrt(value[5]),
                 std::sqrt(value[6]), std::sqrt(value[7])};
  }
  [[gnu::always_inline]] static Float arcsine(const Float& value) {
    constexpr float kHalfPi = 1.57079633F;
    return kHalfPi - squareRoot(1.0F - value) * arcsineSeries(value);
  }
  [[gnu::always_inline]] static Float exponential(const Float& value) {
    return exponentialOfLanes<Float, Mask>(value);
  }
  [[gnu::always_inline]] static Floats half(const Float& value, std::size_t which) {
    return halfOf(value, which);
  }
  [[gnu::always_inline]] static bool any(const Mask& mask) {
    return anyOf(halfOf(mask, 0U) | halfOf(mask, 1U));
  }
};

/// The same kLanes values twice, for two tasks side by side; kLanes more can be read.
struct PairLanes : WideLanes {
  [[gnu::always_inline]] static Float load(const float* values, std::size_t i, std::size_t count) {
    const Float lanes = WideLanes::load(values, i, count);
#ifdef __clang__
    return __builtin_shufflevector(lanes, lanes, 0, 1, 2, 3, 0, 1, 2, 3);
#else
    return __builtin_shuffle(lanes, Mask{0, 1, 2, 3, 0, 1, 2, 3});
#endif
  }
  [[gnu::always_inline]] static Float pair(float first, float second) {
    return Float{first, first, first, first, second, second, second, second};
  }
  [[gnu::always_inline]] static Mask before(std::size_t i, std::size_t count) {
    return Mask{0, 1, 2, 3, 0, 1, 2, 3} < static_cast<std::int32_t>(count - i);
  }
};

}  // namespace field_phenotyping
