#include <gtest/gtest.h>

#include <vector>

#include "block_serialization.hpp"

namespace field_phenotyping {
namespace {

namespace ser = ros::serialization;

template <class From, class To>
To overTheWire(const From& value, std::size_t cut = 0U) {
  std::vector<std::uint8_t> bytes(ser::serializationLength(value));
  ser::OStream out(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ser::serialize(out, value);
  EXPECT_EQ(out.getLength(), 0U) << "the length is not that of what was written";
  To result;
  ser::IStream in(bytes.data(), static_cast<std::uint32_t>(bytes.size() - cut));
  ser::deserialize(in, result);
  EXPECT_EQ(in.getLength(), 0U);
  return result;
}

BlockHeader someHeader() {
  BlockHeader header;
  header.stamp_ns = 1604515190000000123U;
  header.began_ns = 1604515180000000001U;
  header.due_ns = 1604515191000000002U;
  header.frame_id = "map";
  header.index = {-7, 9};
  header.revision = 4U;
  header.final = true;
  header.draft = true;
  header.tile_size = 2.5;
  header.tile_corner = {-0.7, 12.3};
  header.margin = 0.4;
  header.part = {Eigen::Vector2d(-17.0, 35.0), Eigen::Vector2d(-16.0, 36.5)};
  return header;
}

PointCloud someCloud(std::size_t size) {
  PointCloud cloud;
  cloud.origin = {448262.0, 5411932.0, 90.0};
  for (std::size_t i = 0; i < size; ++i) {
    const auto f = static_cast<float>(i);
    cloud.points.emplace_back(f, 2.0F * f, -f);
    cloud.colors.push_back(static_cast<std::uint32_t>(0x010203U * i));
  }
  cloud.scan_origins = {{1.0F, 2.0F, 3.0F}, {4.0F, 5.0F, 6.0F}};
  cloud.scan_origin.assign(cloud.size(), 1U);
  cloud.scan_origin.back() = kNoScanOrigin;
  return cloud;
}

GroundModel someGround() {
  std::vector<GroundModel::Node> nodes(6U);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    nodes[i] = {0.1F * static_cast<float>(i), 0.01F, static_cast<std::uint8_t>(i % 2U)};
  }
  return GroundModel({-1.0F, -2.0F}, 0.5F, 3, 2, nodes, true);
}

Block fieldBlock() {
  Block block;
  block.header = someHeader();
  block.cloud = someCloud(5U);
  block.ground = someGround();
  block.ground_points = 77U;
  block.feet = someCloud(3U);
  block.isolated = someCloud(2U);
  block.joined = {someHeader(), someHeader()};
  block.joined[1].index = {-6, 9};
  return block;
}

SegmentedBlock segmentedBlock() {
  SegmentedBlock block;
  block.header = someHeader();
  block.cloud = someCloud(5U);
  block.ground = someGround();
  Plant plant;
  plant.id = 12;
  plant.owned = false;
  plant.points = {1U, 4U};
  plant.stem = {1U, 3U};
  plant.axis = StemAxis({{{0.0F, 0.0F, 0.0F}, 0.01F}, {{0.0F, 0.1F, 1.0F}, 0.008F}});
  plant.base = {0.1F, 0.2F, 0.3F};
  plant.top_stddev = 0.04F;
  plant.growth = {0.9F, 2U, 0.04F, 0.5F, 0.2F, 0.8F, {RegionSummary()}};
  block.plants = {plant, plant};
  block.plants[1].id = -1;
  block.plants[1].points = block.plants[1].stem = {4U, 4U};
  block.source_index = {4U, 3U, 2U, 1U, 0U};
  return block;
}

CompletedBlock completedBlock() {
  CompletedBlock block;
  block.segmented = std::make_shared<SegmentedBlock>(segmentedBlock());
  block.synthetic = someCloud(3U);
  block.synthetic_stddev = {0.1F, 0.2F, 0.3F};
  block.synthetic_span = {{0U, 2U}, {2U, 3U}};
  block.stems.resize(2U);
  block.stems[1].flags = 8U;
  return block;
}

void expectSame(const BlockHeader& a, const BlockHeader& b) {
  EXPECT_EQ(a.stamp_ns, b.stamp_ns);
  EXPECT_EQ(a.began_ns, b.began_ns);
  EXPECT_EQ(a.due_ns, b.due_ns);
  EXPECT_EQ(a.frame_id, b.frame_id);
  EXPECT_TRUE(a.index == b.index);
  EXPECT_EQ(a.revision, b.revision);
  EXPECT_EQ(a.final, b.final);
  EXPECT_EQ(a.draft, b.draft);
  EXPECT_EQ(a.tile_size, b.tile_size);
  EXPECT_EQ(a.tile_corner, b.tile_corner);
  EXPECT_EQ(a.margin, b.margin);
  EXPECT_EQ(a.part.min(), b.part.min());
  EXPECT_EQ(a.part.max(), b.part.max());
}

void expectSame(const PointCloud& a, const PointCloud& b) {
  EXPECT_EQ(a.scan_origins, b.scan_origins);
  EXPECT_EQ(a.scan_origin, b.scan_origin);
  EXPECT_EQ(a.origin, b.origin);
  EXPECT_EQ(a.points, b.points);
  EXPECT_EQ(a.colors, b.colors);
}

void expectSame(const GroundModel& a, const GroundModel& b) {
  EXPECT_EQ(a.corner(), b.corner());
  EXPECT_EQ(a.spacing(), b.spacing());
  EXPECT_EQ(a.columns(), b.columns());
  EXPECT_EQ(a.rows(), b.rows());
  EXPECT_EQ(a.observed(), b.observed());
  ASSERT_EQ(a.nodes().size(), b.nodes().size());
  for (std::size_t i = 0; i < a.nodes().size(); ++i) {
    EXPECT_EQ(a.nodes()[i].height, b.nodes()[i].height);
    EXPECT_EQ(a.nodes()[i].stddev, b.nodes()[i].stddev);
    EXPECT_EQ(a.nodes()[i].seen, b.nodes()[i].seen);
  }
}

void expectSame(const SegmentedBlock& a, const SegmentedBlock& b) {
  expectSame(a.header, b.header);
  expectSame(a.cloud, b.cloud);
  expectSame(a.ground, b.ground);
  EXPECT_EQ(a.source_index, b.source_index);
  ASSERT_EQ(a.plants.size(), b.plants.size());
  for (std::size_t i = 0; i < a.plants.size(); ++i) {
    const Plant& p = a.plants[i];
    const Plant& q = b.plants[i];
    EXPECT_EQ(p.id, q.id);
    EXPECT_EQ(p.owned, q.owned);
    EXPECT_EQ(p.points.begin, q.points.begin);
    EXPECT_EQ(p.points.end, q.points.end);
    EXPECT_EQ(p.stem.begin, q.stem.begin);
    EXPECT_EQ(p.stem.end, q.stem.end);
    EXPECT_EQ(p.base, q.base);
    EXPECT_EQ(p.top_stddev, q.top_stddev);
    EXPECT_EQ(p.growth.quality, q.growth.quality);
    EXPECT_EQ(p.growth.iterations, q.growth.iterations);
    EXPECT_EQ(p.growth.r1, q.growth.r1);
    EXPECT_EQ(p.growth.M, q.growth.M);
    EXPECT_EQ(p.growth.alpha, q.growth.alpha);
    EXPECT_EQ(p.growth.beta, q.growth.beta);
    ASSERT_EQ(p.axis.nodes().size(), q.axis.nodes().size());
    EXPECT_EQ(p.axis.length(), q.axis.length());
    EXPECT_EQ(p.axis.radiusAt(0.4F), q.axis.radiusAt(0.4F));
  }
}

TEST(Wire, BringsABlockBackWhole) {
  const Block sent = fieldBlock();
  const auto got = overTheWire<Block, Block>(sent);
  expectSame(sent.header, got.header);
  ASSERT_EQ(got.joined.size(), sent.joined.size());
  for (std::size_t t = 0; t < sent.joined.size(); ++t) expectSame(sent.joined[t], got.joined[t]);
  expectSame(sent.cloud, got.cloud);
  expectSame(sent.ground, got.ground);
  EXPECT_EQ(sent.ground_points, got.ground_points);
  expectSame(sent.feet, got.feet);
  expectSame(sent.isolated, got.isolated);
  expectSame(overTheWire<Block, Block>(Block()).cloud, PointCloud());
}

TEST(Wire, BringsASegmentedBlockBackWhole) {
  expectSame(segmentedBlock(), overTheWire<SegmentedBlock, SegmentedBlock>(segmentedBlock()));
}

TEST(Wire, LeavesTheRegionsOfAStemsGrowthBehind) {
  const SegmentedBlock sent = segmentedBlock();
  ASSERT_EQ(sent.plants[0].growth.regions.size(), 1U);
  const auto got = overTheWire<SegmentedBlock, SegmentedBlock>(sent);
  EXPECT_TRUE(got.plants.at(0).growth.regions.empty());
}

TEST(Wire, BringsACompletedBlockBackWhole) {
  const CompletedBlock sent = completedBlock();
  const auto got = overTheWire<CompletedBlock, CompletedBlock>(sent);
  expectSame(*sent.segmented, *got.segmented);
  expectSame(sent.synthetic, got.synthetic);
  EXPECT_EQ(sent.synthetic_stddev, got.synthetic_stddev);
  ASSERT_EQ(got.synthetic_span.size(), 2U);
  EXPECT_EQ(got.synthetic_span[1].begin, 2U);
  EXPECT_EQ(got.synthetic_span[1].end, 3U);
  ASSERT_EQ(got.stems.size(), 2U);
  EXPECT_EQ(got.stems[0].flags, 0U);
  EXPECT_EQ(got.stems[1].flags, 8U);
}

// What `rostopic echo` and other languages read is the generated message.
TEST(Wire, IsThatOfTheGeneratedMessages) {
  const auto block = overTheWire<Block, FieldBlock>(fieldBlock());
  EXPECT_EQ(block.info.header.frame_id, "map");
  EXPECT_EQ(block.info.header.stamp.toNSec(), 1604515190000000123U);
  EXPECT_EQ(block.info.index_y, 9);
  EXPECT_TRUE(block.info.final);
  EXPECT_TRUE(block.info.draft);
  EXPECT_EQ(block.info.part_min_y, 35.0);
  EXPECT_EQ(block.info.part_max_x, -16.0);
  EXPECT_EQ(block.cloud.origin.y, 5411932.0);
  ASSERT_EQ(block.cloud.points.size(), 5U);
  EXPECT_EQ(block.cloud.points[4].z, -4.0F);
  EXPECT_EQ(block.ground.columns, 3U);
  EXPECT_EQ(block.ground_points, 77U);

  const auto segmented = overTheWire<SegmentedBlock, SegmentedFieldBlock>(segmentedBlock());
  EXPECT_EQ(segmented.plants.at(0).id, 12);
  EXPECT_EQ(segmented.plants.at(0).stem_end, 3U);
  EXPECT_EQ(segmented.plants.at(0).axis_radius.at(1), 0.008F);
  EXPECT_EQ(segmented.plants.at(0).top_stddev, 0.04F);
  EXPECT_EQ(segmented.plants.at(0).beta, 0.8F);
  EXPECT_EQ(segmented.source_index.at(0), 4U);

  const auto completed = overTheWire<CompletedBlock, CompletedFieldBlock>(completedBlock());
  EXPECT_EQ(completed.synthetic_end.at(1), 3U);
  EXPECT_EQ(completed.completion_flags.at(1), 8U);
  const auto back = overTheWire<CompletedFieldBlock, CompletedBlock>(completed);
  expectSame(*back.segmented, segmentedBlock());
}

TEST(Wire, RefusesWhatDoesNotFitTogether) {
  auto segmented = overTheWire<SegmentedBlock, SegmentedFieldBlock>(segmentedBlock());
  segmented.plants[0].points_end = 99U;
  EXPECT_THROW((overTheWire<SegmentedFieldBlock, SegmentedBlock>(segmented)), std::exception);
  segmented.plants[0].points_end = 4U;
  segmented.ground.rows = 50U;
  EXPECT_THROW((overTheWire<SegmentedFieldBlock, SegmentedBlock>(segmented)), std::exception);
  segmented.ground.rows = 2U;
  segmented.plants[0].axis_radius.clear();
  EXPECT_THROW((overTheWire<SegmentedFieldBlock, SegmentedBlock>(segmented)), std::exception);
  segmented.plants[0].axis.clear();
  EXPECT_THROW((overTheWire<SegmentedFieldBlock, SegmentedBlock>(segmented)), std::exception);

  auto completed = overTheWire<CompletedBlock, CompletedFieldBlock>(completedBlock());
  completed.synthetic_end[1] = 4U;
  EXPECT_THROW((overTheWire<CompletedFieldBlock, CompletedBlock>(completed)), std::exception);
  completed.synthetic_end[1] = 3U;
  completed.completion_flags.pop_back();
  EXPECT_THROW((overTheWire<CompletedFieldBlock, CompletedBlock>(completed)), std::exception);

  auto block = overTheWire<Block, FieldBlock>(fieldBlock());
  block.cloud.scan_origin[0] = 7U;
  EXPECT_THROW((overTheWire<FieldBlock, Block>(block)), std::exception);
  block.cloud.scan_origin[0] = 0U;
  block.cloud.colors.pop_back();
  EXPECT_THROW((overTheWire<FieldBlock, Block>(block)), std::exception);
}

TEST(Wire, RefusesWhatWasCutShort) {
  EXPECT_THROW((overTheWire<Block, Block>(fieldBlock(), 3U)), std::exception);
  EXPECT_THROW((overTheWire<CompletedBlock, CompletedBlock>(completedBlock(), 9U)), std::exception);
}

TEST(Wire, CallsTheValuesByTheirMessages) {
  EXPECT_STREQ(ros::message_traits::datatype<Block>(), "field_phenotyping/FieldBlock");
  EXPECT_STREQ(ros::message_traits::md5sum<SegmentedBlock>(),
               ros::message_traits::md5sum<SegmentedFieldBlock>());
  EXPECT_STREQ(ros::message_traits::definition(CompletedBlock()),
               ros::message_traits::definition<CompletedFieldBlock>());
}

}  // namespace
}  // namespace field_phenotyping
