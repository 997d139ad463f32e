#pragma once

#include <sensor_msgs/PointCloud2.h>
#include <sensor_msgs/PointField.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <random>
#include <string>
#include <vector>

namespace field_phenotyping {
namespace testing {

/// Six upright plants in two rows on flat soil, all of it known exactly. Some lie near the border
/// of a tile, and all have leaves.
struct SyntheticField {
  std::vector<Eigen::Vector3d> bases;  // [m]
  double plant_height = 1.3;           // [m]
  double stem_radius = 0.011;          // [m]
  std::vector<Eigen::Vector3f> points;
};

inline SyntheticField syntheticField() {
  SyntheticField field;
  std::mt19937 random(7U);
  std::normal_distribution<float> noise(0.0F, 0.001F);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  for (int k = 0; k < 60000; ++k) {
    field.points.emplace_back(3.6F * unit(random), 2.0F * unit(random), 3.0F * noise(random));
  }
  for (const double y : {0.5, 1.4}) {
    for (const double x : {0.6, 1.8, 3.0}) field.bases.emplace_back(x, y, 0.0);
  }
  const auto stem_height = static_cast<float>(field.plant_height);
  const auto radius = static_cast<float>(field.stem_radius);
  for (const Eigen::Vector3d& base : field.bases) {
    const Eigen::Vector3f foot = base.cast<float>();
    for (int k = 0; k < 12000; ++k) {
      const float angle = 6.2831853F * unit(random);
      const float r = radius + noise(random);
      field.points.push_back(foot + Eigen::Vector3f(r * std::cos(angle), r * std::sin(angle),
                                                    stem_height * unit(random)));
    }
    for (int leaf = 0; leaf < 4; ++leaf) {
      const float start = 0.35F + 0.2F * static_cast<float>(leaf);
      const float azimuth = 3.1415927F * static_cast<float>(leaf) + 0.3F;
      const Eigen::Vector3f out(std::cos(azimuth), std::sin(azimuth), 0.0F);
      const Eigen::Vector3f across(-out.y(), out.x(), 0.0F);
      for (int k = 0; k < 1500; ++k) {
        const float s = 0.35F * unit(random);
        const float rise = 0.8F * s - 1.6F * s * s;
        field.points.push_back(foot + out * (radius + s) +
                               across * (0.04F * (unit(random) - 0.5F)) +
                               Eigen::Vector3f(0.0F, 0.0F, start + rise + noise(random)));
      }
    }
  }
  return field;
}

/// Every `step`-th point from `first`, as a sensor at `T_map_sensor` gives it.
inline sensor_msgs::PointCloud2 cloudOf(const SyntheticField& field,
                                        const Eigen::Isometry3d& T_map_sensor,
                                        const std::string& frame, const ros::Time& stamp,
                                        std::size_t first = 0U, std::size_t step = 1U) {
  sensor_msgs::PointCloud2 message;
  message.header.frame_id = frame;
  message.header.stamp = stamp;
  const char* names[] = {"x", "y", "z"};
  for (std::uint32_t i = 0; i < 3U; ++i) {
    sensor_msgs::PointField entry;
    entry.name = names[i];
    entry.offset = 4U * i;
    entry.datatype = sensor_msgs::PointField::FLOAT32;
    entry.count = 1U;
    message.fields.push_back(entry);
  }
  message.point_step = 16U;
  message.height = 1U;
  const Eigen::Isometry3f T_sensor_map = T_map_sensor.inverse().cast<float>();
  for (std::size_t i = first; i < field.points.size(); i += step) {
    const Eigen::Vector3f p = T_sensor_map * field.points[i];
    message.data.resize(message.data.size() + message.point_step);
    std::memcpy(message.data.data() + message.data.size() - message.point_step, p.data(), 12U);
    ++message.width;
  }
  message.row_step = message.width * message.point_step;
  return message;
}

/// The cloud with the fields that a driver gives it, each point with its time over 0.1 s.
/// @param driver velodyne, ouster or hesai; else the cloud stays as it is
inline sensor_msgs::PointCloud2 laidOutBy(const std::string& driver,
                                          const sensor_msgs::PointCloud2& cloud) {
  using sensor_msgs::PointField;
  struct Field {
    const char* name;
    std::uint32_t offset;
    std::uint8_t type;
  };
  std::vector<Field> fields{{"x", 0U, PointField::FLOAT32},
                            {"y", 4U, PointField::FLOAT32},
                            {"z", 8U, PointField::FLOAT32}};
  const auto add = [&](const std::vector<Field>& more) {
    fields.insert(fields.end(), more.begin(), more.end());
  };
  sensor_msgs::PointCloud2 message = cloud;
  if (driver == "velodyne") {
    add({{"intensity", 12U, PointField::FLOAT32},
         {"ring", 16U, PointField::UINT16},
         {"time", 18U, PointField::FLOAT32}});
    message.point_step = 22U;
  } else if (driver == "ouster") {
    add({{"intensity", 16U, PointField::FLOAT32},
         {"t", 20U, PointField::UINT32},
         {"reflectivity", 24U, PointField::UINT16},
         {"ring", 26U, PointField::UINT8},
         {"ambient", 28U, PointField::UINT16},
         {"range", 32U, PointField::UINT32}});
    message.point_step = 48U;
  } else if (driver == "hesai") {
    add({{"intensity", 16U, PointField::FLOAT32},
         {"timestamp", 24U, PointField::FLOAT64},
         {"ring", 32U, PointField::UINT16}});
    message.point_step = 48U;
  } else {
    return cloud;
  }
  message.fields.clear();
  for (const Field& field : fields) {
    PointField entry;
    entry.name = field.name;
    entry.offset = field.offset;
    entry.datatype = field.type;
    entry.count = 1U;
    message.fields.push_back(entry);
  }
  message.row_step = message.width * message.point_step;
  message.data.assign(message.row_step, 0xCDU);
  const auto put = [&](std::size_t i, std::uint32_t offset, const auto& value) {
    std::memcpy(message.data.data() + i * message.point_step + offset, &value, sizeof(value));
  };
  for (std::size_t i = 0; i < message.width; ++i) {
    std::memcpy(message.data.data() + i * message.point_step,
                cloud.data.data() + i * cloud.point_step, 12U);
    const double after = 0.1 * static_cast<double>(i) / message.width;  // [s]
    if (driver == "velodyne") put(i, 18U, static_cast<float>(after));
    if (driver == "ouster") put(i, 20U, static_cast<std::uint32_t>(1e9 * after));
    if (driver == "hesai") put(i, 24U, cloud.header.stamp.toSec() + after);
  }
  return message;
}

/// Where the sensor is at scan `k` of `count`: it passes the field along x, looking slightly down,
/// and starts and stops as a rover does.
inline Eigen::Isometry3d sensorPose(double k, int count) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = Eigen::Vector3d(1.8 - 1.8 * std::cos(M_PI * k / count), -1.5, 1.1);
  pose.rotate(Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()) *
              Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitY()));
  return pose;
}

}  // namespace testing
}  // namespace field_phenotyping
