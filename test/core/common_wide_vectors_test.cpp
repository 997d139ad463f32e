// What wider vectors compute against what the processor's least ones do.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <vector>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/wide_lanes.hpp"

namespace field_phenotyping {
namespace {

/// Sums and products that a fused multiplication, or another order, would round otherwise.
std::vector<double> manyNumbers() {
  constexpr std::size_t kCount = 4003U;
  std::vector<double> numbers(kCount);
  std::vector<float> lanes(kCount + kLanes, 0.0F);
  for (std::size_t i = 0; i < kCount; ++i) {
    numbers[i] = std::sqrt(static_cast<double>(i) / 3.0) - 17.1;
    lanes[i] = static_cast<float>(numbers[i]);
  }
  double sum = 0.0;
  for (std::size_t i = 0; i < kCount; ++i) {
    numbers[i] = numbers[i] * 1.1 + numbers[i] / 3.7 * numbers[kCount - 1U - i];
    sum += numbers[i] * exponential(-1e-3 * numbers[i]);
  }
  Floats total_of_lanes{};
  for (std::size_t i = 0; i < kCount; i += kLanes) {
    const Floats value = loadFloats(&lanes[i]);
    const Floats chosen = value > 3.0F ? value * value - 0.3F : exponentialOf(value);
    total_of_lanes +=
        squareRootOf(magnitudeOf(chosen)) * arctangentOf(magnitudeOf(value), magnitudeOf(chosen));
  }
  numbers.push_back(sum);
  numbers.push_back(static_cast<double>(total(total_of_lanes)));
  return numbers;
}

TEST(WideVectors, GiveTheSameBits) {
  const std::vector<double> usual = manyNumbers();
  const std::vector<double> wide = withWideVectors([] { return manyNumbers(); });
  ASSERT_EQ(usual.size(), wide.size());
  EXPECT_EQ(std::memcmp(usual.data(), wide.data(), usual.size() * sizeof(double)), 0);
}

TEST(WideVectors, HandOnWhatTheWorkReturns) {
  int calls = 0;
  withWideVectors([&] { ++calls; });
  EXPECT_EQ(withWideVectors([&] { return ++calls; }), 2);
}

/// All that lanes can do with some values, of each lane.
template <class Lanes>
std::vector<typename Lanes::Float> allOperations(const float* values, const float* others) {
  const auto a = Lanes::load(values, 0U, 2U * kLanes);
  const auto b = Lanes::load(others, 0U, 2U * kLanes);
  const auto share = Lanes::clamped(Lanes::magnitude(a) * 0.1F, 0.0F, 1.0F);
  return {a - b * Lanes::all(0.3F),
          Lanes::larger(a, b),
          Lanes::smaller(a, b),
          Lanes::magnitude(a),
          share,
          Lanes::squareRoot(Lanes::magnitude(b)),
          Lanes::arcsine(share),
          Lanes::exponential(a),
          Lanes::where(Lanes::both(Lanes::atMost(a, b), Lanes::atMost(b, Lanes::all(2.0F))), a),
          Lanes::choose(Lanes::atMost(a, b), b, a),
          Lanes::all(Lanes::any(Lanes::atMost(a, Lanes::all(-3.0F))) ? 1.0F : 0.0F)};
}

std::vector<float> wavesOf(float frequency) {
  std::vector<float> values(1000U + 2U * kLanes);
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = 5.0F * std::sin(frequency * static_cast<float>(i));
  }
  values[7] = values[8] = 0.0F;
  values[11] = -0.0F;
  return values;
}

/// Compares lanes bit by bit.
void expectSame(const Floats& a, const Floats& b, std::size_t operation) {
  EXPECT_EQ(std::memcmp(&a, &b, sizeof a), 0) << operation;
}

TEST(WideVectors, AreTwiceAsManyLanes) {
  const std::vector<float> a = wavesOf(0.7F);
  const std::vector<float> b = wavesOf(1.3F);
  for (std::size_t i = 0; i + 2U * kLanes <= a.size(); i += 2U * kLanes) {
    const auto low = allOperations<VectorLanes>(&a[i], &b[i]);
    const auto high = allOperations<VectorLanes>(&a[i + kLanes], &b[i + kLanes]);
    std::vector<std::array<Floats, 2>> halves;
    withWideVectors([&] {
      for (const WideFloats& both : allOperations<WideLanes>(&a[i], &b[i])) {
        halves.push_back({halfOf(both, 0U), halfOf(both, 1U)});
      }
    });
    ASSERT_EQ(halves.size(), low.size());
    for (std::size_t k = 0; k + 1U < halves.size(); ++k) {
      expectSame(halves[k][0], low[k], k);
      expectSame(halves[k][1], high[k], k);
    }
    EXPECT_EQ(halves.back()[0][0], std::max(low.back()[0], high.back()[0]));  // of any lane
  }
}

TEST(WideVectors, HoldATaskInEitherHalf) {
  const std::vector<float> a = wavesOf(0.7F);
  const std::vector<float> b = wavesOf(1.3F);
  std::array<Floats, 4> halves;
  withWideVectors([&] {
    const WideFloats loaded = PairLanes::load(&a[5], 0U, 3U) - PairLanes::pair(b[1], b[2]);
    const WideFloats before = PairLanes::where(PairLanes::before(2U, 5U), PairLanes::all(1.0F));
    halves = {halfOf(loaded, 0U), halfOf(loaded, 1U), halfOf(before, 0U), halfOf(before, 1U)};
  });
  expectSame(halves[0], loadFloats(&a[5]) - b[1], 0U);
  expectSame(halves[1], loadFloats(&a[5]) - b[2], 1U);
  expectSame(halves[2], Floats{1.0F, 1.0F, 1.0F, 0.0F}, 2U);
  expectSame(halves[3], halves[2], 3U);
}

}  // namespace
}  // namespace field_phenotyping
