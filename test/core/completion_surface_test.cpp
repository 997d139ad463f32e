#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "field_phenotyping/completion/bilateral_filter.hpp"
#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/measured_surface.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/stem_frame.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"
#include "field_phenotyping/completion/topology_repair.hpp"

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kRadius = 0.012;  // [m]

std::vector<Vector3d> helixCurve() {
  std::vector<Vector3d> curve;
  for (double t = 0.0; t < 1.0; t += 0.01) {
    curve.emplace_back(0.1 * std::cos(3.0 * t), 0.1 * std::sin(3.0 * t), t);
  }
  return curve;
}

TEST(CompletionSurface, FrameRollsBackWhatItUnrolled) {
  const StemFrame frame(helixCurve());
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  for (int i = 0; i < 2000; ++i) {
    const UnrolledPoint point{kPi * (2.0 * uniform(random) - 1.0),
                              -0.1 + (frame.length() + 0.2) * uniform(random),
                              0.03 * uniform(random)};
    const Vector3d rolled = frame.roll(point);
    const UnrolledPoint again = frame.unroll(rolled);
    EXPECT_NEAR(again.s, point.s, 1e-8);
    EXPECT_NEAR(again.r, point.r, 1e-8);
    EXPECT_LT((frame.roll(again) - rolled).norm(), 1e-9);
  }
}

TEST(CompletionSurface, FrameStaysOrthonormalAndDoesNotTwist) {
  const StemFrame frame(helixCurve());
  for (double s = -0.05; s < frame.length() + 0.05; s += 0.003) {
    const StemFrame::Frame here = frame.at(s);
    const StemFrame::Frame next = frame.at(s + 1e-4);
    EXPECT_NEAR(here.u.norm(), 1.0, 1e-9);
    EXPECT_NEAR(here.u.dot(here.tangent), 0.0, 1e-9);
    EXPECT_NEAR((here.u.cross(here.v) - here.tangent).norm(), 0.0, 1e-9);
    // A rotation-minimising frame turns about no more than the tangent does.
    EXPECT_NEAR((next.u - here.u).dot(here.v) / 1e-4, 0.0, 0.02);
  }
}

TEST(CompletionSurface, FrameRejectsWhatIsNoCurve) {
  EXPECT_THROW(StemFrame({Vector3d::Zero()}), std::invalid_argument);
  EXPECT_THROW(StemFrame({Vector3d::Zero(), Vector3d::Zero()}), std::invalid_argument);
}

std::vector<SurfacePosition> randomPositions(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::vector<SurfacePosition> positions;
  for (std::size_t i = 0; i < count; ++i) {
    const double theta = kPi * (2.0 * uniform(random) - 1.0);
    positions.push_back({theta, uniform(random)});
  }
  return positions;
}

TEST(CompletionSurface, IndexAgreesWithBruteForce) {
  const std::vector<SurfacePosition> points = randomPositions(500, 1);
  const SurfaceIndex index(points, kRadius);
  for (const SurfacePosition& query : randomPositions(300, 2)) {
    std::vector<double> distances;
    for (const SurfacePosition& point : points) {
      distances.push_back((index.embed(point) - index.embed(query)).squaredNorm());
    }
    const auto nearest = index.nearest<5>(query);
    ASSERT_EQ(nearest.count, 5U);
    for (std::size_t k = 0; k < 5; ++k) {
      EXPECT_DOUBLE_EQ(distances[nearest.index[k]], nearest.squared_distance[k]);
    }
    constexpr double kReach = 0.02;
    const auto within = std::count_if(distances.begin(), distances.end(),
                                      [](double d) { return d <= kReach * kReach; });
    long visited = 0;
    index.forEachWithin(query, kReach, [&](std::uint32_t, double) { ++visited; });
    EXPECT_EQ(visited, within);
    EXPECT_EQ(index.nearestWithin<1>(query, kReach).count, within > 0 ? 1U : 0U);
    std::sort(distances.begin(), distances.end());
    for (std::size_t k = 0; k < 5; ++k) {
      EXPECT_DOUBLE_EQ(nearest.squared_distance[k], distances[k]);
    }
  }
}

TEST(CompletionSurface, IndexIsPeriodic) {
  const SurfaceIndex index({{kPi - 0.01, 0.5}, {0.0, 0.5}}, kRadius);
  const auto nearest = index.nearest<3>({-kPi + 0.01, 0.5});
  EXPECT_EQ(nearest.count, 2U);
  EXPECT_EQ(nearest.index[0], 0U);
  EXPECT_NEAR(std::sqrt(nearest.squared_distance[0]), 0.02 * kRadius, 1e-6);
  EXPECT_EQ(SurfaceIndex().nearest<3>({0.0, 0.0}).count, 0U);
}

double wavySurface(const SurfacePosition& p) {
  return 0.001 * std::cos(2.0 * p.theta + 0.5) + 0.0005 * std::sin(30.0 * p.s);
}

std::vector<SurfaceSample> sampleWaves(std::size_t count, unsigned seed) {
  std::vector<SurfaceSample> samples;
  for (const SurfacePosition& p : randomPositions(count, seed)) {
    samples.push_back({{p.theta, 0.3 * p.s}, wavySurface({p.theta, 0.3 * p.s}), 1.0});
  }
  return samples;
}

TEST(CompletionSurface, RbfInterpolatesASmoothSurface) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const std::vector<SurfaceSample> samples = sampleWaves(200, seed);
    const RbfSurface surface(samples, kRadius, {2.0, 1e-6, 0.0});
    const auto rmsError = [&](const std::vector<SurfaceSample>& at) {
      double squares = 0.0;
      for (const SurfaceSample& sample : at) {
        squares += std::pow(surface.valueAt(sample.position) - sample.value, 2);
      }
      return std::sqrt(squares / static_cast<double>(at.size()));
    };
    // The surface itself varies by 8e-4.
    EXPECT_LT(rmsError(samples), 1e-6);
    EXPECT_LT(rmsError(sampleWaves(200, 100 + seed)), 2.5e-4);
  }
}

TEST(CompletionSurface, RbfIsPeriodicAndContinuous) {
  const RbfSurface surface(sampleWaves(150, 7), kRadius, {1.0, 1e-3, 0.0005});
  for (double s = -0.05; s < 0.35; s += 0.01) {
    EXPECT_NEAR(surface.valueAt({kPi - 1e-7, s}), surface.valueAt({-kPi + 1e-7, s}), 1e-9);
    EXPECT_NEAR(surface.valueAt({1.0, s}), surface.valueAt({1.0 + 2.0 * kPi, s}), 1e-12);
    EXPECT_NEAR(surface.valueAt({1.0, s}), surface.valueAt({1.0 + 1e-6, s}), 1e-7);
  }
}

TEST(CompletionSurface, RbfForgetsFarAwayAndSmoothsNoise) {
  const RbfSurface surface(sampleWaves(150, 8), kRadius, {});
  EXPECT_EQ(surface.valueAt({0.0, 3.0}), 0.0);
  EXPECT_EQ(RbfSurface({}, kRadius, {}).valueAt({0.0, 0.0}), 0.0);

  std::mt19937 random(1);
  std::normal_distribution<double> noise(0.0, 0.002);
  std::vector<SurfaceSample> samples = sampleWaves(200, 9);
  double plain = 0.0, smoothed = 0.0;
  for (SurfaceSample& sample : samples) sample.value = noise(random);
  const RbfSurface on_noise(samples, kRadius, {1.0, 1e-3, 0.002});
  for (const SurfaceSample& sample : samples) {
    plain += sample.value * sample.value;
    smoothed += std::pow(on_noise.valueAt(sample.position), 2);
  }
  EXPECT_LT(smoothed, 0.1 * plain);
}

TEST(CompletionSurface, RbfSurvivesCoincidentCentres) {
  std::vector<SurfaceSample> samples(50, SurfaceSample{{0.3, 0.1}, 0.001, 1.0});
  EXPECT_NEAR(RbfSurface(samples, kRadius, {}).valueAt({0.3, 0.1}), 0.001, 2e-4);
  samples.insert(samples.end(), 50, SurfaceSample{{0.3, 0.1}, -0.001, 1.0});
  EXPECT_TRUE(std::isfinite(RbfSurface(samples, kRadius, {}).valueAt({0.3, 0.1})));
}

TEST(CompletionSurface, ThinningKeepsMeansAndWeights) {
  const std::vector<SurfaceSample> samples = sampleWaves(5000, 10);
  const std::vector<SurfaceSample> thinned = thinSamples(samples, {0.01, 6});
  EXPECT_LE(thinned.size(), 180U);
  EXPECT_GT(thinned.size(), 150U);
  double weight = 0.0, value = 0.0, expected = 0.0;
  for (const SurfaceSample& sample : thinned) {
    weight += sample.weight;
    value += sample.weight * sample.value;
  }
  for (const SurfaceSample& sample : samples) expected += sample.value;
  EXPECT_NEAR(weight, 5000.0, 1e-6);
  EXPECT_NEAR(value, expected, 1e-9);
  EXPECT_TRUE(thinSamples({}, {0.01, 6}).empty());
}

TEST(CompletionSurface, AmplitudeIsWithoutTheNoise) {
  std::mt19937 random(4);
  std::normal_distribution<double> noise(0.0, 0.001);
  std::vector<SurfaceSample> samples = sampleWaves(4000, 12);
  const double alone = amplitudeOf(samples, 0.0);
  EXPECT_GT(alone, 6e-4);
  for (SurfaceSample& sample : samples) sample.value += noise(random);
  EXPECT_NEAR(amplitudeOf(samples, 0.001), alone, 1e-4);
  EXPECT_GT(amplitudeOf(samples, 0.1), 0.0);
}

TEST(CompletionSurface, PriorHasTheRadiusOfTheStem) {
  // A straight cone without noise, hidden on one side, the axis given 4 mm off and too thick.
  std::vector<Vector3d> points;
  for (const SurfacePosition& p : randomPositions(400, 11)) {
    const double r = kRadius - 0.004 * p.s;
    points.emplace_back(r * std::cos(0.5 * p.theta), r * std::sin(0.5 * p.theta), p.s);
  }
  const StemAxis axis({{{0.004F, 0.0F, 0.0F}, 0.015F}, {{0.0F, 0.004F, 1.0F}, 0.015F}});
  const auto prior = SurfacePrior::fit(points, axis, 0.0);
  ASSERT_TRUE(prior);
  EXPECT_LT(prior->noise(), 3e-4);
  for (double s = 0.05; s < 1.0; s += 0.1) {
    const double on_seen_side = prior->frame().unroll({0.0, 0.0, s}).r;
    EXPECT_LT(on_seen_side, 6e-4) << "axis at height " << s;
    for (double theta = -3.0; theta < 3.0; theta += 0.5) {
      const Vector3d p = prior->frame().roll({theta, s, prior->radius(theta, s)});
      EXPECT_NEAR(std::hypot(p.x(), p.y()), kRadius - 0.004 * p.z(), 1e-3);
      EXPECT_NEAR(prior->radius(-kPi, s), prior->radius(kPi, s), 1e-12);
    }
  }
  EXPECT_GT(prior->variance(kPi, 0.5), prior->variance(0.0, 0.5));
}

TEST(CompletionGaps, RangeLeavesLongGapsOut) {
  const FillRange range = findFillRange({0.9, 0.1, 0.2, 0.65, 0.3}, 0.3);
  EXPECT_DOUBLE_EQ(range.begin, 0.1);
  EXPECT_DOUBLE_EQ(range.end, 0.9);
  ASSERT_EQ(range.open.size(), 1U);
  EXPECT_FALSE(range.contains(0.0));
  EXPECT_TRUE(range.contains(0.25));
  EXPECT_FALSE(range.contains(0.5));
  EXPECT_TRUE(range.contains(0.8));
  EXPECT_FALSE(range.contains(0.95));
  EXPECT_FALSE(FillRange(findFillRange({}, 0.3)).contains(0.1));
}

/// A regular pattern of `spacing` over a stem of 0.4 m with a rectangular hole across theta = pi.
std::vector<SurfacePosition> patternWithHole(double spacing) {
  std::vector<SurfacePosition> positions;
  const double step = 2.0 * kPi / std::round(2.0 * kPi * kRadius / spacing);
  for (double s = 0.0; s <= 0.4 + 1e-9; s += spacing) {
    for (double theta = -kPi; theta < kPi - 1e-9; theta += step) {
      if (std::abs(s - 0.2) < 0.05 && std::abs(theta) > 0.5 * kPi) continue;
      positions.push_back({theta, s});
    }
  }
  return positions;
}

/// Gaps of a stem of one radius.
GapsToFill plainGaps(const std::vector<SurfacePosition>& measured, const FillRange& range,
                     double density) {
  GapsToFill gaps;
  gaps.measured = measured;
  gaps.range = range;
  gaps.density = density;
  gaps.shape.radius = [](double) { return kRadius; };
  gaps.mean_radius = kRadius;
  return gaps;
}

TEST(CompletionGaps, FindsOneHoleAcrossTheSeam) {
  constexpr double kSpacing = 0.004;
  const std::vector<SurfacePosition> positions = patternWithHole(kSpacing);
  const double density = 1.0 / (kSpacing * kSpacing);
  const GapsToFill given = plainGaps(positions, {0.0, 0.4, {}}, density);
  const std::vector<GapRegion> gaps = findGaps(given);
  ASSERT_EQ(gaps.size(), 1U);
  const Gap& gap = gaps[0].gap;
  const double true_area = 0.1 * kPi * kRadius;
  EXPECT_NEAR(gap.area, true_area, 0.15 * true_area);
  EXPECT_NEAR(gap.volume, 0.5 * kRadius * gap.area, 1e-9);
  EXPECT_NEAR(gap.curvature, 1.0 / kRadius, 1e-6);
  EXPECT_EQ(gaps[0].cells.size(), static_cast<std::size_t>(gap.cells));
  const double count = expectedPoints(gap, density, kRadius);
  EXPECT_NEAR(count, density * gap.area, 1e-6 * count);  // Eq 22 on a plain cylinder

  const GapSamples samples = sampleGaps(given);
  EXPECT_FALSE(samples.may_have_holes);
  EXPECT_EQ(samples.places.size(), static_cast<std::size_t>(std::lround(count)));
  for (const SurfacePosition& sample : samples.places) {
    EXPECT_LT(std::abs(sample.s - 0.2), 0.055);
    EXPECT_LT(std::cos(sample.theta), std::cos(0.5 * kPi - 0.4));
  }
}

TEST(CompletionGaps, ThickerOrMoreCurvedRegionsGetMore) {
  Gap region{};
  region.area = 0.001;
  region.volume = 0.5 * kRadius * region.area;
  region.curvature = 1.0 / kRadius;
  const double plain = expectedPoints(region, 1e4, kRadius);
  EXPECT_NEAR(plain, 10.0, 1e-9);
  region.curvature *= 2.0;
  EXPECT_NEAR(expectedPoints(region, 1e4, kRadius), 12.5, 1e-9);
  region.volume *= 2.0;
  EXPECT_NEAR(expectedPoints(region, 1e4, kRadius), 15.0, 1e-9);
}

TEST(CompletionGaps, MedianDensityIsThatOfThePattern) {
  const std::vector<SurfacePosition> positions = patternWithHole(0.004);
  const double density = medianDensity(SurfaceIndex(positions, kRadius), positions);
  EXPECT_NEAR(density, 62500.0, 0.35 * 62500.0);
  EXPECT_EQ(medianDensity(SurfaceIndex({{0.0, 0.0}}, kRadius), {{0.0, 0.0}}), 0.0);
}

TEST(CompletionGaps, NothingToDoGivesNoGaps) {
  const std::vector<SurfacePosition> positions = patternWithHole(0.004);
  for (const GapsToFill& given :
       {plainGaps(positions, {0.0, 0.4, {}}, 0.0), plainGaps(positions, {0.3, 0.3, {}}, 1e4),
        plainGaps(positions, {0.1, 0.3, {{0.1, 0.3}}}, 1e5)}) {
    EXPECT_TRUE(findGaps(given).empty());
    EXPECT_TRUE(sampleGaps(given).places.empty());
  }
}

/// A ring of points with a bump, every degree and 1 mm.
std::vector<FilterPoint> bumpySurface(double shift) {
  std::vector<FilterPoint> points;
  for (double s = 0.0; s < 0.03; s += 0.001) {
    for (double theta = -kPi; theta < kPi; theta += 0.08) {
      FilterPoint point;
      point.position = {theta, s};
      point.deviation = shift;
      points.push_back(point);
    }
  }
  return points;
}

constexpr FilterGrid kFilterGrid{0.002, 15, 31};

TEST(CompletionFilter, DoesNotShrinkAThinCylinder) {
  const std::vector<FilterPoint> points = bumpySurface(0.0004);
  const BilateralFilter filter({points, kFilterGrid, kRadius, {}});
  for (const FilterPoint& point : points) {
    EXPECT_NEAR(filter.at(point.position, point.color), 0.0004, 1e-9);
  }
}

TEST(CompletionFilter, EvensOutNoiseAndKeepsAColourEdge) {
  std::vector<FilterPoint> points = bumpySurface(0.0);
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0.0, 0.001);
  for (FilterPoint& point : points) {
    const bool upper = point.position.s > 0.015;
    point.deviation = (upper ? 0.002 : 0.0) + noise(random);
    point.color = upper ? FilterColor{0.1F, 0.8F, 0.1F} : FilterColor{0.5F, 0.3F, 0.1F};
  }
  FilterOptions by_color;
  by_color.attribute = FilterAttribute::kColor;
  by_color.sigma_attribute = 0.1;
  const BilateralFilter kept({points, kFilterGrid, kRadius, by_color});
  const BilateralFilter blurred({points, kFilterGrid, kRadius, {}});
  double error = 0.0, blurred_at_edge = 0.0, kept_at_edge = 0.0;
  for (const FilterPoint& point : points) {
    const double truth = point.position.s > 0.015 ? 0.002 : 0.0;
    const double by_edge = kept.at(point.position, point.color);
    error += std::pow(by_edge - truth, 2) / static_cast<double>(points.size());
    if (std::abs(point.position.s - 0.015) > 0.0015) continue;
    kept_at_edge = std::max(kept_at_edge, std::abs(by_edge - truth));
    blurred_at_edge =
        std::max(blurred_at_edge, std::abs(blurred.at(point.position, point.color) - truth));
  }
  EXPECT_LT(std::sqrt(error), 0.0004);
  EXPECT_LT(kept_at_edge, 0.5 * blurred_at_edge + 0.0004);
}

TEST(CompletionFilter, AgreesWithTheSumOverAllPairs) {
  std::vector<FilterPoint> points;
  std::mt19937 random(6);
  std::normal_distribution<double> noise(0.0, 0.001);
  for (const SurfacePosition& p : randomPositions(6000, 4)) {
    FilterPoint point;
    point.position = {p.theta, 0.03 * p.s};
    point.deviation = 0.001 * std::sin(3.0 * p.theta) + noise(random);
    point.is_read = points.size() % 20U == 0U;
    points.push_back(point);
  }
  const FilterOptions options;
  const BilateralFilter filter({points, kFilterGrid, kRadius, options});
  double squares = 0.0, spread = 0.0, count = 0.0;
  for (const FilterPoint& p : points) {
    if (!p.is_read) continue;
    double sum = 0.0, total = 0.0;
    for (const FilterPoint& q : points) {
      const double turn = std::remainder(q.position.theta - p.position.theta, 2.0 * kPi);
      const double squared = std::pow(q.position.s - p.position.s, 2) + std::pow(kRadius * turn, 2);
      const double chord = 2.0 * std::sin(0.5 * turn);
      const double weight = std::exp(-0.5 * squared / std::pow(options.sigma_space, 2) -
                                     0.5 * std::pow(chord / options.sigma_attribute, 2));
      sum += weight * q.deviation;
      total += weight;
    }
    squares += std::pow(filter.at(p.position, p.color) - sum / total, 2);
    spread += std::pow(sum / total, 2);
    count += 1.0;
  }
  EXPECT_GT(count, 200.0);
  EXPECT_LT(std::sqrt(squares / count), 0.1 * std::sqrt(spread / count));
}

TEST(CompletionSurface, CellsKeepEveryPointWhateverTheirNumber) {
  const StemAxis axis({{{0.0F, 0.0F, 0.0F}, 0.012F}, {{0.0F, 0.0F, 1.0F}, 0.012F}});
  for (const std::size_t count : {2000U, 60000U}) {
    std::mt19937 random(7);
    std::normal_distribution<double> noise(0.0, 0.001);
    PointCloud cloud;
    std::vector<Vector3d> points;
    for (const SurfacePosition& p : randomPositions(count, 5)) {
      const double r = kRadius + noise(random);
      points.emplace_back(r * std::cos(p.theta), r * std::sin(p.theta), p.s);
      cloud.points.push_back(points.back().cast<float>());
    }
    const auto prior = SurfacePrior::fit(points, axis, 0.0);
    ASSERT_TRUE(prior);
    const IndexSpan all{0U, static_cast<std::uint32_t>(count)};
    const MeasuredSurface measured(cloud, all, *prior, 0.003);
    double weight = 0.0;
    for (const MeasuredSurface::Cell& cell : measured.cells()) weight += cell.weight;
    double expected = 0.0;
    for (const Vector3d& point : points) {
      const double deviation = prior->residual(prior->frame().unroll(point)).deviation;
      if (prior->robustWeight(deviation) >= 0.1) expected += prior->robustWeight(deviation);
    }
    EXPECT_NEAR(weight, expected, 1e-3 * expected);
    const double most_cells = 1.1 * 2.0 * kPi * kRadius / 0.003 * prior->frame().length() / 0.003;
    EXPECT_LT(static_cast<double>(measured.cells().size()), most_cells);
    EXPECT_EQ(measured.places().size(), measured.size());
    std::size_t in_slices = 0U;
    for (long k = sliceAt(*prior, -1.0); k <= sliceAt(*prior, 2.0); ++k) {
      in_slices += measured.slice(k).points;
      const auto [first, last] = measured.placesOf(k, k + 1);
      EXPECT_EQ(last - first, measured.slice(k).on_surface);
      for (std::size_t i = first; i < last; ++i) {
        EXPECT_EQ(sliceAt(*prior, measured.places()[i].s), k);
      }
    }
    EXPECT_EQ(in_slices, count);
  }
}

TEST(CompletionRepair, FindsAHoleAndClosesItOnTheSurface) {
  constexpr double kSpacing = 0.003;
  const double density = 1.0 / (kSpacing * kSpacing);
  const GapsToFill given = plainGaps({}, {0.0, 0.4, {}}, density);
  const auto surface = [](const SurfacePosition& p) {
    return 0.0006 * std::cos(2.0 * p.theta) + 0.002 * (p.s - 0.2);
  };
  std::vector<CompletedPoint> filled;
  for (const SurfacePosition& p : patternWithHole(kSpacing)) filled.push_back({p, surface(p), 0.0});
  const std::size_t sound = filled.size();
  filled.push_back({{kPi, 0.2}, 0.02, 0.0});  // a fold: it has left the stem
  const std::vector<GapRegion> defects = findDefects(given, filled, 0.005);
  EXPECT_EQ(filled.size(), sound);
  ASSERT_EQ(defects.size(), 1U);
  const std::vector<CompletedPoint> repaired =
      repairDefect(defects[0], filled, density, kRadius, {4.0, 1e-6, 0.0, 0.0, 0.0});
  ASSERT_EQ(repaired.size(), defects[0].cells.size());
  double worst_at_rim = 0.0;
  for (const CompletedPoint& point : repaired) {
    EXPECT_TRUE(std::isfinite(point.deviation));
    const double from_rim = 0.05 - std::abs(point.position.s - 0.2);
    if (from_rim > 0.005) continue;
    worst_at_rim = std::max(worst_at_rim, std::abs(point.deviation - surface(point.position)));
  }
  EXPECT_LT(worst_at_rim, 4e-4);  // the surface itself differs by 1.3e-3 there
  filled.insert(filled.end(), repaired.begin(), repaired.end());
  EXPECT_TRUE(findDefects(given, filled, 0.005).empty());
  EXPECT_TRUE(repairDefect(defects[0], {}, density, kRadius, {}).empty());
}

/// A stem of which one half was seen, with noise and with bumps 6 cm long and a sixth of it wide.
std::optional<SurfacePrior> halfSeen(double noise, double bump, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> normal(0.0, 1.0);
  std::vector<double> bumps;
  for (int k = 0; k < 3 * 17; ++k) bumps.push_back(bump * normal(random));
  std::vector<Vector3d> points;
  for (int i = 0; i < 1200; ++i) {
    const double z = uniform(random);
    const double turn = 0.5 * uniform(random);
    const auto at =
        static_cast<std::size_t>(3 * static_cast<int>(z / 0.06) + static_cast<int>(6.0 * turn));
    const double r = kRadius + bumps[at] + noise * normal(random);
    points.emplace_back(r * std::cos(2.0 * kPi * turn), r * std::sin(2.0 * kPi * turn), z);
  }
  const StemAxis axis({{{0.0F, 0.0F, 0.0F}, static_cast<float>(kRadius)},
                       {{0.0F, 0.0F, 1.0F}, static_cast<float>(kRadius)}});
  return SurfacePrior::fit(points, axis, 0.0);
}

TEST(CompletionSurface, WhatIsNoCylinderMakesTheFarSideUncertain) {
  for (unsigned seed = 1; seed <= 3U; ++seed) {
    // Points scatter as much in both.
    const auto noisy = halfSeen(2e-3, 0.0, seed);
    const auto bumpy = halfSeen(1e-3, 1.7e-3, seed);
    ASSERT_TRUE(noisy && bumpy);
    // The half from theta = 0 to pi was seen, whatever the frame calls it.
    double near = std::numeric_limits<double>::max();
    double far = 0.0;
    for (double theta = -kPi; theta < kPi; theta += 0.1) {
      EXPECT_LT(noisy->misfitVariance(theta, 0.5), noisy->variance(theta, 0.5));
      near = std::min(near, bumpy->misfitVariance(theta, 0.5));
      far = std::max(far, bumpy->misfitVariance(theta, 0.5));
      EXPECT_GT(bumpy->misfitVariance(theta, 0.5), 3.0 * bumpy->variance(theta, 0.5));
    }
    EXPECT_GT(far, 4.0 * near);
  }
}

TEST(CompletionSurface, PriorIsRightWhereNoiseIsAThirdOfTheRadius) {
  // Half of the circumference seen: nothing but the noise's own effect tells shift from radius.
  double shift = 0.0, radius = 0.0;
  constexpr int kSeeds = 12;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> noise(0.0, 0.0035);
    std::vector<Vector3d> points;
    for (const SurfacePosition& p : randomPositions(6000, seed)) {
      points.emplace_back(kRadius * std::cos(0.5 * p.theta) + noise(random),
                          kRadius * std::sin(0.5 * p.theta) + noise(random), p.s);
    }
    const StemAxis axis({{{0.0F, 0.0F, 0.0F}, 0.012F}, {{0.0F, 0.0F, 1.0F}, 0.012F}});
    const auto prior = SurfacePrior::fit(points, axis, 0.0);
    ASSERT_TRUE(prior);
    EXPECT_NEAR(prior->noise(), 0.0035, 4e-4);
    shift += prior->frame().roll({0.0, 0.5, 0.0}).x() / kSeeds;
    radius += prior->meanRadius() / kSeeds;
  }
  EXPECT_NEAR(shift, 0.0, 4e-4);
  EXPECT_NEAR(radius, kRadius, 3e-4);
}

}  // namespace
}  // namespace field_phenotyping
