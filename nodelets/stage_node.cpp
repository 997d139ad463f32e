// One stage as a program of its own. The build compiles this once a stage, with STAGE_HEADER, STAGE
// and STAGE_NAME defined.
#include STAGE_HEADER

#include <ros/ros.h>

#include <exception>

int main(int argc, char** argv) {
  ros::init(argc, argv, STAGE_NAME);
  try {
    field_phenotyping::STAGE stage(ros::NodeHandle(), ros::NodeHandle("~"),
                                   ros::this_node::getName());
    ros::spin();
  } catch (const std::exception& error) {
    ROS_FATAL_STREAM("not started: " << error.what());
    return 1;
  }
  return 0;
}
