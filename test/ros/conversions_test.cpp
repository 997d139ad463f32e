#include "conversions.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <boost/weak_ptr.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

namespace field_phenotyping {
namespace {

using sensor_msgs::PointCloud2;
using sensor_msgs::PointField;

/// Puts clouds of any layout together, byte by byte.
class CloudMaker {
 public:
  CloudMaker& field(const std::string& name, std::uint32_t offset, std::uint8_t datatype) {
    PointField entry;
    entry.name = name;
    entry.offset = offset;
    entry.datatype = datatype;
    entry.count = 1U;
    cloud_.fields.push_back(entry);
    return *this;
  }
  CloudMaker& layout(std::uint32_t width, std::uint32_t height, std::uint32_t point_step,
                     std::uint32_t row_padding = 0U) {
    cloud_.width = width;
    cloud_.height = height;
    cloud_.point_step = point_step;
    cloud_.row_step = width * point_step + row_padding;
    cloud_.data.assign(std::size_t{cloud_.row_step} * height, 0xCDU);
    return *this;
  }
  CloudMaker& bigEndian() {
    cloud_.is_bigendian = 1U;
    return *this;
  }
  template <class Value>
  CloudMaker& set(std::uint32_t column, std::uint32_t row, const std::string& name, Value value) {
    const auto entry = std::find_if(cloud_.fields.begin(), cloud_.fields.end(),
                                    [&](const PointField& f) { return f.name == name; });
    std::vector<std::uint8_t> raw(sizeof(Value));
    std::memcpy(raw.data(), &value, sizeof(Value));
    if (cloud_.is_bigendian != 0U) std::reverse(raw.begin(), raw.end());
    std::copy(raw.begin(), raw.end(),
              cloud_.data.begin() + std::ptrdiff_t{row} * cloud_.row_step +
                  std::ptrdiff_t{column} * cloud_.point_step + entry->offset);
    return *this;
  }
  template <class Value>
  CloudMaker& point(std::uint32_t column, std::uint32_t row, Value x, Value y, Value z) {
    return set(column, row, "x", x).set(column, row, "y", y).set(column, row, "z", z);
  }
  PointCloud2& cloud() { return cloud_; }

 private:
  PointCloud2 cloud_;
};

CloudMaker plainCloud(std::uint32_t width = 1U) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT32)
      .field("y", 4U, PointField::FLOAT32)
      .field("z", 8U, PointField::FLOAT32)
      .layout(width, 1U, 12U);
  return maker;
}

std::string errorOf(const PointCloud2& cloud) {
  try {
    toScan(cloud);
  } catch (const CloudFormatError& error) {
    return error.what();
  }
  return "";
}

TEST(ToScan, ReadsPlainFloatsAndTheStamp) {
  CloudMaker maker = plainCloud(2U);
  maker.point(0U, 0U, 1.0F, 2.0F, 3.0F).point(1U, 0U, -4.0F, 5.5F, 0.25F);
  maker.cloud().header.stamp = ros::Time(12U, 34U);
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), 2U);
  EXPECT_EQ(scan.cloud.mapPoint(0), Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_EQ(scan.cloud.mapPoint(1), Eigen::Vector3d(-4.0, 5.5, 0.25));
  EXPECT_FALSE(scan.cloud.hasColors());
  EXPECT_EQ(scan.stamp_ns, 12000000034U);
}

TEST(ToScan, ReadsAnyOrderPaddingTypeAndOrganisedRows) {
  CloudMaker maker;
  maker.field("z", 2U, PointField::FLOAT64)
      .field("intensity", 10U, PointField::UINT16)
      .field("x", 13U, PointField::FLOAT64)
      .field("y", 21U, PointField::FLOAT32)
      .layout(2U, 3U, 32U, 7U);
  for (std::uint32_t row = 0; row < 3U; ++row) {
    for (std::uint32_t column = 0; column < 2U; ++column) {
      maker.set(column, row, "x", 10.0 + column)
          .set(column, row, "y", 20.0F + static_cast<float>(row))
          .set(column, row, "z", 0.5);
    }
  }
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), 6U);
  EXPECT_EQ(scan.cloud.mapPoint(0), Eigen::Vector3d(10.0, 20.0, 0.5));
  EXPECT_EQ(scan.cloud.mapPoint(3), Eigen::Vector3d(11.0, 21.0, 0.5));
  EXPECT_EQ(scan.cloud.mapPoint(4), Eigen::Vector3d(10.0, 22.0, 0.5));
}

TEST(ToScan, ReadsBigEndian) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT32)
      .field("y", 4U, PointField::FLOAT64)
      .field("z", 12U, PointField::FLOAT32)
      .field("rgb", 16U, PointField::UINT32)
      .bigEndian()
      .layout(1U, 1U, 20U)
      .set(0U, 0U, "x", 1.5F)
      .set(0U, 0U, "y", -2.5)
      .set(0U, 0U, "z", 3.5F)
      .set(0U, 0U, "rgb", std::uint32_t{0x00102030U});
  const Scan scan = toScan(maker.cloud());
  EXPECT_EQ(scan.cloud.mapPoint(0), Eigen::Vector3d(1.5, -2.5, 3.5));
  EXPECT_EQ(scan.cloud.colors.at(0), 0x102030U);
}

TEST(ToScan, ReadsPackedColoursWithoutTheirAlpha) {
  for (const char* name : {"rgb", "rgba"}) {
    for (const std::uint8_t type : {PointField::FLOAT32, PointField::UINT32}) {
      CloudMaker maker = plainCloud();
      maker.field(name, 12U, type).layout(1U, 1U, 16U).point(0U, 0U, 0.0F, 0.0F, 0.0F);
      maker.set(0U, 0U, name, std::uint32_t{0x7f8090a0U});
      EXPECT_EQ(toScan(maker.cloud()).cloud.colors.at(0), 0x8090a0U) << name;
    }
  }
}

TEST(ToScan, KeepsNonFinitePointsInTheirPlaces) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  CloudMaker maker = plainCloud(3U);
  maker.point(0U, 0U, nan, nan, nan)
      .point(1U, 0U, 1.0F, std::numeric_limits<float>::infinity(), 0.0F)
      .point(2U, 0U, 1.0F, 1.0F, 1.0F);
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), 3U);
  EXPECT_FALSE(scan.cloud.points[0].allFinite());
  EXPECT_FALSE(scan.cloud.points[1].allFinite());
  EXPECT_EQ(scan.cloud.mapPoint(2), Eigen::Vector3d(1.0, 1.0, 1.0));
}

TEST(ToScan, KeepsMillimetresFarFromTheOrigin) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT64)
      .field("y", 8U, PointField::FLOAT64)
      .field("z", 16U, PointField::FLOAT64)
      .layout(3U, 1U, 24U)
      .point(0U, 0U, std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0)
      .point(1U, 0U, 448262.1234, 5411932.5678, 90.001)
      .point(2U, 0U, 448263.1234, 5411933.5688, 91.001);
  const Scan scan = toScan(maker.cloud());
  EXPECT_NEAR((scan.cloud.mapPoint(1) - Eigen::Vector3d(448262.1234, 5411932.5678, 90.001)).norm(),
              0.0, 1e-6);
  EXPECT_NEAR((scan.cloud.mapPoint(2) - Eigen::Vector3d(448263.1234, 5411933.5688, 91.001)).norm(),
              0.0, 1e-6);
  EXPECT_EQ(coordinateResolution(maker.cloud(), scan), 0.0);
}

TEST(ToScan, TellsHowCoarseFloatsAreFarFromTheOrigin) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 448262.0F, 5411932.0F, 90.0F);
  EXPECT_EQ(coordinateResolution(maker.cloud(), toScan(maker.cloud())), 0.5);
  maker.point(0U, 0U, 3.0F, 5.0F, 1.0F);
  EXPECT_LT(coordinateResolution(maker.cloud(), toScan(maker.cloud())), 1e-6);
}

TEST(ToScan, TakesEmptyClouds) {
  EXPECT_TRUE(toScan(plainCloud(0U).cloud()).cloud.empty());
}

TEST(ToScan, TakesOneRowWithoutARowStep) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 1.0F, 2.0F, 3.0F);
  maker.cloud().row_step = 0U;
  EXPECT_EQ(toScan(maker.cloud()).cloud.size(), 1U);
}

TEST(ToScan, NamesTheFieldsFoundWhenOneIsMissing) {
  CloudMaker maker;
  maker.field("y", 0U, PointField::FLOAT32).field("reflectivity", 4U, PointField::UINT8);
  maker.layout(1U, 1U, 8U);
  const std::string error = errorOf(maker.cloud());
  EXPECT_NE(error.find("no field 'x'"), std::string::npos) << error;
  EXPECT_NE(error.find("y (FLOAT32), reflectivity (UINT8)"), std::string::npos) << error;
  EXPECT_NE(errorOf(PointCloud2()).find("only: none"), std::string::npos);
}

TEST(ToScan, RefusesCoordinatesOfOtherTypes) {
  CloudMaker maker = plainCloud();
  maker.cloud().fields[1].datatype = PointField::INT16;
  EXPECT_NE(errorOf(maker.cloud()).find("'y' is INT16"), std::string::npos);
  maker.cloud().fields[1].datatype = 99U;
  EXPECT_NE(errorOf(maker.cloud()).find("'y' is type 99"), std::string::npos);
}

TEST(ToScan, RefusesLayoutsThatReachBeyondTheirData) {
  CloudMaker maker = plainCloud(4U);
  PointCloud2 broken = maker.cloud();
  broken.data.resize(47U);
  EXPECT_NE(errorOf(broken).find("holds 47 bytes"), std::string::npos);

  broken = maker.cloud();
  broken.point_step = 10U;
  EXPECT_NE(errorOf(broken).find("field z at offset 8"), std::string::npos);

  broken = maker.cloud();
  broken.fields[0].offset = 0xfffffffeU;
  EXPECT_NE(errorOf(broken).find("field x"), std::string::npos);

  broken = maker.cloud();
  broken.height = 2U;
  broken.row_step = 13U;
  EXPECT_NE(errorOf(broken).find("row_step is 13"), std::string::npos);

  broken = maker.cloud();
  broken.width = 0xffffffffU;
  broken.height = 0xffffffffU;
  broken.row_step = 0xffffffffU;
  EXPECT_FALSE(errorOf(broken).empty());

  broken = maker.cloud();
  broken.fields.push_back(broken.fields[0]);
  broken.fields.back().name = "rgb";
  broken.fields.back().offset = 9U;
  EXPECT_NE(errorOf(broken).find("field rgb"), std::string::npos);
}

Phenotype somePlant() {
  Phenotype plant;
  plant.id = 42;
  plant.revision = 3U;
  plant.final = true;
  plant.base = {1.0, 2.0, 3.0};
  plant.axis = {0.0, 0.6, 0.8};
  plant.height = {1.92, 0.011};
  plant.stem_diameter = {0.0213, 0.0004};
  plant.stem_diameter_minor = {0.019, 0.0005};
  plant.stem_diameter_equivalent = {0.0201, 0.0003};
  plant.diameter_height = 0.7;
  plant.lean = {0.1, 0.01};
  plant.lean_azimuth = 1.5;
  plant.spacing = {0.21, 0.02};
  plant.row_spacing = {0.75, 0.03};
  plant.diameter_prior_share = 0.07;
  plant.stem_volume = {2.4e-4, 1.1e-5};
  plant.score = 0.87;
  plant.arc_coverage = 0.6;
  plant.completeness = 0.8;
  plant.stem_points = 11U;
  plant.plant_points = 22U;
  plant.diameter_points = 9U;
  plant.synthetic_points = 33U;
  plant.segmentation_quality = 0.5F;
  plant.growth_iterations = 3U;
  plant.growth_r1 = 0.05F;
  plant.growth_M = 0.45F;
  plant.growth_alpha = 0.25F;
  plant.growth_beta = 0.85F;
  plant.flags = kArcBelow | kTruncated;
  return plant;
}

TEST(Phenotypes, SurviveTheMessage) {
  BlockHeader header;
  header.stamp_ns = 5000000007U;
  header.frame_id = "map";
  header.index = {-3, 4};
  header.revision = 6U;
  header.final = true;
  Phenotype unmeasured;
  unmeasured.id = 43;
  const PlantPhenotypeArray message = toMessage({somePlant(), unmeasured}, header);
  EXPECT_EQ(message.header.stamp, ros::Time(5U, 7U));
  EXPECT_EQ(message.header.frame_id, "map");
  EXPECT_EQ(message.block_x, -3);
  EXPECT_EQ(message.block_y, 4);
  EXPECT_EQ(message.revision, 6U);
  EXPECT_TRUE(message.final);

  const std::vector<Phenotype> plants = fromMessage(message);
  ASSERT_EQ(plants.size(), 2U);
  const Phenotype expected = somePlant();
  const Phenotype& p = plants[0];
  EXPECT_EQ(p.id, expected.id);
  EXPECT_EQ(p.revision, expected.revision);
  EXPECT_EQ(p.final, expected.final);
  EXPECT_EQ(p.base, expected.base);
  EXPECT_EQ(p.axis, expected.axis);
  const auto same = [](const Trait& a, const Trait& b) {
    EXPECT_EQ(a.value, b.value);
    EXPECT_EQ(a.stddev, b.stddev);
  };
  same(p.height, expected.height);
  same(p.stem_diameter, expected.stem_diameter);
  same(p.stem_diameter_minor, expected.stem_diameter_minor);
  same(p.stem_diameter_equivalent, expected.stem_diameter_equivalent);
  same(p.lean, expected.lean);
  same(p.spacing, expected.spacing);
  same(p.row_spacing, expected.row_spacing);
  same(p.stem_volume, expected.stem_volume);
  EXPECT_EQ(p.diameter_prior_share, expected.diameter_prior_share);
  EXPECT_EQ(p.score, expected.score);
  EXPECT_EQ(p.diameter_height, expected.diameter_height);
  EXPECT_EQ(p.lean_azimuth, expected.lean_azimuth);
  EXPECT_EQ(p.arc_coverage, expected.arc_coverage);
  EXPECT_EQ(p.completeness, expected.completeness);
  EXPECT_EQ(p.stem_points, expected.stem_points);
  EXPECT_EQ(p.plant_points, expected.plant_points);
  EXPECT_EQ(p.diameter_points, expected.diameter_points);
  EXPECT_EQ(p.synthetic_points, expected.synthetic_points);
  EXPECT_EQ(p.segmentation_quality, expected.segmentation_quality);
  EXPECT_EQ(p.growth_iterations, expected.growth_iterations);
  EXPECT_EQ(p.growth_r1, expected.growth_r1);
  EXPECT_EQ(p.growth_M, expected.growth_M);
  EXPECT_EQ(p.growth_alpha, expected.growth_alpha);
  EXPECT_EQ(p.growth_beta, expected.growth_beta);
  EXPECT_EQ(p.flags, expected.flags);
  // What was not measured stays NaN, in value and deviation.
  EXPECT_TRUE(std::isnan(plants[1].height.value));
  EXPECT_TRUE(std::isnan(plants[1].stem_diameter.stddev));
}

TEST(Markers, ShowAxisAndLabelOfEachPlant) {
  Phenotype unmeasured;
  unmeasured.id = 7;
  std_msgs::Header header;
  header.frame_id = "map";
  const auto array = plantMarkers({somePlant(), unmeasured}, header);
  ASSERT_EQ(array.markers.size(), 4U);
  EXPECT_EQ(array.markers[0].ns, "axis");
  EXPECT_EQ(array.markers[0].id, 42);
  ASSERT_EQ(array.markers[0].points.size(), 2U);
  // The line ends at the plant's height, leaning as its axis does.
  EXPECT_NEAR(array.markers[0].points[1].z, 3.0 + 1.92, 1e-9);
  EXPECT_NEAR(array.markers[0].points[1].y, 2.0 + 1.92 * 0.75, 1e-9);
  EXPECT_EQ(array.markers[1].ns, "label");
  EXPECT_EQ(array.markers[1].text, "1.92 m\n21.3 mm");
  EXPECT_EQ(array.markers[3].text, "height ?\ndiameter ?");
  for (const auto& marker : array.markers) {
    EXPECT_EQ(marker.header.frame_id, "map");
    EXPECT_TRUE(std::isfinite(marker.pose.position.z));
  }
}

TEST(Markers, AreTakenAwayWithTheirPlants) {
  const auto removed = removedMarkers({42}, std_msgs::Header());
  ASSERT_EQ(removed.markers.size(), 2U);
  EXPECT_EQ(removed.markers[0].action, visualization_msgs::Marker::DELETE);
  EXPECT_EQ(removed.markers[0].ns, "axis");
  EXPECT_EQ(removed.markers[1].ns, "label");
  EXPECT_EQ(removed.markers[1].id, 42);
  EXPECT_EQ(noMarkers(std_msgs::Header()).markers.at(0).action,
            visualization_msgs::Marker::DELETEALL);
}

/// One owned plant with two stem points and one leaf point, one plant of a neighbour.
SegmentedBlock someBlock() {
  SegmentedBlock block;
  block.header.frame_id = "map";
  block.cloud.origin = {100.0, 200.0, 5.0};
  block.cloud.points = {{0.0F, 0.0F, 0.1F},
                        {0.0F, 0.0F, 0.2F},
                        {0.3F, 0.0F, 0.3F},
                        {1.0F, 0.0F, 0.1F},
                        {1.5F, 0.0F, 0.1F}};
  Plant own;
  own.id = 5;
  own.points = {0U, 3U};
  own.stem = {0U, 2U};
  Plant other = own;
  other.id = 6;
  other.owned = false;
  other.points = other.stem = {3U, 4U};
  block.plants = {own, other};
  block.source_index = {0U, 1U, 2U, 3U, 4U};
  return block;
}

struct Seen {
  Eigen::Vector3f position;
  std::uint32_t rgb;
  std::int32_t plant_id;
};

std::vector<Seen> pointsOf(const PointCloud2& message) {
  std::map<std::string, std::uint32_t> offset;
  for (const PointField& field : message.fields) offset[field.name] = field.offset;
  const Scan scan = toScan(message);
  std::vector<Seen> points;
  for (std::uint32_t i = 0; i < message.width; ++i) {
    Seen seen{scan.cloud.mapPoint(i).cast<float>(), scan.cloud.colors.at(i), 0};
    const auto* bytes = message.data.data() + std::size_t{i} * message.point_step;
    std::memcpy(&seen.plant_id, bytes + offset.at("plant_id"), 4U);
    points.push_back(seen);
  }
  return points;
}

TEST(DisplayClouds, ShowTheBlocksOwnPlants) {
  const SegmentedBlock block = someBlock();
  DisplayCloud stems;
  addStems(block, stems);
  const auto stem_points = pointsOf(stems.message(std_msgs::Header()));
  ASSERT_EQ(stem_points.size(), 2U);
  EXPECT_EQ(stem_points[1].position, Eigen::Vector3f(100.0F, 200.0F, 5.2F));
  EXPECT_EQ(stem_points[1].rgb, plantColor(5));
  EXPECT_EQ(stem_points[1].plant_id, 5);

  DisplayCloud plants;
  addPlants(block, plants);
  const auto plant_points = pointsOf(plants.message(std_msgs::Header()));
  ASSERT_EQ(plant_points.size(), 3U);
  EXPECT_EQ(plant_points[0].rgb, plantColor(5));
  EXPECT_NE(plant_points[2].rgb, plantColor(5));
}

TEST(DisplayClouds, ShowFilledInPointsInRed) {
  CompletedBlock completed;
  completed.segmented = std::make_shared<SegmentedBlock>(someBlock());
  completed.synthetic.points = {{0.0F, 0.0F, 1.0F}, {1.0F, 0.0F, 1.0F}};
  completed.synthetic_stddev = {0.1F, 0.1F};
  completed.synthetic_span = {{0U, 1U}, {1U, 2U}};
  DisplayCloud cloud;
  addSynthetic(completed, cloud);
  const auto points = pointsOf(cloud.message(std_msgs::Header()));
  ASSERT_EQ(points.size(), 1U);
  EXPECT_EQ(points[0].rgb, 0xff0000U);
  EXPECT_EQ(points[0].plant_id, 5);
}

TEST(DisplayClouds, ShowSoilAndPointsOfTheBlocksOwnTile) {
  Block block;
  block.header.index = {0, 0};
  block.header.tile_size = 2.0;
  block.cloud.points = {{1.0F, 1.0F, 0.5F}, {2.3F, 1.0F, 0.5F}};
  std::vector<GroundModel::Node> nodes(4U);
  nodes[0] = {0.25F, 0.01F, 1U};
  nodes[3] = {0.5F, 0.01F, 0U};
  block.ground = GroundModel({0.5F, 0.5F}, 1.0F, 2, 2, nodes, true);
  DisplayCloud above;
  addAboveGround(block, above);
  EXPECT_EQ(above.size(), 1U);
  DisplayCloud ground;
  addGround(block, ground);
  const auto points = pointsOf(ground.message(std_msgs::Header()));
  ASSERT_EQ(points.size(), 4U);
  EXPECT_EQ(points[0].position, Eigen::Vector3f(0.5F, 0.5F, 0.25F));
  EXPECT_EQ(points[3].position, Eigen::Vector3f(1.5F, 1.5F, 0.5F));
  EXPECT_NE(points[0].rgb, points[3].rgb);
}

TEST(DisplayClouds, KeepEveryNthPoint) {
  DisplayCloud cloud(3U);
  for (int i = 0; i < 10; ++i) cloud.add(Eigen::Vector3d::Zero(), 0U, i);
  EXPECT_EQ(cloud.size(), 4U);
}

TEST(PlantColors, TellNeighbouringIdsApartAndLeaveRedAlone) {
  for (int id = 0; id < 200; ++id) {
    const std::uint32_t a = plantColor(id), b = plantColor(id + 1);
    int difference = 0;
    for (int shift = 0; shift < 24; shift += 8) {
      difference +=
          std::abs(static_cast<int>((a >> shift) & 255U) - static_cast<int>((b >> shift) & 255U));
    }
    EXPECT_GT(difference, 100) << id;
    EXPECT_FALSE((a >> 16U) > 200U && ((a >> 8U) & 255U) < 80U && (a & 255U) < 80U) << id;
  }
}

TEST(ToStd, KeepsTheAddressAndTheObjectAlive) {
  auto owner = boost::make_shared<Block>();
  const Block* address = owner.get();
  auto shared = toStd(boost::shared_ptr<const Block>(owner));
  EXPECT_EQ(shared.get(), address);
  const boost::weak_ptr<Block> watch = owner;
  owner.reset();
  EXPECT_FALSE(watch.expired());
  shared.reset();
  EXPECT_TRUE(watch.expired());
}

}  // namespace
}  // namespace field_phenotyping
