#include "bag_player.hpp"

#include <rosgraph_msgs/Clock.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <exception>
#include <future>
#include <iomanip>
#include <limits>
#include <set>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "block_serialization.hpp"
#include "transform_listener.hpp"

namespace field_phenotyping {
namespace {

// How long a stage may think about a block before it counts as given up.
const ros::WallDuration kStalled(60.0);
// /clock goes on so often while nothing is played: whoever takes a silent clock for the end waits.
const ros::WallDuration kTick(0.2);
const ros::WallDuration kFailureShown(5.0);
const ros::WallDuration kTellInterval(5.0);
const ros::WallDuration kPoll(0.001);
// Subscribers that are there already need so long to be connected.
const ros::WallDuration kSettle(0.5);

double clamped(const ros::NodeHandle& pnh, const char* name, double value, double low) {
  return std::max(pnh.param(name, value), low);
}

std::size_t countOf(const ros::NodeHandle& pnh, const char* name, int value) {
  return static_cast<std::size_t>(std::max(pnh.param(name, value), 1));
}

std::string withSlash(const std::string& topic) {
  return !topic.empty() && topic.front() != '/' ? "/" + topic : topic;
}

}  // namespace

BagPlayer::BagPlayer(ros::NodeHandle nh, const ros::NodeHandle& pnh, std::string name)
    : name_(std::move(name)),
      path_(pnh.param<std::string>("bag", "")),
      points_topic_(withSlash(pnh.param<std::string>("points_topic", "/points"))),
      rate_(clamped(pnh, "rate", 0.0, 0.0)),
      tf_ahead_(clamped(pnh, "tf_ahead", 2.0, 0.0)),
      most_scans_(countOf(pnh, "scans_in_work", 10)),
      most_blocks_(countOf(pnh, "blocks_in_work", 3)),
      loops_(countOf(pnh, "loops", 1)),
      loop_period_(clamped(pnh, "loop_period", 0.0, 0.0)),
      loop_step_x_(pnh.param("loop_step_x", 0.0)),
      loop_step_y_(pnh.param("loop_step_y", 0.0)),
      map_frame_(pnh.param<std::string>("map_frame", "map")),
      clock_(nh.advertise<rosgraph_msgs::Clock>("/clock", 10)),
      points_(nh.advertise<sensor_msgs::PointCloud2>(points_topic_,
                                                     static_cast<std::uint32_t>(most_scans_))),
      tf_(nh.advertise<tf2_msgs::TFMessage>("/tf", 100)),
      tf_static_(nh.advertise<tf2_msgs::TFMessage>("/tf_static", 10, true)) {
  pnh.getParam("flush_services", flush_services_);
  ros::NodeHandle private_handle = pnh;
  block_input_ = private_handle.subscribe("blocks", 200, &BagPlayer::noteBlock, this);
  plant_input_ = private_handle.subscribe("plants", 200, &BagPlayer::notePlants, this);
  thread_ = std::thread([this] { run(); });
}

BagPlayer::~BagPlayer() {
  running_ = false;
  block_input_.shutdown();
  plant_input_.shutdown();
  thread_.join();
}

void BagPlayer::run() {
  try {
    open();
    waitForStages();
    if (running_) play();
  } catch (const std::exception& error) {
    ROS_FATAL_STREAM("[" << name_ << "] " << error.what());
    // A clock that has begun and stops is the end for those who wait for it, once they are there.
    const ros::SteadyTime end = ros::SteadyTime::now() + kFailureShown;
    while (running_ && ros::SteadyTime::now() < end) {
      tick();
      kTick.sleep();
    }
  }
}

void BagPlayer::open() {
  bags_ = std::make_unique<BagFiles>(path_);
  const auto isCloud = [](const rosbag::ConnectionInfo* connection) {
    return connection->datatype == "sensor_msgs/PointCloud2";
  };
  const auto isPoints = [&](const rosbag::ConnectionInfo* connection) {
    return isCloud(connection) && withSlash(connection->topic) == points_topic_;
  };
  const auto isTransform = [](const rosbag::ConnectionInfo* connection) {
    return withSlash(connection->topic) == "/tf";
  };
  scans_ = bags_->view(isPoints);
  transforms_ = bags_->view(isTransform);
  std::set<std::string> topics;
  std::set<std::string> other_clouds;
  const std::unique_ptr<rosbag::View> all = bags_->view();
  for (const rosbag::ConnectionInfo* connection : all->getConnections()) {
    topics.insert(" " + connection->topic + " (" + connection->datatype + ")");
    if (isCloud(connection) && !isPoints(connection)) other_clouds.insert(" " + connection->topic);
  }
  std::ostringstream text;
  if (scans_->size() == 0U) {
    text << "the bag '" << path_ << "' has no sensor_msgs/PointCloud2 on " << points_topic_
         << ", only:";
    for (const std::string& topic : topics) text << topic;
    text << ". Say which one: points_topic:=TOPIC";
    throw std::runtime_error(text.str());
  }
  if (other_clouds.empty()) return;
  text << "only " << points_topic_ << " is played; the bag has other clouds too:";
  for (const std::string& topic : other_clouds) text << topic;
  ROS_INFO_STREAM("[" << name_ << "] " << text.str() << ". points_topic:=TOPIC plays another");
}

void BagPlayer::waitForStages() {
  for (const std::string& service : flush_services_) {
    while (running_ && !ros::service::exists(service, false)) {
      ROS_WARN_STREAM_DELAYED_THROTTLE(10.0, "[" << name_ << "] waiting for " << service);
      ros::WallDuration(0.1).sleep();
    }
  }
  while (running_ && points_.getNumSubscribers() == 0U) ros::WallDuration(0.1).sleep();
  kSettle.sleep();
}

/// All of the bag at once, as who holds for ever.
void BagPlayer::publishStaticTransforms() {
  std::map<std::string, geometry_msgs::TransformStamped> newest;
  const auto isStatic = [](const rosbag::ConnectionInfo* connection) {
    return withSlash(connection->topic) == "/tf_static";
  };
  const std::unique_ptr<rosbag::View> statics = bags_->view(isStatic);
  for (const rosbag::MessageInstance& instance : *statics) {
    const auto message = instance.instantiate<tf2_msgs::TFMessage>();
    if (!message) continue;
    for (const auto& transform : message->transforms) newest[transform.child_frame_id] = transform;
  }
  tf2_msgs::TFMessage all;
  for (const auto& entry : newest) all.transforms.push_back(entry.second);
  if (!all.transforms.empty()) tf_static_.publish(all);
}

void BagPlayer::play() {
  begin_ = told_ = ros::SteadyTime::now();
  publishStaticTransforms();
  for (std::size_t loop = 0; running_ && loop < loops_; ++loop) playOnce(loop);
  if (!running_) return;
  // The last scan may be kept: nothing follows that would take its place.
  waitForRoom(2U, std::numeric_limits<std::size_t>::max());
  told_ = ros::SteadyTime();
  tell("all scans are placed");
  if (running_) flush();
}

void BagPlayer::playOnce(std::size_t loop) {
  if (goesBack(timeIn(loop, scans_->getBeginTime()), now_)) {
    // While tf holds what the last ones need.
    waitForRoom(2U, std::numeric_limits<std::size_t>::max());
    kSettle.sleep();
  }
  next_transform_ = transforms_->begin();
  for (const rosbag::MessageInstance& instance : *scans_) {
    sensor_msgs::PointCloud2Ptr scan = instance.instantiate<sensor_msgs::PointCloud2>();
    if (!scan) continue;
    if (loop > 0U) scan->header.stamp = timeIn(loop, scan->header.stamp);
    now_ = std::max(now_, timeIn(loop, instance.getTime()));
    if (rate_ > 0.0) {
      keepPace(now_);
    } else {
      waitForRoom(most_scans_, most_blocks_);
    }
    if (!running_) return;
    playTransformsUntil(instance.getTime() + tf_ahead_, loop);
    tick();
    const sensor_msgs::PointCloud2ConstPtr finished = std::move(scan);
    points_.publish(finished);
    in_work_.emplace_back(finished);
    ++scans_played_;
    tell();
  }
  playTransformsUntil(ros::TIME_MAX, loop);
}

/// Every stage hands on what it holds, down the chain.
void BagPlayer::flush() {
  std::future<bool> flushed = std::async(std::launch::async, [this] {
    return std::all_of(flush_services_.begin(), flush_services_.end(), [](const auto& service) {
      std_srvs::Trigger trigger;
      return ros::service::call(service, trigger) && trigger.response.success;
    });
  });
  while (flushed.wait_for(std::chrono::milliseconds(100)) != std::future_status::ready) {
    tick();
    tell("working what is left");
  }
  told_ = ros::SteadyTime();
  tell(flushed.get() ? "all is worked"
                     : "a stage could not be flushed: the last plants may be missing");
}

/// In one message, for the listeners' queues are shorter than what comes within some seconds.
/// @param time of the bag
void BagPlayer::playTransformsUntil(const ros::Time& time, std::size_t loop) {
  tf2_msgs::TFMessage due;
  for (; next_transform_ != transforms_->end() && next_transform_->getTime() <= time;
       ++next_transform_) {
    const auto message = next_transform_->instantiate<tf2_msgs::TFMessage>();
    if (!message) continue;
    due.transforms.insert(due.transforms.end(), message->transforms.begin(),
                          message->transforms.end());
  }
  for (geometry_msgs::TransformStamped& transform : due.transforms) moveOn(transform, loop);
  if (!due.transforms.empty()) tf_.publish(due);
}

/// A time of the bag, when it is played for the `loop`-th time.
ros::Time BagPlayer::timeIn(std::size_t loop, const ros::Time& time) const {
  return time + loop_period_ * static_cast<double>(loop);
}

void BagPlayer::moveOn(geometry_msgs::TransformStamped& transform, std::size_t loop) const {
  if (loop == 0U) return;
  transform.header.stamp = timeIn(loop, transform.header.stamp);
  if (transform.header.frame_id != map_frame_) return;
  transform.transform.translation.x += loop_step_x_ * static_cast<double>(loop);
  transform.transform.translation.y += loop_step_y_ * static_cast<double>(loop);
}

/// Until fewer scans and blocks than these are in work.
void BagPlayer::waitForRoom(std::size_t scans, std::size_t blocks) {
  ros::SteadyTime changed = ros::SteadyTime::now();
  std::pair<std::size_t, std::size_t> known{0U, 0U};
  while (running_) {
    const std::pair<std::size_t, std::size_t> in_work{scansInWork(), blocksInWork()};
    if (in_work.first < scans && in_work.second < blocks) return;
    const ros::SteadyTime now = ros::SteadyTime::now();
    if (in_work != known) {
      known = in_work;
      changed = now;
    }
    if (now - changed > kStalled) {
      ROS_WARN_STREAM("[" << name_ << "] " << in_work.first << " scans and " << in_work.second
                          << " blocks have been in work for " << kStalled.toSec()
                          << " s without an answer: going on without one");
      in_work_.clear();
      forgetBlocks();
      return;
    }
    if (now - ticked_ > kTick) tick();
    tell();
    kPoll.sleep();
  }
}

void BagPlayer::keepPace(const ros::Time& time) {
  scansInWork();  // forgets those that are done with
  const ros::SteadyTime due =
      begin_ + ros::WallDuration((time - scans_->getBeginTime()).toSec() / rate_);
  while (running_ && ros::SteadyTime::now() < due) {
    if (ros::SteadyTime::now() - ticked_ > kTick) tick();
    kPoll.sleep();
  }
}

void BagPlayer::tick() {
  rosgraph_msgs::Clock message;
  message.clock = now_;
  clock_.publish(message);
  ticked_ = ros::SteadyTime::now();
}

/// @param last what is said where nothing is left to be played; empty while there is
void BagPlayer::tell(const std::string& last) {
  const ros::SteadyTime now = ros::SteadyTime::now();
  if (now - told_ < kTellInterval) return;
  told_ = now;
  const double played = (now_ - scans_->getBeginTime()).toSec();
  const double all = (timeIn(loops_ - 1U, scans_->getEndTime()) - scans_->getBeginTime()).toSec();
  const double taken = (now - begin_).toSec();
  std::ostringstream text;
  text << std::fixed << std::setprecision(1) << "[" << name_ << "] " << played << " of " << all
       << " s, " << scans_played_ << " scans, in " << taken << " s, " << played / taken
       << " x real time";
  if (!last.empty()) {
    text << ": " << last;
  } else if (played > 0.0) {
    text << ", about " << std::lround(taken * (all - played) / played) << " s left";
  }
  ROS_INFO_STREAM(text.str());
}

std::size_t BagPlayer::scansInWork() {
  in_work_.erase(std::remove_if(in_work_.begin(), in_work_.end(),
                                [](const auto& scan) { return scan.expired(); }),
                 in_work_.end());
  return in_work_.size();
}

std::size_t BagPlayer::blocksInWork() {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::set<std::uint64_t> blocks;
  for (const auto& tile : tiles_) blocks.insert(tile.second.block);
  return blocks.size();
}

void BagPlayer::forgetBlocks() {
  const std::lock_guard<std::mutex> lock(mutex_);
  tiles_.clear();
}

void BagPlayer::noteBlock(const boost::shared_ptr<const Block>& block) {
  const std::lock_guard<std::mutex> lock(mutex_);
  ++blocks_;
  for (const BlockHeader& tile : block->tiles()) tiles_[tile.index] = {blocks_, tile.revision};
}

void BagPlayer::notePlants(const PlantPhenotypeArrayConstPtr& plants) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto tile = tiles_.find({plants->block_x, plants->block_y});
  if (tile != tiles_.end() && tile->second.revision <= plants->revision) tiles_.erase(tile);
}

}  // namespace field_phenotyping
