// Scans in, blocks out: what is due when, what is forgotten, what becomes of every point.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>
#include <set>

#include "field_phenotyping/common/spatial_order.hpp"
#include "field_phenotyping/preprocessing/preprocessor.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::PlantTruth;
using testing::Scene;

constexpr std::uint64_t kSecond = 1000000000U;
constexpr std::uint64_t kStart = 1700000000U * kSecond;

PreprocessingParameters unlimitedRange() {
  PreprocessingParameters parameters;
  parameters.min_range = 0.0;
  parameters.max_range = 1000.0;
  parameters.block_size = 2.0;
  return parameters;
}

/// A patch of soil, one voxel every `step` [m], in the sensor's frame.
Scan patch(double low_x, double high_x, std::uint64_t stamp, double step = 0.05, double z = -1.0) {
  Scan scan;
  scan.stamp_ns = stamp;
  for (double x = low_x + 0.5 * step; x < high_x; x += step) {
    for (double y = 0.5 * step; y < 2.0; y += step) {
      scan.cloud.points.emplace_back(static_cast<float>(x), static_cast<float>(y),
                                     static_cast<float>(z));
    }
  }
  return scan;
}

bool isDue(const Preprocessor& preprocessor, const BlockIndex& index, bool flush = false) {
  const auto due = preprocessor.dueBlocks(flush);
  return std::find(due.begin(), due.end(), index) != due.end();
}

void handOn(Preprocessor& preprocessor, const BlockIndex& index, bool flush = false) {
  preprocessor.markHandedOn(preprocessor.makeBlock(index, flush).header);
}

const Eigen::Isometry3d kIdentity = Eigen::Isometry3d::Identity();

Scene smallField(unsigned seed = 1U) {
  Scene scene(testing::slopingSoil(4.0), seed);
  scene.addSoil({-1.5, -1.5}, {3.5, 3.5}, 1500.0);
  for (const Eigen::Vector2d& base :
       {Eigen::Vector2d(0.4, 0.4), Eigen::Vector2d(1.2, 0.5), Eigen::Vector2d(1.98, 1.3)}) {
    PlantTruth plant;
    plant.base = base;
    scene.addPlant(plant);
  }
  return scene;
}

TEST(Preprocessor, KeepsWhereTheSensorWasWhileItStoodStill) {
  Preprocessor preprocessor(unlimitedRange(), "map");
  Eigen::Isometry3d T_map_sensor = kIdentity;
  const auto addPost = [&](double x, double y, bool has_origin) {
    Scan scan;  // a post of 40 voxels at (x, y) of the map
    for (int i = 0; i < 40; ++i) {
      const Eigen::Vector3d p(x, y, 0.5 + 0.004 * i);
      scan.cloud.points.push_back((T_map_sensor.inverse() * p).cast<float>());
    }
    if (has_origin) scan.origin = Eigen::Vector3d::Zero();
    preprocessor.addScan(scan, T_map_sensor);
  };
  preprocessor.addScan(patch(0.0, 2.0, kStart, 0.05, 0.0), kIdentity);
  T_map_sensor.translation() = Eigen::Vector3d(0.2, 0.3, 1.0);
  addPost(0.5, 0.5, true);  // the first: nobody knows whether the sensor moves
  T_map_sensor.translation().x() += 0.005;
  addPost(0.9, 0.5, true);
  addPost(1.3, 0.5, false);
  addPost(1.3, 0.9, true);  // after a scan of which it is not known
  T_map_sensor.translation().x() += 0.05;
  addPost(1.3, 1.3, true);
  const Block block = preprocessor.makeBlock({0, 0}, true);
  ASSERT_EQ(block.cloud.scan_origin.size(), block.cloud.size());
  std::size_t known = 0U;
  for (std::size_t i = 0; i < block.cloud.size(); ++i) {
    const Eigen::Vector3d p = block.cloud.mapPoint(i);
    const std::uint16_t origin = block.cloud.scan_origin[i];
    EXPECT_EQ(origin != kNoScanOrigin, (p - Eigen::Vector3d(0.9, 0.5, p.z())).norm() < 0.01);
    if (origin == kNoScanOrigin) continue;
    ++known;
    ASSERT_LT(origin, block.cloud.scan_origins.size());
    const Eigen::Vector3d sensor =
        block.cloud.origin + block.cloud.scan_origins[origin].cast<double>();
    EXPECT_LT((sensor - Eigen::Vector3d(0.205, 0.3, 1.0)).norm(), 1e-5);
  }
  EXPECT_GT(known, 30U);
}

TEST(Preprocessor, SameBlockWhateverTheSplitInScans) {
  const Scene scene = smallField();
  Preprocessor whole(unlimitedRange(), "map");
  Scan all;
  all.cloud = scene.cloud;
  all.stamp_ns = kStart;
  whole.addScan(all, kIdentity);
  const Block expected = whole.makeBlock({0, 0}, true);
  ASSERT_GT(expected.cloud.size(), 1000U);
  ASSERT_GT(expected.ground_points, 1000U);

  for (const std::size_t parts : {2U, 17U, 200U}) {
    Preprocessor streaming(unlimitedRange(), "map");
    std::size_t used = 0U;
    for (std::size_t part = 0; part < parts; ++part) {
      Scan scan;
      scan.stamp_ns = kStart;
      const std::size_t begin = scene.cloud.size() * part / parts;
      const std::size_t end = scene.cloud.size() * (part + 1U) / parts;
      for (std::size_t i = begin; i < end; ++i) scan.cloud.points.push_back(scene.cloud.points[i]);
      used += streaming.addScan(scan, kIdentity).used;
    }
    EXPECT_EQ(used, scene.cloud.size());
    EXPECT_EQ(streaming.voxels(), whole.voxels());
    const Block block = streaming.makeBlock({0, 0}, true);
    EXPECT_EQ(block.ground_points, expected.ground_points);
    ASSERT_EQ(block.cloud.size(), expected.cloud.size()) << parts << " scans";
    for (std::size_t i = 0; i < block.cloud.size(); ++i) {
      ASSERT_EQ(block.cloud.points[i], expected.cloud.points[i]) << parts << " scans";
    }
  }
}

TEST(Preprocessor, ScansFromManyPosesMeetInTheMap) {
  const Scene scene = smallField();
  Preprocessor whole(unlimitedRange(), "map");
  Scan all;
  all.cloud = scene.cloud;
  all.stamp_ns = kStart;
  whole.addScan(all, kIdentity);
  const Block expected = whole.makeBlock({0, 0}, true);

  Preprocessor streaming(unlimitedRange(), "map");
  constexpr std::size_t kScans = 40U;
  for (std::size_t k = 0; k < kScans; ++k) {
    Eigen::Isometry3d T_map_sensor = Eigen::Isometry3d::Identity();
    T_map_sensor.translation() << -1.0 + 0.1 * static_cast<double>(k), -0.8, 1.1;
    T_map_sensor.rotate(Eigen::AngleAxisd(0.15 * static_cast<double>(k), Eigen::Vector3d::UnitZ()) *
                        Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()));
    const Eigen::Isometry3d T_sensor_map = T_map_sensor.inverse();
    Scan scan;
    scan.stamp_ns = kStart + k * kSecond / 10U;
    for (std::size_t i = k; i < scene.cloud.size(); i += kScans) {
      scan.cloud.points.push_back(
          (T_sensor_map * scene.cloud.points[i].cast<double>()).cast<float>());
    }
    streaming.addScan(scan, T_map_sensor);
  }
  const Block block = streaming.makeBlock({0, 0}, true);
  EXPECT_NEAR(static_cast<double>(block.cloud.size()), static_cast<double>(expected.cloud.size()),
              0.01 * static_cast<double>(expected.cloud.size()));
  for (float x = -0.9F; x < 1.0F; x += 0.3F) {
    EXPECT_NEAR(block.ground.heightAt(x, x), expected.ground.heightAt(x, x), 0.002F);
  }
}

TEST(Preprocessor, BlockKnowsWhatItIs) {
  Preprocessor preprocessor(unlimitedRange(), "field");
  preprocessor.addScan(patch(-2.0, 4.0, kStart), kIdentity);
  const Block block = preprocessor.makeBlock({-1, 0}, false);
  EXPECT_EQ(block.header.frame_id, "field");
  EXPECT_EQ(block.header.stamp_ns, kStart);
  EXPECT_EQ(block.header.index, (BlockIndex{-1, 0}));
  EXPECT_EQ(block.header.revision, 1U);
  EXPECT_FALSE(block.header.final);
  EXPECT_DOUBLE_EQ(block.header.tile_size, preprocessor.parameters().block_size);
  EXPECT_DOUBLE_EQ(preprocessor.makeBlock({-1, 0}, true).header.margin,
                   preprocessor.parameters().block_margin);
  EXPECT_TRUE(preprocessor.makeBlock({-1, 0}, true).header.final);
  preprocessor.markHandedOn(block.header);
  EXPECT_EQ(preprocessor.makeBlock({-1, 0}, false).header.revision, 2U);
}

TEST(Preprocessor, FarFromTheOriginAsAtIt) {
  const Scene scene = smallField();
  const Eigen::Vector3d far(500000.0, 4500000.0, 90.0);
  Scan scan;
  scan.cloud = scene.cloud;
  scan.stamp_ns = kStart;
  Preprocessor near_map(unlimitedRange(), "map");
  near_map.addScan(scan, kIdentity);
  Eigen::Isometry3d T_map_sensor = Eigen::Isometry3d::Identity();
  T_map_sensor.translation() = far;
  Preprocessor far_map(unlimitedRange(), "map");
  far_map.addScan(scan, T_map_sensor);

  const auto near_due = near_map.dueBlocks(true);
  const auto far_due = far_map.dueBlocks(true);
  ASSERT_EQ(near_due.size(), far_due.size());
  ASSERT_GE(near_due.size(), 9U);
  for (std::size_t b = 0; b < near_due.size(); ++b) {
    EXPECT_EQ(far_due[b].x, near_due[b].x + 250000);
    EXPECT_EQ(far_due[b].y, near_due[b].y + 2250000);
    const Block near_block = near_map.makeBlock(near_due[b], true);
    const Block far_block = far_map.makeBlock(far_due[b], true);
    // The local height datum is in whole voxels, which 90 m are not.
    const Eigen::Vector3d shift = far_block.cloud.origin - far - near_block.cloud.origin;
    EXPECT_LT(shift.head<2>().norm(), 1e-6);
    EXPECT_LT(std::abs(shift.z()), 1.0);
    // The sum with the far origin rounds to 1 nm, which may move a point into the next voxel.
    const auto size = static_cast<double>(near_block.cloud.size());
    EXPECT_NEAR(static_cast<double>(far_block.cloud.size()), size, 2.0 + 0.005 * size);
    for (float x = -0.9F; x < 1.0F; x += 0.3F) {
      EXPECT_NEAR(far_block.ground.heightAt(x, -x) + static_cast<float>(shift.z()),
                  near_block.ground.heightAt(x, -x), 1e-3F);
    }
  }
}

TEST(Preprocessor, TakesRangesFromTheSensorWhereverTheCloudsOriginIs) {
  PreprocessingParameters parameters;
  parameters.max_range = 10.0;
  Preprocessor preprocessor(parameters, "map");
  Scan scan;
  scan.stamp_ns = kStart;
  scan.cloud.origin = {600.0, 0.0, 0.0};
  scan.cloud.points = {{1.0F, 0.0F, 0.0F}, {-595.0F, 0.0F, 0.0F}};
  const ScanReport report = preprocessor.addScan(scan, kIdentity);
  EXPECT_EQ(report.out_of_range, 1U);
  EXPECT_EQ(report.used, 1U);
}

TEST(Preprocessor, EveryPointIsAccountedFor) {
  PreprocessingParameters parameters;
  parameters.min_range = 0.5;
  parameters.max_range = 10.0;
  parameters.min_x = -100.0;
  parameters.max_x = 6.0;
  parameters.min_z = -0.5;
  Preprocessor preprocessor(parameters, "map");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  Scan scan;
  scan.stamp_ns = kStart;
  scan.cloud.points = {
      {1.0F, 0.0F, 0.0F},                                              // used
      {0.3F, 0.0F, 0.0F},                                              // too near
      {0.0F, 11.0F, 0.0F},                                             // too far
      {9.0F, 0.0F, 0.0F},                                              // outside the crop box
      {2.0F, 0.0F, -1.0F},                                             // below the crop box
      {nan, 0.0F, 0.0F},   {0.0F, nan, 1.0F}, {1.0F, 1.0F, infinity},  // not finite
      {-4.0F, 5.0F, 1.0F},                                             // used
  };
  const ScanReport report = preprocessor.addScan(scan, kIdentity);
  EXPECT_EQ(report.points, 9U);
  EXPECT_EQ(report.used, 2U);
  EXPECT_EQ(report.out_of_range, 4U);
  EXPECT_EQ(report.non_finite, 3U);
  EXPECT_EQ(preprocessor.voxels(), 2U);

  // The crop box is in the map's frame, the range in the sensor's.
  Eigen::Isometry3d T_map_sensor = Eigen::Isometry3d::Identity();
  T_map_sensor.translation() << -50.0, 0.0, 0.0;
  scan.cloud.points = {{9.0F, 0.0F, 0.0F}, {-9.0F, 0.0F, 0.0F}, {11.0F, 0.0F, 0.0F}};
  EXPECT_EQ(preprocessor.addScan(scan, T_map_sensor).used, 2U);
}

TEST(Preprocessor, EmptyAndUselessScans) {
  Preprocessor preprocessor(PreprocessingParameters(), "map");
  EXPECT_EQ(preprocessor.addScan(Scan(), kIdentity).points, 0U);
  Scan scan;
  scan.stamp_ns = kStart;
  scan.cloud.points.assign(100U, Eigen::Vector3f::Constant(std::nanf("")));
  EXPECT_EQ(preprocessor.addScan(scan, kIdentity).non_finite, 100U);
  EXPECT_EQ(preprocessor.openTiles(), 0U);
  EXPECT_TRUE(preprocessor.dueBlocks(false).empty());
  EXPECT_TRUE(preprocessor.dueBlocks(true).empty());
  const Block block = preprocessor.makeBlock({0, 0}, true);
  EXPECT_TRUE(block.cloud.empty());
  EXPECT_TRUE(block.ground.empty());
}

TEST(Preprocessor, DueWhenChangedEnoughAndNotTooSoon) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.update_period = 2.0;
  parameters.update_min_change = 0.15;
  parameters.final_after = 1000.0;
  Preprocessor preprocessor(parameters, "map");
  const BlockIndex index{0, 0};
  preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity);
  EXPECT_TRUE(isDue(preprocessor, index)) << "the first view is worth working at once";
  handOn(preprocessor, index);
  EXPECT_FALSE(isDue(preprocessor, index));

  preprocessor.addScan(patch(0.2, 1.2, kStart + 3U * kSecond), kIdentity);
  EXPECT_FALSE(isDue(preprocessor, index)) << "the same voxels again";
  EXPECT_TRUE(isDue(preprocessor, index, true)) << "but their centroids may have moved";

  preprocessor.addScan(patch(1.2, 1.3, kStart + 3U * kSecond), kIdentity);
  EXPECT_FALSE(isDue(preprocessor, index)) << "10 % new voxels are not worth it";
  preprocessor.addScan(patch(1.3, 1.5, kStart + 3U * kSecond), kIdentity);
  EXPECT_TRUE(isDue(preprocessor, index)) << "30 % are";
  handOn(preprocessor, index);

  preprocessor.addScan(patch(1.5, 1.9, kStart + 4U * kSecond), kIdentity);
  EXPECT_FALSE(isDue(preprocessor, index)) << "handed on a second ago";
  preprocessor.addScan(patch(1.8, 1.9, kStart + 5U * kSecond + kSecond / 10U), kIdentity);
  EXPECT_TRUE(isDue(preprocessor, index));
}

TEST(Preprocessor, ARoverThatStandsStillForMinutesIsNotToldOfAgainAndAgain) {
  // The same beams ten times a second, with 3 mm of noise along them.
  constexpr std::size_t kScans = 3000U;
  std::mt19937 random(1U);
  std::normal_distribution<float> noise(0.0F, 0.003F);
  Preprocessor preprocessor(unlimitedRange(), "map");
  const BlockIndex index{0, 0};
  const Scan seen = patch(0.0, 2.0, kStart);
  std::size_t drafts = 0U;
  std::size_t others = 0U;
  std::size_t late = 0U;  // after the first minute
  std::size_t voxels_after_a_minute = 0U;
  for (std::size_t k = 0; k < kScans; ++k) {
    Scan scan = seen;
    scan.stamp_ns = kStart + k * (kSecond / 10U);
    for (Eigen::Vector3f& point : scan.cloud.points) point *= 1.0F + noise(random) / point.norm();
    preprocessor.addScan(scan, kIdentity);
    if (k == kScans / 5U) voxels_after_a_minute = preprocessor.voxels();
    if (!isDue(preprocessor, index)) continue;
    const BlockHeader header = preprocessor.collect({index}, false).header;
    EXPECT_FALSE(header.final) << "scans reach it";
    ++(header.draft ? drafts : others);
    if (k > kScans / 5U) ++late;
    preprocessor.markHandedOn(header);
  }
  EXPECT_LE(drafts, 6U);
  EXPECT_LE(others, 6U);
  EXPECT_LE(late, 2U) << "as stray returns open voxels farther and farther off";
  EXPECT_LT(preprocessor.voxels(), 3U * voxels_after_a_minute / 2U);
}

TEST(Preprocessor, ADraftNeedsOnlyThePartInWhichMuchIsNew) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.block_size = 4.0;
  parameters.block_margin = 0.6;
  Preprocessor preprocessor(parameters, "map");
  const BlockIndex index{0, 0};
  EXPECT_FALSE(preprocessor.changedPart(index)) << "nothing is there";
  preprocessor.addScan(patch(0.0, 4.0, kStart), kIdentity);
  auto part = preprocessor.changedPart(index);
  ASSERT_TRUE(part);
  EXPECT_TRUE(part->isEmpty()) << "never handed on: the whole tile";
  handOn(preprocessor, index);
  EXPECT_FALSE(preprocessor.changedPart(index)) << "nothing is new";

  // Twice as many in one cell, a tenth more in others.
  preprocessor.addScan(patch(2.0, 3.0, kStart + kSecond, 0.05, -0.9), kIdentity);
  preprocessor.addScan(patch(0.0, 0.1, kStart + kSecond, 0.05, -0.9), kIdentity);
  part = preprocessor.changedPart(index);
  ASSERT_TRUE(part);
  EXPECT_EQ(part->min(), Eigen::Vector2d(2.0, 0.0));
  EXPECT_EQ(part->max(), Eigen::Vector2d(3.0, 2.0));
  const BlockPoints tile = preprocessor.collect({index}, false);
  const BlockPoints of_part = partOf(tile, *part);
  EXPECT_TRUE(of_part.header.isPart());
  const auto in_reach = [&](const Eigen::Vector3d& p) {
    return p.x() >= 1.7 && p.x() <= 3.3 && p.y() <= 2.3;
  };
  std::size_t count = 0U;
  for (std::size_t i = 0; i < tile.cloud.size(); ++i) count += in_reach(tile.cloud.mapPoint(i));
  EXPECT_EQ(of_part.cloud.size(), count) << "with half of the margin, as of all drafts";
  for (std::size_t i = 0; i < of_part.cloud.size(); ++i) {
    EXPECT_TRUE(in_reach(of_part.cloud.mapPoint(i)));
  }
  const Block block = finishBlock(of_part, parameters);
  EXPECT_TRUE(block.header.holds(2.5, 1.0));
  EXPECT_FALSE(block.header.holds(1.9, 1.0));
  EXPECT_TRUE(block.header.holds(1.95, 1.0, 0.1));

  // Where most of the tile has changed it is not worth it.
  preprocessor.addScan(patch(0.0, 4.0, kStart + kSecond, 0.05, -0.8), kIdentity);
  Scan rest = patch(0.0, 4.0, kStart + kSecond, 0.05, -0.8);
  for (Eigen::Vector3f& point : rest.cloud.points) point.y() += 2.0F;
  preprocessor.addScan(rest, kIdentity);
  part = preprocessor.changedPart(index);
  ASSERT_TRUE(part);
  EXPECT_TRUE(part->isEmpty());
}

TEST(Preprocessor, WhatHasChangedIsADraftAndABetterBlockFollowsOnceItHasSettled) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.update_period = 2.0;
  parameters.final_after = 1000.0;
  parameters.block_margin = 0.6;
  Preprocessor preprocessor(parameters, "map");
  const BlockIndex index{0, 0};
  preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity);
  const BlockPoints first = preprocessor.collect({index}, false);
  EXPECT_TRUE(first.header.draft);
  EXPECT_DOUBLE_EQ(first.header.margin, 0.3) << "narrow: it is to be quick";
  preprocessor.markHandedOn(first.header);

  preprocessor.addScan(patch(1.2, 1.3, kStart + 4U * kSecond), kIdentity);
  EXPECT_FALSE(isDue(preprocessor, index)) << "little is new";
  preprocessor.addScan(patch(1.2, 1.3, kStart + 5U * kSecond), kIdentity);
  ASSERT_TRUE(isDue(preprocessor, index)) << "nor does more come";
  const BlockPoints settled = preprocessor.collect({index}, false);
  EXPECT_FALSE(settled.header.draft);
  EXPECT_FALSE(settled.header.final);
  EXPECT_DOUBLE_EQ(settled.header.margin, 0.3) << "it is worked again when it is final";
  EXPECT_DOUBLE_EQ(preprocessor.collect({index}, true).header.margin, 0.6);
  preprocessor.markHandedOn(settled.header);

  preprocessor.addScan(patch(1.3, 1.4, kStart + 20U * kSecond), kIdentity);
  EXPECT_FALSE(isDue(preprocessor, index)) << "once is enough";
  preprocessor.addScan(patch(1.4, 1.9, kStart + 21U * kSecond), kIdentity);
  ASSERT_TRUE(isDue(preprocessor, index));
  EXPECT_TRUE(preprocessor.collect({index}, false).header.draft) << "much is new";
  EXPECT_FALSE(preprocessor.collect({index}, true).header.draft) << "the last is no draft";
  EXPECT_TRUE(preprocessor.isDraft(index, false));
  EXPECT_FALSE(preprocessor.isDraft(index, true));
}

TEST(Preprocessor, JoinsFinalBlocksThatAdjoin) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.final_after = 5.0;
  parameters.block_margin = 0.0;
  Preprocessor preprocessor(parameters, "map");
  preprocessor.addScan(patch(0.0, 6.0, kStart), kIdentity);                   // tiles 0 to 2
  preprocessor.addScan(patch(8.0, 10.0, kStart + kSecond), kIdentity);        // tile 4
  preprocessor.addScan(patch(6.0, 8.0, kStart + 4U * kSecond), kIdentity);    // between them
  preprocessor.addScan(patch(99.0, 99.9, kStart + 7U * kSecond), kIdentity);  // as time goes on
  const std::vector<BlockIndex> due = preprocessor.dueBlocks(false);
  const std::vector<BlockIndex> three = preprocessor.joinedWith({1, 0}, due, false);
  EXPECT_EQ(three.front(), (BlockIndex{1, 0}));
  EXPECT_EQ(std::set<BlockIndex>(three.begin(), three.end()),
            (std::set<BlockIndex>{{0, 0}, {1, 0}, {2, 0}}));
  EXPECT_EQ(preprocessor.joinedWith({4, 0}, due, false), (std::vector<BlockIndex>{{4, 0}}));
  EXPECT_EQ(preprocessor.joinedWith({3, 0}, due, false), (std::vector<BlockIndex>{{3, 0}}))
      << "scans may reach it yet";
  EXPECT_EQ(preprocessor.joinedWith({3, 0}, preprocessor.dueBlocks(true), true).size(), 5U)
      << "but for the one far away";

  // Each says of itself what it is.
  const BlockPoints points = preprocessor.collect(three, false);
  ASSERT_EQ(points.joined.size(), 3U);
  EXPECT_EQ(points.header.index, three.front());
  EXPECT_TRUE(points.header.final);
  for (std::size_t k = 0; k < three.size(); ++k) {
    const BlockHeader alone = preprocessor.collect({three[k]}, false).header;
    EXPECT_EQ(points.joined[k].index, three[k]);
    EXPECT_EQ(points.joined[k].began_ns, alone.began_ns);
    EXPECT_EQ(points.joined[k].revision, alone.revision);
    preprocessor.markHandedOn(points.joined[k]);
    EXPECT_FALSE(isDue(preprocessor, three[k]));
  }
}

TEST(Preprocessor, JoinsNoMoreThanCanBeWorkedAtOnceAndThoseOfTheShortestMargin) {
  PreprocessingParameters parameters = unlimitedRange();
  Preprocessor preprocessor(parameters, "map");
  for (int row = 0; row < 3; ++row) {
    Eigen::Isometry3d sensor = kIdentity;
    sensor.translation().y() = 2.0 * row;
    preprocessor.addScan(patch(0.0, 12.0, kStart), sensor);
  }
  const auto joined = preprocessor.joinedWith({2, 1}, preprocessor.dueBlocks(true), true);
  ASSERT_EQ(joined.size(), Preprocessor::kMostJoined);
  const auto [left, right] = std::minmax_element(
      joined.begin(), joined.end(), [](const auto& a, const auto& b) { return a.x < b.x; });
  const auto [low, high] = std::minmax_element(
      joined.begin(), joined.end(), [](const auto& a, const auto& b) { return a.y < b.y; });
  EXPECT_EQ((right->x - left->x + 1) * (high->y - low->y + 1), 6) << "a rectangle";
}

TEST(Preprocessor, JoinsTheOneThatWouldBeLeftAlone) {
  Preprocessor preprocessor(unlimitedRange(), "map");
  preprocessor.addScan(patch(0.0, 16.0, kStart), kIdentity);  // eight tiles in a row
  const auto joined = preprocessor.joinedWith({6, 0}, preprocessor.dueBlocks(true), true);
  EXPECT_EQ(std::set<BlockIndex>(joined.begin(), joined.end()),
            (std::set<BlockIndex>{{2, 0}, {3, 0}, {4, 0}, {5, 0}, {6, 0}, {7, 0}}));
}

TEST(Preprocessor, AFinalBlockMayWaitWhileItIsNearAndNotLongAfterwards) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.final_after = 5.0;
  parameters.final_distance = 20.0;
  parameters.block_margin = 0.0;
  Preprocessor preprocessor(parameters, "map");
  preprocessor.addScan(patch(0.0, 2.0, kStart), kIdentity);
  preprocessor.addScan(patch(10.0, 12.0, kStart + 100U * kSecond), kIdentity);
  EXPECT_TRUE(preprocessor.isFinished({0, 0}));
  EXPECT_TRUE(preprocessor.mayWait({0, 0})) << "10 m away: the rover may come back";
  EXPECT_FALSE(preprocessor.mayWait({3, 0})) << "nothing is there";

  preprocessor.addScan(patch(0.0, 2.0, kStart + 101U * kSecond), kIdentity);
  preprocessor.addScan(patch(30.0, 32.0, kStart + 120U * kSecond), kIdentity);
  EXPECT_TRUE(preprocessor.mayWait({0, 0})) << "30 m away, but seen 19 s ago";
  preprocessor.addScan(patch(30.0, 32.0, kStart + 122U * kSecond), kIdentity);
  EXPECT_FALSE(preprocessor.mayWait({0, 0}));
}

TEST(Preprocessor, DraftsAreThinnerThanWhatFollows) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.draft_density = 1000.0;
  parameters.max_density = 2000.0;
  const Scene scene = smallField();
  BlockPoints points;
  points.cloud = scene.cloud;
  points.header.draft = true;
  DensePoints before;
  const Block draft = finishBlock(points, parameters, {}, &before);
  ASSERT_EQ(before.thinned.size(), before.points.size());
  points.header.draft = false;
  const Block whole = finishBlock(points, parameters);
  parameters.max_density = 1e9;
  const Block all = finishBlock(points, parameters);
  EXPECT_LT(draft.cloud.size(), whole.cloud.size());
  EXPECT_LT(whole.cloud.size(), all.cloud.size());
  PointCloud undone = all.cloud;
  undone.points.insert(undone.points.end(), all.feet.points.begin(), all.feet.points.end());
  EXPECT_EQ(undone.points, before.points);
  EXPECT_EQ(draft.ground_points, all.ground_points) << "soil is found among all points";
}

TEST(Preprocessor, LargeCloudsLieInSpatialOrder) {
  // Soil, and above it points that are known again by their colours.
  BlockPoints points;
  Scene scene(testing::levelSoil(), 2U);
  scene.addSoil({0.0, 0.0}, {4.0, 4.0}, 1500.0);
  points.cloud = scene.cloud;
  std::mt19937 random(3U);
  std::uniform_real_distribution<float> across(0.0F, 4.0F);
  std::uniform_real_distribution<float> above(0.5F, 1.5F);
  constexpr std::size_t kPlants = 100000U;
  for (std::size_t i = 0; i < kPlants; ++i) {
    points.cloud.points.emplace_back(across(random), across(random), above(random));
  }
  for (std::uint32_t i = 0; i < points.cloud.size(); ++i) points.cloud.colors.push_back(i);
  PreprocessingParameters parameters = unlimitedRange();
  parameters.max_density = 1e9;
  const Block block = finishBlock(points, parameters);
  ASSERT_GT(block.cloud.size(), kPlants / 2U);
  ASSERT_EQ(block.cloud.colors.size(), block.cloud.size());
  for (std::size_t i = 0; i < block.cloud.size(); ++i) {
    ASSERT_EQ(block.cloud.points[i], points.cloud.points[block.cloud.colors[i]]);
  }
  std::vector<std::uint32_t> as_they_are(block.cloud.size());
  std::iota(as_they_are.begin(), as_they_are.end(), 0U);
  EXPECT_EQ(spatialOrder(block.cloud.points), as_they_are);

  // What stands for a point of a thinned cloud lies in its voxel.
  parameters.max_density = 5000.0;
  DensePoints before;
  const Block thinned = finishBlock(points, parameters, {}, &before);
  ASSERT_FALSE(before.empty());
  ASSERT_LT(thinned.cloud.size(), block.cloud.size());
  ASSERT_GT(thinned.cloud.size(), 65536U) << "few are left in their order";
  constexpr float kVoxel = 0.03F;  // [m] the widest
  for (std::size_t i = 0; i < before.points.size(); ++i) {
    if (before.thinned[i] >= thinned.cloud.size()) continue;
    const Eigen::Vector3f& stands_for_it = thinned.cloud.points[before.thinned[i]];
    ASSERT_LT((before.points[i] - stands_for_it).cwiseAbs().maxCoeff(), kVoxel);
  }
}

TEST(Preprocessor, FinalWhenNoScanReachesItAnyMore) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.final_after = 5.0;
  parameters.final_distance = 20.0;
  Preprocessor preprocessor(parameters, "map");
  const BlockIndex index{0, 0};
  preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity);
  handOn(preprocessor, index);
  preprocessor.addScan(patch(10.0, 11.0, kStart + 4U * kSecond), kIdentity);
  EXPECT_FALSE(isDue(preprocessor, index));
  preprocessor.addScan(patch(10.0, 11.0, kStart + 6U * kSecond), kIdentity);
  EXPECT_TRUE(isDue(preprocessor, index)) << "to be said final";
  EXPECT_TRUE(preprocessor.makeBlock(index, false).header.final);
  handOn(preprocessor, index);
  EXPECT_FALSE(isDue(preprocessor, index));
  EXPECT_FALSE(isDue(preprocessor, index, true)) << "final and unchanged: said already";
  EXPECT_EQ(preprocessor.openTiles(), 2U) << "kept: the sensor is near";

  // Seen again: no longer final.
  preprocessor.addScan(patch(1.2, 1.9, kStart + 9U * kSecond), kIdentity);
  EXPECT_TRUE(isDue(preprocessor, index));
  const Block again = preprocessor.makeBlock(index, false);
  EXPECT_FALSE(again.header.final);
  EXPECT_EQ(again.header.revision, 3U);
}

TEST(Preprocessor, AMarginThatChangesKeepsItsBlocksOpen) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.final_after = 5.0;
  parameters.block_margin = 0.6;
  Preprocessor preprocessor(parameters, "map");
  preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity);
  // 0.5 m beyond the border is in the margin, 0.7 m is not.
  preprocessor.addScan(patch(2.4, 2.5, kStart + 4U * kSecond), kIdentity);
  preprocessor.addScan(patch(2.7, 2.8, kStart + 8U * kSecond), kIdentity);
  EXPECT_FALSE(preprocessor.makeBlock({0, 0}, false).header.final) << "touched 4 s ago";
  preprocessor.addScan(patch(2.7, 2.8, kStart + 10U * kSecond), kIdentity);
  EXPECT_TRUE(preprocessor.makeBlock({0, 0}, false).header.final);
}

TEST(Preprocessor, ForgetsFinalTilesFarBehind) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.final_after = 2.0;
  parameters.final_distance = 10.0;
  Preprocessor preprocessor(parameters, "map");
  std::size_t most_tiles = 0U;
  std::size_t most_voxels = 0U;
  std::set<BlockIndex> said_final;
  for (int second = 0; second < 200; ++second) {
    const double x = second;  // 1 m/s
    preprocessor.addScan(
        patch(x - 1.0, x + 1.0, kStart + static_cast<std::uint64_t>(second) * kSecond), kIdentity);
    for (const BlockIndex& index : preprocessor.dueBlocks(false)) {
      const Block block = preprocessor.makeBlock(index, false);
      if (block.header.final) {
        EXPECT_TRUE(said_final.insert(index).second) << "said final twice: " << index.x;
      }
      preprocessor.markHandedOn(block.header);
    }
    most_tiles = std::max(most_tiles, preprocessor.openTiles());
    most_voxels = std::max(most_voxels, preprocessor.voxels());
  }
  EXPECT_LT(most_tiles, 12U) << "memory follows the blocks still open";
  EXPECT_LT(most_voxels, 12U * 1600U);
  EXPECT_GT(said_final.size(), 90U) << "and every tile was finished once";
  EXPECT_EQ(preprocessor.makeBlock({0, 0}, true).cloud.size(), 0U);
}

TEST(Preprocessor, MemoryLimitFinishesTheOldestTiles) {
  PreprocessingParameters parameters = unlimitedRange();
  parameters.memory_limit = 10000.0;
  parameters.final_after = 1000.0;
  parameters.final_distance = 1000.0;
  parameters.block_margin = 0.0;
  Preprocessor preprocessor(parameters, "map");
  for (int k = 0; k < 20; ++k) {
    preprocessor.addScan(
        patch(2.0 * k, 2.0 * k + 2.0, kStart + static_cast<std::uint64_t>(k) * kSecond, 0.05),
        kIdentity);
    for (const BlockIndex& index : preprocessor.dueBlocks(false)) {
      const Block block = preprocessor.makeBlock(index, false);
      if (block.header.final) {
        EXPECT_LT(index.x, k - 3) << "the oldest are given up";
        EXPECT_FALSE(preprocessor.mayWait(index));
      }
      preprocessor.markHandedOn(block.header);
    }
    EXPECT_LE(preprocessor.voxels(), 10000U);
  }
  EXPECT_LE(preprocessor.openTiles(), 7U);
  EXPECT_GE(preprocessor.openTiles(), 4U);
}

TEST(Preprocessor, NewGridEmptiesTheMapOtherParametersDoNot) {
  PreprocessingParameters parameters = unlimitedRange();
  Preprocessor preprocessor(parameters, "map");
  preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity);
  const std::size_t voxels = preprocessor.voxels();
  ASSERT_GT(voxels, 0U);
  parameters.max_range = 0.1;
  parameters.min_range = 0.0;
  EXPECT_FALSE(preprocessor.setParameters(parameters));
  EXPECT_EQ(preprocessor.voxels(), voxels);
  EXPECT_EQ(preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity).used, 0U)
      << "holds for further scans";
  parameters.max_range = 1000.0;
  parameters.voxel_size = 0.02;
  EXPECT_TRUE(preprocessor.setParameters(parameters));
  EXPECT_EQ(preprocessor.voxels(), 0U);
  EXPECT_EQ(preprocessor.openTiles(), 0U);
  preprocessor.addScan(patch(0.2, 1.2, kStart), kIdentity);
  parameters.block_size = 4.0;
  EXPECT_TRUE(preprocessor.setParameters(parameters));
  EXPECT_EQ(preprocessor.voxels(), 0U);
  preprocessor.addScan(patch(0.2, 3.9, kStart), kIdentity);
  EXPECT_EQ(preprocessor.openTiles(), 1U);
}

TEST(Preprocessor, ResetForgetsEverything) {
  Preprocessor preprocessor(unlimitedRange(), "map");
  preprocessor.addScan(patch(0.2, 5.0, kStart, 0.05, 40.0), kIdentity);
  preprocessor.reset();
  EXPECT_EQ(preprocessor.voxels(), 0U);
  EXPECT_EQ(preprocessor.openTiles(), 0U);
  EXPECT_TRUE(preprocessor.dueBlocks(true).empty());
  // Time may start anew, and so may the height datum.
  preprocessor.addScan(patch(0.2, 1.2, 5U * kSecond, 0.05, -7.5), kIdentity);
  const Block block = preprocessor.makeBlock({0, 0}, true);
  EXPECT_EQ(block.header.stamp_ns, 5U * kSecond);
  EXPECT_EQ(block.header.revision, 1U);
  EXPECT_NEAR(block.cloud.origin.z(), -8.0, 1.0);
}

TEST(Preprocessor, ColoursTravelWithTheirPoints) {
  Preprocessor preprocessor(unlimitedRange(), "map");
  Scan scan;
  scan.stamp_ns = kStart;
  Scene scene(testing::levelSoil(), 3U);
  scene.addSoil({0.0, 0.0}, {2.0, 2.0}, 1000.0);
  PlantTruth plant;
  plant.base = {1.0, 1.0};
  scene.addPlant(plant);
  scan.cloud = scene.cloud;
  for (const testing::PointTruth& truth : scene.truth) {
    scan.cloud.colors.push_back(truth.soil ? 0x806040U : 0x20A010U);
  }
  preprocessor.addScan(scan, kIdentity);
  const Block block = preprocessor.makeBlock({0, 0}, true);
  ASSERT_EQ(block.cloud.colors.size(), block.cloud.size());
  std::size_t green = 0U;
  for (std::size_t i = 0; i < block.cloud.size(); ++i) {
    if (block.ground.heightAbove(block.cloud.points[i]) < 0.1F) continue;
    ASSERT_EQ(block.cloud.colors[i], 0x20A010U);
    ++green;
  }
  EXPECT_GT(green, 500U);
}

}  // namespace
}  // namespace field_phenotyping
