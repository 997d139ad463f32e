#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/ros.h>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <mutex>
#include <string>
#include <vector>

namespace field_phenotyping {

/// What a stage tells about itself: /diagnostics once a second (rate, age, drops, counts, the last
/// trouble with its cause and cure) and the log. Thread-safe.
class StageHealth {
 public:
  /// @param input what arrives at the stage, for the texts: "scan", "block"
  StageHealth(const ros::NodeHandle& nh, const ros::NodeHandle& pnh, const std::string& name,
              const std::string& input);

  /// An input has arrived; `stamp` is that of its data, zero if unknown.
  void received(const ros::Time& stamp);
  /// An output has gone out `seconds` after its input arrived.
  void finished(double seconds);

  /// Adds to a counter that is shown under this name.
  void count(const std::string& what, std::uint64_t amount = 1U);
  /// Sets a figure that is shown under this name.
  void show(const std::string& what, double value);

  /// Adds to the times [s] whose median, 99th percentile and maximum are shown under this name, of
  /// the last kTimesKept.
  void took(const std::string& what, double seconds);

  /// Something went wrong: shown as a warning for ten seconds, logged at most every five seconds a
  /// `kind`. `text` names the cause and the cure.
  void trouble(const std::string& kind, const std::string& text);

  std::uint64_t counted(const std::string& what) const;

  static constexpr std::size_t kTimesKept = 1000U;

 private:
  /// The last kTimesKept of them.
  struct Times {
    std::vector<double> seconds;
    std::size_t next = 0U;
  };

  static void showTimes(diagnostic_updater::DiagnosticStatusWrapper& status,
                        const std::string& what, const Times& times);
  void fill(diagnostic_updater::DiagnosticStatusWrapper& status);

  const std::string name_;
  const std::string input_;
  mutable std::mutex mutex_;
  std::deque<ros::SteadyTime> arrivals_;  // of the last seconds
  ros::SteadyTime last_arrival_;
  double age_ = 0.0;
  double latency_ = 0.0;
  std::uint64_t received_ = 0U;
  std::map<std::string, std::uint64_t> counters_;
  std::map<std::string, double> figures_;
  std::map<std::string, Times> times_;
  std::map<std::string, ros::SteadyTime> logged_;
  std::string trouble_;
  ros::SteadyTime trouble_time_;
  diagnostic_updater::Updater updater_;
  ros::WallTimer timer_;  // last: fires only while everything above lives
};

}  // namespace field_phenotyping
