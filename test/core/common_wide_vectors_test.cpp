// What wider vectors compute against what the processor's least ones do.

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <vector>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/lanes.hpp"

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

}  // namespace
}  // namespace field_phenotyping
