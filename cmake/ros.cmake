# Messages, dynamic_reconfigure and what catkin exports.
find_package(catkin REQUIRED COMPONENTS
  diagnostic_msgs
  diagnostic_updater
  dynamic_reconfigure
  geometry_msgs
  message_generation
  nodelet
  pluginlib
  rosbag
  roscpp
  rosgraph_msgs
  sensor_msgs
  std_msgs
  std_srvs
  tf2
  tf2_eigen
  tf2_msgs
  tf2_ros
  visualization_msgs
)

catkin_python_setup()

add_message_files(FILES
  BlockInfo.msg
  CompletedFieldBlock.msg
  FieldBlock.msg
  LocalCloud.msg
  PlantPhenotype.msg
  PlantPhenotypeArray.msg
  SegmentedFieldBlock.msg
  SegmentedPlant.msg
  SoilModel.msg
)
generate_messages(DEPENDENCIES geometry_msgs std_msgs)
generate_dynamic_reconfigure_options(
  cfg/Preprocessing.cfg
  cfg/Segmentation.cfg
  cfg/Completion.cfg
  cfg/Measurement.cfg
)

catkin_package(
  INCLUDE_DIRS include
  LIBRARIES field_phenotyping_core
  CATKIN_DEPENDS
    diagnostic_msgs
    diagnostic_updater
    dynamic_reconfigure
    geometry_msgs
    message_runtime
    nodelet
    pluginlib
    rosbag
    roscpp
    rosgraph_msgs
    sensor_msgs
    std_msgs
    std_srvs
    tf2
    tf2_eigen
    tf2_msgs
    tf2_ros
    visualization_msgs
  DEPENDS EIGEN3
  CFG_EXTRAS field_phenotyping-extras.cmake
)
