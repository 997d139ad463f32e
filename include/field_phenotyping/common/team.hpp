#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

/// Marks what runs on the CPU and, where it is compiled by nvcc, on the GPU. Such code uses neither
/// Eigen nor the standard library, and of arithmetic only + - * / and the square root, which give
/// the same bits on both.
#ifdef __CUDACC__
#define FIELD_PHENOTYPING_HD __host__ __device__
/// The same for what is long and called from many places: nvcc would copy it into all of them.
#define FIELD_PHENOTYPING_HD_ONCE __host__ __device__ __noinline__
#else
#define FIELD_PHENOTYPING_HD
#define FIELD_PHENOTYPING_HD_ONCE
#endif

namespace field_phenotyping {

/// Values that a lane group works on at once.
constexpr std::size_t kLanes = 4U;

// Work that is to run on the CPU and on the GPU is written once, for a team: a template over a type
// with
//
//   static constexpr bool kAlone          whether it never has more than one member: loops may then
//                                         be unrolled
//   unsigned rank() const, size() const   of this member; members of the team
//   void sync() const                     every member waits here for all others; what they wrote
//                                         before it may be read after it
//   unsigned group() const, groups() const   of this member; groups of the team
//   Lanes lanes() const                   those of its group
//
// A team is divided into groups of kLanes lanes, which work on kLanes consecutive values at once.
// On the CPU a team has one member, whose lanes are those of a vector register (SerialTeam). On the
// GPU it is a thread block, whose lanes are neighbouring threads (CudaTeam); tests have teams of
// CPU threads (EmulatedTeam). All members of a group must come to every call of its lanes' total(),
// product(), greatest(), count() and meet(), all members of the team to every sync(). Lanes have
//
//   Float, Mask                           a value and a truth, of the lanes that this member stands
//                                         for
//   Float all(float) const                the same value in every lane
//   Float load(const float* values, std::size_t i, std::size_t count) const
//                                         values[i] ... values[i + kLanes - 1]; anything in lanes
//                                         at `count` or beyond, but kLanes values beyond it can be
//                                         read
//   void store(Float, float* values, std::size_t i, std::size_t count) const   the reverse
//   Mask before(std::size_t i, std::size_t count) const   the lanes of values[i] ... below `count`
//   Mask atMost(Float a, Float b) const, both(Mask a, Mask b) const
//   void mark(Mask, unsigned char* marks, std::size_t i) const   marks[i] ... = 1 where it is true
//   Float larger(Float a, Float b) const, smaller(Float a, Float b) const
//   Float squareRoot(Float) const
//   Float magnitude(Float) const, clamped(Float, float low, float high) const
//   Float exponential(Float) const, arcsine(Float) const   as exponentialOf(), arcsineOf()
//   Float where(Mask, Float) const        the value where it is true, else 0
//   Float choose(Mask, Float a, Float b) const   a where it is true, else b
//   Float numbers() const                 0 ... kLanes - 1, of the lanes
//   float total(Float) const              sum over the lanes, in one fixed order
//   double product(Float) const           likewise
//   float greatest(Float) const           of all lanes
//   unsigned count(Mask) const            lanes in which it is true
//   bool any(Mask) const                  whether it is true in a lane that this member stands for
//   bool first() const                    whether this member is its group's first
//   void meet() const                     the members of a group wait for one another; what they
//                                         wrote before it they may read after it

/// The next `count` of what `at` points to, which moves on: cuts memory for a team into pieces.
template <class Value>
FIELD_PHENOTYPING_HD Value* takeFrom(Value*& at, int count) {
  Value* const taken = at;
  at += count;
  return taken;
}

/// Sum of the values of all groups; all members get it.
/// @param value the same in all members of a group
/// @param scratch as many values as the team has groups; all members see the same memory
template <class Team, class Value>
FIELD_PHENOTYPING_HD Value teamSum(const Team& team, Value value, Value* scratch) {
  if (team.lanes().first()) scratch[team.group()] = value;
  team.sync();
  Value sum = scratch[0];
  for (unsigned k = 1U; k < team.groups(); ++k) sum += scratch[k];
  team.sync();  // the scratch is free again
  return sum;
}

/// The exponential of a value, or of those of all lanes, over the power of two that is `whole`:
/// exact to six digits for values in [-87, 87].
template <class Float>
FIELD_PHENOTYPING_HD Float exponentialOver(const Float& value, Float& whole) {
  constexpr float kLog2e = 1.44269504F;
  constexpr float kRound = 12582912.0F;  // 1.5 * 2^23: what is added to it becomes whole
  const Float power = value * kLog2e;
  whole = (power + kRound) - kRound;
  const Float rest = (power - whole) * 0.693147181F;  // in [-0.35, 0.35]
  return 1.0F +
         rest * (1.0F +
                 rest * (0.5F + rest * (1.0F / 6.0F +
                                        rest * (1.0F / 24.0F +
                                                rest * (1.0F / 120.0F + rest * 1.0F / 720.0F)))));
}

/// Exponential of a value in [-87, 87], exact to six digits: the bits of a lane of exponentialOf().
FIELD_PHENOTYPING_HD inline float exponentialOfLane(float value) {
  float whole;
  const float series = exponentialOver(value, whole);
  constexpr std::int32_t kBias = 127;  // of a float's exponent, which begins at bit 23
  const auto bits = static_cast<std::uint32_t>(static_cast<std::int32_t>(whole) + kBias) << 23U;
  float scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return series * scale;
}

/// What a value in [0, 1] adds to its arcsine beside the steep end: see arcsineOf().
template <class Float>
FIELD_PHENOTYPING_HD Float arcsineSeries(const Float& x) {
  // Abramowitz and Stegun, 4.4.46.
  return 1.5707963050F +
         x * (-0.2145988016F +
              x * (0.0889789874F +
                   x * (-0.0501743046F +
                        x * (0.0308918810F +
                             x * (-0.0170881256F + x * (0.0066700901F - x * 0.0012624911F))))));
}

/// What is the same in all lanes that are threads of their own.
struct ThreadLanes {
  using Float = float;
  using Mask = bool;

  unsigned lane;  ///< of this thread, in its group

  FIELD_PHENOTYPING_HD static float all(float value) { return value; }
  FIELD_PHENOTYPING_HD float load(const float* values, std::size_t i, std::size_t count) const {
    return i + lane < count ? values[i + lane] : 0.0F;
  }
  FIELD_PHENOTYPING_HD void store(float value, float* values, std::size_t i,
                                  std::size_t count) const {
    if (i + lane < count) values[i + lane] = value;
  }
  FIELD_PHENOTYPING_HD bool before(std::size_t i, std::size_t count) const {
    return i + lane < count;
  }
  FIELD_PHENOTYPING_HD static float larger(float a, float b) { return a > b ? a : b; }
  FIELD_PHENOTYPING_HD static float squareRoot(float value) { return std::sqrt(value); }
  FIELD_PHENOTYPING_HD static float smaller(float a, float b) { return a < b ? a : b; }
  FIELD_PHENOTYPING_HD static float magnitude(float value) { return larger(value, -value); }
  FIELD_PHENOTYPING_HD static float clamped(float value, float low, float high) {
    return smaller(larger(value, low), high);
  }
  FIELD_PHENOTYPING_HD static float arcsine(float value) {
    constexpr float kHalfPi = 1.57079633F;
    return kHalfPi - std::sqrt(1.0F - value) * arcsineSeries(value);
  }
  FIELD_PHENOTYPING_HD static float exponential(float value) { return exponentialOfLane(value); }
  FIELD_PHENOTYPING_HD static bool atMost(float a, float b) { return a <= b; }
  FIELD_PHENOTYPING_HD static bool both(bool a, bool b) { return a && b; }
  FIELD_PHENOTYPING_HD void mark(bool mask, unsigned char* marks, std::size_t i) const {
    if (mask) marks[i + lane] = 1U;
  }
  FIELD_PHENOTYPING_HD static float where(bool mask, float value) { return mask ? value : 0.0F; }
  FIELD_PHENOTYPING_HD static float choose(bool mask, float a, float b) { return mask ? a : b; }
  FIELD_PHENOTYPING_HD float numbers() const { return static_cast<float>(lane); }
  FIELD_PHENOTYPING_HD static bool any(bool mask) { return mask; }
  FIELD_PHENOTYPING_HD bool first() const { return lane == 0U; }
};

}  // namespace field_phenotyping
