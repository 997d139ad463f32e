// Writes a bag of the synthetic field, driven past to and fro: raw scans at 10 Hz and tf. Prints
// the bases.
#include <ros/time.h>
#include <rosbag/bag.h>
#include <tf2_eigen/tf2_eigen.h>
#include <tf2_msgs/TFMessage.h>

#include <iostream>
#include <string>

#include "synthetic_field.hpp"

int main(int argc, char** argv) {
  using namespace field_phenotyping::testing;
  if (argc < 2 || argc > 3) {
    std::cerr << "usage: write_test_bag FILE.bag [DRIVES]\n";
    return 1;
  }
  const int drives = argc > 2 ? std::stoi(argv[2]) : 1;
  const SyntheticField field = syntheticField();
  rosbag::Bag bag(argv[1], rosbag::bagmode::Write);
  constexpr int kScans = 30;
  for (int scan = 0; scan < drives * kScans; ++scan) {
    const bool back = scan / kScans % 2 == 1;
    const int k = scan % kScans;
    const ros::Time stamp = ros::Time(1600000000.0) + ros::Duration(0.1 * scan);
    const Eigen::Isometry3d pose = sensorPose(back ? kScans - k : k, kScans);
    tf2_msgs::TFMessage tf;
    tf.transforms.push_back(tf2::eigenToTransform(pose));
    tf.transforms[0].header.stamp = stamp;
    tf.transforms[0].header.frame_id = "map";
    tf.transforms[0].child_frame_id = "lidar";
    bag.write("/points", stamp,
              cloudOf(field, pose, "lidar", stamp, static_cast<std::size_t>(k), kScans));
    bag.write("/tf", stamp + ros::Duration(0.2), tf);
  }
  for (const Eigen::Vector3d& base : field.bases) std::cout << base.transpose() << "\n";
  return 0;
}
