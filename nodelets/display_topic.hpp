#pragma once

#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <string>

#include "block_worker.hpp"
#include "conversions.hpp"

namespace field_phenotyping {

/// A cloud for people to look at: all blocks of the stage's history in one. Made only while someone
/// listens, at most once a second; a new listener is served at once.
template <class T>
class DisplayTopic {
 public:
  using AddBlock = std::function<void(const T&, DisplayCloud&)>;

  /// @param points how many points a block adds at most, to keep the cloud in bounds
  DisplayTopic(ros::NodeHandle& pnh, const std::string& topic, AddBlock add_block)
      : add_block_(std::move(add_block)) {
    publisher_ = pnh.advertise<sensor_msgs::PointCloud2>(
        topic, 1, [this](const ros::SingleSubscriberPublisher&) { outdated_ = true; });
  }

  /// There is something new to show.
  void changed() { outdated_ = true; }

  /// Publishes if it is time to; call it often, from one thread.
  void update(const BlockHistory<T>& history) {
    if (!outdated_ || publisher_.getNumSubscribers() == 0U || history.blocks().empty()) return;
    const ros::SteadyTime now = ros::SteadyTime::now();
    if (now - published_ < ros::WallDuration(1.0)) return;
    outdated_ = false;
    published_ = now;

    std::size_t total = 0U;
    for (const auto& block : history.blocks()) total += cloudSize(*block);
    DisplayCloud cloud(total / kMaxPoints + 1U);
    for (const auto& block : history.blocks()) add_block_(*block, cloud);
    publisher_.publish(cloud.message(messageHeader(headerOf(*history.blocks().back()))));
  }

 private:
  static constexpr std::size_t kMaxPoints = 2000000U;

  static std::size_t cloudSize(const Block& block) { return block.cloud.size(); }
  static std::size_t cloudSize(const SegmentedBlock& block) { return block.cloud.size(); }
  static std::size_t cloudSize(const CompletedBlock& block) { return block.synthetic.size(); }

  AddBlock add_block_;
  std::atomic<bool> outdated_{false};
  ros::SteadyTime published_;
  ros::Publisher publisher_;  // last: its callback uses the above
};

}  // namespace field_phenotyping
