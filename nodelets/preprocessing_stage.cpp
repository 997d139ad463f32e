#include "preprocessing_stage.hpp"

#include <tf2_eigen/tf2_eigen.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <chrono>
#include <cmath>
#include <exception>
#include <limits>
#include <set>
#include <sstream>

#include "cloud_decoder.hpp"
#include "conversions.hpp"
#include "field_phenotyping/common/nearest_name.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

const ros::Duration kTfMemory(60.0);
// Scans and transforms that lie this far apart are not late, they go by different clocks [s].
constexpr double kOtherClock = 30.0;
// Coarser coordinates than this spoil a stem's diameter [m].
constexpr double kCoarse = 0.001;
constexpr std::chrono::milliseconds kPause(10);
// Blocks in the making: one is at work, and one more waits, so that it never has to.
constexpr std::size_t kMostPending = 2U;
// Tiles that no scan reaches any more and that wait to be made blocks, before scans wait for them.
constexpr std::size_t kMostFinished = 16U;
// A sensor that is so far from where it was heading has not moved, the map has: within a step even
// a sharp turn (8 m/s^2) leaves it within half of that.
constexpr double kMapJump = 0.045;  // [m]
const ros::Duration kStep(0.05);
const ros::Duration kLongestLook(0.5);  // back from a scan

/// tf2 knows no leading slash, old drivers still write it.
std::string withoutSlash(const std::string& frame) {
  return !frame.empty() && frame.front() == '/' ? frame.substr(1) : frame;
}

std::string listed(const std::vector<std::string>& names) {
  constexpr std::size_t kMostListed = 20U;
  std::string list;
  for (std::size_t i = 0; i < std::min(names.size(), kMostListed); ++i) {
    list += (i == 0U ? "'" : ", '") + names[i] + "'";
  }
  return names.size() > kMostListed ? list + ", ..." : list;
}

std::set<std::string> ownParameterNames() {
  std::set<std::string> names = commonParameterNames();
  names.insert({"target_frame", "tf_timeout", "idle_timeout", "queue_size", "preliminary"});
  return names;
}

}  // namespace

PreprocessingStage::PreprocessingStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh,
                                       const std::string& name)
    : pnh_(pnh),
      health_(nh, pnh_, name, "scan"),
      target_frame_(withoutSlash(pnh_.param<std::string>("target_frame", "map"))),
      tf_timeout_(pnh_.param("tf_timeout", 1.0)),
      idle_timeout_(pnh_.param("idle_timeout", 1.5)),
      preliminary_(pnh_.param("preliminary", true)),
      queue_size_(static_cast<std::size_t>(std::max(pnh_.param("queue_size", 50), 1))),
      parameters_(pnh_, health_, ownParameterNames(), [this] { parameters_changed_ = true; }),
      tf_buffer_(kTfMemory),
      tf_listener_(
          tf_buffer_, nh,
          [this](const std::string& frame, double seconds) { noteTfTimeJump(frame, seconds); }),
      output_(pnh_.advertise<Block>("output", kChainQueue)),
      gate_(pnh_, output_),
      device_(chooseDevice(pnh_, health_)),
      preprocessor_(parameters_.current(), target_frame_),
      done_(historyOf(pnh_)),
      ground_(pnh_, "ground", addGround),
      cloud_(pnh_, "cloud", addAboveGround),
      borders_(pnh_.advertise<visualization_msgs::MarkerArray>("blocks", 100)) {
  checkFixedParameters(pnh_, health_);
  BlockMaker::Calls calls;
  calls.work = [this](BlockMaker::Task& task) { makeBlock(task); };
  calls.idle = [this] { showDone(); };
  maker_ = std::make_unique<BlockMaker>(std::move(calls));
  BlockMaker::Calls draft_calls;
  draft_calls.work = [this](BlockMaker::Task& task) { makeDraft(task); };
  draft_calls.idle = [] {};
  drafts_ = std::make_unique<BlockMaker>(std::move(draft_calls));
  worker_ = std::thread([this] { run(); });
  flush_server_ = pnh_.advertiseService("flush", &PreprocessingStage::flush, this);
  input_ = pnh_.subscribe("input", static_cast<std::uint32_t>(queue_size_),
                          &PreprocessingStage::receive, this);
}

PreprocessingStage::~PreprocessingStage() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    running_ = false;
  }
  changed_.notify_all();
  input_.shutdown();
  flush_server_.shutdown();
  worker_.join();
  drafts_.reset();
  maker_.reset();
}

void PreprocessingStage::receive(const sensor_msgs::PointCloud2ConstPtr& message) {
  health_.received(message->header.stamp);
  bool dropped = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    last_arrival_ = ros::SteadyTime::now();
    scans_.push_back({message, last_arrival_});
    dropped = scans_.size() > queue_size_;
    if (dropped) scans_.pop_front();
  }
  changed_.notify_all();
  if (!dropped) return;
  health_.count("scans dropped: queue full");
  health_.trouble("queue full",
                  "scans arrive faster than they are worked or than tf follows: the oldest was "
                  "dropped. Raise queue_size above lag x rate, or crop the scans");
}

bool PreprocessingStage::flush(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) {
  std::unique_lock<std::mutex> lock(mutex_);
  const std::uint64_t wanted = ++flushes_wanted_;
  changed_.notify_all();
  response.success = waitWhileItGoesOn(changed_, lock, kFlushStalled, blocks_made_,
                                       [&] { return flushes_done_ >= wanted || !running_; });
  response.message =
      response.success ? "all blocks are handed on" : "no block was ready within 120 s";
  return true;
}

void PreprocessingStage::run() {
  std::unique_lock<std::mutex> lock(mutex_);
  while (running_) {
    lock.unlock();
    try {
      step();
    } catch (const std::exception& error) {
      // One bad scan or block must not take the manager with it.
      health_.count("failures");
      health_.trouble("exception", std::string("a step was given up: ") + error.what());
    }
    lock.lock();
  }
}

void PreprocessingStage::step() {
  std::uint64_t wanted = 0U;
  bool asked_to_flush = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    wanted = flushes_wanted_;
    asked_to_flush = wanted > flushes_done_;
  }
  if (parameters_changed_.exchange(false)) applyParameters();
  const bool added = hasRoom() && addNextScan();
  const bool flush = !added && (asked_to_flush || inputIsIdle());
  const bool more = handOnBlocks(flush, WhenFull::kLater);

  std::unique_lock<std::mutex> lock(mutex_);
  if (flush && asked_to_flush && !more && scans_.empty() && pending() == 0U) {
    flushes_done_ = wanted;
    changed_.notify_all();
  }
  // A scan at the queue's head may be waiting for tf, so a non-empty queue is no reason to hurry.
  if (!added && running_) changed_.wait_for(lock, kPause);
}

/// Tiles that no scan reaches any more wait in the map until they have gone out; while too many do,
/// scans wait too.
bool PreprocessingStage::hasRoom() const {
  return pending() == 0U ||
         (preprocessor_.finishedBlocks() <= kMostFinished &&
          static_cast<double>(preprocessor_.voxels()) <= preprocessor_.parameters().memory_limit);
}

/// @return whether there was a scan to be placed or dropped
bool PreprocessingStage::addNextScan() {
  WaitingScan next;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (scans_.empty()) return false;
    next = scans_.front();
  }
  if (!addScan(next)) return false;
  const std::lock_guard<std::mutex> lock(mutex_);
  // The callback may have dropped it meanwhile to make room.
  if (!scans_.empty() && scans_.front().message == next.message) scans_.pop_front();
  return true;
}

/// @return false when the scan should stay in the queue and be tried again
bool PreprocessingStage::addScan(const WaitingScan& waiting) {
  // Whatever is wrong with a scan, it must not stay at the queue's head.
  try {
    requireValidStamp(*waiting.message);
    bool try_again = false;
    const auto T_target_sensor = findTransform(waiting, try_again);
    if (T_target_sensor) {
      const ros::SteadyTime begin = ros::SteadyTime::now();
      place(waiting.message, *T_target_sensor);
      const ros::SteadyTime end = ros::SteadyTime::now();
      health_.took("work on a scan", (end - begin).toSec());
      health_.took("scan, from its arrival until it is placed", (end - waiting.arrival).toSec());
      health_.count("scans placed");
    }
    return !try_again;
  } catch (const CloudFormatError& error) {
    health_.count("scans dropped: unreadable");
    health_.trouble("unreadable", std::string("a scan was dropped: ") + error.what());
  } catch (const std::exception& error) {
    health_.count("scans dropped: failed");
    health_.trouble("failed scan", std::string("a scan was given up: ") + error.what());
  }
  return true;
}

std::optional<Eigen::Isometry3d> PreprocessingStage::findTransform(const WaitingScan& waiting,
                                                                   bool& try_again) {
  const std_msgs::Header& header = waiting.message->header;
  if (isRegistered(*waiting.message)) return Eigen::Isometry3d::Identity();
  const std::string frame = withoutSlash(header.frame_id);
  // tf2 would take a stamp of zero for "the newest", which is where the rover is by now.
  if (header.stamp.isZero() && !frame.empty()) {
    throw CloudFormatError("its stamp is zero and it is not in '" + target_frame_ +
                           "': when it was taken, and so from where, is not known");
  }
  std::string reason;  // tf2 adds to it
  const std::uint64_t tf_jumps = tf_jumps_;
  if (frame.empty()) {
    reason = "its frame_id is empty";
  } else if (isAheadOfTf(header)) {
    reason = "scans have gone back in time, and transforms have not";
  } else if (tf_buffer_.canTransform(target_frame_, frame, header.stamp, &reason)) {
    tf_jumps_then_ = tf_jumps;
    return tf2::transformToEigen(tf_buffer_.lookupTransform(target_frame_, frame, header.stamp));
  }
  try_again = ros::SteadyTime::now() - waiting.arrival < tf_timeout_ && !frame.empty();
  if (try_again) return std::nullopt;

  health_.count("scans dropped: no transform");
  if (nameOtherClock(header)) return std::nullopt;
  std::ostringstream text;
  text << "a scan was dropped: no transform from '" << frame << "' to '" << target_frame_
       << "' at its stamp within " << tf_timeout_.toSec() << " s (" << reason << "). "
       << cureOfMissingTransform(header);
  health_.trouble("no transform", text.str());
  return std::nullopt;
}

std::string PreprocessingStage::cureOfMissingTransform(const std_msgs::Header& header) const {
  const std::string frame = withoutSlash(header.frame_id);
  if (frame.empty()) return "Let the driver name the frame that its points are in";
  std::vector<std::string> known;
  tf_buffer_._getFrameStrings(known);
  if (known.empty()) {
    return "No transform has come at all: is the SLAM running? If it has registered the scans, set "
           "target_frame to '" +
           frame + "'";
  }
  std::sort(known.begin(), known.end());
  const auto unknown = [&](const std::string& name) { return !tf_buffer_._frameExists(name); };
  const auto nameFrames = [&](const std::string& name, const std::string& cure) {
    return "tf knows no '" + name + "', only " + listed(known) + "; is '" +
           nearestName(name, known) + "' meant? " + cure;
  };
  if (unknown(frame)) {
    return nameFrames(
        frame,
        "Let the driver stamp scans with that frame, or publish its tf. Of bags that a "
        "drive was split into the first alone may hold /tf_static: play all of them");
  }
  if (unknown(target_frame_)) {
    return "tf knows no '" + target_frame_ + "', only " + listed(known) +
           "; set target_frame to '" + topFrame(frame) + "', which '" + frame + "' hangs on";
  }
  const std::optional<double> behind = aheadOfTf(header);
  if (!behind || *behind <= 0.0) {
    return "Is the SLAM running, is target_frame right, is use_sim_time set for a bag?";
  }
  std::ostringstream text;
  text << "The newest one is " << *behind
       << " s older than the scan. Has the SLAM stopped? If it is "
       << "late, raise tf_timeout by more than that, and queue_size above lag x rate";
  return text.str();
}

/// The frame that hangs on none and that this one hangs on.
std::string PreprocessingStage::topFrame(const std::string& frame) const {
  constexpr int kDeepest = 100;  // a broken tree may lead round and round
  std::string top = frame;
  std::string parent;
  for (int k = 0; k < kDeepest; ++k) {
    if (!tf_buffer_._getParent(top, ros::Time(), parent) || parent.empty()) break;
    top = parent;
  }
  return top;
}

/// How much younger a scan is than the newest transform of its frame [s]; nothing where there is
/// none, or one for all times.
std::optional<double> PreprocessingStage::aheadOfTf(const std_msgs::Header& header) const {
  const std::string frame = withoutSlash(header.frame_id);
  const ros::Time any;  // the newest transform that there is
  if (!tf_buffer_.canTransform(target_frame_, frame, any)) return std::nullopt;
  const ros::Time newest = tf_buffer_.lookupTransform(target_frame_, frame, any).header.stamp;
  if (newest.isZero()) return std::nullopt;
  return header.stamp.toSec() - newest.toSec();
}

/// Whether time has gone back for scans and not for transforms: those that are known are of the
/// time before, and may be of another map.
bool PreprocessingStage::isAheadOfTf(const std_msgs::Header& header) const {
  const bool jumps = !header.stamp.isZero() && goesBack(header.stamp, newest_stamp_);
  return jumps && tf_jumps_ == tf_jumps_then_ && aheadOfTf(header).value_or(0.0) < -kTimeJump;
}

void PreprocessingStage::noteTfTimeJump(const std::string& frame, double seconds) {
  ++tf_jumps_;
  health_.count("time jumps of tf");
  std::ostringstream text;
  text << "transforms of '" << frame << "' went back by " << seconds
       << " s (a bag that starts again?): older ones are forgotten. If that goes on, two nodes "
       << "publish '" << frame << "' by different clocks: let one do so";
  health_.trouble("tf time jump", text.str());
}

/// Scans by one clock and transforms by another never meet.
/// @return whether that is what is wrong
bool PreprocessingStage::nameOtherClock(const std_msgs::Header& header) {
  const std::optional<double> ahead = aheadOfTf(header);
  if (!ahead || std::abs(*ahead) < kOtherClock) return false;
  // Where scans have been placed by transforms, these have stopped.
  if (*ahead > 0.0 && !registered_ && scans_added_ > 0U) return false;
  health_.count("scans dropped: another clock than tf");
  std::ostringstream text;
  text
      << "a scan was dropped: it is " << std::abs(*ahead) << " s "
      << (*ahead > 0.0 ? "younger" : "older") << " than the newest transform from '"
      << withoutSlash(header.frame_id) << "' to '" << target_frame_
      << "'. Scans and transforms go by different clocks: set "
      << "use_sim_time for all nodes and play the bag with --clock, or for none, and let one clock "
      << "stamp both. check_bag tells whether a bag was recorded so";
  if (*ahead < 0.0 && goesBack(header.stamp, newest_stamp_)) {
    text << ". Or a bag was started again and who publishes transforms has not noticed: start the "
         << "SLAM again";
  }
  health_.trouble("another clock", text.str());
  return true;
}

void PreprocessingStage::place(const sensor_msgs::PointCloud2ConstPtr& message,
                               const Eigen::Isometry3d& T_target_sensor) {
  const Scan scan = scanOf(*message);
  if (isRegistered(*message)) requireMetres(scan);  // of others what is out of range is dropped
  noticeTimeJump(message->header.stamp);
  if (isRegistered(*message) != registered_) {
    registered_ = !registered_;
    preprocessor_.setParameters(effectiveParameters());
  }
  noticeMapJump(message->header);
  const ScanReport report = preprocessor_.addScan(scan, T_target_sensor, device_);
  ++scans_added_;
  only_scan_ = scans_added_ == 1U ? message : nullptr;
  only_transform_ = T_target_sensor;
  reportScan(*message, scan, report);
}

/// Raw scans are in the sensor's frame, so that its place is known.
Scan PreprocessingStage::scanOf(const sensor_msgs::PointCloud2& message) const {
  Scan scan = toScan(message);
  if (!isRegistered(message)) scan.origin = Eigen::Vector3d::Zero();
  return scan;
}

void PreprocessingStage::reportScan(const sensor_msgs::PointCloud2& message, const Scan& scan,
                                    const ScanReport& report) {
  health_.count("points received", report.points);
  health_.count("points non-finite", report.non_finite);
  health_.count("points out of range or crop box", report.out_of_range);
  health_.show("open tiles", static_cast<double>(preprocessor_.openTiles()));
  health_.show("voxels", static_cast<double>(preprocessor_.voxels()));
  if (report.points == 0U) {
    health_.trouble("empty", "a scan holds no point: does the sensor see anything?");
  } else if (report.used == 0U) {
    std::ostringstream text;
    text << "no point of a scan of " << report.points << " was of use: " << report.non_finite
         << " are not finite, " << report.out_of_range
         << " lie outside min_range ... max_range or the crop box. Are coordinates in metres?";
    health_.trouble("unused", text.str());
  }
  const double resolution = coordinateResolution(message, scan);
  if (resolution > kCoarse) {
    std::ostringstream text;
    text << "so far from the origin of '" << target_frame_ << "' FLOAT32 coordinates come in steps "
         << "of " << resolution << " m: stems blur. Use FLOAT64, or a frame with its origin nearby";
    health_.trouble("coarse", text.str());
  }
}

void PreprocessingStage::noticeTimeJump(const ros::Time& stamp) {
  if (stamp.isZero()) return;
  if (goesBack(stamp, newest_stamp_)) {
    health_.count("time jumps");
    health_.trouble("time jump", "time went back by " +
                                     std::to_string((newest_stamp_ - stamp).toSec()) +
                                     " s (a bag that starts again?): what was seen so far is "
                                     "measured by itself");
    handOnBlocks(true, WhenFull::kInAnyCase);
    emptyMap();
    last_fix_ = ros::Time();
    scans_added_ = 0U;
    revision_base_ = 0U;
    newest_revision_ = 0U;
    newest_stamp_ = stamp;
  }
  newest_stamp_ = std::max(newest_stamp_, stamp);
}

/// When the SLAM moves its map, scans from before and after do not fit together: two half stems a
/// few centimetres apart measure as one thick one. What was seen so far is handed on as it is, and
/// the same plants are measured anew, as in another pass.
void PreprocessingStage::noticeMapJump(const std_msgs::Header& header) {
  if (registered_ || header.stamp.isZero()) return;
  const ros::Time since = std::max(last_fix_, header.stamp - kLongestLook);
  last_fix_ = header.stamp;
  double off = 0.0;
  for (ros::Time time = header.stamp; time > since; time -= kStep) {
    const auto now = sensorAt(header.frame_id, time);
    const auto before = sensorAt(header.frame_id, time - kStep);
    const auto earlier = sensorAt(header.frame_id, time - kStep - kStep);
    if (!now || !before || !earlier) break;
    off = std::max(off, (*now - 2.0 * *before + *earlier).norm());
  }
  if (off < kMapJump) return;
  health_.count("map jumps");
  std::ostringstream text;
  text << "the sensor is " << off << " m from where it was heading: the SLAM has moved the map. "
       << "What was seen so far is measured by itself, and fused with what is seen from now on";
  health_.trouble("map jump", text.str());
  handOnBlocks(true, WhenFull::kInAnyCase);
  emptyMap();
}

/// Where the sensor was in the map [m]; nothing where tf does not reach so far back.
std::optional<Eigen::Vector3d> PreprocessingStage::sensorAt(const std::string& frame_id,
                                                            const ros::Time& time) const {
  const std::string frame = withoutSlash(frame_id);
  if (!tf_buffer_.canTransform(target_frame_, frame, time)) return std::nullopt;
  const auto transform = tf_buffer_.lookupTransform(target_frame_, frame, time);
  return tf2::transformToEigen(transform).translation();
}

void PreprocessingStage::applyParameters() {
  const PreprocessingParameters parameters = effectiveParameters();
  const PreprocessingParameters& before = preprocessor_.parameters();
  const bool new_grid =
      parameters.voxel_size != before.voxel_size || parameters.block_size != before.block_size;
  if (new_grid && !only_scan_) handOnBlocks(true, WhenFull::kInAnyCase);
  const bool emptied = preprocessor_.setParameters(parameters);
  if (!emptied && !only_scan_) return;
  revision_base_ = newest_revision_;
  if (!only_scan_) {
    scans_added_ = 0U;
    due_since_.clear();
    health_.trouble("emptied",
                    "a new voxel_size or block_size empties the map: what was seen so far is "
                    "measured by itself, and blocks begin anew");
    return;
  }
  // One whole cloud comes only once: it is worked again, so that tuning shows its effect.
  emptyMap();
  preprocessor_.addScan(scanOf(*only_scan_), only_transform_, device_);
}

PreprocessingParameters PreprocessingStage::effectiveParameters() const {
  PreprocessingParameters parameters = parameters_.current();
  if (registered_) {
    parameters.min_range = 0.0;
    parameters.max_range = std::numeric_limits<double>::infinity();
  }
  return parameters;
}

void PreprocessingStage::emptyMap() {
  preprocessor_.reset();
  due_since_.clear();
}

/// What is due is taken out of the map: later, if at all, where enough blocks are in the making.
/// @return whether blocks are left that should be handed on now
bool PreprocessingStage::handOnBlocks(bool flush, WhenFull when_full) {
  // One whole cloud needs no preliminary blocks: they are made once, when nothing follows it.
  const bool may_be_whole = scans_added_ < 2U;
  if (!gate_.open() || (may_be_whole && !flush)) return false;
  std::vector<BlockIndex> due = preprocessor_.dueBlocks(flush);
  if (!preliminary_ && !flush) {
    const auto open = [this](const BlockIndex& index) { return !preprocessor_.isFinished(index); };
    due.erase(std::remove_if(due.begin(), due.end(), open), due.end());
  }
  noteDue(due, flush);
  // Updates wait for those that are final.
  std::stable_partition(due.begin(), due.end(), [this](const BlockIndex& index) {
    return preprocessor_.isFinished(index);
  });
  health_.show("blocks due", static_cast<double>(due.size()));
  bool more = false;
  while (!due.empty()) {
    const BlockIndex index = due.front();
    // No draft waits for other blocks, but those of an earlier pass of the same place, which must
    // be known by then; those wait for drafts, which may be of the same tiles.
    const bool draft = preprocessor_.isDraft(index, flush);
    const std::size_t drafts = drafts_->pending();
    const bool full = draft ? drafts >= kMostPending ||
                                  maker_->holdsEarlierPass(index, preprocessor_.beganAt(index))
                            : drafts > 0U || maker_->pending() >= kMostPending;
    if (full && when_full == WhenFull::kLater) {
      more = true;
      due.erase(due.begin());
      continue;
    }
    const std::vector<BlockIndex> joined = preprocessor_.joinedWith(index, due, flush);
    if (flush || !mayGrow(joined)) handOn(joined, flush);
    due.erase(std::remove_if(due.begin(), due.end(),
                             [&](const BlockIndex& other) {
                               return std::find(joined.begin(), joined.end(), other) !=
                                      joined.end();
                             }),
              due.end());
  }
  return more;
}

/// Whether final blocks are put off because they may be worked with more that adjoin them, or be
/// reached again: where nobody waits for them.
bool PreprocessingStage::mayGrow(const std::vector<BlockIndex>& joined) const {
  return !preliminary_ && joined.size() < Preprocessor::kMostJoined &&
         preprocessor_.finishedBlocks() <= kMostFinished &&
         std::all_of(joined.begin(), joined.end(),
                     [this](const BlockIndex& index) { return preprocessor_.mayWait(index); });
}

/// The blocks are due; more than one: to be worked as one.
void PreprocessingStage::handOn(const std::vector<BlockIndex>& indices, bool flush) {
  BlockMaker::Task task{preprocessor_.collect(indices, flush), preprocessor_.parameters()};
  BlockHeader& header = task.points.header;
  std::optional<Eigen::AlignedBox2d> part;
  if (!header.final) part = preprocessor_.changedPart(header.index);
  for (BlockHeader& tile : task.points.joined) noteHandedOn(tile);
  if (task.points.joined.empty()) {
    noteHandedOn(header);
  } else {
    header.revision = task.points.joined.front().revision;
  }
  const bool has_settled = !header.draft && !header.final;
  if (has_settled && part) {
    // What little has come since the last draft may show further plants, whose first values should
    // not wait for the whole block.
    BlockMaker::Task draft{partOf(task.points, *part), task.parameters};
    draft.points.header.draft = true;
    --draft.points.header.revision;
    draft.whole = std::make_shared<BlockMaker::Task>(std::move(task));
    drafts_->push(std::move(draft));
  } else if (header.draft) {
    if (part) task.points = partOf(task.points, *part);
    drafts_->push(std::move(task));
  } else {
    maker_->push(std::move(task));
  }
}

void PreprocessingStage::noteDue(const std::vector<BlockIndex>& due, bool flush) {
  const ros::WallTime now = ros::WallTime::now();
  for (const BlockIndex& index : due) {
    DueSince& since = due_since_.try_emplace(index, DueSince{now, std::nullopt}).first->second;
    if (!flush && !preprocessor_.isFinished(index)) {
      since.as_final.reset();  // scans reach it again
    } else if (!since.as_final) {
      since.as_final = now;
    }
  }
}

/// It says as which revision, and since when it was due: who knows its plants already waits for
/// their last values.
void PreprocessingStage::noteHandedOn(BlockHeader& tile) {
  const bool has_settled = !tile.draft && !tile.final;
  if (has_settled) ++tile.revision;  // a draft comes before it
  preprocessor_.markHandedOn(tile);
  const auto due = due_since_.find(tile.index);
  const DueSince& since = due->second;
  const bool known = tile.final && tile.revision > 1U;
  tile.due_ns = (known ? since.as_final.value_or(since.at_all) : since.at_all).toNSec();
  due_since_.erase(due);
  tile.revision += revision_base_;
  newest_revision_ = std::max(newest_revision_, tile.revision);
}

/// Blocks that wait or are being made.
std::size_t PreprocessingStage::pending() const {
  // Drafts first: what follows one is pushed before that is done.
  const std::size_t drafts = drafts_->pending();
  return drafts + maker_->pending();
}

void PreprocessingStage::makeDraft(BlockMaker::Task& task) {
  {
    const UrgentWork urgent;
    makeBlock(task);
  }
  if (task.whole) maker_->push(std::move(*task.whole));
}

void PreprocessingStage::makeBlock(BlockMaker::Task& task) {
  try {
    const ros::WallTime begin = ros::WallTime::now();
    const ros::WallTime due = ros::WallTime().fromNSec(task.points.header.due_ns);
    const boost::shared_ptr<const Block> block =
        boost::make_shared<Block>(finishBlock(std::move(task.points), task.parameters, device_));
    showDeviceUse(device_, health_);
    output_.publish(block);
    {
      const std::lock_guard<std::mutex> lock(done_mutex_);
      done_.add(block);
    }
    ground_.changed();
    cloud_.changed();
    if (borders_.getNumSubscribers() > 0U) borders_.publish(blockMarker(*block));
    const ros::WallTime end = ros::WallTime::now();
    health_.count("blocks handed on");
    health_.show("points in the last block", static_cast<double>(block->cloud.size()));
    health_.took("work on a block", (end - begin).toSec());
    if (!due.isZero())
      health_.took("block, from when it is due until it is out", (end - due).toSec());
    health_.finished((end - begin).toSec());
  } catch (const std::exception& error) {
    health_.count("blocks failed");
    health_.trouble("exception", std::string("a block was given up: ") + error.what());
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++blocks_made_;
  }
  changed_.notify_all();
}

void PreprocessingStage::showDone() {
  try {
    const std::lock_guard<std::mutex> lock(done_mutex_);
    ground_.update(done_);
    cloud_.update(done_);
  } catch (const std::exception& error) {
    health_.trouble("exception", std::string("a display was given up: ") + error.what());
  }
}

bool PreprocessingStage::isRegistered(const sensor_msgs::PointCloud2& message) const {
  return withoutSlash(message.header.frame_id) == target_frame_;
}

bool PreprocessingStage::inputIsIdle() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return scans_.empty() && ros::SteadyTime::now() - last_arrival_ > idle_timeout_;
}

}  // namespace field_phenotyping
