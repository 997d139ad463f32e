#include "simulation/bag_writer.hpp"

#include <geometry_msgs/TransformStamped.h>
#include <ros/time.h>
#include <rosbag/bag.h>
#include <sensor_msgs/PointCloud2.h>
#include <tf2_msgs/TFMessage.h>

#include <boost/make_shared.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <set>
#include <stdexcept>

#include "simulation/writers.hpp"

namespace field_phenotyping::simulation {
namespace {

constexpr double kTfRate = 50.0;

/// Stamp of a time from the start, on whole microseconds so that equal times give equal stamps.
ros::Time stampOf(const BagSettings& settings, double time) {
  const ros::Time start(settings.start_time);
  return start +
         ros::Duration().fromNSec(static_cast<std::int64_t>(std::llround(time * 1e6)) * 1000);
}

geometry_msgs::TransformStamped transformMessage(const Eigen::Isometry3d& T_parent_child,
                                                 const std::string& parent,
                                                 const std::string& child, const ros::Time& stamp) {
  geometry_msgs::TransformStamped message;
  message.header.stamp = stamp;
  message.header.frame_id = parent;
  message.child_frame_id = child;
  const Eigen::Quaterniond rotation(T_parent_child.linear());
  message.transform.translation.x = T_parent_child.translation().x();
  message.transform.translation.y = T_parent_child.translation().y();
  message.transform.translation.z = T_parent_child.translation().z();
  message.transform.rotation.x = rotation.x();
  message.transform.rotation.y = rotation.y();
  message.transform.rotation.z = rotation.z();
  message.transform.rotation.w = rotation.w();
  return message;
}

void addField(const char* name, std::uint8_t type, std::uint32_t size,
              sensor_msgs::PointCloud2& cloud) {
  sensor_msgs::PointField field;
  field.name = name;
  field.offset = cloud.point_step;
  field.datatype = type;
  field.count = 1;
  cloud.fields.push_back(field);
  cloud.point_step += size;
}

template <typename Value>
void put(Value value, std::uint8_t*& place) {
  std::memcpy(place, &value, sizeof(Value));
  place += sizeof(Value);
}

template <typename Scalar>
void putPosition(const Eigen::Matrix<Scalar, 3, 1>& position, std::uint8_t*& place) {
  put(position.x(), place);
  put(position.y(), place);
  put(position.z(), place);
}

sensor_msgs::PointCloud2 cloudMessage(const Simulation& simulation, const BagSettings& settings,
                                      std::size_t index) {
  const Scan& scan = simulation.scans[index];
  const Eigen::Vector3d& origin = simulation.settings.origin;
  const bool double_precision = settings.registered && needsDoublePrecision(origin);
  sensor_msgs::PointCloud2 cloud;
  cloud.header.seq = static_cast<std::uint32_t>(index);
  cloud.header.stamp = stampOf(settings, scan.time);
  cloud.header.frame_id = settings.registered ? "map" : "lidar";
  for (const char* name : {"x", "y", "z"}) {
    if (double_precision) {
      addField(name, sensor_msgs::PointField::FLOAT64, 8, cloud);
    } else {
      addField(name, sensor_msgs::PointField::FLOAT32, 4, cloud);
    }
  }
  addField("intensity", sensor_msgs::PointField::FLOAT32, 4, cloud);
  cloud.height = 1;
  cloud.width = static_cast<std::uint32_t>(scan.points.size());
  cloud.row_step = cloud.width * cloud.point_step;
  cloud.is_dense = 1U;
  cloud.data.resize(cloud.row_step);
  std::uint8_t* place = cloud.data.data();
  for (const LidarPoint& point : scan.points) {
    const Eigen::Vector3d map_position = origin + scan.mapPosition(point);
    if (double_precision) {
      putPosition<double>(map_position, place);
    } else if (settings.registered) {
      putPosition<float>(map_position.cast<float>(), place);
    } else {
      putPosition<float>(point.position, place);
    }
    put(point.intensity, place);
  }
  return cloud;
}

/// Times of the transforms in microseconds: a steady rate, and each scan's own.
std::set<std::int64_t> transformTimes(const Simulation& simulation) {
  std::set<std::int64_t> times;
  const double end = simulation.trajectory->duration() + 1.0 / simulation.settings.lidar.scan_rate;
  for (std::int64_t i = 0; static_cast<double>(i) <= std::ceil(end * kTfRate); ++i) {
    times.insert(std::llround(static_cast<double>(i) * 1e6 / kTfRate));
  }
  for (const Scan& scan : simulation.scans) {
    times.insert(std::llround(scan.time * 1e6));
  }
  return times;
}

/// Connection header that makes `rosbag play` latch the topic, as tf2 expects of /tf_static.
boost::shared_ptr<ros::M_string> latchedConnection() {
  auto header = boost::make_shared<ros::M_string>();
  (*header)["type"] = ros::message_traits::datatype<tf2_msgs::TFMessage>();
  (*header)["md5sum"] = ros::message_traits::md5sum<tf2_msgs::TFMessage>();
  (*header)["message_definition"] = ros::message_traits::definition<tf2_msgs::TFMessage>();
  (*header)["latching"] = "1";
  (*header)["callerid"] = "/simulate_field";
  return header;
}

}  // namespace

void writeBag(const Simulation& simulation, const BagSettings& settings, const std::string& path,
              const ProgressCallback& progress) try {
  const Lidar& lidar = *simulation.lidar;
  const Eigen::Isometry3d T_map_local(Eigen::Translation3d(simulation.settings.origin));
  const bool turning = simulation.settings.lidar.head_rate > 0.0;
  rosbag::Bag bag(path, rosbag::bagmode::Write);

  const ros::Time start = stampOf(settings, 0.0);
  tf2_msgs::TFMessage fixed;
  fixed.transforms.push_back(transformMessage(lidar.mast(), "base_link", "mast", start));
  if (!turning) {
    fixed.transforms.push_back(transformMessage(lidar.head(0.0), "mast", "lidar", start));
  }
  bag.write("/tf_static", start, fixed, latchedConnection());

  const double scan_period = 1.0 / simulation.settings.lidar.scan_rate;
  std::size_t next_scan = 0;
  const auto writeScansUntil = [&](double time) {
    while (next_scan < simulation.scans.size() &&
           simulation.scans[next_scan].time + scan_period <= time) {
      const double finished = simulation.scans[next_scan].time + scan_period;
      bag.write("/points", stampOf(settings, finished),
                cloudMessage(simulation, settings, next_scan));
      ++next_scan;
      progress("writing the bag",
               static_cast<double>(next_scan) / static_cast<double>(simulation.scans.size()));
    }
  };
  for (const std::int64_t microseconds : transformTimes(simulation)) {
    const double time = 1e-6 * static_cast<double>(microseconds);
    writeScansUntil(time);
    const ros::Time stamp = stampOf(settings, time);
    tf2_msgs::TFMessage moving;
    moving.transforms.push_back(transformMessage(
        T_map_local * simulation.trajectory->estimatedPose(time), "map", "base_link", stamp));
    if (turning) {
      moving.transforms.push_back(transformMessage(lidar.head(time), "mast", "lidar", stamp));
    }
    bag.write("/tf", stamp, moving);
  }
  writeScansUntil(std::numeric_limits<double>::infinity());
  bag.close();
} catch (const rosbag::BagException& error) {
  throw std::runtime_error("cannot write " + path + ": " + error.what());
}

}  // namespace field_phenotyping::simulation
