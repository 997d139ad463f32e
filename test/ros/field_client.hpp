#pragma once

#include <diagnostic_msgs/DiagnosticArray.h>
#include <field_phenotyping/PlantPhenotypeArray.h>
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <tf2_ros/transform_broadcaster.h>

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "conversions.hpp"
#include "plant_table.hpp"
#include "synthetic_field.hpp"

namespace field_phenotyping {
namespace testing {

/// Plays the sensor and the SLAM for the nodes under test, and listens to what they find.
class FieldClient {
 public:
  FieldClient()
      : field_(syntheticField()),
        points_(nh_.advertise<sensor_msgs::PointCloud2>("/points", 50)),
        plants_(nh_.subscribe("/field_phenotyping/measurement/output", 200,
                              &FieldClient::notePlants, this)),
        diagnostics_(nh_.subscribe("/diagnostics", 200, &FieldClient::noteDiagnostics, this)) {}

  bool waitFor(const std::function<bool()>& condition, double seconds = 20.0) {
    const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(seconds);
    while (ros::ok() && ros::WallTime::now() < end) {
      ros::spinOnce();
      if (condition()) return true;
      ros::WallDuration(0.02).sleep();
    }
    return false;
  }

  bool waitForStages() {
    return waitFor([this] {
      return points_.getNumSubscribers() > 0U && plants_.getNumPublishers() > 0U &&
             troubles_.size() >= 4U;
    });
  }

  void publish(const sensor_msgs::PointCloud2& cloud) { points_.publish(cloud); }

  /// The field in `count` scans of a sensor that drives past, 10 a second, each with its tf.
  void driveBy(int count) {
    for (int k = 0; k < count; ++k) {
      const Eigen::Isometry3d pose = sensorPose(k, count);
      const ros::Time stamp = ros::Time::now();
      publish(cloudOf(field_, pose, "lidar", stamp, static_cast<std::size_t>(k),
                      static_cast<std::size_t>(count)));
      // The SLAM is later than the scan that it places.
      ros::WallDuration(0.05).sleep();
      broadcast(pose, stamp);
      waitFor([] { return false; }, 0.05);
    }
  }

  void broadcast(const Eigen::Isometry3d& T_map_lidar, const ros::Time& stamp) {
    geometry_msgs::TransformStamped transform;
    transform.header.stamp = stamp;
    transform.header.frame_id = "map";
    transform.child_frame_id = "lidar";
    const Eigen::Quaterniond q(T_map_lidar.rotation());
    transform.transform.translation.x = T_map_lidar.translation().x();
    transform.transform.translation.y = T_map_lidar.translation().y();
    transform.transform.translation.z = T_map_lidar.translation().z();
    transform.transform.rotation.x = q.x();
    transform.transform.rotation.y = q.y();
    transform.transform.rotation.z = q.z();
    transform.transform.rotation.w = q.w();
    broadcaster_.sendTransform(transform);
  }

  /// Whether every plant of the field has been reported as final, none missing, none invented.
  bool foundEveryPlant() const {
    const auto plants = table_.plants();
    return plants.size() == field_.bases.size() &&
           std::all_of(plants.begin(), plants.end(), [](const Phenotype& p) { return p.final; });
  }

  /// Compares what was found with the truth.
  void expectTruth() const {
    const auto plants = table_.plants();
    EXPECT_EQ(plants.size(), field_.bases.size());
    for (const Eigen::Vector3d& base : field_.bases) {
      const auto nearest = std::min_element(
          plants.begin(), plants.end(), [&](const Phenotype& a, const Phenotype& b) {
            return (a.base - base).norm() < (b.base - base).norm();
          });
      ASSERT_NE(nearest, plants.end());
      EXPECT_LT((nearest->base - base).norm(), 0.04) << "plant at " << base.transpose();
      EXPECT_NEAR(nearest->height.value, field_.plant_height, 0.05);
      EXPECT_NEAR(nearest->stem_diameter.value, 2.0 * field_.stem_radius, 0.003);
    }
  }

  /// Whether a stage's diagnostics have ever held this text.
  bool heardOf(const std::string& stage, const std::string& text) const {
    for (const auto& entry : troubles_) {
      if (entry.first.find(stage) != std::string::npos &&
          entry.second.find(text) != std::string::npos) {
        return true;
      }
    }
    return false;
  }

  void forgetPlants() { table_ = PlantTable(); }
  const SyntheticField& field() const { return field_; }
  ros::NodeHandle& nodeHandle() { return nh_; }

 private:
  void notePlants(const PlantPhenotypeArrayConstPtr& message) {
    table_.update({message->block_x, message->block_y}, message->revision, fromMessage(*message));
  }

  void noteDiagnostics(const diagnostic_msgs::DiagnosticArrayConstPtr& message) {
    for (const auto& status : message->status) {
      std::string& text = troubles_[status.name];
      if (text.find(status.message) == std::string::npos) text += status.message + "\n";
      for (const auto& value : status.values) {
        if (value.key == "last trouble" && text.find(value.value) == std::string::npos) {
          text += value.value + "\n";
        }
      }
    }
  }

  ros::NodeHandle nh_;
  SyntheticField field_;
  PlantTable table_;
  std::map<std::string, std::string> troubles_;  // all that was said, by status name
  tf2_ros::TransformBroadcaster broadcaster_;
  ros::Publisher points_;
  ros::Subscriber plants_;
  ros::Subscriber diagnostics_;
};

}  // namespace testing
}  // namespace field_phenotyping
