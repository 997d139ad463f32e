#ifdef FIELD_PHENOTYPING_WITH_ROS

#include <geometry_msgs/TransformStamped.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/PointCloud2.h>
#include <sensor_msgs/point_cloud2_iterator.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>

#include <Eigen/Geometry>
#include <fstream>
#include <iterator>
#include <string>

#include "simulation/bag_writer.hpp"

namespace field_phenotyping::simulation {
namespace {

void noProgress(const char*, double) {}

SimulationSettings smallSimulation() {
  SimulationSettings settings;
  settings.field.rows = 2;
  settings.field.plants_per_row = 4;
  settings.target_points = 60000;
  settings.rover.pose_noise = 0.01;
  return settings;
}

Eigen::Isometry3d toEigen(const geometry_msgs::Transform& transform) {
  return Eigen::Translation3d(transform.translation.x, transform.translation.y,
                              transform.translation.z) *
         Eigen::Quaterniond(transform.rotation.w, transform.rotation.x, transform.rotation.y,
                            transform.rotation.z);
}

/// All transforms of a bag.
void fillBuffer(const rosbag::Bag& bag, tf2::BufferCore& buffer) {
  for (const rosbag::MessageInstance& instance :
       rosbag::View(bag, rosbag::TopicQuery(std::vector<std::string>{"/tf", "/tf_static"}))) {
    const auto message = instance.instantiate<tf2_msgs::TFMessage>();
    for (const auto& transform : message->transforms) {
      buffer.setTransform(transform, "bag", instance.getTopic() == "/tf_static");
    }
  }
}

void expectTransformsLeadToTheMergedCloud(const SimulationSettings& settings) {
  const Simulation simulation = simulate(settings, noProgress);
  const std::string path = testing::TempDir() + "field.bag";
  writeBag(simulation, BagSettings(), path, noProgress);
  rosbag::Bag bag(path, rosbag::bagmode::Read);
  tf2::BufferCore buffer(ros::Duration(1000.0));
  fillBuffer(bag, buffer);

  std::size_t index = 0;
  for (const rosbag::MessageInstance& instance : rosbag::View(bag, rosbag::TopicQuery("/points"))) {
    const auto cloud = instance.instantiate<sensor_msgs::PointCloud2>();
    ASSERT_EQ(cloud->header.frame_id, "lidar");
    ASSERT_LT(index, simulation.scans.size());
    const Scan& scan = simulation.scans[index++];
    ASSERT_EQ(cloud->width, scan.points.size());
    EXPECT_NEAR((instance.getTime() - cloud->header.stamp).toSec(), 1.0 / settings.lidar.scan_rate,
                2e-6);
    const Eigen::Isometry3d T_map_lidar =
        toEigen(buffer.lookupTransform("map", "lidar", cloud->header.stamp).transform);
    sensor_msgs::PointCloud2ConstIterator<float> x(*cloud, "x");
    sensor_msgs::PointCloud2ConstIterator<float> intensity(*cloud, "intensity");
    for (const LidarPoint& point : scan.points) {
      const Eigen::Vector3d map = T_map_lidar * Eigen::Vector3d(x[0], x[1], x[2]);
      ASSERT_LT((map - settings.origin - scan.mapPosition(point)).norm(), 1e-4);
      ASSERT_GT(*intensity, 0.0F);
      ASSERT_LE(*intensity, 255.0F);
      ++x;
      ++intensity;
    }
  }
  EXPECT_EQ(index, simulation.scans.size());
}

TEST(Bag, TransformsLeadFromScansToTheMergedCloud) {
  expectTransformsLeadToTheMergedCloud(smallSimulation());
}

TEST(Bag, TransformsLeadToACloudInUtm) {
  SimulationSettings settings = smallSimulation();
  settings.origin = {431234.5, 5432109.25, 90.0};
  settings.field.terrain.slope_deg = 10.0;
  settings.field.row_azimuth_deg = 40.0;
  expectTransformsLeadToTheMergedCloud(settings);
}

TEST(Bag, FixedHeadIsOnTfStatic) {
  SimulationSettings settings = smallSimulation();
  settings.lidar.head_rate = 0.0;
  settings.lidar.scan_rate = 7.0;  // no multiple of the transforms' rate
  settings.lidar.point_rate = 70000.0;
  expectTransformsLeadToTheMergedCloud(settings);
}

TEST(Bag, SameSeedSameBytes) {
  const std::string path = testing::TempDir() + "field.bag";
  const auto bytes = [&path] {
    writeBag(simulate(smallSimulation(), noProgress), BagSettings(), path, noProgress);
    std::ifstream file(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
  };
  const std::string first = bytes();
  EXPECT_GT(first.size(), 60000U * 16U);
  EXPECT_TRUE(first == bytes());
}

TEST(Bag, TransformsComeAtFiftyHertz) {
  const Simulation simulation = simulate(smallSimulation(), noProgress);
  const std::string path = testing::TempDir() + "field.bag";
  writeBag(simulation, BagSettings(), path, noProgress);
  rosbag::Bag bag(path, rosbag::bagmode::Read);
  rosbag::View transforms(bag, rosbag::TopicQuery("/tf"));
  EXPECT_NEAR(transforms.size() / (simulation.trajectory->duration() + 0.1), 50.0, 6.0);
  EXPECT_EQ(rosbag::View(bag).getBeginTime(), ros::Time(1700000000.0));
}

TEST(Bag, RegisteredScansAreInTheMapFrame) {
  SimulationSettings settings = smallSimulation();
  settings.origin = {431234.5, 5432109.25, 90.0};
  const Simulation simulation = simulate(settings, noProgress);
  BagSettings bag_settings;
  bag_settings.registered = true;
  const std::string path = testing::TempDir() + "registered.bag";
  writeBag(simulation, bag_settings, path, noProgress);
  rosbag::Bag bag(path, rosbag::bagmode::Read);
  rosbag::View view(bag, rosbag::TopicQuery("/points"));
  const auto cloud = view.begin()->instantiate<sensor_msgs::PointCloud2>();
  EXPECT_EQ(cloud->header.frame_id, "map");
  ASSERT_EQ(cloud->fields[0].datatype, sensor_msgs::PointField::FLOAT64);
  sensor_msgs::PointCloud2ConstIterator<double> x(*cloud, "x");
  const Scan& scan = simulation.scans[0];
  const Eigen::Vector3d expected = settings.origin + scan.mapPosition(scan.points[0]);
  EXPECT_LT((Eigen::Vector3d(x[0], x[1], x[2]) - expected).norm(), 1e-8);
}

TEST(Bag, UnwritablePathIsAnError) {
  const Simulation simulation = simulate(smallSimulation(), noProgress);
  EXPECT_THROW(writeBag(simulation, BagSettings(), "/nowhere/field.bag", noProgress),
               std::runtime_error);
}

}  // namespace
}  // namespace field_phenotyping::simulation

#endif  // FIELD_PHENOTYPING_WITH_ROS
