// Of every test that rostest runs as a node; rostest gives it its name.
#include <gtest/gtest.h>
#include <ros/ros.h>

int main(int argc, char** argv) {
  ::testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "rostest");
  const ros::NodeHandle keep_alive;  // else ROS shuts down with the first test's last handle
  return RUN_ALL_TESTS();
}
