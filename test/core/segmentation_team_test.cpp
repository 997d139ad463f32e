// The search for leaf bases by teams of threads: the same bits as by one, whatever the team.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <type_traits>
#include <vector>

#include "emulated_team.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/segmentation/leaf_search_team.hpp"

namespace field_phenotyping {
namespace {

TEST(Lanes, OfThreadsDoAsThoseOfARegister) {
  const std::vector<float> values{0.25F, -0.5F, 0.75F, 1.0F};
  const VectorLanes lanes;
  const Floats vector = lanes.load(values.data(), 0U, kLanes);
  std::vector<double> products(kLanes);
  runEmulatedTeam(1U, [&](const EmulatedTeam& team) {
    const EmulatedLanes own = team.lanes();
    const float value = own.load(values.data(), 0U, kLanes);
    products[team.rank()] = own.product(value);
    const unsigned k = team.rank();
    EXPECT_EQ(own.numbers(), lanes.numbers()[k]);
    EXPECT_EQ(own.magnitude(value), lanes.magnitude(vector)[k]);
    EXPECT_EQ(own.smaller(value, 0.3F), lanes.smaller(vector, lanes.all(0.3F))[k]);
    EXPECT_EQ(own.clamped(value, 0.0F, 0.8F), lanes.clamped(vector, 0.0F, 0.8F)[k]);
    const float size = own.magnitude(value);
    EXPECT_EQ(own.arcsine(size), lanes.arcsine(lanes.magnitude(vector))[k]);
    EXPECT_NEAR(own.arcsine(size), std::asin(size), 2e-6);
    EXPECT_EQ(own.choose(own.atMost(value, 0.3F), 7.0F, value),
              lanes.choose(lanes.atMost(vector, lanes.all(0.3F)), lanes.all(7.0F), vector)[k]);
  });
  for (const double product : products) EXPECT_EQ(product, lanes.product(vector));
  EXPECT_EQ(products.front(), 0.25 * -0.5 * 0.75);
}

/// A stem about an axis with two leaves, as LeafBases looks at it.
struct Stem {
  std::vector<float> arc_lengths, azimuths, distances, radii, stem;
  std::vector<LeafBase> guesses;
  LeafSearchTask task;

  explicit Stem(int points) {
    constexpr float kRadius = 0.01F;
    constexpr float kNoise = 0.002F;
    constexpr float kLength = 0.5F;
    const float heights[] = {0.1F, 0.3F};
    const float sides[] = {1.0F, -2.2F};
    std::mt19937 random(11U);
    std::uniform_real_distribution<float> uniform;
    std::normal_distribution<float> noise(0.0F, kNoise);
    for (int i = 0; i < points; ++i) arc_lengths.push_back(kLength * uniform(random));
    std::sort(arc_lengths.begin(), arc_lengths.end());
    for (int i = 0; i < points; ++i) {
      const float up = arc_lengths[static_cast<std::size_t>(i)];
      const int leaf = up > heights[1] ? 1 : 0;
      const float above = up - heights[leaf];
      const bool is_leaf = i % 2 == 0 && above > 0.0F && above < 0.05F;
      azimuths.push_back(is_leaf ? sides[leaf] + 0.6F * (uniform(random) - 0.5F)
                                 : leaf::kPi * (2.0F * uniform(random) - 1.0F));
      distances.push_back(kRadius + (is_leaf ? 0.5F * above : 0.0F) + noise(random));
      radii.push_back(kRadius);
    }
    task.count = points;
    task.spread = kNoise;
    task.stem_density = static_cast<float>(points) / (kLength * 2.0F * leaf::kPi * kRadius);
    task.clutter = 20.0F;
    for (int i = 0; i < points; ++i) {
      const float z = (distances[static_cast<std::size_t>(i)] - kRadius) / kNoise;
      stem.push_back(task.stem_density * 0.4F / kNoise * std::exp(-0.5F * z * z));
    }
    for (std::vector<float>* values : {&arc_lengths, &azimuths, &distances, &radii, &stem}) {
      values->resize(values->size() + kLanes);
    }
    for (float height = 0.0F; height < kLength; height += 0.05F) {
      for (const float side : {-2.5F, 0.7F}) guesses.push_back({height + 0.004F, side, 0.4F});
    }
    task.arc_lengths = arc_lengths.data();
    task.azimuths = azimuths.data();
    task.distances = distances.data();
    task.radii = radii.data();
    task.stem = stem.data();
    task.guesses = guesses.data();
    task.guess_count = static_cast<int>(guesses.size());
  }
};

/// @param run calls what it is given with the members of a team
template <class Run>
std::vector<LeafBase> findBy(const Stem& stem, std::size_t members, const Run& run) {
  const std::size_t guesses = stem.guesses.size();
  std::vector<float> hidden(stem.stem.size()), leaves(stem.stem.size());
  std::vector<LeafBase> candidates(guesses), others(guesses), found(guesses);
  std::vector<int> kept(guesses), counts(members);
  int count = 0;
  run([&](const auto& team) {
    LeafSearch<std::decay_t<decltype(team)>> search(
        team, stem.task,
        {hidden.data(), leaves.data(), candidates.data(), others.data(), found.data(), kept.data(),
         &count});
    counts[team.rank()] = search.find();
  });
  for (const int other : counts) EXPECT_EQ(other, counts.front());
  found.resize(static_cast<std::size_t>(counts.front()));
  return found;
}

TEST(LeafSearchTeam, FindsWhatOneThreadDoesBitForBit) {
  for (const int points : {90, 241}) {
    const Stem stem(points);
    const std::vector<LeafBase> alone =
        findBy(stem, 1U, [](const auto& work) { work(SerialTeam()); });
    EXPECT_GE(alone.size(), points > 200 ? 2U : 1U);
    for (const unsigned groups : {1U, 3U}) {
      const std::vector<LeafBase> together =
          findBy(stem, groups * kLanes, [&](const auto& work) { runEmulatedTeam(groups, work); });
      ASSERT_EQ(together.size(), alone.size()) << groups;
      for (std::size_t k = 0; k < alone.size(); ++k) {
        EXPECT_EQ(together[k].arc_length, alone[k].arc_length);
        EXPECT_EQ(together[k].azimuth, alone[k].azimuth);
        EXPECT_EQ(together[k].slope, alone[k].slope);
        EXPECT_EQ(together[k].evidence, alone[k].evidence);
        EXPECT_EQ(together[k].sight, alone[k].sight);
      }
    }
  }
}

TEST(LeafSearchTeam, OfNothingThereIsNone) {
  Stem stem(50);
  stem.guesses.clear();
  stem.task.guess_count = 0;
  EXPECT_TRUE(findBy(stem, 1U, [](const auto& work) { work(SerialTeam()); }).empty());
}

}  // namespace
}  // namespace field_phenotyping
