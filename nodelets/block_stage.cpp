#include "block_stage.hpp"

#include <algorithm>
#include <array>
#include <sstream>

namespace field_phenotyping {

const std::set<std::string>& commonParameterNames() {
  static const std::set<std::string> names = {
      "device",         "diagnostic_period",   "history",
      "journal",        "most_points_waiting", "new_journal",
      "overload_after", "wait_for_subscriber"};
  return names;
}

namespace {

/// A number that a stage reads once at its start, and the least that makes sense.
struct FixedNumber {
  const char* name;
  double least;
  const char* unit;
};
constexpr std::array<FixedNumber, 7> kFixedNumbers = {{{"history", 0.0, ""},
                                                       {"most_points_waiting", 0.0, ""},
                                                       {"overload_after", 0.0, " s"},
                                                       {"wait_for_subscriber", 0.0, " s"},
                                                       {"tf_timeout", 0.0, " s"},
                                                       {"idle_timeout", 0.0, " s"},
                                                       {"queue_size", 1.0, ""}}};

}  // namespace

void checkFixedParameters(const ros::NodeHandle& pnh, StageHealth& health) {
  for (const FixedNumber& number : kFixedNumbers) {
    if (!pnh.hasParam(number.name)) continue;
    const std::string name = pnh.resolveName(number.name);
    std::ostringstream text;
    double value = 0.0;
    if (!pnh.getParam(number.name, value)) {
      text << name << " is not a number (" << number.least << " ..." << number.unit
           << "): ignored, its default is in force";
    } else if (!(value >= number.least)) {
      text << name << " is " << value << ", below " << number.least << number.unit
           << ": taken for that";
    }
    if (!text.str().empty()) health.trouble(name, text.str());
  }
}

ComputeDevice chooseDevice(const ros::NodeHandle& pnh, StageHealth& health) {
  try {
    return ComputeDevice::choose(pnh.param<std::string>("device", "auto"));
  } catch (const std::exception& error) {
    health.trouble("device", std::string(error.what()) + ". Working on the CPU");
    return {};
  }
}

void showDeviceUse(const ComputeDevice& device, StageHealth& health) {
  if (!device.hasGpu()) return;
  const DeviceUse use = device.use();
  health.show("steps on the GPU", static_cast<double>(use.gpu_steps));
  const std::string failed = "steps done by the CPU because the GPU failed";
  const std::uint64_t before = health.counted(failed);
  if (use.fallbacks <= before) return;
  health.count(failed, use.fallbacks - before);
  health.trouble("gpu", "the GPU failed, the CPU does what it did not: " + use.last_failure +
                            ". What else runs on it? nvidia-smi says so");
}

OverloadLimits overloadLimitsOf(const ros::NodeHandle& pnh) {
  // A tile's update period and a little more; half a gigabyte.
  constexpr double kAfter = 3.0;  // [s]
  constexpr double kMostPoints = 2e7;
  return {ros::WallDuration(std::max(pnh.param("overload_after", kAfter), 0.0)),
          static_cast<std::size_t>(std::max(pnh.param("most_points_waiting", kMostPoints), 0.0))};
}

ListenerGate::ListenerGate(const ros::NodeHandle& pnh, const ros::Publisher& output)
    : output_(output),
      give_up_(ros::SteadyTime::now() + ros::WallDuration(pnh.param("wait_for_subscriber", 10.0))) {
}

bool ListenerGate::open() {
  open_ = open_ || output_.getNumSubscribers() > 0U || ros::SteadyTime::now() > give_up_;
  return open_;
}

}  // namespace field_phenotyping
