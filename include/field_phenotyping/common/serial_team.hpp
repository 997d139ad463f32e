#pragma once

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

/// The lanes of a vector register (see team.hpp).
struct VectorLanes {
  using Float = Floats;
  using Mask = Integers;

  static Float all(float value) { return allOf(value); }
  static Float load(const float* values, std::size_t i, std::size_t /*count*/) {
    return loadFloats(values + i);
  }
  static void store(const Float& value, float* values, std::size_t i, std::size_t /*count*/) {
    field_phenotyping::store(value, values + i);
  }
  static Mask before(std::size_t i, std::size_t count) {
    return i + kLanes <= count ? allOf(-1) : lanesBefore(count - i);
  }
  static Mask atMost(const Float& a, const Float& b) { return a <= b; }
  static Mask both(const Mask& a, const Mask& b) { return a & b; }
  static void mark(const Mask& mask, unsigned char* marks, std::size_t i) {
    for (unsigned bits = bitsOf(mask); bits != 0U; bits &= bits - 1U) {
      marks[i + static_cast<std::size_t>(__builtin_ctz(bits))] = 1U;
    }
  }
  static Float where(const Mask& mask, const Float& value) { return mask ? value : Float{}; }
  static Float larger(const Float& a, const Float& b) { return largerOf(a, b); }
  static Float squareRoot(const Float& value) { return squareRootOf(value); }
  static Float smaller(const Float& a, const Float& b) { return smallerOf(a, b); }
  static Float magnitude(const Float& value) { return magnitudeOf(value); }
  static Float clamped(const Float& value, float low, float high) {
    return clampedTo(value, low, high);
  }
  static Float arcsine(const Float& value) { return arcsineOf(value); }
  static Float choose(const Mask& mask, const Float& a, const Float& b) { return mask ? a : b; }
  static Float numbers() { return Float{0.0F, 1.0F, 2.0F, 3.0F}; }
  static Float exponential(const Float& value) { return exponentialOf(value); }
  static float greatest(const Float& value) {
    const float low = value[0] > value[1] ? value[0] : value[1];
    const float high = value[2] > value[3] ? value[2] : value[3];
    return low > high ? low : high;
  }
  static float total(const Float& value) { return field_phenotyping::total(value); }
  static double product(const Float& value) {
    return static_cast<double>(value[0] * value[1]) * static_cast<double>(value[2] * value[3]);
  }
  static unsigned count(const Mask& mask) {
    constexpr unsigned char kBits[1U << kLanes] = {0U, 1U, 1U, 2U, 1U, 2U, 2U, 3U,
                                                   1U, 2U, 2U, 3U, 2U, 3U, 3U, 4U};
    return kBits[bitsOf(mask)];
  }
  static bool any(const Mask& mask) { return anyOf(mask); }
  static bool first() { return true; }
  static void meet() {}
};

struct WideLanes;
struct PairLanes;

/// The team of one thread that the CPU works with (see team.hpp).
struct SerialTeam {
  using Wide = WideLanes;  ///< what takes most time has vectors of twice as many values where it is
                           ///< alone, see wide_lanes.hpp
  using Pair = PairLanes;  ///< likewise
  static constexpr bool kAlone = true;
  static unsigned rank() { return 0U; }
  static unsigned size() { return 1U; }
  static void sync() {}
  static unsigned group() { return 0U; }
  static unsigned groups() { return 1U; }
  static VectorLanes lanes() { return {}; }
};

}  // namespace field_phenotyping
