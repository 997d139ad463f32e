#pragma once

#include <field_phenotyping/PlantPhenotypeArray.h>
#include <geometry_msgs/TransformStamped.h>
#include <ros/ros.h>
#include <rosbag/view.h>
#include <sensor_msgs/PointCloud2.h>

#include <atomic>
#include <boost/weak_ptr.hpp>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "bag_files.hpp"
#include "field_phenotyping/preprocessing/block.hpp"

namespace field_phenotyping {

/// Plays the scans and transforms of a bag to the stages in the same process, as fast as they can
/// be worked, with none dropped: the next scan goes out when few are still in work, and few blocks.
/// A scan counts as in work while anybody in the process holds its message, a block until the
/// measurement has answered its newest revision.
///
/// At a rate it waits for nobody, as a rover does: what comes when, and what is dropped because
/// more comes than can be worked, is as it would have been on the drive.
///
/// Played several times in a row, time goes on from one time to the next, and so does the place:
/// the transforms of the map are moved on, as if one long field were driven through.
///
/// Transforms are handed out ahead of the scans, so that no scan has to wait for its own; /clock
/// follows the scans. On a thread of its own from the constructor on.
class BagPlayer {
 public:
  /// Reads `~bag`, `~points_topic`, `~rate` [times real time; 0: as fast as can be worked],
  /// `~tf_ahead` [s], `~scans_in_work`, `~blocks_in_work`, `~loops`, and for these `~loop_period`
  /// [s], `~loop_step_x`, `~loop_step_y` [m] and `~map_frame`, and `~flush_services`: what must be
  /// there before the first scan and is called after the last.
  BagPlayer(ros::NodeHandle nh, const ros::NodeHandle& pnh, std::string name);
  ~BagPlayer();

 private:
  struct TileInWork {
    std::uint64_t block = 0U;  // counted, that it came in
    std::uint32_t revision = 0U;
  };

  void run();
  void waitForStages();
  void open();
  void publishStaticTransforms();
  void play();
  void playOnce(std::size_t loop);
  void flush();
  void playTransformsUntil(const ros::Time& time, std::size_t loop);
  ros::Time timeIn(std::size_t loop, const ros::Time& time) const;
  void moveOn(geometry_msgs::TransformStamped& transform, std::size_t loop) const;
  void waitForRoom(std::size_t scans, std::size_t blocks);
  void keepPace(const ros::Time& time);
  void tick();
  void tell(const std::string& last = "");
  std::size_t scansInWork();
  std::size_t blocksInWork();
  void forgetBlocks();

  void noteBlock(const boost::shared_ptr<const Block>& block);
  void notePlants(const PlantPhenotypeArrayConstPtr& plants);

  const std::string name_;
  const std::string path_;
  const std::string points_topic_;
  const double rate_;
  const ros::Duration tf_ahead_;
  const std::size_t most_scans_;
  const std::size_t most_blocks_;
  const std::size_t loops_;
  const ros::Duration loop_period_;
  const double loop_step_x_;  // [m]
  const double loop_step_y_;
  const std::string map_frame_;
  std::vector<std::string> flush_services_;

  std::unique_ptr<BagFiles> bags_;
  std::unique_ptr<rosbag::View> scans_;
  std::unique_ptr<rosbag::View> transforms_;
  rosbag::View::iterator next_transform_;
  ros::Time now_;  // of the bag
  ros::SteadyTime begin_;
  ros::SteadyTime told_;
  ros::SteadyTime ticked_;
  std::size_t scans_played_ = 0U;
  std::deque<boost::weak_ptr<const sensor_msgs::PointCloud2>> in_work_;

  std::mutex mutex_;
  std::map<BlockIndex, TileInWork> tiles_;  // that are not measured yet
  std::uint64_t blocks_ = 0U;               // that have come

  ros::Publisher clock_;
  ros::Publisher points_;
  ros::Publisher tf_;
  ros::Publisher tf_static_;
  ros::Subscriber block_input_;
  ros::Subscriber plant_input_;
  std::atomic<bool> running_{true};
  std::thread thread_;  // last: runs on all of the above
};

}  // namespace field_phenotyping
