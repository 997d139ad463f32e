#include "conversions.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <boost/weak_ptr.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "cloud_decoder.hpp"
#include "field_phenotyping/completion/completion_flags.hpp"

namespace field_phenotyping {
namespace {

using sensor_msgs::PointCloud2;
using sensor_msgs::PointField;

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
  plant.completion_flags = kCompletionOpenGap | kCompletionUncertain;
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
  EXPECT_EQ(p.completion_flags, expected.completion_flags);
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
  ASSERT_EQ(array.markers.size(), 6U);
  EXPECT_EQ(array.markers[0].ns, "axis");
  EXPECT_EQ(array.markers[0].id, 42);
  ASSERT_EQ(array.markers[0].points.size(), 2U);
  // The line ends at the plant's height, leaning as its axis does; the bar stands upright.
  EXPECT_NEAR(array.markers[0].points[1].z, 3.0 + 1.92, 1e-9);
  EXPECT_NEAR(array.markers[0].points[1].y, 2.0 + 1.92 * 0.75, 1e-9);
  EXPECT_EQ(array.markers[1].ns, "height");
  EXPECT_NEAR(array.markers[1].scale.z, 1.92, 1e-9);
  EXPECT_NEAR(array.markers[1].pose.position.z, 3.0 + 0.96, 1e-9);
  EXPECT_NEAR(array.markers[1].pose.position.y, 2.0, 1e-9);
  EXPECT_EQ(array.markers[2].ns, "label");
  EXPECT_EQ(array.markers[2].text, "1.92 m\n21.3 mm");
  EXPECT_LT(array.markers[4].scale.z, 0.02) << "no height is known";
  EXPECT_EQ(array.markers[5].text, "height ?\ndiameter ?");
  for (const auto& marker : array.markers) {
    EXPECT_EQ(marker.header.frame_id, "map");
    EXPECT_TRUE(std::isfinite(marker.pose.position.z));
  }
}

TEST(Markers, LabelsOfNeighboursInARowDoNotCoverOneAnother) {
  std::vector<Phenotype> row(6, somePlant());
  for (std::size_t k = 0; k < row.size(); ++k) row[k].base.x() = 0.2 * static_cast<double>(k) + 0.1;
  std::vector<geometry_msgs::Point> labels;
  for (const auto& marker : plantMarkers(row, std_msgs::Header()).markers) {
    if (marker.ns == "label") labels.push_back(marker.pose.position);
  }
  ASSERT_EQ(labels.size(), row.size());
  for (std::size_t a = 0; a < labels.size(); ++a) {
    for (std::size_t b = 0; b < a; ++b) {
      EXPECT_TRUE(std::abs(labels[a].x - labels[b].x) > 0.5 ||
                  std::abs(labels[a].z - labels[b].z) > 0.14)
          << a << " and " << b;
    }
  }
}

TEST(Markers, ShowRowsAsLinesAndTakeOldOnesAway) {
  std::vector<Phenotype> plants;
  for (int k = 0; k < 10; ++k) {
    for (const double y : {0.0, 0.75}) {
      Phenotype plant = somePlant();
      plant.base = {0.2 * k, y, 90.0};
      plants.push_back(plant);
    }
  }
  const auto rows = rowMarkers(plants, 3U, std_msgs::Header());
  ASSERT_EQ(rows.markers.size(), 3U);
  for (std::size_t k = 0; k < 2U; ++k) {
    const auto& row = rows.markers[k];
    EXPECT_EQ(row.ns, "row");
    EXPECT_EQ(row.id, static_cast<int>(k));
    ASSERT_EQ(row.points.size(), 2U);
    EXPECT_NEAR(std::abs(row.points[1].x - row.points[0].x), 1.8, 0.01);
    EXPECT_NEAR(row.points[0].z, 90.05, 1e-6);
  }
  EXPECT_NEAR(std::abs(rows.markers[1].points[0].y - rows.markers[0].points[0].y), 0.75, 0.01);
  EXPECT_EQ(rows.markers[2].action, visualization_msgs::Marker::DELETE);
  EXPECT_TRUE(rowMarkers({}, 0U, std_msgs::Header()).markers.empty());
}

TEST(Markers, ShowTheBordersOfABlockOnItsSoil) {
  Block block;
  block.header.frame_id = "map";
  block.header.index = {-2, 3};
  block.header.tile_size = 4.0;
  block.header.tile_corner = {0.5, 0.0};
  block.cloud.origin = {-5.5, 14.0, 90.0};
  block.ground =
      GroundModel({-3.0F, -3.0F}, 6.0F, 2, 2,
                  {{0.2F, 0.0F, 1U}, {0.2F, 0.0F, 1U}, {0.2F, 0.0F, 1U}, {0.2F, 0.0F, 1U}}, true);
  const auto open = blockMarker(block);
  ASSERT_EQ(open.markers.size(), 1U);
  const auto& border = open.markers[0];
  ASSERT_EQ(border.points.size(), 5U);
  EXPECT_NEAR(border.points[0].x, -7.5, 1e-6);
  EXPECT_NEAR(border.points[2].x, -3.5, 1e-6);
  EXPECT_NEAR(border.points[2].y, 16.0, 1e-6);
  EXPECT_NEAR(border.points[2].z, 90.2, 1e-6);
  block.header.final = true;
  EXPECT_NE(blockMarker(block).markers[0].color.r, border.color.r);
  block.header.index = {3, -2};
  EXPECT_NE(blockMarker(block).markers[0].id, border.id);
  block.joined = {block.header, block.header};
  block.joined[1].index = {4, -2};
  const auto both = blockMarker(block).markers;
  ASSERT_EQ(both.size(), 2U) << "of each tile";
  EXPECT_NEAR(both[1].points[0].x - both[0].points[0].x, 4.0, 1e-6);
}

TEST(Markers, AreTakenAwayWithTheirPlants) {
  const auto removed = removedMarkers({42}, std_msgs::Header());
  ASSERT_EQ(removed.markers.size(), 3U);
  EXPECT_EQ(removed.markers[0].action, visualization_msgs::Marker::DELETE);
  EXPECT_EQ(removed.markers[0].ns, "axis");
  EXPECT_EQ(removed.markers[1].ns, "height");
  EXPECT_EQ(removed.markers[2].ns, "label");
  EXPECT_EQ(removed.markers[2].id, 42);
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
  completed.synthetic_stddev = {0.1F, 0.2F};
  completed.synthetic_span = {{0U, 1U}, {1U, 2U}};
  DisplayCloud cloud;
  addSynthetic(completed, cloud);
  const sensor_msgs::PointCloud2 message = cloud.message(std_msgs::Header());
  const auto points = pointsOf(message);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_EQ(points[0].rgb, 0xff0000U);
  float stddev = 0.0F;
  ASSERT_EQ(message.fields.back().name, "stddev");
  std::memcpy(&stddev, &message.data[message.fields.back().offset], sizeof(stddev));
  EXPECT_EQ(stddev, 0.1F);
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
