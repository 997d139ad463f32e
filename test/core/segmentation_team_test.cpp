// Leaf bases and growth of stems by teams of threads: the same bits as by one, whatever the team.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <type_traits>
#include <vector>

#include "emulated_team.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/wide_lanes.hpp"
#include "field_phenotyping/segmentation/leaf_bases.hpp"
#include "field_phenotyping/segmentation/leaf_search_team.hpp"
#include "field_phenotyping/segmentation/stem_growth_team.hpp"
#include "growth_room.hpp"

namespace field_phenotyping {
namespace {

TEST(Lanes, OfThreadsDoAsThoseOfARegister) {
  const std::vector<float> values{0.25F, -0.5F, 0.75F, 1.0F};
  const VectorLanes lanes;
  const Floats vector = lanes.load(values.data(), 0U, kLanes);
  std::vector<double> products(kLanes);
  std::vector<unsigned char> marks(kLanes);
  std::vector<unsigned char> vector_marks(kLanes);
  lanes.mark(lanes.atMost(vector, lanes.all(0.3F)), vector_marks.data(), 0U);
  runEmulatedTeam(1U, [&](const EmulatedTeam& team) {
    const EmulatedLanes own = team.lanes();
    const float value = own.load(values.data(), 0U, kLanes);
    products[team.rank()] = own.product(value);
    own.mark(own.atMost(value, 0.3F), marks.data(), 0U);
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
  EXPECT_EQ(marks, (std::vector<unsigned char>{1U, 1U, 0U, 0U}));
  EXPECT_EQ(vector_marks, marks);
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

/// A bent stem with leaves and a gap, and regions along it.
struct StemAmongLeaves {
  std::vector<Eigen::Vector3f> points;
  std::vector<LocalShape> shapes;
  NeighborGrid grid;
  Midline midline;
  std::vector<LeafBase> leaf_bases{{0.1F, 0.5F, 0.4F, 5.0F, 1.0F},
                                   {0.33F, -2.6F, 0.7F, 5.0F, 1.1F}};
  std::vector<GrowthRegionTask> regions;
  GrowthTask task;

  explicit StemAmongLeaves(int count) : points(pointsOf(count)), grid(points, 0.04F) {
    shapes = computeLocalShapes(points, grid, 0.04F);
    midline.axis = StemAxis({{{0.0F, 0.0F, 0.0F}, 0.012F},
                             {{0.01F, 0.0F, 0.3F}, 0.010F},
                             {{0.05F, 0.02F, 0.6F}, 0.009F}});
    midline.spread = 0.002F;
    constexpr int kRegions = 9;
    for (int k = 0; k < kRegions; ++k) {
      const float part = midline.axis.length() / static_cast<float>(kRegions);
      const float begin = part * static_cast<float>(k);
      regions.push_back(testing::regionTask(midline.axis.pointAt(begin),
                                            midline.axis.pointAt(begin + part),
                                            k % 3 == 0 ? 0.8F : 1.0F));
      regions.back().longest_carried = 0.1F;
    }
    task = testing::growthTask(scene(), midline, regions, settings());
    task.leaf_bases = leaf_bases.data();
    task.base_count = static_cast<int>(leaf_bases.size());
    task.leaf_spread = midline.spread;
    task.least = 0.3F;
    task.bands = 6;
    task.band_height = midline.axis.length() / 6.0F;
    task.target = 1.0F;  // never reached
    task.most_cycles = 3;
    task.crowd = 31;
    task.max_gap = 0.1F;
  }
  StemAmongLeaves(const StemAmongLeaves&) = delete;

  GrowthScene scene() const { return {points, shapes, grid}; }
  static GrowthSettings settings() {
    GrowthSettings settings;
    settings.r1 = 0.03F;
    settings.M = 0.5F;
    settings.alpha = 0.3F;
    settings.beta = 0.8F;
    settings.max_steps = 50;
    return settings;
  }

  static std::vector<Eigen::Vector3f> pointsOf(int count) {
    std::mt19937 random(19U);
    std::uniform_real_distribution<float> uniform;
    std::normal_distribution<float> noise(0.0F, 0.002F);
    std::vector<Eigen::Vector3f> points;
    for (int i = 0; i < count; ++i) {
      const float z = 0.6F * uniform(random);
      const float angle = 6.28F * uniform(random);
      const float along = 0.1F * uniform(random);
      const float r = 0.01F + noise(random);
      const float x = 0.1F * z * z;
      if (z > 0.4F && z < 0.48F) continue;
      if (i % 3 == 0) {
        points.emplace_back(x + 0.01F + along, 0.02F * (uniform(random) - 0.5F), z + along);
      } else {
        points.emplace_back(x + r * std::cos(angle), r * std::sin(angle), z);
      }
    }
    return points;
  }
};

struct Grown {
  growth::Outcome outcome;
  std::vector<std::uint32_t> points;
  std::vector<std::uint32_t> of_regions;
  std::vector<bool> merged;
  std::vector<float> evidence;  // of the last growth
  std::vector<float> distances;
};

/// @param run calls what it is given with the members of a team
template <class Run>
Grown growBy(const GrowthTask& task, bool is_candidate, std::size_t members, const Run& run) {
  testing::GrowthRoom room(task, members);
  run([&](const auto& team) {
    StemGrowth<std::decay_t<decltype(team)>> stem(team, task, room.memory, room.scratch());
    is_candidate ? stem.growCandidate() : stem.growStem();
  });
  Grown grown;
  grown.outcome = room.shared.outcome;
  grown.points.assign(room.memory.best, room.memory.best + grown.outcome.points);
  for (int r = 0; r < task.region_count; ++r) {
    grown.of_regions.push_back(room.memory.results[r].points);
    grown.merged.push_back(room.memory.results[r].merged);
    grown.evidence.push_back(room.memory.regions[r].evidence);
    grown.distances.push_back(room.memory.regions[r].distance);
  }
  return grown;
}

TEST(StemGrowthTeam, GrowsWhatOneThreadDoesBitForBit) {
  for (const int count : {1500, 700, 40, 2}) {
    const StemAmongLeaves stem(count);
    for (const bool is_candidate : {false, true}) {
      const Grown alone =
          growBy(stem.task, is_candidate, 1U, [](const auto& work) { work(SerialTeam()); });
      EXPECT_GT(alone.points.size(), count > 500 ? stem.points.size() / 5U : 0U) << count;
      EXPECT_EQ(alone.outcome.cycles, is_candidate ? 0 : 3);
      for (const unsigned groups : {1U, 3U, 8U}) {
        const Grown together = growBy(stem.task, is_candidate, groups * kLanes,
                                      [&](const auto& work) { runEmulatedTeam(groups, work); });
        EXPECT_EQ(together.points, alone.points);
        EXPECT_EQ(together.of_regions, alone.of_regions);
        EXPECT_EQ(together.merged, alone.merged);
        EXPECT_EQ(together.evidence, alone.evidence);
        EXPECT_EQ(together.distances, alone.distances);
        EXPECT_EQ(together.outcome.quality, alone.outcome.quality);
        EXPECT_EQ(together.outcome.settings.r1, alone.outcome.settings.r1);
        EXPECT_EQ(together.outcome.settings.M, alone.outcome.settings.M);
        EXPECT_EQ(together.outcome.settings.alpha, alone.outcome.settings.alpha);
        EXPECT_EQ(together.outcome.settings.beta, alone.outcome.settings.beta);
        EXPECT_EQ(together.outcome.cycles, alone.outcome.cycles);
      }
    }
  }
}

TEST(StemGrowthTeam, OfNothingNothingGrows) {
  StemAmongLeaves stem(50);
  stem.task.count = 0;
  const Grown none = growBy(stem.task, false, 1U, [](const auto& work) { work(SerialTeam()); });
  EXPECT_TRUE(none.points.empty());
  EXPECT_EQ(none.outcome.quality, 0.0F);
  EXPECT_EQ(
      growBy(stem.task, false, 2U * kLanes, [](const auto& work) { runEmulatedTeam(2U, work); })
          .points,
      none.points);
}

/// The members of a region by Eq 1-5 as printed, every sphere compared with every point.
std::vector<std::uint32_t> growByHand(const StemAmongLeaves& stem, const GrowthRegionTask& region,
                                      const LeafBases& leaves) {
  const GrowthSettings settings = stem.settings();
  const Eigen::Vector3f start(region.start.x, region.start.y, region.start.z);
  const Eigen::Vector3f end(region.end.x, region.end.y, region.end.z);
  const float M = region.share * settings.M;
  std::vector<bool> joined(stem.points.size(), false);
  Eigen::Vector3f s_k = start;
  for (int step = 0; step < settings.max_steps; ++step) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    float total = 0.0F;
    for (std::size_t i = 0; i < stem.points.size(); ++i) {
      const Eigen::Vector3f away = stem.points[i] - s_k;
      if (away.norm() > settings.r1) continue;
      const LocalShape& shape = stem.shapes[i];
      const StemAxis::Projection at = stem.midline.axis.project(stem.points[i]);
      const float beyond = std::max(at.distance - at.radius, 0.0F) /
                           std::hypot(stem.midline.spread, 0.07F * at.radius);
      const float similarity =
          std::exp(-0.1F * beyond * beyond) *
          (0.5F + 0.2F * (1.0F - std::abs(shape.normal.dot(at.direction))) +
           0.3F * (shape.linearity * std::abs(shape.direction.dot(at.direction)) +
                   (1.0F - shape.linearity) * 0.5F)) *
          (1.0F - leaves.leafShare(stem.points[i], stem.midline.axis));
      if (similarity < M) continue;
      joined[i] = true;
      const float weight = std::min(static_cast<float>(shape.neighbors) / 20.0F, 1.0F) *
                           (1.0F - 3.0F * shape.curvature);
      sum += weight * away.normalized();
      total += weight;
    }
    Eigen::Vector3f v_k = settings.beta * (end - s_k).normalized();
    if (total > 0.0F) v_k += settings.alpha / total * sum;
    s_k += settings.r1 * std::clamp(v_k.norm(), 0.5F, 1.0F) * v_k.normalized();
    const float t = (s_k - start).dot(end - start) / (end - start).squaredNorm();
    if (t < 0.0F || t > 1.0F) break;
  }
  std::vector<std::uint32_t> members;
  for (std::uint32_t i = 0; i < joined.size(); ++i) {
    if (joined[i]) members.push_back(i);
  }
  return members;
}

TEST(RegionGrowthTeam, ByEquationsOneToFive) {
  const StemAmongLeaves stem(1500);
  const LeafBases leaves(stem.leaf_bases, stem.midline.spread);
  testing::GrowthRoom room(stem.task);
  RegionGrowth<SerialTeam> growing(SerialTeam(), stem.task, room.memory, room.scratch());
  growing.placePoints();
  growing.growRegions(stem.settings());
  const int placed = static_cast<int>(std::count_if(
      room.memory.slots, room.memory.slots + stem.task.count, [](int slot) { return slot >= 0; }));
  std::size_t all = 0U;
  for (int r = 0; r < stem.task.region_count; ++r) {
    std::vector<std::uint32_t> members;
    for (int i = 0; i < stem.task.count; ++i) {
      const int k = room.memory.slots[i];
      if (k >= 0 && room.memory.marks[r * placed + k] != 0U) {
        members.push_back(static_cast<std::uint32_t>(i));
      }
    }
    EXPECT_EQ(members, growByHand(stem, stem.regions[static_cast<std::size_t>(r)], leaves)) << r;
    all += members.size();
  }
  EXPECT_GT(all, 800U);
}

TEST(TeamOrder, PicksInOrder) {
  for (const int count : {0, 1, 7, 100}) {
    const auto holds = [](int i) { return i % 3 != 1; };
    std::vector<int> expected;
    for (int i = 0; i < count; ++i) {
      if (holds(i)) expected.push_back(i);
    }
    const auto pickBy = [&](std::size_t members, const auto& run) {
      std::vector<int> picked(static_cast<std::size_t>(count) + 1U, -1);
      std::vector<int> counts(members);
      run([&](const auto& team) {
        const int found = teamPick(
            team, count, holds, [&](int i, int n) { picked[n] = i; }, counts.data());
        EXPECT_EQ(found, static_cast<int>(expected.size()));
      });
      picked.resize(expected.size());
      return picked;
    };
    EXPECT_EQ(pickBy(1U, [](const auto& work) { work(SerialTeam()); }), expected);
    EXPECT_EQ(pickBy(2U * kLanes, [](const auto& work) { runEmulatedTeam(2U, work); }), expected);
  }
}

TEST(TeamOrder, SortsAsTheLibraryDoes) {
  struct Item {
    int value;
    int before;
    bool operator==(const Item& o) const { return value == o.value && before == o.before; }
  };
  const auto isLess = [](const Item& a, const Item& b) { return a.value < b.value; };
  std::mt19937 random(3U);
  for (const std::size_t count : {0U, 1U, 15U, 16U, 17U, 33U, 500U, 1024U}) {
    std::vector<Item> items;
    for (std::size_t i = 0; i < count; ++i) {
      items.push_back({static_cast<int>(random() % 50U), static_cast<int>(i)});
    }
    std::vector<Item> expected = items;
    std::stable_sort(expected.begin(), expected.end(), isLess);
    const auto sortBy = [&](const auto& run) {
      std::vector<Item> first = items;
      std::vector<Item> second(count);
      const Item* sorted = nullptr;
      run([&](const auto& team) {
        const Item* const result =
            teamSort(team, first.data(), second.data(), static_cast<int>(count), isLess);
        if (team.rank() == 0U) sorted = result;
      });
      return std::vector<Item>(sorted, sorted + count);
    };
    EXPECT_EQ(sortBy([](const auto& work) { work(SerialTeam()); }), expected);
    EXPECT_EQ(sortBy([](const auto& work) { runEmulatedTeam(2U, work); }), expected);
  }
}

}  // namespace
}  // namespace field_phenotyping
