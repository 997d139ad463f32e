// A nodelet manager that has the four stages loaded from the start. One process: whatever ends it,
// starting it again brings the whole chain back, where loaders beside a manager that dies while
// they load wait for good. More nodelets may be loaded into it, as into any manager.
#include <nodelet/loader.h>
#include <ros/ros.h>

#ifdef __GLIBC__
#include <malloc.h>
#endif

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

// Free memory between what is kept goes back to the system so often: that takes some milliseconds,
// in which others wait for memory.
const ros::WallDuration kTrimInterval(10.0);

void giveBackFreeMemory(const ros::WallTimerEvent&) {
#ifdef __GLIBC__
  malloc_trim(0U);
#endif
}

/// By itself glibc has eight pools of memory a core, and what little is kept of a block holds on to
/// pages in all of them. Fewer, of which two threads share one, wait for each other hardly more.
void keepMemoryTogether() {
#ifdef __GLIBC__
  constexpr unsigned kThreadsPerPool = 2U;
  const unsigned pools = std::max(1U, std::thread::hardware_concurrency() / kThreadsPerPool);
  mallopt(M_ARENA_MAX, static_cast<int>(pools));
#endif
}

}  // namespace

int main(int argc, char** argv) {
  keepMemoryTogether();
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
  ros::NodeHandle nh;
  const ros::WallTimer trimming = nh.createWallTimer(kTrimInterval, giveBackFreeMemory);
  ros::spin();
  return 0;
}
