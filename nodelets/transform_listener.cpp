#include "transform_listener.hpp"

#include <exception>
#include <utility>

namespace field_phenotyping {
namespace {

constexpr std::uint32_t kQueue = 100U;  // as tf2_ros has it

}  // namespace

bool goesBack(const ros::Time& stamp, const ros::Time& newest) {
  return newest.toSec() - stamp.toSec() > kTimeJump;
}

void TransformIntake::add(const tf2_msgs::TFMessage& message, const std::string& authority) {
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    noticeTimeJump(transform);
    put(transform, authority, false);
  }
}

void TransformIntake::addStatic(const tf2_msgs::TFMessage& message, const std::string& authority) {
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    put(transform, authority, true);
  }
}

/// One bad transform must not take the manager with it: tf2 throws at a stamp near the end of time.
void TransformIntake::put(const geometry_msgs::TransformStamped& transform,
                          const std::string& authority, bool is_static) {
  try {
    buffer_.setTransform(transform, authority, is_static);
  } catch (const std::exception& error) {
    ROS_ERROR_STREAM_THROTTLE(5.0, "a transform of '" << transform.child_frame_id << "' by "
                                                      << authority
                                                      << " was dropped: " << error.what());
  }
}

void TransformIntake::noticeTimeJump(const geometry_msgs::TransformStamped& transform) {
  const ros::Time& stamp = transform.header.stamp;
  if (stamp.isZero()) return;  // of no time
  ros::Time& newest = newest_[transform.child_frame_id];
  if (goesBack(stamp, newest)) {
    const double seconds = newest.toSec() - stamp.toSec();
    buffer_.clear();
    newest_ = {{transform.child_frame_id, stamp}};
    went_back_(transform.child_frame_id, seconds);
  } else if (newest < stamp) {
    newest = stamp;
  }
}

TransformListener::TransformListener(tf2::BufferCore& buffer, const ros::NodeHandle& nh,
                                     TransformIntake::WentBack went_back)
    : intake_(buffer, std::move(went_back)), nh_(nh), spinner_(1U, &queue_) {
  nh_.setCallbackQueue(&queue_);
  transforms_ = nh_.subscribe("/tf", kQueue, &TransformListener::receive, this);
  static_transforms_ = nh_.subscribe("/tf_static", kQueue, &TransformListener::receiveStatic, this);
  spinner_.start();
}

void TransformListener::receive(const Event& event) {
  intake_.add(*event.getConstMessage(), event.getPublisherName());
}

void TransformListener::receiveStatic(const Event& event) {
  intake_.addStatic(*event.getConstMessage(), event.getPublisherName());
}

}  // namespace field_phenotyping
