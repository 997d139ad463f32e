#include "stage_health.hpp"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>

namespace field_phenotyping {
namespace {

const ros::WallDuration kRateWindow(5.0);
const ros::WallDuration kTroubleShown(10.0);
const ros::WallDuration kLogInterval(5.0);

/// Of this process, which may hold other stages too [MB]; 0 where the system does not tell.
double residentMemory() {
  std::ifstream statm("/proc/self/statm");
  double all = 0.0;
  double resident = 0.0;
  if (!(statm >> all >> resident)) return 0.0;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) * 1e-6;
}

}  // namespace

StageHealth::StageHealth(const ros::NodeHandle& nh, const ros::NodeHandle& pnh,
                         const std::string& name, const std::string& input)
    : name_(name), input_(input), updater_(nh, pnh, name) {
  updater_.setHardwareID("none");
  updater_.add("status", this, &StageHealth::fill);
  // Wall time: with use_sim_time a paused bag must not silence the diagnostics.
  timer_ = pnh.createWallTimer(ros::WallDuration(1.0),
                               [this](const ros::WallTimerEvent&) { updater_.force_update(); });
}

void StageHealth::received(const ros::Time& stamp) {
  const ros::Time now = ros::Time::now();
  const std::lock_guard<std::mutex> lock(mutex_);
  last_arrival_ = ros::SteadyTime::now();
  arrivals_.push_back(last_arrival_);
  while (last_arrival_ - arrivals_.front() > kRateWindow) arrivals_.pop_front();
  ++received_;
  // Not (now - stamp): it throws where the stamp is nonsense.
  age_ = stamp.isZero() ? 0.0 : now.toSec() - stamp.toSec();
}

void StageHealth::finished(double seconds) {
  const std::lock_guard<std::mutex> lock(mutex_);
  latency_ = seconds;
}

void StageHealth::count(const std::string& what, std::uint64_t amount) {
  const std::lock_guard<std::mutex> lock(mutex_);
  counters_[what] += amount;
}

void StageHealth::show(const std::string& what, double value) {
  const std::lock_guard<std::mutex> lock(mutex_);
  figures_[what] = value;
}

void StageHealth::took(const std::string& what, double seconds) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Times& times = times_[what];
  if (times.seconds.size() < kTimesKept) {
    times.seconds.push_back(seconds);
  } else {
    times.seconds[times.next] = seconds;
    times.next = (times.next + 1U) % kTimesKept;
  }
}

std::uint64_t StageHealth::counted(const std::string& what) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto found = counters_.find(what);
  return found == counters_.end() ? 0U : found->second;
}

void StageHealth::trouble(const std::string& kind, const std::string& text) {
  const ros::SteadyTime now = ros::SteadyTime::now();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    trouble_ = text;
    trouble_time_ = now;
    const auto logged = logged_.find(kind);
    if (logged != logged_.end() && now - logged->second < kLogInterval) return;
    logged_[kind] = now;
  }
  ROS_WARN_STREAM("[" << name_ << "] " << text);
}

void StageHealth::showTimes(diagnostic_updater::DiagnosticStatusWrapper& status,
                            const std::string& what, const Times& times) {
  std::vector<double> sorted = times.seconds;
  std::sort(sorted.begin(), sorted.end());
  const auto quantile = [&](double share) {
    const double rank = share * static_cast<double>(sorted.size() - 1U);
    return sorted[static_cast<std::size_t>(std::ceil(rank))];
  };
  status.add(what + ", median [s]", quantile(0.5));
  status.add(what + ", 99 % [s]", quantile(0.99));
  status.add(what + ", most [s]", sorted.back());
}

void StageHealth::fill(diagnostic_updater::DiagnosticStatusWrapper& status) {
  using diagnostic_msgs::DiagnosticStatus;
  const ros::SteadyTime now = ros::SteadyTime::now();
  const std::lock_guard<std::mutex> lock(mutex_);
  while (!arrivals_.empty() && now - arrivals_.front() > kRateWindow) arrivals_.pop_front();

  if (!trouble_.empty() && now - trouble_time_ < kTroubleShown) {
    status.summary(DiagnosticStatus::WARN, trouble_);
  } else if (received_ == 0U) {
    status.summary(DiagnosticStatus::WARN, "no " + input_ + " has arrived yet");
  } else if (arrivals_.empty()) {
    status.summary(DiagnosticStatus::OK, "idle: no " + input_ + " for a while");
  } else {
    status.summary(DiagnosticStatus::OK, "running");
  }
  status.add("rate [1/s]", static_cast<double>(arrivals_.size()) / kRateWindow.toSec());
  status.add("received", received_);
  status.add("age at arrival [s]", age_);
  status.add("latency [s]", latency_);
  status.add("memory of the process [MB]", residentMemory());
  if (!last_arrival_.isZero()) status.add("silent for [s]", (now - last_arrival_).toSec());
  for (const auto& [what, value] : counters_) status.add(what, value);
  for (const auto& [what, value] : figures_) status.add(what, value);
  for (const auto& [what, times] : times_) showTimes(status, what, times);
  status.add("last trouble", trouble_.empty() ? "none" : trouble_);
}

}  // namespace field_phenotyping
