// Keeps the newest values of every plant that the Measurement nodelet reports and writes them as
// plants.csv and plants.geojson, whenever they change and at the end.
#include <field_phenotyping/PlantPhenotypeArray.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <rosgraph_msgs/Clock.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <exception>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "conversions.hpp"
#include "phenotype_files.hpp"
#include "plant_table.hpp"

namespace field_phenotyping {
namespace {

constexpr const char* kUsage =
    R"(Usage: rosrun field_phenotyping record_phenotypes [_output_dir:=DIR] [~input:=TOPIC]

Keeps the newest values of every plant and writes DIR/plants.csv and DIR/plants.geojson whenever
they change (at most once a second) and at the end. Metres, radians, map frame.

Subscribes
  ~input  field_phenotyping/PlantPhenotypeArray
Parameters
  ~output_dir      where the files go; made if need be; empty: nothing is written   [""]
  ~end_with_clock  end once /clock has stopped, as it does when a bag is over       [false]
  ~clock_timeout   /clock counts as stopped after this long [s of wall time]        [3.0]
  ~flush_services  called in this order before the end, so that nothing measured
                   is left behind: the ~flush of each stage                         [[]]
)";

/// Writes no more often than this.
const ros::WallDuration kWriteInterval(1.0);
/// Tells how far it is no more often than this.
const ros::WallDuration kTellInterval(5.0);

class PhenotypeRecorder {
 public:
  PhenotypeRecorder(ros::NodeHandle nh, ros::NodeHandle pnh)
      : directory_(pnh.param<std::string>("output_dir", "")),
        end_with_clock_(pnh.param("end_with_clock", false)),
        clock_timeout_(pnh.param("clock_timeout", 3.0)) {
    pnh.getParam("flush_services", flush_services_);
    if (!directory_.empty()) {
      directory_ = std::filesystem::absolute(directory_);
      std::filesystem::create_directories(directory_);
      write();
    }
    input_ = pnh.subscribe("input", 200, &PhenotypeRecorder::receive, this);
    if (end_with_clock_) clock_ = nh.subscribe("/clock", 1, &PhenotypeRecorder::noteClock, this);
  }

  /// Until the node is shut down or, if so asked, the bag is over.
  /// @return whether everything could be written
  bool run() {
    while (ros::ok() && !clockHasStopped()) {
      ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
      if (changed_ && ros::WallTime::now() - written_ > kWriteInterval) write();
    }
    if (ros::ok()) flushStages();
    if (changed_) write();
    if (!directory_.empty()) {
      std::cout << table_.size() << " plants in " << (directory_ / "plants.csv").string()
                << std::endl;
    }
    return all_written_;
  }

 private:
  void receive(const PlantPhenotypeArrayConstPtr& message) {
    frame_id_ = message->header.frame_id;
    table_.update({message->block_x, message->block_y}, message->revision, fromMessage(*message));
    changed_ = true;
    const ros::WallTime now = ros::WallTime::now();
    if (now - told_ < kTellInterval) return;
    told_ = now;
    ROS_INFO_STREAM(table_.size() << " plants so far");
  }

  void noteClock(const rosgraph_msgs::ClockConstPtr&) { last_clock_ = ros::WallTime::now(); }

  bool clockHasStopped() const {
    return end_with_clock_ && !last_clock_.isZero() &&
           ros::WallTime::now() - last_clock_ > clock_timeout_;
  }

  /// Stage by stage down the chain, then waits for what the last one has still sent.
  void flushStages() {
    for (const std::string& service : flush_services_) {
      std_srvs::Trigger trigger;
      if (!ros::service::call(service, trigger) || !trigger.response.success) {
        ROS_ERROR_STREAM("flushing " << service << " failed (" << trigger.response.message
                                     << "): the last plants may be missing");
        all_written_ = false;
      }
    }
    const ros::WallTime end = ros::WallTime::now() + kWriteInterval;
    while (ros::ok() && ros::WallTime::now() < end) {
      ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
    }
  }

  void write() {
    changed_ = false;
    written_ = ros::WallTime::now();
    if (directory_.empty()) return;
    try {
      const std::vector<Phenotype> plants = table_.plants();
      writePhenotypeCsv(directory_ / "plants.csv", plants);
      writePhenotypeGeoJson(directory_ / "plants.geojson", plants, frame_id_);
    } catch (const std::exception& error) {
      ROS_ERROR_STREAM(error.what());
      all_written_ = false;
    }
  }

  std::filesystem::path directory_;
  const bool end_with_clock_;
  const ros::WallDuration clock_timeout_;
  std::vector<std::string> flush_services_;
  PlantTable table_;
  std::string frame_id_;
  bool changed_ = false;
  bool all_written_ = true;
  ros::WallTime written_;
  ros::WallTime told_;
  ros::WallTime last_clock_;
  ros::Subscriber input_;
  ros::Subscriber clock_;
};

}  // namespace
}  // namespace field_phenotyping

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--help" || argument == "-h") {
      std::cout << field_phenotyping::kUsage;
      return 0;
    }
  }
  ros::init(argc, argv, "record_phenotypes");
  try {
    field_phenotyping::PhenotypeRecorder recorder(ros::NodeHandle(), ros::NodeHandle("~"));
    return recorder.run() ? 0 : 1;
  } catch (const std::exception& error) {
    std::cerr << "record_phenotypes: " << error.what() << std::endl;
    return 1;
  }
}
