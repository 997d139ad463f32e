#pragma once

#include <field_phenotyping/PreprocessingConfig.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2/buffer_core.h>

#include <Eigen/Geometry>
#include <atomic>
#include <condition_variable>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "block_maker.hpp"
#include "block_stage.hpp"
#include "display_topic.hpp"
#include "field_phenotyping/preprocessing/preprocessor.hpp"
#include "parameter_server.hpp"
#include "stage_health.hpp"
#include "transform_listener.hpp"

namespace field_phenotyping {

/// First stage as a node: PointCloud2 and tf in, blocks out.
///
/// A scan in `~target_frame` is taken as registered: no tf, and no cropping by range, for nobody
/// knows where its sensor was. Any other scan waits for its transform at its own stamp, up to
/// `~tf_timeout`; without one it is dropped, never placed at a guess. When time goes back, scans
/// and transforms of before and after never meet. Work is done outside the callbacks: scans are
/// placed on one thread, and what is due is taken out of the map there; blocks are made of it on
/// another, so that no scan waits for a block, and drafts on one more, so that none waits for
/// larger blocks. Where more scans come than can be placed the oldest are dropped and blocks go out
/// all the same.
class PreprocessingStage {
 public:
  PreprocessingStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh,
                     const std::string& name);
  ~PreprocessingStage();

 private:
  struct WaitingScan {
    sensor_msgs::PointCloud2ConstPtr message;
    ros::SteadyTime arrival;
  };

  /// Since when a block is due.
  struct DueSince {
    ros::WallTime at_all;
    std::optional<ros::WallTime> as_final;
  };

  /// What happens to blocks that are due while enough others are in the making.
  enum class WhenFull { kLater, kInAnyCase };

  // Called by ROS.
  void receive(const sensor_msgs::PointCloud2ConstPtr& message);
  bool flush(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response);

  // The worker thread.
  void run();
  void step();
  bool addNextScan();
  bool hasRoom() const;
  bool addScan(const WaitingScan& waiting);
  std::optional<Eigen::Isometry3d> findTransform(const WaitingScan& waiting, bool& try_again);
  std::string topFrame(const std::string& frame) const;
  std::string cureOfMissingTransform(const std_msgs::Header& header) const;
  std::optional<double> aheadOfTf(const std_msgs::Header& header) const;
  bool nameOtherClock(const std_msgs::Header& header);
  bool isAheadOfTf(const std_msgs::Header& header) const;
  void noteTfTimeJump(const std::string& frame, double seconds);
  void place(const sensor_msgs::PointCloud2ConstPtr& message,
             const Eigen::Isometry3d& T_target_sensor);
  Scan scanOf(const sensor_msgs::PointCloud2& message) const;
  void reportScan(const sensor_msgs::PointCloud2& message, const Scan& scan,
                  const ScanReport& report);
  void noticeTimeJump(const ros::Time& stamp);
  void noticeMapJump(const std_msgs::Header& header);
  std::optional<Eigen::Vector3d> sensorAt(const std::string& frame_id, const ros::Time& time) const;
  void applyParameters();
  PreprocessingParameters effectiveParameters() const;
  bool handOnBlocks(bool flush, WhenFull when_full);
  bool mayGrow(const std::vector<BlockIndex>& joined) const;
  void handOn(const std::vector<BlockIndex>& indices, bool flush);
  void noteDue(const std::vector<BlockIndex>& due, bool flush);
  void noteHandedOn(BlockHeader& tile);
  void emptyMap();

  // The threads that make blocks.
  void makeBlock(BlockMaker::Task& task);
  void makeDraft(BlockMaker::Task& task);
  std::size_t pending() const;
  void showDone();

  bool isRegistered(const sensor_msgs::PointCloud2& message) const;
  bool inputIsIdle() const;

  ros::NodeHandle pnh_;
  StageHealth health_;
  const std::string target_frame_;
  const ros::WallDuration tf_timeout_;
  const ros::WallDuration idle_timeout_;
  const bool preliminary_;  // blocks are handed on before they are final, too
  const std::size_t queue_size_;
  std::atomic<bool> parameters_changed_{false};
  ParameterServer<PreprocessingConfig, PreprocessingParameters> parameters_;
  tf2::BufferCore tf_buffer_;
  std::atomic<std::uint64_t> tf_jumps_{0U};  // how often time went back for transforms
  TransformListener tf_listener_;
  ros::Publisher output_;
  ListenerGate gate_;

  const ComputeDevice device_;

  // Of the worker thread alone.
  Preprocessor preprocessor_;
  bool registered_ = false;  // the last scan needed no transform
  ros::Time newest_stamp_;
  std::uint64_t tf_jumps_then_ = 0U;            // when the last scan was placed
  ros::Time last_fix_;                          // until when the sensor's path was looked at
  std::size_t scans_added_ = 0U;                // since the map was empty
  sensor_msgs::PointCloud2ConstPtr only_scan_;  // kept while it is the only one, for tuning
  Eigen::Isometry3d only_transform_ = Eigen::Isometry3d::Identity();
  std::uint32_t revision_base_ = 0U;  // revisions go on counting when new parameters empty the map
  std::uint32_t newest_revision_ = 0U;
  std::map<BlockIndex, DueSince> due_since_;

  // Of the threads that make blocks.
  std::mutex done_mutex_;
  BlockHistory<Block> done_;
  DisplayTopic<Block> ground_;
  DisplayTopic<Block> cloud_;
  ros::Publisher borders_;

  // Between the callbacks and the worker.
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<WaitingScan> scans_;
  ros::SteadyTime last_arrival_;
  std::uint64_t flushes_wanted_ = 0U;
  std::uint64_t flushes_done_ = 0U;
  std::uint64_t blocks_made_ = 0U;
  bool running_ = true;

  std::unique_ptr<BlockMaker> maker_;   // from here on: runs on all of the above
  std::unique_ptr<BlockMaker> drafts_;  // makes those
  std::thread worker_;
  ros::ServiceServer flush_server_;
  ros::Subscriber input_;
};

}  // namespace field_phenotyping
