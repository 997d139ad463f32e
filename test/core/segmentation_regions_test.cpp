// What happens to a stem's regions: segments along it (3.1.2), merging (Eq 6, 10), quality
// (Eq 7-9), adaptive parameters (Eq 11-14), and all of it together.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>

#include "field_phenotyping/segmentation/growth_adaptation.hpp"
#include "field_phenotyping/segmentation/region_merging_team.hpp"
#include "field_phenotyping/segmentation/region_quality_team.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "field_phenotyping/segmentation/stem_segments.hpp"
#include "growth_room.hpp"

namespace field_phenotyping {
namespace {

using Points = std::vector<Eigen::Vector3f>;

constexpr float kRadius = 0.01F;

Midline uprightMidline(float length) {
  Midline midline;
  midline.axis = StemAxis({{{0.0F, 0.0F, 0.0F}, kRadius}, {{0.0F, 0.0F, length}, kRadius}});
  midline.spread = 0.002F;
  return midline;
}

/// Points on an upright cylinder about the z axis, from `low` to `high`.
void addStem(Points& points, float low, float high, std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  std::normal_distribution<float> noise(0.0F, 0.001F);
  for (std::size_t k = 0; k < count; ++k) {
    const float angle = 6.2832F * unit(random);
    const float r = kRadius + noise(random);
    points.emplace_back(r * std::cos(angle), r * std::sin(angle),
                        low + (high - low) * unit(random));
  }
}

/// A leaf that leaves the stem at `height` towards +x, rising at 45 degrees.
void addLeaf(Points& points, float height, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  for (int k = 0; k < 400; ++k) {
    const float along = 0.3F * unit(random);
    points.emplace_back(kRadius + along, 0.03F * (unit(random) - 0.5F), height + along);
  }
}

/// A cloud with all that growth wants to know about it.
class Cloud {
 public:
  explicit Cloud(Points points)
      : points_(std::move(points)),
        grid_(points_, 0.02F),
        shapes_(computeLocalShapes(points_, grid_, 0.04F)) {}
  GrowthScene scene() const { return {points_, shapes_, grid_}; }
  const Points& points() const { return points_; }

 private:
  Points points_;
  NeighborGrid grid_;
  std::vector<LocalShape> shapes_;
};

// ---------------------------------------------------------------------------- segments (3.1.2)

TEST(StemSegments, CoverTheStemWithoutGapOrOverlap) {
  for (const std::vector<float>& branchings :
       {std::vector<float>{}, {0.3F}, {0.0F, 1.0F}, {0.3F, 0.31F, 0.32F, 0.8F}, {0.005F, 0.999F}}) {
    const std::vector<StemSegment> segments = splitStem(1.0F, branchings);
    ASSERT_FALSE(segments.empty());
    EXPECT_FLOAT_EQ(segments.front().begin, 0.0F);
    EXPECT_NEAR(segments.back().end, 1.0F, 1e-3F);
    for (std::size_t k = 0; k < segments.size(); ++k) {
      EXPECT_GT(segments[k].end, segments[k].begin);
      EXPECT_LT(segments[k].end - segments[k].begin, 0.1001F);
      if (k > 0) {
        EXPECT_NEAR(segments[k].begin, segments[k - 1U].end, 1e-5F);
      }
    }
    for (const float at : branchings) {
      const bool inside = std::any_of(segments.begin(), segments.end(), [&](const StemSegment& s) {
        return s.branching && at >= s.begin - 1e-3F && at <= s.end + 1e-3F;
      });
      EXPECT_TRUE(inside) << at;
    }
    if (branchings.empty()) {
      for (const StemSegment& segment : segments) EXPECT_FALSE(segment.branching);
    }
  }
}

// ---------------------------------------------------------------------------- merging (Eq 6, 10)

struct Region {
  Eigen::Vector3f start = Eigen::Vector3f::Zero();
  Eigen::Vector3f end = Eigen::Vector3f::UnitZ();
  std::vector<std::uint32_t> points;
};

Region regionOf(const Points& points, float low, float high) {
  Region region;
  region.start = {0.0F, 0.0F, low};
  region.end = {0.0F, 0.0F, high};
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    if (points[i].z() >= low && points[i].z() < high) region.points.push_back(i);
  }
  return region;
}

GrowthRegionTask taskOf(const Region& region) {
  return testing::regionTask(region.start, region.end);
}

growth::Region extentOf(const Points& points, const Region& region) {
  const Eigen::Vector3f along = (region.end - region.start).normalized();
  double extents[5] = {0.0, 0.0, 0.0, 1e9, -1e9};
  for (const std::uint32_t i : region.points) {
    for (int axis = 0; axis < 3; ++axis) extents[axis] += static_cast<double>(points[i][axis]);
    const auto at = static_cast<double>(along.dot(points[i]));
    extents[3] = std::min(extents[3], at);
    extents[4] = std::max(extents[4], at);
  }
  growth::Region extent{};
  extent.count = static_cast<int>(region.points.size());
  if (extent.count > 0) setExtent(taskOf(region), extent.count, extents, extent);
  return extent;
}

float distanceOf(const Points& points, const Region& low, const Region& high) {
  float apart = std::numeric_limits<float>::max();
  for (const std::uint32_t i : low.points) {
    for (const std::uint32_t k : high.points) {
      apart = std::min(apart, (points[i] - points[k]).norm());
    }
  }
  return regionDistance(extentOf(points, low), extentOf(points, high), taskOf(low).start,
                        taskOf(high).end, apart);
}

/// Which of them belong to the merged region with the most points.
std::vector<bool> merge(const Points& points, const std::vector<Region>& some, float threshold) {
  std::vector<growth::Region> regions;
  std::vector<GrowthRegionTask> tasks;
  const Region* below = nullptr;
  for (const Region& region : some) {
    regions.push_back(extentOf(points, region));
    tasks.push_back(taskOf(region));
    if (region.points.empty()) continue;
    if (below != nullptr) regions.back().distance = distanceOf(points, *below, region);
    below = &region;
  }
  mergeRegions(regions.data(), tasks.data(), static_cast<int>(regions.size()), threshold);
  std::vector<bool> merged;
  for (const growth::Region& region : regions) merged.push_back(region.merged);
  return merged;
}

/// Points on the z axis, a centimetre apart, without those in [from, to).
Points lineWithGap(float from, float to) {
  Points points;
  for (int k = 0; k <= 100; ++k) {
    const float z = 0.01F * static_cast<float>(k);
    if (z < from || z >= to) points.emplace_back(0.0F, 0.0F, z);
  }
  return points;
}

TEST(RegionMerging, DistanceIsTheGapAlongTheAxis) {
  const Points points = lineWithGap(0.395F, 0.595F);
  // Points end at 0.39 and go on at 0.60: 0.21 in each of the three terms.
  EXPECT_NEAR(distanceOf(points, regionOf(points, 0.0F, 0.5F), regionOf(points, 0.5F, 1.1F)), 0.21F,
              1e-5F);
  // Neighbours on an unbroken line are one step apart.
  EXPECT_NEAR(distanceOf(points, regionOf(points, 0.0F, 0.205F), regionOf(points, 0.205F, 0.5F)),
              0.01F, 1e-5F);
}

TEST(RegionMerging, DistanceByEquationSix) {
  // A region 0.1 m aside: ends 0.1 apart, points 0.1 apart, centroids sqrt(0.1^2 + 0.2^2) of which
  // 0.2 are the regions' own lengths.
  Points points;
  Region low;
  Region high;
  low.start = {0.0F, 0.0F, 0.0F};
  low.end = {0.0F, 0.0F, 0.2F};
  high.start = {0.1F, 0.0F, 0.2F};
  high.end = {0.1F, 0.0F, 0.4F};
  for (int k = 0; k <= 20; ++k) {
    low.points.push_back(static_cast<std::uint32_t>(points.size()));
    points.emplace_back(0.0F, 0.0F, 0.01F * static_cast<float>(k));
    high.points.push_back(static_cast<std::uint32_t>(points.size()));
    points.emplace_back(0.1F, 0.0F, 0.2F + 0.01F * static_cast<float>(k));
  }
  const float centroids = std::sqrt(0.1F * 0.1F + 0.2F * 0.2F) - 0.2F;
  // The facing ends differ by 0.1 m across; along the line of both, they do not overlap.
  EXPECT_NEAR(distanceOf(points, low, high), 0.3F * centroids + 0.3F * 0.1F + 0.4F * 0.1F, 2e-3F);
}

TEST(RegionMerging, SharedPointsAreNoDistance) {
  const Points points = lineWithGap(2.0F, 2.0F);
  EXPECT_NEAR(distanceOf(points, regionOf(points, 0.0F, 0.6F), regionOf(points, 0.4F, 1.1F)), 0.0F,
              1e-5F);
}

TEST(RegionMerging, KeepsTheLargestChain) {
  using Merged = std::vector<bool>;
  const Points points = lineWithGap(0.295F, 0.595F);
  const std::vector<Region> regions = {regionOf(points, 0.0F, 0.2F), regionOf(points, 0.2F, 0.4F),
                                       regionOf(points, 0.4F, 0.55F), regionOf(points, 0.55F, 0.8F),
                                       regionOf(points, 0.8F, 1.1F)};
  EXPECT_EQ(merge(points, regions, 0.05F), (Merged{false, false, false, true, true}));
  EXPECT_EQ(merge(points, regions, 0.5F), (Merged{true, true, false, true, true}));
  EXPECT_EQ(merge(points, {}, 0.5F), Merged{});
  EXPECT_EQ(merge(points, {Region{}}, 0.5F), Merged{false});
}

TEST(RegionMerging, GoesOnWhereTheSurfaceIsCarried) {
  growth::Region region{};
  region.distance = 0.3F;
  region.evidence = 2.0F;
  GrowthRegionTask task = taskOf(Region{});
  task.longest_carried = 0.4F;
  EXPECT_TRUE(isCarriedTo(region, task));
  region.evidence = -2.0F;
  EXPECT_FALSE(isCarriedTo(region, task)) << "the points speak against it";
  region.evidence = 2.0F;
  task.longest_carried = 0.2F;
  EXPECT_FALSE(isCarriedTo(region, task)) << "too far";
}

TEST(RegionMerging, Thresholds) {
  const auto initial = [](std::vector<double> distances, float least, float most) {
    return initialMergingThreshold(distances.data(), static_cast<int>(distances.size()), least,
                                   most);
  };
  std::vector<double> distances;
  for (int k = 0; k <= 80; ++k) distances.push_back(0.001 * ((37 * k) % 81));
  EXPECT_NEAR(initial(distances, 0.01F, 0.4F), 0.070F, 1e-6F);
  EXPECT_NEAR(initial(distances, 0.01F, 0.05F), 0.05F, 1e-6F);
  EXPECT_NEAR(initial(distances, 0.08F, 0.05F), 0.08F, 1e-6F);
  EXPECT_NEAR(initial({}, 0.04F, 0.4F), 0.04F, 1e-6F);

  EXPECT_FLOAT_EQ(adaptMergingThreshold(0.1F, 0.7F, 0.7F), 0.1F) << "on target: as it is";
  EXPECT_LT(adaptMergingThreshold(0.1F, 0.5F, 0.7F), 0.1F);
  EXPECT_GT(adaptMergingThreshold(0.1F, 0.9F, 0.7F), 0.1F);
  EXPECT_FLOAT_EQ(adaptMergingThreshold(0.1F, 0.0F, 0.7F), adaptMergingThreshold(0.1F, 0.2F, 0.7F))
      << "clipped at half the target";
  EXPECT_TRUE(std::isfinite(adaptMergingThreshold(0.1F, 0.5F, 0.0F)));
}

// ---------------------------------------------------------------------------- quality (Eq 7-9)

float consistencyOf(const std::vector<float>& values, const std::vector<float>& neighbor_means) {
  float mean = 0.0F;
  for (const float value : values) mean += value / static_cast<float>(values.size());
  float sum = 0.0F;
  for (std::size_t i = 0; i < values.size() && mean > 0.0F; ++i) {
    sum += quality::consistencyTerm(values[i], neighbor_means[i], mean);
  }
  return quality::consistency(mean, sum, static_cast<int>(values.size()));
}

TEST(RegionQuality, ConsistencyByHand) {
  EXPECT_FLOAT_EQ(consistencyOf({0.2F, 0.2F, 0.2F}, {0.2F, 0.2F, 0.2F}), 1.0F);
  EXPECT_FLOAT_EQ(consistencyOf({0.0F, 0.0F}, {0.0F, 0.0F}), 1.0F) << "a plane is even";
  // Values 1 and 3, mean 2: both half a mean off, and a whole mean off each other.
  const double term = 1.0 / 1.5 + 0.5 * std::exp(-2.0 * 1.0);
  EXPECT_NEAR(consistencyOf({1.0F, 3.0F}, {3.0F, 1.0F}), term / 1.5, 1e-6);
  // Units do not matter.
  EXPECT_NEAR(consistencyOf({100.0F, 300.0F}, {300.0F, 100.0F}), term / 1.5, 1e-6);
}

TEST(RegionQuality, NeighborsAreThoseOnEitherSide) {
  const auto meanAt = [](int k, int count) {
    return quality::neighborMean(k, count, [](int j) { return static_cast<float>(j * j); });
  };
  EXPECT_EQ(meanAt(0, 1), 0.0F);
  EXPECT_EQ(meanAt(1, 2), 0.0F);
  EXPECT_EQ(meanAt(0, 20), (1.0F + 4.0F + 9.0F + 16.0F) / 4.0F);
  EXPECT_EQ(meanAt(18, 20), (196.0F + 225.0F + 256.0F + 289.0F + 361.0F) / 5.0F);
}

/// Q of Eq 9 by its definition.
/// @param kept of the scene's points
float qualityByHand(const GrowthScene& scene, const Midline& midline, int grown, int crowd,
                    std::vector<std::uint32_t> kept) {
  std::vector<StemAxis::Projection> places;
  for (const Eigen::Vector3f& point : scene.points) places.push_back(midline.axis.project(point));
  std::sort(kept.begin(), kept.end(), [&](std::uint32_t a, std::uint32_t b) {
    return places[a].arc_length < places[b].arc_length;
  });
  const auto evenness = [&](const auto& valueOf) {
    std::vector<float> values;
    std::vector<float> means;
    for (const std::uint32_t i : kept) values.push_back(valueOf(scene.shapes[i]));
    const int count = static_cast<int>(values.size());
    for (int k = 0; k < count; ++k) {
      float sum = 0.0F;
      int neighbors = 0;
      for (int j = std::max(0, k - 4); j <= std::min(count - 1, k + 4); ++j) {
        if (j == k) continue;
        sum += values[static_cast<std::size_t>(j)];
        ++neighbors;
      }
      means.push_back(sum / static_cast<float>(neighbors));
    }
    return consistencyOf(values, means);
  };
  float distances = 0.0F;
  float farthest = 0.0F;
  for (const std::uint32_t i : kept) {
    const float off = std::abs(places[i].distance - places[i].radius);
    distances += off;
    farthest = std::max(farthest, off);
  }
  const auto count = static_cast<float>(kept.size());
  const float geometric =
      0.5F * evenness([](const LocalShape& shape) { return shape.curvature; }) +
      0.5F * evenness([](const LocalShape& s) { return static_cast<float>(s.neighbors); });
  const float structural = 0.5F * count / static_cast<float>(grown + crowd) +
                           0.5F * (1.0F - distances / count / farthest);
  return 0.2F * geometric + 0.8F * structural;
}

TEST(RegionQuality, ByItsDefinition) {
  Points points;
  addStem(points, 0.0F, 1.2F, 1500U, 6U);
  for (unsigned k = 0; k < 4U; ++k) addLeaf(points, 0.2F + 0.2F * static_cast<float>(k), 7U + k);
  const Cloud cloud(points);
  const Midline midline = uprightMidline(1.2F);
  std::vector<GrowthRegionTask> regions;
  for (int k = 0; k < 12; ++k) {
    const float low = 0.1F * static_cast<float>(k);
    regions.push_back(testing::regionTask({0.0F, 0.0F, low}, {0.0F, 0.0F, low + 0.1F}));
  }
  GrowthTask task = testing::growthTask(cloud.scene(), midline, regions,
                                        GrowthSettings(SegmentationParameters()));
  task.crowd = 77;
  task.prune_factor = 1.2F;
  testing::GrowthRoom room(task);
  StemGrowth<SerialTeam>(SerialTeam(), task, room.memory, room.scratch()).growStem();
  const growth::Outcome& outcome = room.shared.outcome;
  const std::vector<std::uint32_t> kept(room.memory.best, room.memory.best + outcome.points);
  ASSERT_GT(kept.size(), 1000U);
  EXPECT_TRUE(std::is_sorted(kept.begin(), kept.end()));
  std::set<int> grown;
  for (int r = 0; r < task.region_count; ++r) {
    std::uint32_t of_region = 0U;
    for (int k = 0; k < task.count; ++k) {  // all of them may join
      if (room.memory.marks[r * task.count + k] == 0U) continue;
      grown.insert(k);
      ++of_region;
    }
    EXPECT_EQ(room.memory.results[r].points, of_region) << r;
    EXPECT_TRUE(room.memory.results[r].merged) << r;
  }
  EXPECT_GT(grown.size(), kept.size()) << "something was pruned";
  EXPECT_EQ(outcome.cycles, 1);
  EXPECT_NEAR(outcome.quality,
              qualityByHand(cloud.scene(), midline, static_cast<int>(grown.size()), 77, kept),
              2e-5F);
}

float scoreOf(const Points& points, float length) {
  const Cloud cloud(points);
  SegmentationParameters parameters;
  parameters.max_growth_cycles = 1;
  return growStem(cloud.scene(), uprightMidline(length), 0.4F, parameters).growth.quality;
}

TEST(RegionQuality, CleanStemScoresMoreThanOneAmongLeaves) {
  Points points;
  addStem(points, 0.0F, 1.2F, 3000U, 6U);
  const float good = scoreOf(points, 1.2F);
  addLeaf(points, 0.5F, 7U);
  addLeaf(points, 0.8F, 8U);
  EXPECT_LE(good, 1.0F);
  EXPECT_GT(good, scoreOf(points, 1.2F));
  // Half of what had grown was taken away.
  EXPECT_GT(quality::qualityOf(0.9F, 0.9F, 1.0F, 0.01F, 1000, 1000, 0).overall,
            quality::qualityOf(0.9F, 0.9F, 1.0F, 0.01F, 2000, 1000, 0).overall);
}

TEST(RegionQuality, LengthDoesNotCount) {
  const auto scoreOfLength = [](float length) {
    Points points;
    addStem(points, 0.0F, length, static_cast<std::size_t>(2500.0F * length), 9U);
    return scoreOf(points, length);
  };
  EXPECT_NEAR(scoreOfLength(0.6F), scoreOfLength(2.4F), 0.05F);
}

// ---------------------------------------------------------------------------- Eq 11-14

TEST(GrowthAdaptation, ByEquation) {
  GrowthSettings first;
  first.r1 = 0.04F;
  first.M = 0.5F;
  first.alpha = 0.2F;
  first.beta = 0.8F;
  const GrowthSettings next = adaptSettings(first, first, 0.5F, 0.7F, {0.4F, -0.3F});
  EXPECT_NEAR(next.r1, 0.04F * (1.0F + 0.5F * 0.2F), 1e-6F);
  EXPECT_NEAR(next.M, 0.5F * (1.0F + 0.5F * 0.2F), 1e-6F);
  EXPECT_NEAR(next.alpha, 0.2F + 0.1F * 0.4F, 1e-6F);
  EXPECT_NEAR(next.beta, 0.8F - 0.1F * 0.3F, 1e-6F);
}

TEST(GrowthAdaptation, StaysWithinItsRanges) {
  GrowthSettings first;
  first.r1 = 0.04F;
  first.M = 0.5F;
  first.alpha = 0.2F;
  first.beta = 0.8F;
  for (const float quality : {0.0F, 1.0F}) {
    for (const float slope : {-50.0F, 50.0F}) {
      GrowthSettings settings = first;
      for (int round = 0; round < 50; ++round) {
        settings = adaptSettings(settings, first, quality, 0.7F, {slope, slope});
        EXPECT_GE(settings.r1, 0.02F);
        EXPECT_LE(settings.r1, 0.08F);
        EXPECT_GE(settings.M, 0.1F);
        EXPECT_LE(settings.M, 0.9F);
        EXPECT_GE(settings.alpha, 0.0F);
        EXPECT_LE(settings.alpha, 1.0F);
        EXPECT_GE(settings.beta, 0.0F);
        EXPECT_LE(settings.beta, 1.0F);
      }
    }
  }
}

// ---------------------------------------------------------------------------- all of it

TEST(StemGrowth, TakesTheStemAndLeavesTheLeaf) {
  Points points;
  addStem(points, 0.0F, 1.2F, 3000U, 10U);
  addLeaf(points, 0.5F, 11U);
  const Cloud cloud(points);
  const GrownStem stem =
      growStem(cloud.scene(), uprightMidline(1.2F), 0.4F, SegmentationParameters());
  const auto leaf = std::count_if(stem.points.begin(), stem.points.end(),
                                  [](std::uint32_t i) { return i >= 3000U; });
  EXPECT_GT(stem.points.size() - static_cast<std::size_t>(leaf), 2800U);
  EXPECT_LT(leaf, 40);
  EXPECT_TRUE(std::is_sorted(stem.points.begin(), stem.points.end()));
  EXPECT_GT(stem.growth.quality, 0.7F);
  EXPECT_EQ(stem.growth.iterations, 1U) << "good at once";

  // The leaf's segment has an M of its own, and every decision is reported.
  std::set<float> used;
  float reached = 0.0F;
  for (const RegionSummary& region : stem.growth.regions) {
    used.insert(region.M);
    EXPECT_NEAR(region.start.z(), reached, 1e-5F);
    reached = region.end.z();
    EXPECT_TRUE(region.merged);
    EXPECT_GT(region.points, 0U);
    if (region.branching) {
      EXPECT_NEAR(0.5F * (region.start.z() + region.end.z()), 0.5F, 0.08F);
    }
  }
  EXPECT_EQ(used.size(), 2U);
  EXPECT_NEAR(reached, 1.2F, 1e-3F);
}

TEST(StemGrowth, GrowsAgainUntilGoodAndKeepsTheBest) {
  Points points;
  addStem(points, 0.0F, 1.2F, 3000U, 12U);
  for (unsigned k = 0; k < 6U; ++k) addLeaf(points, 0.2F + 0.15F * static_cast<float>(k), 13U + k);
  const Cloud cloud(points);
  SegmentationParameters parameters;
  parameters.max_growth_cycles = 1;
  parameters.quality_target = 1.0;  // never reached
  const GrownStem once = growStem(cloud.scene(), uprightMidline(1.2F), 0.4F, parameters);
  parameters.max_growth_cycles = 5;
  const GrownStem often = growStem(cloud.scene(), uprightMidline(1.2F), 0.4F, parameters);
  EXPECT_EQ(once.growth.iterations, 1U);
  EXPECT_FLOAT_EQ(once.growth.M, 0.5F);
  EXPECT_EQ(often.growth.iterations, 5U);
  EXPECT_GE(often.growth.quality, once.growth.quality);
  parameters.quality_target = 0.0;
  EXPECT_EQ(growStem(cloud.scene(), uprightMidline(1.2F), 0.4F, parameters).growth.iterations, 1U);
}

TEST(StemGrowth, NothingBeyondALongGap) {
  // Leaves far above, in line with the stem, with nothing between.
  Points points;
  addStem(points, 0.0F, 0.7F, 2000U, 20U);
  addStem(points, 1.3F, 1.5F, 300U, 21U);
  const Cloud cloud(points);
  const auto highest = [&](float max_gap) {
    const GrownStem stem =
        growStem(cloud.scene(), uprightMidline(1.5F), max_gap, SegmentationParameters());
    float z = 0.0F;
    for (const std::uint32_t i : stem.points) z = std::max(z, points[i].z());
    return z;
  };
  EXPECT_LT(highest(0.4F), 0.75F);
}

TEST(StemGrowth, GoesOnWhereItsSurfaceCarriesAcross) {
  // 0.3 m of it hidden; above, the stem again, or leaves that cross the axis.
  Points stem_above;
  addStem(stem_above, 0.0F, 0.5F, 400U, 22U);
  addStem(stem_above, 0.8F, 1.2F, 400U, 23U);
  Points leaves_above;
  addStem(leaves_above, 0.0F, 0.5F, 400U, 22U);
  std::mt19937 random(24U);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  for (int k = 0; k < 400; ++k) {
    const float angle = 6.2832F * unit(random);
    const float r = 1.4F * kRadius * std::sqrt(unit(random));
    leaves_above.emplace_back(r * std::cos(angle), r * std::sin(angle), 0.8F + 0.4F * unit(random));
  }
  const auto above = [](const Points& points) {
    const Cloud cloud(points);
    const GrownStem stem =
        growStem(cloud.scene(), uprightMidline(1.2F), 0.4F, SegmentationParameters());
    return std::count_if(stem.points.begin(), stem.points.end(),
                         [&](std::uint32_t i) { return points[i].z() > 0.7F; });
  };
  EXPECT_GT(above(stem_above), 380);
  EXPECT_EQ(above(leaves_above), 0);
}

TEST(StemGrowth, NothingThere) {
  const Cloud cloud({{5.0F, 5.0F, 0.3F}});
  const GrownStem stem =
      growStem(cloud.scene(), uprightMidline(1.0F), 0.4F, SegmentationParameters());
  EXPECT_TRUE(stem.points.empty());
  EXPECT_EQ(stem.growth.quality, 0.0F);
}

}  // namespace
}  // namespace field_phenotyping
