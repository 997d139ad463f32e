// Writes what the Measurement nodelet has put into its journal as plants.csv, plants.geojson and
// rows.csv, when that has changed, when asked and at the end.
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <rosgraph_msgs/Clock.h>
#include <std_srvs/Trigger.h>

#include <algorithm>
#include <exception>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <vector>

#include "phenotype_files.hpp"
#include "phenotype_journal.hpp"
#include "plant_table.hpp"

namespace field_phenotyping {
namespace {

constexpr const char* kUsage =
    R"(Usage: rosrun field_phenotyping record_phenotypes _output_dir:=DIR [_journal:=FILE]

Writes what the journal of the measurement holds as DIR/plants.csv, DIR/plants.geojson and DIR/rows.csv,
whenever it has changed (at most once a second, less often where there are thousands), when asked, and
at the end. Metres, radians, map frame.

Services
  ~export  std_srvs/Trigger: writes the files now
Parameters
  ~output_dir      where the files go; made if need be
  ~journal         SQLite file that the measurement writes  [DIR/journal.sqlite]
  ~end_with_clock  end once /clock has stopped, as it does when a bag is over       [false]
  ~clock_timeout   /clock counts as stopped after this long [s of wall time]        [3.0]
  ~flush_services  called in this order before the end, so that nothing measured
                   is left behind: the ~flush of each stage                         [[]]
)";

/// Looks into the journal this often, and where there are so many plants that writing takes long,
/// pauses so many times as long as that.
const ros::WallDuration kInterval(1.0);
constexpr double kPauses = 10.0;
/// Looks for the measurement this often.
const ros::WallDuration kWatchInterval(2.0);
/// Tells how far it is no more often than this.
const ros::WallDuration kTellInterval(5.0);

class PhenotypeRecorder {
 public:
  PhenotypeRecorder(ros::NodeHandle nh, ros::NodeHandle pnh)
      : directory_(pnh.param<std::string>("output_dir", "")),
        measurement_(nh.resolveName("measurement/flush")),
        end_with_clock_(pnh.param("end_with_clock", false)),
        clock_timeout_(pnh.param("clock_timeout", 3.0)) {
    pnh.getParam("flush_services", flush_services_);
    if (directory_.empty()) {
      throw std::runtime_error("where to? Give a folder as _output_dir:=DIR");
    }
    directory_ = std::filesystem::absolute(directory_);
    journal_ = pnh.param<std::string>("journal", directory_ / "journal.sqlite");
    std::error_code failure;
    std::filesystem::create_directories(directory_, failure);
    if (failure) {
      throw std::runtime_error(directory_.string() + ": cannot be made: " + failure.message() +
                               "; give another folder, in the launch files as output:=");
    }
    write();
    export_ = pnh.advertiseService("export", &PhenotypeRecorder::exportNow, this);
    if (end_with_clock_) clock_ = nh.subscribe("/clock", 1, &PhenotypeRecorder::noteClock, this);
  }

  /// Until the node is shut down or, if so asked, the bag is over.
  /// @return whether everything could be written
  bool run() {
    while (ros::ok()) {
      ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
      // Only now: writing may have taken longer than the clock may be silent.
      if (clockHasStopped()) break;
      if (ros::SteadyTime::now() - looked_ > interval_ && (readJournal() || isRemoved())) write();
      watchMeasurement();
    }
    if (ros::ok()) flushStages();
    if (readJournal()) write();
    std::cout << table_.size() << " plants in " << (directory_ / "plants.csv").string()
              << std::endl;
    return all_written_;
  }

 private:
  bool exportNow(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
    readJournal();
    response.success = write();
    response.message = std::to_string(table_.size()) + " plants in " + directory_.string();
    return true;
  }

  /// Loaders without a bond do not notice that the manager has died with all nodelets.
  void watchMeasurement() {
    const ros::SteadyTime now = ros::SteadyTime::now();
    if (now - watched_ < kWatchInterval) return;
    watched_ = now;
    const bool is_there = ros::service::exists(measurement_, false);
    if (was_there_ && !is_there && ros::ok()) {
      ROS_ERROR_STREAM("the measurement has gone ("
                       << measurement_
                       << "): nothing more is measured. Has the nodelet manager died? Launch "
                          "again, with the same output to go on with the same plants; with "
                          "respawn:=true the nodelets are loaded again by themselves");
    }
    was_there_ = is_there;
  }

  void noteClock(const rosgraph_msgs::ClockConstPtr&) { last_clock_ = ros::SteadyTime::now(); }

  bool clockHasStopped() const {
    return end_with_clock_ && !last_clock_.isZero() &&
           ros::SteadyTime::now() - last_clock_ > clock_timeout_;
  }

  /// Stage by stage down the chain.
  void flushStages() {
    for (const std::string& service : flush_services_) {
      std_srvs::Trigger trigger;
      if (!ros::service::call(service, trigger) || !trigger.response.success) {
        ROS_ERROR_STREAM("flushing " << service << " failed (" << trigger.response.message
                                     << "): the last plants may be missing");
        all_written_ = false;
      }
    }
  }

  /// @return whether there was something new in it
  bool readJournal() {
    looked_ = ros::SteadyTime::now();
    if (!std::filesystem::exists(journal_)) return false;
    try {
      // Opened anew each time: the measurement may have begun another one.
      const PhenotypeJournal journal(journal_, PhenotypeJournal::Access::kRead);
      const std::string identity = journal.identity();
      if (identity != identity_) {
        table_ = PlantTable();
        position_ = 0;
        identity_ = identity;
      }
      if (readInto(table_, journal, position_) == 0U) return false;
      frame_id_ = journal.frameId();
    } catch (const JournalError& error) {
      ROS_ERROR_STREAM_THROTTLE(5.0, error.what());
      return false;
    }
    if (looked_ - told_ > kTellInterval) {
      told_ = looked_;
      ROS_INFO_STREAM(table_.size() << " plants so far");
    }
    return true;
  }

  bool isRemoved() const { return !std::filesystem::exists(directory_ / "plants.csv"); }

  bool write() {
    const ros::SteadyTime begin = ros::SteadyTime::now();
    try {
      std::filesystem::create_directories(directory_);  // somebody may have removed it
      const std::vector<Phenotype> plants = table_.plants();
      writePhenotypeCsv(directory_ / "plants.csv", plants);
      writePhenotypeGeoJson(directory_ / "plants.geojson", plants, frame_id_);
      writeRowsCsv(directory_ / "rows.csv", plants);
      interval_ = std::max(kInterval, (ros::SteadyTime::now() - begin) * kPauses);
      return true;
    } catch (const std::exception& error) {
      ROS_ERROR_STREAM(error.what());
      all_written_ = false;
      return false;
    }
  }

  std::filesystem::path directory_;
  const std::string measurement_;  // a service of that nodelet
  std::string journal_;
  const bool end_with_clock_;
  const ros::WallDuration clock_timeout_;
  std::vector<std::string> flush_services_;
  PlantTable table_;
  std::string identity_;       // of the journal that it is from
  std::int64_t position_ = 0;  // read so far
  std::string frame_id_ = "map";
  bool all_written_ = true;
  ros::WallDuration interval_ = kInterval;
  ros::SteadyTime looked_;
  ros::SteadyTime told_;
  ros::SteadyTime watched_;  // whether the measurement is there
  bool was_there_ = false;
  ros::SteadyTime last_clock_;
  ros::ServiceServer export_;
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
