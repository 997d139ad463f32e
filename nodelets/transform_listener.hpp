#pragma once

#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>

#include <functional>
#include <map>
#include <string>
#include <utility>

namespace field_phenotyping {

/// A stamp that lies so far before the newest one means that time was set back (a bag that starts
/// again), not that messages changed places on the way [s].
constexpr double kTimeJump = 1.0;
bool goesBack(const ros::Time& stamp, const ros::Time& newest);

/// Puts transforms into a tf2 buffer, and empties it when time goes back, which their own stamps
/// tell: of one frame they come in order. tf2_ros goes by the ROS clock, which comes another way:
/// the last transforms of a bag that come when /clock has begun again would stay, and scans be
/// placed between the first ones and them. Not thread-safe; the buffer may be read meanwhile.
class TransformIntake {
 public:
  /// Is told which frame's transforms went back, and by how much [s].
  using WentBack = std::function<void(const std::string& frame, double seconds)>;

  TransformIntake(tf2::BufferCore& buffer, WentBack went_back)
      : buffer_(buffer), went_back_(std::move(went_back)) {}

  /// @param authority who says so, for tf2's messages
  void add(const tf2_msgs::TFMessage& message, const std::string& authority);
  /// Those that hold at all times; they stay when time goes back.
  void addStatic(const tf2_msgs::TFMessage& message, const std::string& authority);

 private:
  void noticeTimeJump(const geometry_msgs::TransformStamped& transform);
  void put(const geometry_msgs::TransformStamped& transform, const std::string& authority,
           bool is_static);

  tf2::BufferCore& buffer_;
  const WentBack went_back_;
  std::map<std::string, ros::Time> newest_;  // of each frame in the buffer
};

/// Listens to /tf and /tf_static on a thread of its own.
class TransformListener {
 public:
  /// @param went_back is called on that thread
  TransformListener(tf2::BufferCore& buffer, const ros::NodeHandle& nh,
                    TransformIntake::WentBack went_back);
  ~TransformListener() { spinner_.stop(); }
  TransformListener(const TransformListener&) = delete;
  TransformListener& operator=(const TransformListener&) = delete;

 private:
  using Event = ros::MessageEvent<const tf2_msgs::TFMessage>;

  void receive(const Event& event);
  void receiveStatic(const Event& event);

  TransformIntake intake_;
  ros::CallbackQueue queue_;
  ros::NodeHandle nh_;
  ros::Subscriber transforms_;
  ros::Subscriber static_transforms_;
  ros::AsyncSpinner spinner_;  // last: runs on all of the above
};

}  // namespace field_phenotyping
