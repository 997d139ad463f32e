#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <ctime>
#include <iostream>
#include <memory>
#include <random>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/completion.hpp"
#include "field_phenotyping/completion/stem_completion.hpp"

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr double kPi = 3.14159265358979323846;

/// A tapering stem of elliptic cross-section whose axis is an arc in the x-z plane, standing on
/// z = 0.
struct TrueStem {
  double length = 1.2;        // [m]
  double bend = 0.1;          // total turn of the axis [rad]
  double radius = 0.0125;     // at the base, of the circle with the same area [m]
  double taper = 0.003;       // loss of radius per metre
  double ellipticity = 0.06;  // major axis radius * (1 + e), minor axis radius * (1 - e)
  double orientation = 0.4;   // of the major axis [rad]
  double lean = 0.05;         // at the base [rad]
  double bumps = 0.0;         // [m] in and out of the surface, 5 cm long, three round the stem

  double angleAt(double s) const { return lean + bend * s / length; }
  Vector3d tangentAt(double s) const { return {std::sin(angleAt(s)), 0.0, std::cos(angleAt(s))}; }
  Vector3d uAt(double s) const { return {std::cos(angleAt(s)), 0.0, -std::sin(angleAt(s))}; }
  Vector3d axisAt(double s) const {
    const double k = bend / length;
    if (std::abs(k) < 1e-9) return s * tangentAt(0.0);
    return {(std::cos(lean) - std::cos(angleAt(s))) / k, 0.0,
            (std::sin(angleAt(s)) - std::sin(lean)) / k};
  }
  double majorAt(double s) const { return (radius - taper * s) * (1.0 + ellipticity); }
  double minorAt(double s) const { return (radius - taper * s) * (1.0 - ellipticity); }
  Vector3d surfaceAt(double phi, double s) const {
    const double bump = 1.0 + bumps / radius * std::sin(40.0 * kPi * s) * std::cos(3.0 * phi);
    const double x = bump * majorAt(s) * std::cos(phi);
    const double y = bump * minorAt(s) * std::sin(phi);
    const double c = std::cos(orientation);
    const double d = std::sin(orientation);
    return axisAt(s) + (c * x - d * y) * uAt(s) + (d * x + c * y) * Vector3d::UnitY();
  }

  double arcLengthOf(const Vector3d& p) const {
    double s = p.z();
    for (int i = 0; i < 20; ++i) s += (p - axisAt(s)).dot(tangentAt(s));
    return s;
  }

  /// Distance to the surface: the nearest point by search, refined.
  double distance(const Vector3d& p) const {
    const double s = arcLengthOf(p);
    const auto squared = [&](double phi) { return (p - surfaceAt(phi, s)).squaredNorm(); };
    double best = 0.0;
    for (int i = 1; i < 90; ++i) {
      const double phi = 2.0 * kPi * i / 90;
      if (squared(phi) < squared(best)) best = phi;
    }
    double low = best - 0.08, high = best + 0.08;
    for (int i = 0; i < 40; ++i) {
      const double third = (high - low) / 3.0;
      (squared(low + third) < squared(high - third) ? high : low) +=
          squared(low + third) < squared(high - third) ? -third : third;
    }
    return std::sqrt(squared(0.5 * (low + high)));
  }
};

/// What was seen of a stem.
struct Scene {
  TrueStem stem;
  std::size_t points = 600;
  double noise = 0.002;                         // [m] in each direction
  std::vector<std::pair<double, double>> gaps;  // arc lengths without points
  std::pair<double, double> shadow{0.0, 0.0};   // arc lengths seen from one side only
  double leaf_share = 0.0;                      // of points on a leaf that leaves the stem
  double axis_error = 0.003;                    // [m] of the segmented axis
  double radius_error = 0.15;                   // share, of the segmented radius
  Vector3d origin = Vector3d::Zero();
  bool colors = false;
  unsigned seed = 1;
};

bool isHidden(const Scene& scene, double phi, double s) {
  for (const auto& gap : scene.gaps) {
    if (s > gap.first && s < gap.second) return true;
  }
  return s > scene.shadow.first && s < scene.shadow.second && std::sin(phi + 0.7) < 0.0;
}

StemAxis segmentedAxis(const Scene& scene, std::mt19937& random) {
  std::normal_distribution<double> error(0.0, scene.axis_error);
  std::vector<StemAxis::Node> nodes;
  const int steps = static_cast<int>(scene.stem.length / 0.06);
  const Vector3d offset(error(random), error(random), 0.0);
  for (int i = 0; i <= steps; ++i) {
    const double s = scene.stem.length * i / steps;
    const Vector3d own(0.5 * error(random), 0.5 * error(random), 0.0);
    nodes.push_back({(scene.stem.axisAt(s) + offset + own).cast<float>(),
                     static_cast<float>((1.0 + scene.radius_error) * scene.stem.radius)});
  }
  return StemAxis(nodes);
}

GroundModel flatGround(float height) {
  return GroundModel({-5.0F, -5.0F}, 10.0F, 2, 2,
                     std::vector<GroundModel::Node>(4, {height, 0.005F, 1U}), true);
}

std::shared_ptr<SegmentedBlock> makeBlock(const Scene& scene) {
  std::mt19937 random(scene.seed);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  auto block = std::make_shared<SegmentedBlock>();
  block->ground = flatGround(0.0F);
  block->cloud.origin = scene.origin;
  while (block->cloud.size() < scene.points) {
    const double phi = 2.0 * kPi * uniform(random);
    const double s = scene.stem.length * uniform(random);
    const Vector3d error = scene.noise * Vector3d(noise(random), noise(random), noise(random));
    Vector3d point = scene.stem.surfaceAt(phi, s) + error;
    if (uniform(random) < scene.leaf_share) {
      const double along = 0.015 + 0.05 * uniform(random);
      point = scene.stem.axisAt(s) + along * Vector3d(0.8, 0.5, 0.6);
    } else if (isHidden(scene, phi, s)) {
      continue;
    }
    block->cloud.points.push_back(point.cast<float>());
    if (scene.colors)
      block->cloud.colors.push_back(s < 0.5 * scene.stem.length ? 0x204060U : 0x60C020U);
  }
  Plant plant;
  plant.id = 7;
  plant.axis = segmentedAxis(scene, random);
  plant.stem = {0U, static_cast<std::uint32_t>(scene.points)};
  plant.points = plant.stem;
  block->plants.push_back(plant);
  return block;
}

struct Quality {
  std::size_t points = 0;
  double rmse = 0.0;      // of the synthetic points to the true surface [m]
  double worst = 0.0;     // [m]
  double coverage = 0.0;  // share within 1.96 standard deviations
};

Quality judge(const TrueStem& stem, const CompletedBlock& block) {
  Quality quality;
  quality.points = block.synthetic.size();
  double sum = 0.0;
  std::size_t covered = 0;
  constexpr std::size_t kMostJudged = 1500;  // evenly over the stem: each takes a search
  const std::size_t stride = 1 + quality.points / kMostJudged;
  std::size_t judged = 0;
  for (std::size_t i = 0; i < quality.points; i += stride, ++judged) {
    const double distance = stem.distance(block.synthetic.points[i].cast<double>());
    sum += distance * distance;
    quality.worst = std::max(quality.worst, distance);
    if (distance <= 1.96 * static_cast<double>(block.synthetic_stddev[i])) ++covered;
  }
  const auto count = static_cast<double>(std::max<std::size_t>(judged, 1));
  quality.rmse = std::sqrt(sum / count);
  quality.coverage = static_cast<double>(covered) / count;
  return quality;
}

struct Case {
  const char* name;
  std::vector<std::pair<double, double>> gaps;
  std::pair<double, double> shadow{0.0, 0.0};
  double leaf_share = 0.0;
  double limit = 1.0e-3;  // of the RMSE over all seeds [m]
};

const std::vector<Case>& gapCases() {
  static const std::vector<Case> cases{
      {"gap 5 cm", {{0.5, 0.55}}},
      {"gap 10 cm", {{0.5, 0.6}}},
      {"gap 20 cm", {{0.45, 0.65}}},
      {"shadow 40 cm", {}, {0.4, 0.8}},
      {"one side only", {}, {-1.0, 9.0}, 0.0, 2.0e-3},
      {"gap 20 cm, shadow", {{0.3, 0.5}}, {0.7, 1.0}},
      {"gap 20 cm, 15 % leaf", {{0.45, 0.65}}, {0.0, 0.0}, 0.15, 1.3e-3}};
  return cases;
}

TEST(CompletionStem, FillsGapsOnTheTrueSurface) {
  constexpr unsigned kSeeds = 20;
  for (const Case& gap_case : gapCases()) {
    for (const double noise : {0.0, 0.001, 0.003}) {
      double squares = 0.0, coverage = 0.0, worst_rmse = 0.0;
      std::size_t points = 0;
      for (unsigned seed = 1; seed <= kSeeds; ++seed) {
        Scene scene;
        scene.gaps = gap_case.gaps;
        scene.shadow = gap_case.shadow;
        scene.leaf_share = gap_case.leaf_share;
        scene.noise = noise;
        scene.seed = seed;
        const Quality quality = judge(scene.stem, completeBlock(makeBlock(scene), {}));
        EXPECT_GT(quality.points, 10U) << gap_case.name;
        squares += quality.rmse * quality.rmse * static_cast<double>(quality.points);
        coverage += quality.coverage * static_cast<double>(quality.points);
        points += quality.points;
        worst_rmse = std::max(worst_rmse, quality.rmse);
      }
      const double rmse = std::sqrt(squares / static_cast<double>(points));
      coverage /= static_cast<double>(points);
      std::cout << gap_case.name << ", noise " << 1e3 * noise << " mm: RMSE " << 1e3 * rmse
                << " mm (worst seed " << 1e3 * worst_rmse << "), coverage " << coverage << ", "
                << points / kSeeds << " points" << std::endl;
      EXPECT_LT(rmse, gap_case.limit) << gap_case.name << ", noise " << noise;
      EXPECT_LT(worst_rmse, 2.0 * gap_case.limit) << gap_case.name << ", noise " << noise;
      EXPECT_GT(coverage, 0.85) << gap_case.name << ", noise " << noise;
    }
  }
}

TEST(CompletionStem, StandardDeviationsHoldWhatTheModelCannotFollow) {
  double coverage = 0.0, error = 0.0;
  constexpr unsigned kSeeds = 8;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    Scene scene;
    scene.stem.bumps = 0.0025;
    scene.points = 3000;
    scene.noise = 0.001;
    scene.gaps = {{0.5, 0.6}};
    scene.shadow = {0.8, 1.0};
    scene.seed = seed;
    const CompletedBlock completed = completeBlock(makeBlock(scene), {});
    const Quality quality = judge(scene.stem, completed);
    EXPECT_GT(quality.points, 3000U);  // that a stem is bumpy leaves no gap open
    coverage += quality.coverage / kSeeds;
    error += quality.rmse / kSeeds;
  }
  std::cout << "bumpy stem: RMSE " << 1e3 * error << " mm, coverage " << coverage << std::endl;
  EXPECT_GT(error, 0.0008);
  EXPECT_GT(coverage, 0.87);
  EXPECT_LT(coverage, 0.99);
}

TEST(CompletionStem, FollowsABentStem) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    Scene scene;
    scene.stem.bend = 20.0 * kPi / 180.0;
    scene.gaps = {{0.5, 0.7}};
    scene.noise = 0.003;
    scene.axis_error = 0.005;
    scene.seed = seed;
    const Quality quality = judge(scene.stem, completeBlock(makeBlock(scene), {}));
    std::cout << "bent by 20 deg: RMSE " << 1e3 * quality.rmse << " mm" << std::endl;
    EXPECT_GT(quality.points, 50U);
    EXPECT_LT(quality.rmse, 1.5e-3);
  }
}

TEST(CompletionStem, FillsTheGapAtTheWantedDensity) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  scene.noise = 0.001;
  CompletionParameters parameters;
  parameters.density = 20000.0;
  const CompletedBlock block = completeBlock(makeBlock(scene), parameters);
  const auto inside = std::count_if(block.synthetic.points.begin(), block.synthetic.points.end(),
                                    [&](const Vector3f& p) {
                                      const double s = scene.stem.arcLengthOf(p.cast<double>());
                                      return s > 0.42 && s < 0.58;
                                    });
  const double radius = scene.stem.radius - scene.stem.taper * 0.5;
  EXPECT_NEAR(static_cast<double>(inside), 20000.0 * 2.0 * kPi * radius * 0.16, 30.0);
}

TEST(CompletionStem, LeavesLongGapsOpen) {
  for (const double max_gap : {0.0, 0.1, 0.25}) {
    Scene scene;
    scene.points = 2000;
    scene.gaps = {{0.2, 0.28}, {0.5, 0.8}};
    scene.shadow = {-1.0, 0.4};
    CompletionParameters parameters;
    parameters.max_gap = max_gap;
    const CompletedBlock block = completeBlock(makeBlock(scene), parameters);
    std::size_t in_short_gap = 0;
    for (const Vector3f& point : block.synthetic.points) {
      const double s = scene.stem.arcLengthOf(point.cast<double>());
      EXPECT_FALSE(s > 0.51 && s < 0.79) << "arc length " << s << ", max_gap " << max_gap;
      if (s > 0.21 && s < 0.27) ++in_short_gap;
    }
    EXPECT_EQ(in_short_gap > 10U, max_gap >= 0.1) << "max_gap " << max_gap;
  }
}

TEST(CompletionStem, ReachesTheSoilAndNeverGoesBelow) {
  Scene scene;
  scene.gaps = {{-1.0, 0.1}};
  auto block = makeBlock(scene);
  const auto lowest = [](const CompletedBlock& completed) {
    float z = 1e9F;
    for (const Vector3f& point : completed.synthetic.points) z = std::min(z, point.z());
    return z;
  };
  CompletionParameters parameters;
  parameters.max_stddev = 0.0;  // however little is known of the surface there
  const float on_soil = lowest(completeBlock(block, parameters));
  EXPECT_GE(on_soil, 0.0F);
  EXPECT_LT(on_soil, 0.02F);

  block->ground = flatGround(0.5F);  // as if the soil reached up the stem
  EXPECT_GE(lowest(completeBlock(block, {})), 0.5F);

  block->ground = flatGround(-1.0F);  // soil out of reach: nothing says how far the stem goes on
  EXPECT_GT(lowest(completeBlock(block, {})), 0.08F);
  block->ground = GroundModel();
  EXPECT_GT(lowest(completeBlock(block, {})), 0.08F);
}

TEST(CompletionStem, StddevGrowsIntoTheGap) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  const CompletedBlock block = completeBlock(makeBlock(scene), {});
  double edge = 0.0, middle = 0.0;
  std::size_t edge_count = 0, middle_count = 0;
  for (std::size_t i = 0; i < block.synthetic.size(); ++i) {
    const double s = scene.stem.arcLengthOf(block.synthetic.points[i].cast<double>());
    const double from_middle = std::abs(s - 0.5);
    const auto stddev = static_cast<double>(block.synthetic_stddev[i]);
    EXPECT_GT(stddev, 0.0);
    if (from_middle < 0.03) middle += stddev, ++middle_count;
    if (from_middle > 0.08 && from_middle < 0.1) edge += stddev, ++edge_count;
  }
  ASSERT_GT(edge_count, 3U);
  ASSERT_GT(middle_count, 3U);
  EXPECT_GT(middle / static_cast<double>(middle_count),
            1.2 * edge / static_cast<double>(edge_count));
}

TEST(CompletionStem, TakesColoursFromTheNeighbours) {
  Scene scene;
  scene.gaps = {{0.2, 0.3}, {0.9, 1.0}, {0.55, 0.65}};
  scene.colors = true;
  const CompletedBlock block = completeBlock(makeBlock(scene), {});
  ASSERT_EQ(block.synthetic.colors.size(), block.synthetic.size());
  std::size_t mixed = 0;
  for (std::size_t i = 0; i < block.synthetic.size(); ++i) {
    const double s = scene.stem.arcLengthOf(block.synthetic.points[i].cast<double>());
    const std::uint32_t color = block.synthetic.colors[i];
    EXPECT_TRUE(s > 0.4 || color == 0x204060U);
    EXPECT_TRUE(s < 0.8 || color == 0x60C020U);
    mixed += color != 0x204060U && color != 0x60C020U ? 1U : 0U;
    EXPECT_GE(color >> 16U, 0x20U);
    EXPECT_LE(color >> 16U, 0x60U);
  }
  EXPECT_GT(mixed, 0U);
  scene.colors = false;
  EXPECT_FALSE(completeBlock(makeBlock(scene), {}).synthetic.hasColors());
}

TEST(CompletionStem, SharesTheMeasuredPointsUntouched) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  const auto block = makeBlock(scene);
  const std::vector<Vector3f> before = block->cloud.points;
  const CompletedBlock completed = completeBlock(block, {});
  EXPECT_EQ(completed.segmented.get(), block.get());
  EXPECT_EQ(completed.segmented->cloud.points.data(), block->cloud.points.data());
  EXPECT_EQ(block->cloud.points, before);
}

TEST(CompletionStem, RepeatsBitForBitOnAnyNumberOfThreads) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  scene.leaf_share = 0.1;
  auto block = makeBlock(scene);
  for (int i = 0; i < 7; ++i) block->plants.push_back(block->plants.front());
  const CompletedBlock first = completeBlock(block, {});
  const ThreadLimit one_thread(1);
  const CompletedBlock second = completeBlock(block, {});
  ASSERT_EQ(first.synthetic.size(), second.synthetic.size());
  ASSERT_GT(first.synthetic.size(), 0U);
  EXPECT_EQ(first.synthetic.points, second.synthetic.points);
  EXPECT_EQ(first.synthetic_stddev, second.synthetic_stddev);
}

TEST(CompletionStem, DoesNotDependOnTheOrigin) {
  Scene near, far;
  near.gaps = far.gaps = {{0.4, 0.6}};
  far.origin = {500123.25, 5300456.5, 90.0};
  const CompletedBlock a = completeBlock(makeBlock(near), {});
  const CompletedBlock b = completeBlock(makeBlock(far), {});
  EXPECT_EQ(b.synthetic.origin, far.origin);
  EXPECT_EQ(a.synthetic.points, b.synthetic.points);
}

TEST(CompletionStem, SkipsPlantsThatAnotherBlockReports) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  auto block = makeBlock(scene);
  block->plants.push_back(block->plants.front());
  block->plants.push_back(block->plants.front());
  block->plants[1].owned = false;
  const CompletedBlock completed = completeBlock(block, {});
  ASSERT_EQ(completed.synthetic_span.size(), 3U);
  EXPECT_FALSE(completed.synthetic_span[0].empty());
  EXPECT_TRUE(completed.synthetic_span[1].empty());
  EXPECT_EQ(completed.synthetic_span[2].size(), completed.synthetic_span[0].size());
  EXPECT_EQ(completed.synthetic_span[2].end, completed.synthetic.size());
  EXPECT_EQ(completed.synthetic_stddev.size(), completed.synthetic.size());
}

TEST(CompletionStem, AddsNothingWhenDisabled) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  CompletionParameters parameters;
  parameters.enabled = false;
  const CompletedBlock completed = completeBlock(makeBlock(scene), parameters);
  EXPECT_TRUE(completed.synthetic.empty());
  EXPECT_TRUE(completed.synthetic_stddev.empty());
  ASSERT_EQ(completed.synthetic_span.size(), 1U);
  EXPECT_TRUE(completed.synthetic_span[0].empty());
}

/// The block with more points of the same stem between two arc lengths, as a later scan adds them.
std::shared_ptr<SegmentedBlock> scannedAgain(const Scene& scene, const SegmentedBlock& block,
                                             double begin, double end, std::size_t points) {
  std::mt19937 random(scene.seed + 1000U);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, scene.noise);
  auto again = std::make_shared<SegmentedBlock>(block);
  for (std::size_t i = 0; i < points; ++i) {
    const Vector3d error(noise(random), noise(random), noise(random));
    const double s = begin + (end - begin) * uniform(random);
    again->cloud.points.push_back(
        (scene.stem.surfaceAt(2.0 * kPi * uniform(random), s) + error).cast<float>());
  }
  again->plants[0].stem.end = static_cast<std::uint32_t>(again->cloud.size());
  again->plants[0].points = again->plants[0].stem;
  return again;
}

/// Farthest distance of a point of `a` from the surface that the points of `b` lie on: of the
/// quadric through those near it, round the stem's axis.
double apart(const TrueStem& stem, const std::vector<Vector3f>& a, const std::vector<Vector3f>& b) {
  constexpr double kNear = 0.007;  // [m]
  double worst = 0.0;
  double alone = 0.0;
  for (const Vector3f& p : a) {
    const double s = stem.arcLengthOf(p.cast<double>());
    const Vector3d offset = p.cast<double>() - stem.axisAt(s);
    const Vector3d out = offset.normalized();
    const Vector3d side = stem.tangentAt(s).cross(out);
    Eigen::Matrix<double, 6, 6> squares = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> sums = Eigen::Matrix<double, 6, 1>::Zero();
    int count = 0;
    for (const Vector3f& q : b) {
      const Vector3d way = (q - p).cast<double>() / kNear;
      if (way.norm() > 1.0) continue;
      const double x = way.dot(side);
      const double y = way.dot(stem.tangentAt(s));
      Eigen::Matrix<double, 6, 1> row;
      row << 1.0, x, y, x * x, x * y, y * y;
      squares += row * row.transpose();
      sums += way.dot(out) * row;
      ++count;
    }
    if (count < 12) {  // at an end
      ++alone;
      continue;
    }
    worst = std::max(worst, kNear * std::abs(squares.ldlt().solve(sums)[0]));
  }
  EXPECT_LT(alone, 0.06 * static_cast<double>(a.size()));
  return worst;
}

/// Share of the points of `a` that have moved by less than half of their noise.
double shareAtRest(const std::vector<Vector3f>& a, const std::vector<Vector3f>& b) {
  double at_rest = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) at_rest += (a[i] - b[i]).norm() < 5e-4F ? 1.0 : 0.0;
  return at_rest / static_cast<double>(a.size());
}

TEST(CompletionStem, NewScansSolveOnlyTheRegionsTheyTouch) {
  CompletionParameters parameters;
  parameters.points_around = 28;  // enough to compare
  std::size_t taken_over = 0, regions = 0;
  for (unsigned seed = 2; seed <= 5; ++seed) {
    Scene scene;
    scene.points = 2600;
    scene.noise = 0.001;
    scene.gaps = {{0.5, 0.6}};
    scene.seed = seed;
    const auto block = makeBlock(scene);
    const CompletedBlock first = completeBlock(block, parameters);
    ASSERT_EQ(first.stems.size(), 1U);
    EXPECT_GE(first.stems[0].regions, 10U);
    EXPECT_EQ(first.stems[0].regions_solved, first.stems[0].regions);

    const CompletedBlock same = completeBlock(block, parameters, &first);
    EXPECT_EQ(same.stems[0].regions_solved, 0U);
    EXPECT_EQ(same.synthetic.points, first.synthetic.points);

    // A few points, all in one place: three regions can reach them.
    const auto again = scannedAgain(scene, *block, 0.82, 0.85, 12);
    const CompletedBlock updated = completeBlock(again, parameters, &first);
    const CompletedBlock scratch = completeBlock(again, parameters);
    EXPECT_GE(updated.stems[0].regions_solved, 1U);
    taken_over += updated.stems[0].regions - updated.stems[0].regions_solved;
    regions += updated.stems[0].regions;
    std::cout << "seed " << seed << ": " << updated.stems[0].regions_solved << " of "
              << updated.stems[0].regions << " regions solved again" << std::endl;
    EXPECT_LT(apart(scene.stem, updated.synthetic.points, scratch.synthetic.points), 1e-4);
    EXPECT_GT(shareAtRest(updated.stems[0].smoothed, scratch.stems[0].smoothed), 0.98);

    parameters.max_gap = 0.05;  // other parameters: the gap must open
    const CompletedBlock opened = completeBlock(again, parameters, &updated);
    const CompletedBlock opened_scratch = completeBlock(again, parameters);
    EXPECT_LT(apart(scene.stem, opened.synthetic.points, opened_scratch.synthetic.points), 1e-4);
    parameters.max_gap = CompletionParameters().max_gap;
  }
  EXPECT_GE(static_cast<double>(taken_over), 0.6 * static_cast<double>(regions));
}

TEST(CompletionStem, TakesOverNothingFromAnotherPlant) {
  Scene scene;
  const auto block = makeBlock(scene);
  const CompletedBlock first = completeBlock(block, {});
  auto renamed = std::make_shared<SegmentedBlock>(*block);
  renamed->plants[0].id = 8;
  EXPECT_EQ(completeBlock(renamed, {}, &first).stems[0].regions_solved, first.stems[0].regions);
}

TEST(CompletionStem, SaysWhyItLeftAStemAlone) {
  const auto flagsOf = [](const Scene& scene) {
    return static_cast<int>(completeBlock(makeBlock(scene), {}).stems.at(0).flags);
  };
  Scene scene;
  scene.noise = 0.001;
  EXPECT_EQ(flagsOf(scene), 0);
  scene.points = 8;
  EXPECT_EQ(flagsOf(scene), kCompletionTooFewPoints);
  scene.points = 40;  // on 1.2 m
  EXPECT_EQ(flagsOf(scene), kCompletionTooFewPoints);
  scene.points = 600;
  scene.gaps = {{0.4, 0.8}};
  EXPECT_EQ(flagsOf(scene), kCompletionOpenGap);
  scene.gaps.clear();
  scene.shadow = {-1.0, 9.0};
  scene.noise = 0.004;
  EXPECT_EQ(flagsOf(scene) & kCompletionUncertain, kCompletionUncertain);
}

TEST(CompletionStem, NamesItsFlags) {
  EXPECT_EQ(completionFlagNames(0U), "ok");
  EXPECT_EQ(completionFlagNames(kCompletionOpenGap | kCompletionSeenEmpty), "open_gap|seen_empty");
  EXPECT_EQ(completionFlagNames(kCompletionTooFewPoints), "too_few_points");
  EXPECT_EQ(completionFlagNames(kCompletionNoSurface | kCompletionUncertain),
            "no_surface|uncertain");
}

TEST(CompletionStem, FillsNothingBetweenTheBranchesOfAFork) {
  Scene scene;
  scene.points = 1200;
  scene.noise = 0.001;
  auto block = makeBlock(scene);
  for (std::size_t i = 0; i < block->cloud.size(); ++i) {
    Vector3f& p = block->cloud.points[i];
    p.y() += (i % 2 == 0 ? 0.13F : -0.13F) * std::max(p.z() - 0.6F, 0.0F);
  }
  const CompletedBlock completed = completeBlock(block, {});
  EXPECT_EQ(completed.stems[0].flags & kCompletionNoSurface, kCompletionNoSurface);
  // What is filled in above belongs to one of the branches.
  std::size_t between = 0;
  for (const Vector3f& p : completed.synthetic.points) {
    const Vector3d shift(0.0, 0.13 * std::max(static_cast<double>(p.z()) - 0.6, 0.0), 0.0);
    const double distance = std::min(scene.stem.distance(p.cast<double>() - shift),
                                     scene.stem.distance(p.cast<double>() + shift));
    if (p.z() > 0.8F && distance > 0.004) ++between;  // below, they are nearer than their width
  }
  EXPECT_LT(static_cast<double>(between),
            0.02 * static_cast<double>(completed.synthetic.size()) + 1);
}

TEST(CompletionStem, FillsNothingWhereTheSensorSawThrough) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  const auto block = makeBlock(scene);
  const Plant& plant = block->plants[0];
  PointCloud cloud = block->cloud;
  cloud.scan_origin.assign(cloud.size(), kNoScanOrigin);
  const auto addBeam = [&](const Vector3d& origin, const Vector3d& end) {
    cloud.scan_origin.push_back(static_cast<std::uint16_t>(cloud.scan_origins.size()));
    cloud.scan_origins.push_back(origin.cast<float>());
    cloud.points.push_back(end.cast<float>());
  };
  for (int i = 0; i < 8; ++i) {  // beams through the gap, and some past the stem below it
    const double s = 0.47 + 0.01 * i;
    const Vector3d middle = scene.stem.axisAt(s);
    const Vector3d way(0.3, 1.0, 0.1);
    addBeam(middle - way, middle + 0.4 * way);
    const Vector3d beside = scene.stem.axisAt(0.2 + 0.01 * i) + Vector3d(0.012, 0.0, 0.0);
    addBeam(beside - Vector3d(0.0, 1.0, 0.0), beside + Vector3d(0.0, 1.0, 0.0));
    // Right through where points of the stem were measured: they are the better witnesses.
    const Vector3d measured = scene.stem.axisAt(0.8 + 0.01 * i);
    addBeam(measured - way, measured + 0.4 * way);
  }
  const auto filledBetween = [&](const CompletedStem& stem, double begin, double end) {
    return std::count_if(stem.points.begin(), stem.points.end(), [&](const Vector3f& p) {
      const double s = scene.stem.arcLengthOf(p.cast<double>());
      return s > begin && s < end;
    });
  };
  const CompletedStem blind = completeStem(block->cloud, plant.stem, plant.axis, block->ground, {});
  const CompletedStem seeing = completeStem(cloud, plant.stem, plant.axis, block->ground, {});
  EXPECT_EQ(seeing.solution.flags & kCompletionSeenEmpty, kCompletionSeenEmpty);
  EXPECT_EQ(blind.solution.flags & kCompletionSeenEmpty, 0);
  EXPECT_GT(filledBetween(blind, 0.47, 0.54), 100);
  EXPECT_EQ(filledBetween(seeing, 0.47, 0.54), 0);
  EXPECT_EQ(filledBetween(seeing, 0.2, 0.3), filledBetween(blind, 0.2, 0.3));
  EXPECT_EQ(filledBetween(seeing, 0.8, 0.9), filledBetween(blind, 0.8, 0.9));
}

TEST(CompletionStem, StemsTogetherAreThoseApart) {
  for (const bool has_colors : {false, true}) {
    Scene scene;
    scene.gaps = {{0.4, 0.5}};
    const auto block = makeBlock(scene);
    const Plant& plant = block->plants[0];
    PointCloud cloud = block->cloud;
    for (std::size_t i = 0; has_colors && i < cloud.size(); ++i) {
      cloud.colors.push_back(static_cast<std::uint32_t>(i * 7919U) & 0xFFFFFFU);
    }
    IndexSpan half = plant.stem;  // another stem: fewer points
    half.end = half.begin + half.size() / 2U;
    std::vector<StemToModel> to_model;
    for (const IndexSpan span : {plant.stem, half}) {
      to_model.push_back(stemToModel(cloud, span, plant.axis, {}));
    }
    const auto priors = fitSurfacePriors(to_model, {});
    ASSERT_TRUE(priors[0] && priors[1]);
    std::vector<StemToComplete> stems{{plant.stem, &*priors[0], nullptr},
                                      {{0U, 0U}, nullptr, nullptr},
                                      {plant.stem, nullptr, nullptr},
                                      {half, &*priors[1], nullptr}};
    const std::vector<CompletedStem> first = completeStems(cloud, stems, block->ground, {}, {});
    for (const bool again : {false, true}) {  // then all regions are taken over
      if (again) stems[0].previous = first[0].solution.state.get();
      const std::vector<CompletedStem> apart = completeStems(cloud, stems, block->ground, {}, {});
      const std::vector<CompletedStem> together =
          completeStemsTogether(cloud, stems, block->ground, {}, {});
      ASSERT_EQ(together.size(), stems.size());
      for (std::size_t i = 0; i < stems.size(); ++i) {
        EXPECT_EQ(together[i].points, apart[i].points) << i;
        EXPECT_EQ(together[i].colors, apart[i].colors) << i;
        EXPECT_EQ(together[i].stddev, apart[i].stddev) << i;
        EXPECT_EQ(together[i].solution.smoothed, apart[i].solution.smoothed) << i;
        EXPECT_EQ(together[i].solution.flags, apart[i].solution.flags) << i;
        EXPECT_EQ(together[i].solution.regions_solved, apart[i].solution.regions_solved) << i;
      }
      EXPECT_GT(together[0].points.size(), 100U);
      EXPECT_NE(together[0].solution.state, nullptr);
      std::vector<StemToComplete> last = stems;
      last[0].is_last = true;
      const CompletedStem kept_nothing =
          std::move(completeStems(cloud, last, block->ground, {}, {}).front());
      EXPECT_EQ(kept_nothing.points, together[0].points);
      EXPECT_EQ(kept_nothing.solution.smoothed, together[0].solution.smoothed);
      EXPECT_EQ(kept_nothing.solution.state, nullptr);
      EXPECT_EQ(together[0].colors.size(), has_colors ? together[0].points.size() : 0U);
      EXPECT_EQ(together[0].solution.regions_solved == 0U, again);
      EXPECT_EQ(together[1].solution.flags, kCompletionTooFewPoints);
      EXPECT_EQ(together[2].solution.flags, kCompletionNoSurface);
    }
  }
}

TEST(CompletionStem, SmoothsMeasuredPointsOfThePictureOnly) {
  Scene scene;
  scene.points = 2000;
  scene.noise = 0.003;
  const auto block = makeBlock(scene);
  const CompletedBlock completed = completeBlock(block, {});
  const std::vector<Vector3f>& smoothed = completed.stems[0].smoothed;
  ASSERT_EQ(smoothed.size(), block->cloud.size());
  double before = 0.0, after = 0.0;
  for (std::size_t i = 0; i < smoothed.size(); ++i) {
    before += std::pow(scene.stem.distance(block->cloud.points[i].cast<double>()), 2);
    after += std::pow(scene.stem.distance(smoothed[i].cast<double>()), 2);
  }
  EXPECT_LT(after, 0.25 * before);
  CompletionParameters parameters;
  parameters.smoothing = 0.0;
  EXPECT_EQ(completeBlock(block, parameters).stems[0].smoothed, block->cloud.points);
}

/// Odd stems: whatever comes out must be finite, above the soil and within the plant.
void expectSane(const CompletedBlock& block) {
  ASSERT_EQ(block.synthetic_span.size(), block.segmented->plants.size());
  ASSERT_EQ(block.synthetic_stddev.size(), block.synthetic.size());
  for (std::size_t i = 0; i < block.synthetic.size(); ++i) {
    const Vector3f& point = block.synthetic.points[i];
    EXPECT_TRUE(point.allFinite());
    EXPECT_GE(point.z(), 0.0F);
    EXPECT_LT(point.norm(), 3.0F);
    EXPECT_TRUE(std::isfinite(block.synthetic_stddev[i]));
  }
}

TEST(CompletionStem, SurvivesFewPoints) {
  for (const std::size_t points : {0U, 1U, 3U, 4U, 5U, 8U, 12U, 20U, 40U}) {
    for (unsigned seed = 1; seed <= 20; ++seed) {
      Scene scene;
      scene.points = points;
      scene.seed = seed;
      CompletionParameters parameters;
      const CompletedBlock by_default = completeBlock(makeBlock(scene), parameters);
      expectSane(by_default);
      EXPECT_TRUE(points >= 12U || by_default.synthetic.empty());
      parameters.min_points = 4;
      parameters.density = 5000.0;
      expectSane(completeBlock(makeBlock(scene), parameters));
    }
  }
}

TEST(CompletionStem, SurvivesDegenerateStems) {
  const auto block = makeBlock({});
  CompletionParameters parameters;
  parameters.min_points = 4;
  const auto completeMoved = [&](auto&& move) {
    auto moved = std::make_shared<SegmentedBlock>(*block);
    for (std::size_t i = 0; i < moved->cloud.size(); ++i) {
      moved->cloud.points[i] = move(moved->cloud.points[i], i);
    }
    expectSane(completeBlock(moved, parameters));
  };
  completeMoved([](const Vector3f&, std::size_t) { return Vector3f(0.01F, 0.0F, 0.3F); });
  completeMoved([](const Vector3f& p, std::size_t) { return Vector3f(0.01F, 0.0F, p.z()); });
  completeMoved([](const Vector3f& p, std::size_t) { return Vector3f(p.x(), p.y(), 0.3F); });
  completeMoved(
      [](const Vector3f& p, std::size_t) { return Vector3f(20.0F * p.x(), p.y(), p.z()); });
  completeMoved([](const Vector3f& p, std::size_t i) {  // a fork, its branches 15 deg apart
    const float rise = std::max(p.z() - 0.5F, 0.0F);
    return Vector3f(p + (i % 2 == 0 ? 0.13F : -0.13F) * rise * Vector3f::UnitY());
  });

  auto without_axis = std::make_shared<SegmentedBlock>(*block);
  without_axis->plants[0].axis = StemAxis();
  EXPECT_TRUE(completeBlock(without_axis, {}).synthetic.empty());
  EXPECT_TRUE(completeBlock(std::make_shared<SegmentedBlock>(), {}).synthetic.empty());
}

TEST(CompletionStem, BoundsWhatItMakesUp) {
  Scene scene;
  scene.gaps = {{0.4, 0.6}};
  CompletionParameters parameters;
  parameters.density = 1e7;
  const CompletedBlock completed = completeBlock(makeBlock(scene), parameters);
  EXPECT_LT(completed.synthetic.size(), 42000U);
  EXPECT_GT(completed.synthetic.size(), 10000U);
}

TEST(CompletionStem, PrintsItsTime) {
  for (const std::size_t points : {std::size_t{600}, std::size_t{10000}, std::size_t{100000}}) {
    Scene scene;
    scene.points = points;
    scene.gaps = {{0.45, 0.65}};
    scene.shadow = {0.7, 1.0};
    const auto block = makeBlock(scene);
    std::vector<double> times;
    std::size_t made = 0;
    for (int i = 0; i < 15; ++i) {
      const std::clock_t start = std::clock();
      made = completeBlock(block, {}).synthetic.size();
      times.push_back(static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
    }
    std::sort(times.begin(), times.end());
    std::cout << points << " points: " << 1e3 * times[7] << " ms of one core, " << made << " made"
              << std::endl;
    EXPECT_GT(made, 100U);
  }
}

}  // namespace
}  // namespace field_phenotyping
