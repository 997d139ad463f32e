// What happens to a stem's regions: segments along it (3.1.2), merging (Eq 6, 10), quality
// (Eq 7-9), adaptive parameters (Eq 11-14), and all of it together.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>

#include "field_phenotyping/segmentation/growth_adaptation.hpp"
#include "field_phenotyping/segmentation/region_merging.hpp"
#include "field_phenotyping/segmentation/region_quality.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "field_phenotyping/segmentation/stem_segments.hpp"

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

std::vector<std::uint32_t> allOf(const Points& points) {
  std::vector<std::uint32_t> members(points.size());
  for (std::uint32_t i = 0; i < members.size(); ++i) members[i] = i;
  return members;
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

GrowthRegion regionOf(const Points& points, float low, float high) {
  GrowthRegion region;
  region.start = {0.0F, 0.0F, low};
  region.end = {0.0F, 0.0F, high};
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    if (points[i].z() >= low && points[i].z() < high) region.points.push_back(i);
  }
  return region;
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
  EXPECT_NEAR(regionDistance(points, regionOf(points, 0.0F, 0.5F), regionOf(points, 0.5F, 1.1F)),
              0.21F, 1e-5F);
  // Neighbours on an unbroken line are one step apart.
  EXPECT_NEAR(
      regionDistance(points, regionOf(points, 0.0F, 0.205F), regionOf(points, 0.205F, 0.5F)), 0.01F,
      1e-5F);
}

TEST(RegionMerging, DistanceByEquationSix) {
  // A region 0.1 m aside: ends 0.1 apart, points 0.1 apart, centroids sqrt(0.1^2 + 0.2^2) of which
  // 0.2 are the regions' own lengths.
  Points points;
  GrowthRegion low;
  GrowthRegion high;
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
  const float d = regionDistance(points, low, high);
  EXPECT_NEAR(d, 0.3F * centroids + 0.3F * 0.1F + 0.4F * 0.1F, 2e-3F);
  high.points.clear();
  EXPECT_EQ(regionDistance(points, low, high), std::numeric_limits<float>::infinity());
}

TEST(RegionMerging, SharedPointsAreNoDistance) {
  Points points = lineWithGap(2.0F, 2.0F);
  const GrowthRegion low = regionOf(points, 0.0F, 0.6F);
  const GrowthRegion high = regionOf(points, 0.4F, 1.1F);
  EXPECT_NEAR(regionDistance(points, low, high), 0.0F, 1e-5F);
}

TEST(RegionMerging, KeepsTheLargestChain) {
  const Points points = lineWithGap(0.295F, 0.595F);
  const std::vector<GrowthRegion> regions = {
      regionOf(points, 0.0F, 0.2F), regionOf(points, 0.2F, 0.4F), regionOf(points, 0.4F, 0.55F),
      regionOf(points, 0.55F, 0.8F), regionOf(points, 0.8F, 1.1F)};
  const auto merged = [&](const std::vector<GrowthRegion>& some, float threshold) {
    return mergeRegions(some, neighborDistances(points, some), threshold);
  };
  EXPECT_EQ(merged(regions, 0.05F), (std::vector<std::uint8_t>{0, 0, 0, 1, 1}));
  EXPECT_EQ(merged(regions, 0.5F), (std::vector<std::uint8_t>{1, 1, 0, 1, 1}));
  EXPECT_EQ(merged({}, 0.5F), std::vector<std::uint8_t>{});
  EXPECT_EQ(merged({GrowthRegion{}}, 0.5F), std::vector<std::uint8_t>{0});
}

TEST(RegionMerging, Thresholds) {
  std::vector<float> distances;
  for (int k = 0; k <= 80; ++k) distances.push_back(0.001F * static_cast<float>((37 * k) % 81));
  EXPECT_NEAR(initialMergingThreshold(distances, 0.01F, 0.4F), 0.070F, 1e-6F);
  EXPECT_NEAR(initialMergingThreshold(distances, 0.01F, 0.05F), 0.05F, 1e-6F);
  EXPECT_NEAR(initialMergingThreshold(distances, 0.08F, 0.05F), 0.08F, 1e-6F);
  EXPECT_NEAR(initialMergingThreshold({}, 0.04F, 0.4F), 0.04F, 1e-6F);

  EXPECT_FLOAT_EQ(adaptMergingThreshold(0.1F, 0.7F, 0.7F), 0.1F) << "on target: as it is";
  EXPECT_LT(adaptMergingThreshold(0.1F, 0.5F, 0.7F), 0.1F);
  EXPECT_GT(adaptMergingThreshold(0.1F, 0.9F, 0.7F), 0.1F);
  EXPECT_FLOAT_EQ(adaptMergingThreshold(0.1F, 0.0F, 0.7F), adaptMergingThreshold(0.1F, 0.2F, 0.7F))
      << "clipped at half the target";
  EXPECT_TRUE(std::isfinite(adaptMergingThreshold(0.1F, 0.5F, 0.0F)));
}

// ---------------------------------------------------------------------------- quality (Eq 7-9)

TEST(RegionQuality, ConsistencyByHand) {
  EXPECT_FLOAT_EQ(consistency({0.2F, 0.2F, 0.2F}, {0.2F, 0.2F, 0.2F}), 1.0F);
  EXPECT_FLOAT_EQ(consistency({}, {}), 0.0F);
  EXPECT_FLOAT_EQ(consistency({0.0F, 0.0F}, {0.0F, 0.0F}), 1.0F) << "a plane is even";
  // Values 1 and 3, mean 2: both half a mean off, and a whole mean off each other.
  const double term = 1.0 / 1.5 + 0.5 * std::exp(-2.0 * 1.0);
  EXPECT_NEAR(consistency({1.0F, 3.0F}, {3.0F, 1.0F}), term / 1.5, 1e-6);
  // Units do not matter.
  EXPECT_NEAR(consistency({100.0F, 300.0F}, {300.0F, 100.0F}), term / 1.5, 1e-6);
}

TEST(RegionQuality, CleanStemScoresMoreThanOneAmongLeaves) {
  Points points;
  addStem(points, 0.0F, 1.2F, 3000U, 6U);
  const std::vector<std::uint32_t> stem = allOf(points);
  const Midline midline = uprightMidline(1.2F);
  const Cloud clean(points);
  const RegionQuality good =
      evaluateRegion(clean.scene(), stem.size(), stem, midline, countCrowd(clean.scene(), midline));
  addLeaf(points, 0.5F, 7U);
  addLeaf(points, 0.8F, 8U);
  const Cloud leafy(points);
  const RegionQuality worse =
      evaluateRegion(leafy.scene(), stem.size(), stem, midline, countCrowd(leafy.scene(), midline));
  const RegionQuality pruned = evaluateRegion(leafy.scene(), 2U * stem.size(), stem, midline,
                                              countCrowd(leafy.scene(), midline));
  for (const RegionQuality& quality : {good, worse, pruned}) {
    for (const float part : {quality.geometric, quality.structural, quality.overall}) {
      EXPECT_GT(part, 0.0F);
      EXPECT_LE(part, 1.0F);
    }
    EXPECT_NEAR(quality.overall, 0.2F * quality.geometric + 0.8F * quality.structural, 1e-6F);
  }
  EXPECT_GT(good.overall, worse.overall);
  EXPECT_GT(worse.overall, pruned.overall) << "half of what had grown was taken away";
  EXPECT_EQ(evaluateRegion(clean.scene(), 0U, {}, midline, 0U).overall, 0.0F);
}

TEST(RegionQuality, LengthDoesNotCount) {
  const auto scoreOf = [](float length) {
    Points points;
    addStem(points, 0.0F, length, static_cast<std::size_t>(2500.0F * length), 9U);
    const Cloud cloud(points);
    const Midline midline = uprightMidline(length);
    return evaluateRegion(cloud.scene(), points.size(), allOf(points), midline,
                          countCrowd(cloud.scene(), midline))
        .overall;
  };
  EXPECT_NEAR(scoreOf(0.6F), scoreOf(2.4F), 0.05F);
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
