// A nodelet manager that has the four stages loaded from the start. One process: whatever ends it,
// starting it again brings the whole chain back, where loaders beside a manager that dies while
// they load wait for good. More nodelets may be loaded into it, as into any manager.
#include <malloc.h>
#include <nodelet/loader.h>
#include <ros/ros.h>

#include <algorithm>
#include <string>
#include <thread>

namespace {

struct StageEntry {
  const char* name;
  const char* type;
  const char* input;  // relative to the manager's namespace
};

constexpr StageEntry kStages[] = {
    {"measurement", "field_phenotyping/Measurement", "completion/output"},
    {"completion", "field_phenotyping/Completion", "segmentation/output"},
    {"segmentation", "field_phenotyping/Segmentation", "preprocessing/output"},
    {"preprocessing", "field_phenotyping/Preprocessing", nullptr},
};

/// What one thread gives back another can use: by itself the allocator keeps up to eight stores of
/// memory a core, each as large as the largest block that was ever worked from it.
void shareFreeMemory() {
  mallopt(M_ARENA_MAX, static_cast<int>(std::max(std::thread::hardware_concurrency(), 1U)));
}

}  // namespace

int main(int argc, char** argv) {
  shareFreeMemory();
  ros::init(argc, argv, "manager");
  const ros::NodeHandle pnh("~");
  const std::string points_topic = pnh.param<std::string>("points_topic", "/points");
  nodelet::Loader loader;
  for (const StageEntry& stage : kStages) {
    const std::string name = ros::names::resolve(std::string(stage.name));
    const std::string input = ros::names::resolve(stage.input ? stage.input : points_topic);
    if (!loader.load(name, stage.type, {{name + "/input", input}}, {})) {
      ROS_FATAL_STREAM(name << " could not be loaded");
      return 1;
    }
  }
  // What a burst of blocks has left goes back to the system: by itself the allocator keeps it.
  const ros::WallTimer trim = pnh.createWallTimer(
      ros::WallDuration(10.0), [](const ros::WallTimerEvent&) { malloc_trim(0U); });
  ros::spin();
  return 0;
}
