#include "block_stage.hpp"

namespace field_phenotyping {

const std::set<std::string>& commonParameterNames() {
  static const std::set<std::string> names = {
      "device", "diagnostic_period", "history", "journal", "new_journal", "wait_for_subscriber"};
  return names;
}

void checkDevice(const ros::NodeHandle& pnh, StageHealth& health) {
  const std::string device = pnh.param<std::string>("device", "auto");
  if (device == "auto" || device == "cpu") return;
  health.trouble("device", device == "cuda"
                               ? "device 'cuda' was asked for, but this build has no GPU code: "
                                 "working on the CPU"
                               : "device '" + device +
                                     "' is none of auto, cpu, cuda: working on "
                                     "the CPU");
}

ListenerGate::ListenerGate(const ros::NodeHandle& pnh, const ros::Publisher& output)
    : output_(output),
      give_up_(ros::WallTime::now() + ros::WallDuration(pnh.param("wait_for_subscriber", 10.0))) {}

bool ListenerGate::open() {
  open_ = open_ || output_.getNumSubscribers() > 0U || ros::WallTime::now() > give_up_;
  return open_;
}

}  // namespace field_phenotyping
