#pragma once

#include <diagnostic_msgs/DiagnosticArray.h>
#include <field_phenotyping/PlantPhenotypeArray.h>
#include <gtest/gtest.h>
#include <ros/ros.h>
#include <tf2_ros/transform_broadcaster.h>

#include <cstdlib>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "conversions.hpp"
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

  /// Takes callbacks meanwhile. @param seconds on a machine of its own; where all is slower, as
  /// under ThreadSanitizer, so many times as long as the environment's FIELD_PHENOTYPING_PATIENCE
  bool waitFor(const std::function<bool()>& condition, double seconds = 20.0) {
    const char* patience = std::getenv("FIELD_PHENOTYPING_PATIENCE");
    return spinUntil(condition, patience == nullptr ? seconds : seconds * std::atof(patience));
  }

  void spinFor(double seconds) {
    spinUntil([] { return false; }, seconds);
  }

  bool waitForStages() {
    return waitFor([this] {
      return points_.getNumSubscribers() > 0U && plants_.getNumPublishers() > 0U &&
             troubles_.size() >= 4U;
    });
  }

  void publish(const sensor_msgs::PointCloud2& cloud) { points_.publish(cloud); }

  /// How the sensor and the SLAM behave.
  struct Sensor {
    double rate = 10.0;     ///< scans a second
    double tf_rate = 20.0;  ///< transforms a second
    double tf_late = 0.05;  ///< how long after its stamp a transform comes [s]
    std::string layout;     ///< whose driver's, see laidOutBy(); empty: x, y, z
  };

  /// The field in `count` scans of a sensor that drives past and, if so asked, back, each with its
  /// tf, by a SLAM whose map is `shift` off.
  void driveBy(int count, const Eigen::Vector3d& shift = Eigen::Vector3d::Zero(),
               bool back = false) {
    driveBy(count, Sensor(), shift, back);
  }
  void driveBy(int count, const Sensor& sensor,
               const Eigen::Vector3d& shift = Eigen::Vector3d::Zero(), bool back = false) {
    // Without a pause where one drive follows another, however slow the machine.
    const ros::Time today = ros::Time::now() - set_back_;
    if (next_stamp_ + ros::Duration(5.0) < today) next_stamp_ = today;
    const auto poseAt = [&](double seconds) {
      const double k = std::min(std::max(seconds * sensor.rate, 0.0), static_cast<double>(count));
      return sensorPose(back ? count - k : k, count);
    };
    const double lasts = count / sensor.rate;  // [s]
    int scan = 0;
    int transform = -1;
    const ros::WallTime begin = ros::WallTime::now();
    while (scan < count || (transform - 1) / sensor.tf_rate < lasts) {
      const double now = (ros::WallTime::now() - begin).toSec();
      const double taken = scan / sensor.rate;
      if (scan < count && taken <= now) {
        publish(
            laidOutBy(sensor.layout,
                      cloudOf(field_, poseAt(taken), "lidar", next_stamp_ + ros::Duration(taken),
                              static_cast<std::size_t>(scan), static_cast<std::size_t>(count))));
        ++scan;
      }
      const double estimated = transform / sensor.tf_rate;
      if (estimated + sensor.tf_late <= now) {
        Eigen::Isometry3d estimate = poseAt(estimated);
        estimate.pretranslate(shift);
        broadcast(estimate, next_stamp_ + ros::Duration(estimated));
        ++transform;
      }
      spinFor(0.005);
    }
    next_stamp_ += ros::Duration(lasts);
  }

  /// From now on drives are as much earlier.
  void setTimeBack(double seconds) {
    set_back_ += ros::Duration(seconds);
    next_stamp_ -= ros::Duration(seconds);
  }

  void broadcast(const Eigen::Isometry3d& T_map_lidar, const ros::Time& stamp,
                 const std::string& frame = "lidar") {
    geometry_msgs::TransformStamped transform;
    transform.header.stamp = stamp;
    transform.header.frame_id = "map";
    transform.child_frame_id = frame;
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
    const auto plants = this->plants();
    return plants.size() == field_.bases.size() &&
           std::all_of(plants.begin(), plants.end(), [](const Phenotype& p) { return p.final; });
  }

  /// Compares what was found with the truth.
  void expectTruth(const Eigen::Vector3d& shift = Eigen::Vector3d::Zero()) const {
    const auto plants = this->plants();
    EXPECT_EQ(plants.size(), field_.bases.size());
    for (const Eigen::Vector3d& true_base : field_.bases) {
      const Eigen::Vector3d base = true_base + shift;
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

  /// What a stage's newest diagnostics say under this name; 0 where there is nothing.
  double valueOf(const std::string& stage, const std::string& name) const {
    for (const auto& entry : newest_) {
      if (entry.first.find(stage) == std::string::npos) continue;
      for (const auto& value : entry.second.values) {
        if (value.key == name) return std::stod(value.value);
      }
    }
    return 0.0;
  }

  /// Whether a stage says so now.
  bool isWell(const std::string& stage) const {
    for (const auto& entry : newest_) {
      if (entry.first.find(stage) != std::string::npos) {
        return entry.second.level == diagnostic_msgs::DiagnosticStatus::OK;
      }
    }
    return false;
  }

  /// What the newest message of each block says.
  std::vector<Phenotype> plants() const {
    std::vector<Phenotype> all;
    for (const auto& block : plants_of_)
      all.insert(all.end(), block.second.begin(), block.second.end());
    return all;
  }
  void forgetPlants() { plants_of_.clear(); }
  const SyntheticField& field() const { return field_; }
  ros::NodeHandle& nodeHandle() { return nh_; }

 private:
  bool spinUntil(const std::function<bool()>& condition, double seconds) {
    const ros::WallTime end = ros::WallTime::now() + ros::WallDuration(seconds);
    while (ros::ok() && ros::WallTime::now() < end) {
      ros::spinOnce();
      if (condition()) return true;
      ros::WallDuration(0.02).sleep();
    }
    return false;
  }

  void notePlants(const PlantPhenotypeArrayConstPtr& message) {
    plants_of_[{message->block_x, message->block_y}] = fromMessage(*message);
  }

  void noteDiagnostics(const diagnostic_msgs::DiagnosticArrayConstPtr& message) {
    for (const auto& status : message->status) {
      newest_[status.name] = status;
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
  ros::Time next_stamp_;
  ros::Duration set_back_;
  std::map<BlockIndex, std::vector<Phenotype>> plants_of_;
  std::map<std::string, std::string> troubles_;  // all that was said, by status name
  std::map<std::string, diagnostic_msgs::DiagnosticStatus> newest_;
  tf2_ros::TransformBroadcaster broadcaster_;
  ros::Publisher points_;
  ros::Subscriber plants_;
  ros::Subscriber diagnostics_;
};

}  // namespace testing
}  // namespace field_phenotyping
