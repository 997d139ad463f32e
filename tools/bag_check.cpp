#include "bag_check.hpp"

#include <rosbag/view.h>
#include <sensor_msgs/PointCloud2.h>
#include <tf2/buffer_core.h>
#include <tf2_eigen/tf2_eigen.h>
#include <tf2_msgs/TFMessage.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "bag_files.hpp"
#include "cloud_decoder.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/nearest_name.hpp"
#include "field_phenotyping/preprocessing/preprocessor.hpp"
#include "simulation/progress.hpp"

namespace field_phenotyping {
namespace {

using sensor_msgs::PointCloud2;

// Between two transforms the pose is taken to change evenly. A rover that brakes with 1 m/s^2 is an
// eighth of the square of this off in between: 5 mm, a quarter of a stem.
constexpr double kLongestTfGap = 0.2;  // [s]
// What the nodelets and the player of bags wait for by default.
constexpr double kTfTimeout = 1.0;    // [s]
constexpr double kPlayerAhead = 2.0;  // [s]
// A clock that is further off than this is another clock.
constexpr double kOtherClock = 1.0;  // [s]
// A pause in the scans of so many times their usual distance is a hole, if it is as long as this.
constexpr double kHoleFactor = 5.0;
constexpr double kHole = 0.5;           // [s]
constexpr double kCoarse = 0.001;       // [m] steps of coordinates that spoil a diameter
constexpr double kMostMisses = 0.9;     // share of non-finite points that is still usual
constexpr double kMostAtOrigin = 0.05;  // share of points in the sensor's very place
// What simulated seedlings, jointing and tasselling maize of other densities have shown alike
// (docs/bags.md): below the first few plants are found and hardly a diameter, from the second one
// on all.
constexpr double kDensityLeast = 300.0;    // [1/m^2]
constexpr double kDensityEnough = 2000.0;  // [1/m^2]

template <class... Parts>
std::string textOf(const Parts&... parts) {
  std::ostringstream text;
  text.precision(4);
  (text << ... << parts);
  return text.str();
}

std::string withoutSlash(const std::string& frame) {
  return !frame.empty() && frame.front() == '/' ? frame.substr(1) : frame;
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1U));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

/// All transforms of the bag, and what is odd about them.
class Transforms {
 public:
  explicit Transforms(const ros::Duration& memory) : buffer_(memory) {}

  void add(const tf2_msgs::TFMessage& message, const ros::Time& recorded, bool is_static) {
    for (geometry_msgs::TransformStamped transform : message.transforms) {
      transform.header.frame_id = withoutSlash(transform.header.frame_id);
      transform.child_frame_id = withoutSlash(transform.child_frame_id);
      const auto& r = transform.transform.rotation;
      const auto& t = transform.transform.translation;
      const double norm = r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w;
      if (!(std::abs(norm - 1.0) < 1e-2) || !std::isfinite(t.x + t.y + t.z) ||
          transform.header.frame_id.empty() || transform.child_frame_id.empty() ||
          transform.child_frame_id == transform.header.frame_id) {
        ++invalid_;
        continue;
      }
      Edge& edge = edges_[transform.child_frame_id];
      edge.parents.insert(transform.header.frame_id);
      edge.is_static = is_static;
      const double stamp = transform.header.stamp.toSec();
      if (!is_static) {
        if (!edge.stamps.empty() && stamp < edge.stamps.back()) ++edge.back;
        edge.stamps.push_back(stamp);
        edge.lags.push_back(recorded.toSec() - stamp);
      }
      buffer_.setTransform(transform, "bag", is_static);
    }
  }

  struct Edge {
    std::set<std::string> parents;
    bool is_static = false;
    std::vector<double> stamps;  // [s]
    std::vector<double> lags;    // [s] from stamp to record
    std::size_t back = 0U;       // how often time went back
  };

  const tf2::BufferCore& buffer() const { return buffer_; }
  std::size_t invalid() const { return invalid_; }
  bool empty() const { return edges_.empty(); }
  const Edge* edge(const std::string& child) const {
    const auto found = edges_.find(child);
    return found == edges_.end() ? nullptr : &found->second;
  }

  std::vector<std::string> frames() const {
    std::set<std::string> names;
    for (const auto& [child, edge] : edges_) {
      names.insert(child);
      names.insert(edge.parents.begin(), edge.parents.end());
    }
    return {names.begin(), names.end()};
  }

  /// The frame, the one that it hangs on, and so on.
  std::vector<std::string> pathUp(std::string frame) const {
    std::vector<std::string> path{frame};
    while (const Edge* up = edge(frame)) {
      frame = *up->parents.begin();
      if (std::find(path.begin(), path.end(), frame) != path.end()) break;
      path.push_back(frame);
    }
    return path;
  }

  /// From one frame to the other; empty where they do not hang together.
  std::vector<std::string> chain(const std::string& from, const std::string& to) const {
    std::vector<std::string> up = pathUp(from);
    std::vector<std::string> down = pathUp(to);
    if (up.back() != down.back()) return {};
    while (up.size() > 1U && down.size() > 1U && up[up.size() - 2U] == down[down.size() - 2U]) {
      up.pop_back();
      down.pop_back();
    }
    up.insert(up.end(), down.rbegin() + 1, down.rend());
    return up;
  }

 private:
  tf2::BufferCore buffer_;
  std::map<std::string, Edge> edges_;
  std::size_t invalid_ = 0U;
};

/// Height above the soil that few of the block's points pass [m]; 0 where there are none.
double plantHeightOf(const Block& block) {
  constexpr double kFew = 0.05;
  std::vector<double> heights;
  for (const Eigen::Vector3f& point : block.cloud.points) {
    heights.push_back(block.ground.heightAbove(point));
  }
  return quantile(std::move(heights), 1.0 - kFew);
}

class Checker {
 public:
  explicit Checker(const BagCheckRequest& request)
      : request_(request),
        target_(withoutSlash(request.target_frame)),
        bags_(request.bag),
        preprocessor_(parametersOf(request), target_) {}

  BagReport run() {
    if (!chooseTopic()) return report_;
    readTransforms();
    const auto views = bags_.view(rosbag::TopicQuery(report_.points_topic));
    rosbag::View& scans = *views;
    simulation::ProgressBar progress;  // bags of hours take minutes
    const auto all = static_cast<double>(scans.size());
    for (const rosbag::MessageInstance& instance : scans) {
      const auto message = instance.instantiate<PointCloud2>();
      if (message) addScan(*message, instance.getTime());
      progress.update("placing scans", static_cast<double>(report_.scans) / all);
    }
    judgeTime();
    judgePoints();
    judgeFrames();
    judgeTransforms();
    judgeDensity();
    std::stable_sort(report_.findings.begin(), report_.findings.end(),
                     [](const Finding& a, const Finding& b) { return a.severity > b.severity; });
    return report_;
  }

 private:
  static PreprocessingParameters parametersOf(const BagCheckRequest& request) {
    PreprocessingParameters parameters = request.parameters.preprocessing;
    // Nobody looks at blocks that are still being filled.
    parameters.update_period = 600.0;
    return parameters;
  }

  void warn(const char* about, const std::string& what, const std::string& cure) {
    report_.findings.push_back({Severity::kWarning, about, what, cure});
  }
  void fail(const char* about, const std::string& what, const std::string& cure) {
    report_.findings.push_back({Severity::kError, about, what, cure});
  }

  bool chooseTopic();
  void readTransforms();
  void addScan(const PointCloud2& message, const ros::Time& recorded);
  void place(const PointCloud2& message, const Scan& scan);
  std::optional<Eigen::Isometry3d> poseOf(const PointCloud2& message);
  void countBlocks(bool flush);
  void judgeTime();
  void judgePoints();
  void judgeFrames();
  void judgeTransforms();
  void judgeDensity();

  const BagCheckRequest& request_;
  const std::string target_;
  const BagFiles bags_;
  BagReport report_;
  std::optional<Transforms> transforms_;
  Preprocessor preprocessor_;

  std::vector<double> stamps_;   // [s] of scans
  std::vector<double> offsets_;  // [s] from stamp to record
  std::size_t without_stamp_ = 0U;
  std::vector<double> sizes_;  // points of each scan
  std::size_t points_ = 0U;
  std::size_t non_finite_ = 0U;
  std::size_t at_origin_ = 0U;
  std::size_t out_of_range_ = 0U;
  std::size_t used_ = 0U;
  double coarsest_ = 0.0;
  std::map<std::string, std::size_t> unreadable_;  // by what was said
  std::map<std::string, std::size_t> frames_;      // of the scans
  std::map<std::string, std::size_t> unplaced_;    // by what tf said
  std::size_t before_tf_ = 0U;
  std::size_t after_tf_ = 0U;
  std::size_t blocks_ = 0U;
  std::size_t blocks_with_soil_ = 0U;
  std::vector<double> plant_heights_;  // [m] of blocks
  // Points at stem height of each square, by its place.
  std::map<std::pair<long, long>, std::size_t> cells_;
};

bool Checker::chooseTopic() {
  std::map<std::string, std::pair<std::string, std::size_t>> topics;  // type, messages
  const auto all = bags_.view();
  for (const rosbag::ConnectionInfo* connection : all->getConnections()) {
    topics[connection->topic] = {connection->datatype, 0U};
  }
  std::vector<std::string> clouds;
  for (auto& [topic, about] : topics) {
    about.second = bags_.view(rosbag::TopicQuery(topic))->size();
    if (about.first == "sensor_msgs/PointCloud2" && about.second > 0U) clouds.push_back(topic);
  }
  std::string list;
  for (const auto& [topic, about] : topics) {
    list += textOf(list.empty() ? "" : ", ", topic, " (", about.first, ", ", about.second, ")");
  }
  if (clouds.empty()) {
    const bool driver_only = list.find("velodyne_msgs") != std::string::npos ||
                             list.find("PacketMsg") != std::string::npos ||
                             list.find("LaserScan") != std::string::npos;
    fail("topics",
         "there is no sensor_msgs/PointCloud2, only: " + (list.empty() ? "nothing" : list),
         driver_only ? "record the driver's point cloud, not its packets"
                     : "record the topic of the scans, with /tf and /tf_static");
    return false;
  }
  report_.points_topic = request_.points_topic;
  if (report_.points_topic.empty()) {
    report_.points_topic = *std::max_element(
        clouds.begin(), clouds.end(),
        [&](const auto& a, const auto& b) { return topics[a].second < topics[b].second; });
    if (clouds.size() > 1U) {
      std::string others;
      for (const std::string& cloud : clouds) {
        if (cloud != report_.points_topic) others += (others.empty() ? "" : ", ") + cloud;
      }
      warn("topics",
           "there are several sensor_msgs/PointCloud2: " + report_.points_topic +
               " was checked, not " + others,
           "say which one holds the scans, --points-topic here and points_topic:= to replay: one "
           "LiDAR is measured at a time");
    }
    return true;
  }
  const auto asked = topics.find(report_.points_topic);
  if (asked != topics.end() && asked->second.first == "sensor_msgs/PointCloud2") return true;
  if (asked != topics.end()) {
    fail("topics", asked->first + " is " + asked->second.first + ", not sensor_msgs/PointCloud2",
         "use points_topic:=" + clouds.front());
  } else {
    fail("topics", "there is no topic " + report_.points_topic + ", only: " + list,
         "use points_topic:=" + nearestName(report_.points_topic, clouds));
  }
  return false;
}

void Checker::readTransforms() {
  const auto all = bags_.view();
  // Stamps may be of another clock than the record; forget nothing.
  transforms_.emplace(ros::Duration((all->getEndTime() - all->getBeginTime()).toSec() + 1e6));
  for (const bool is_static : {true, false}) {
    const std::string name = is_static ? "tf_static" : "tf";
    const auto wanted = [&](const rosbag::ConnectionInfo* connection) {
      return withoutSlash(connection->topic) == name;
    };
    const auto transforms = bags_.view(wanted);
    for (const rosbag::MessageInstance& instance : *transforms) {
      const auto message = instance.instantiate<tf2_msgs::TFMessage>();
      if (message) transforms_->add(*message, instance.getTime(), is_static);
    }
  }
}

void Checker::addScan(const PointCloud2& message, const ros::Time& recorded) {
  ++report_.scans;
  ++frames_[withoutSlash(message.header.frame_id)];
  if (message.header.stamp.isZero()) {
    ++without_stamp_;
  } else {
    stamps_.push_back(message.header.stamp.toSec());
    offsets_.push_back(recorded.toSec() - stamps_.back());
  }
  Scan scan;
  try {
    scan = toScan(message);
  } catch (const CloudFormatError& error) {
    ++unreadable_[error.what()];
    return;
  }
  sizes_.push_back(static_cast<double>(scan.cloud.size()));
  points_ += scan.cloud.size();
  coarsest_ = std::max(coarsest_, coordinateResolution(message, scan));
  for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
    if (scan.cloud.points[i].isZero() && scan.cloud.origin.isZero()) ++at_origin_;
  }
  place(message, scan);
}

std::optional<Eigen::Isometry3d> Checker::poseOf(const PointCloud2& message) {
  const std::string frame = withoutSlash(message.header.frame_id);
  if (frame == target_) return Eigen::Isometry3d::Identity();
  const ros::Time stamp = message.header.stamp;
  std::string reason;
  if (frame.empty() || stamp.isZero()) return std::nullopt;
  if (transforms_->buffer().canTransform(target_, frame, stamp, &reason)) {
    return tf2::transformToEigen(transforms_->buffer().lookupTransform(target_, frame, stamp));
  }
  ++unplaced_[frame];
  if (reason.find("past") != std::string::npos) ++before_tf_;
  if (reason.find("future") != std::string::npos) ++after_tf_;
  return std::nullopt;
}

void Checker::place(const PointCloud2& message, const Scan& scan) {
  const auto T_target_sensor = poseOf(message);
  if (!T_target_sensor) return;
  if (withoutSlash(message.header.frame_id) == target_ && !report_.registered) {
    report_.registered = true;
    PreprocessingParameters parameters = parametersOf(request_);
    parameters.min_range = 0.0;
    parameters.max_range = std::numeric_limits<double>::infinity();
    preprocessor_.setParameters(parameters);
  }
  const ScanReport report = preprocessor_.addScan(scan, *T_target_sensor);
  ++report_.scans_placed;
  non_finite_ += report.non_finite;
  out_of_range_ += report.out_of_range;
  used_ += report.used;
  countBlocks(false);
}

void Checker::countBlocks(bool flush) {
  for (const BlockIndex& index : preprocessor_.dueBlocks(flush)) {
    const Block block = preprocessor_.makeBlock(index, flush);
    preprocessor_.markHandedOn(block.header);
    ++blocks_;
    if (block.ground.observed()) ++blocks_with_soil_;
    // What an earlier revision said of the tile is replaced.
    const auto cellOf = [](double x) { return std::lround(std::floor(x / kDensityCell)); };
    for (auto cell = cells_.begin(); cell != cells_.end();) {
      const double x = (static_cast<double>(cell->first.first) + 0.5) * kDensityCell;
      const double y = (static_cast<double>(cell->first.second) + 0.5) * kDensityCell;
      cell = block.header.holds(x, y) ? cells_.erase(cell) : std::next(cell);
    }
    const double plant_height = plantHeightOf(block);
    if (plant_height < kLeastPlantHeight) continue;
    plant_heights_.push_back(plant_height);
    for (std::size_t i = 0; i < block.cloud.size(); ++i) {
      const double height = block.ground.heightAbove(block.cloud.points[i]);
      if (height < kStemBandLow * plant_height || height > kStemBandHigh * plant_height) continue;
      const Eigen::Vector3d p = block.cloud.mapPoint(i);
      const std::pair<long, long> cell{cellOf(p.x()), cellOf(p.y())};
      if (block.header.holds((static_cast<double>(cell.first) + 0.5) * kDensityCell,
                             (static_cast<double>(cell.second) + 0.5) * kDensityCell)) {
        ++cells_[cell];
      }
    }
  }
}

void Checker::judgeTime() {
  if (without_stamp_ > 0U && !report_.registered) {
    fail("time", textOf(without_stamp_, " of ", report_.scans, " scans have no stamp"),
         "let the driver stamp its scans: without one nobody knows where the sensor was");
  }
  if (stamps_.empty()) return;
  const auto [first, last] = std::minmax_element(stamps_.begin(), stamps_.end());
  report_.duration_s = *last - *first;
  std::vector<double> steps;
  std::size_t back = 0U;
  double furthest_back = 0.0;
  for (std::size_t i = 1; i < stamps_.size(); ++i) {
    const double step = stamps_[i] - stamps_[i - 1U];
    if (step < 0.0) {
      ++back;
      furthest_back = std::max(furthest_back, -step);
    } else {
      steps.push_back(step);
    }
  }
  if (back > 0U) {
    warn("time",
         textOf("the stamps of scans go back ", back, " times, by up to ", furthest_back, " s"),
         "if the bag was made of several, play each alone; else let one clock stamp all scans. "
         "Blocks that are open when time goes back by over 1 s are given up");
  }
  if (steps.empty()) return;
  const double usual = medianOf(steps);
  report_.rate_hz = usual > 0.0 ? 1.0 / usual : 0.0;
  std::size_t holes = 0U;
  double missing = 0.0;
  double longest = 0.0;
  for (const double step : steps) {
    if (step < std::max(kHole, kHoleFactor * usual)) continue;
    ++holes;
    missing += step;
    longest = std::max(longest, step);
  }
  if (holes > 0U) {
    warn("time",
         textOf("scans are missing: ", holes, " holes of ", missing, " s in all, the longest ",
                longest, " s, where one comes every ", usual, " s"),
         "was the disk too slow, or the network? Record to a local disk, with --buffsize 0");
  }
  const double offset = medianOf(offsets_);
  if (std::abs(offset) > kOtherClock) {
    warn("time",
         textOf("scans are recorded ", offset, " s ", offset > 0.0 ? "after" : "before",
                " their stamps: their clock is not that of the recording machine"),
         "synchronise the sensor's clock (PTP, PPS). It does no harm if the transforms have the "
         "same "
         "clock as the scans");
  }
}

void Checker::judgePoints() {
  for (const auto& [said, count] : unreadable_) {
    fail("fields", textOf(count, " of ", report_.scans, " scans cannot be read: ", said),
         "the driver, or what converts its clouds, must be put right");
  }
  if (sizes_.empty()) return;
  report_.points_per_scan = medianOf(sizes_);
  const auto empty = std::count(sizes_.begin(), sizes_.end(), 0.0);
  if (empty > 0) {
    const std::string what = textOf(empty, " of ", sizes_.size(), " scans hold no point");
    if (static_cast<std::size_t>(empty) == sizes_.size()) {
      fail("points", what, "does the sensor see anything?");
    } else if (2U * static_cast<std::size_t>(empty) > sizes_.size()) {
      warn("points", what, "does the sensor see anything?");
    }
  }
  if (points_ == 0U) return;
  const auto all = static_cast<double>(points_);
  const auto placed =
      static_cast<double>(std::max<std::size_t>(1U, non_finite_ + out_of_range_ + used_));
  report_.non_finite_share = static_cast<double>(non_finite_) / placed;
  if (report_.non_finite_share > kMostMisses) {
    warn("points", textOf(100.0 * report_.non_finite_share, " % of the points are not finite"),
         "are the returns filtered too strictly in the driver?");
  }
  if (static_cast<double>(at_origin_) > kMostAtOrigin * all) {
    warn("points",
         textOf(100.0 * static_cast<double>(at_origin_) / all, " % of the points are (0, 0, 0)"),
         report_.registered
             ? "misses were registered as if they were points: take them out before, or let the "
               "driver "
               "give NaN (REP 117)"
             : "they are misses; min_range drops them. Let the driver give NaN (REP 117)");
  }
  if (report_.scans_placed > 0U && used_ == 0U) {
    fail("points",
         textOf("no point is of use: ", non_finite_, " are not finite, ", out_of_range_,
                " lie outside min_range ... max_range or the crop box"),
         "are coordinates in metres? Set min_range, max_range or the crop box with --config");
  }
  if (coarsest_ > kCoarse) {
    warn("fields",
         textOf("so far from the origin FLOAT32 coordinates come in steps of ", coarsest_,
                " m: stems blur"),
         "use FLOAT64, or a frame with its origin nearby");
  }
}

void Checker::judgeFrames() {
  if (report_.scans == 0U) return;
  report_.sensor_frame =
      std::max_element(frames_.begin(), frames_.end(), [](const auto& a, const auto& b) {
        return a.second < b.second;
      })->first;
  if (frames_.count("") != 0U) {
    fail("frames", textOf(frames_[""], " of ", report_.scans, " scans have no frame_id"),
         "set frame_id in the driver");
  }
  if (frames_.size() > 1U) {
    std::string list;
    for (const auto& [frame, count] : frames_) {
      list += textOf(list.empty() ? "" : ", ", "'", frame, "' (", count, ")");
    }
    warn("frames", "scans come in several frames: " + list,
         "record each sensor on a topic of its own, or merge them in one frame");
  }
}

void Checker::judgeTransforms() {
  if (transforms_->invalid() > 0U) {
    warn("tf",
         textOf(transforms_->invalid(), " transforms are invalid: no frame, or no unit quaternion"),
         "put right whoever publishes them; tf2 ignores them");
  }
  const std::string& sensor = report_.sensor_frame;
  if (report_.scans == 0U || sensor.empty() || sensor == target_) return;
  report_.tf_chain = transforms_->chain(sensor, target_);
  if (report_.tf_chain.empty()) {
    const std::vector<std::string> frames = transforms_->frames();
    const bool known = std::find(frames.begin(), frames.end(), target_) != frames.end();
    std::string what = "no transform leads from '" + sensor + "' to '" + target_ + "'";
    std::string cure;
    if (transforms_->empty()) {
      what += ": the bag has none at all";
      cure =
          "record /tf and /tf_static as well. If the scans are registered already, use "
          "target_frame:=" +
          sensor;
    } else if (!known) {
      const std::vector<std::string> up = transforms_->pathUp(sensor);
      what += ": there is no such frame";
      cure = up.size() > 1U ? "use target_frame:=" + up.back() + ", which '" + sensor + "' hangs on"
                            : "the nearest name is '" + nearestName(target_, frames) +
                                  "'; is the SLAM's /tf recorded?";
    } else {
      what += ": '" + sensor + "' hangs on '" + transforms_->pathUp(sensor).back() + "', '" +
              target_ + "' on '" + transforms_->pathUp(target_).back() + "'";
      cure =
          "publish what joins them: the sensor's place on the rover (static_transform_publisher), "
          "or the rover's on the map (SLAM)";
    }
    fail("tf", what, cure);
    return;
  }
  for (std::size_t i = 0; i + 1U < report_.tf_chain.size(); ++i) {
    for (const auto& [child, parent] : {std::pair(report_.tf_chain[i], report_.tf_chain[i + 1U]),
                                        std::pair(report_.tf_chain[i + 1U], report_.tf_chain[i])}) {
      const Transforms::Edge* edge = transforms_->edge(child);
      if (edge == nullptr || edge->parents.count(parent) == 0U) continue;
      if (edge->parents.size() > 1U) {
        warn("tf",
             "'" + child + "' has several parents: " + *edge->parents.begin() + " and " +
                 *edge->parents.rbegin(),
             "two programs publish its place; let only one do so");
      }
      if (edge->is_static || edge->stamps.empty()) continue;
      if (edge->back > 0U) {
        warn("tf",
             textOf("the stamps of '", parent, "' -> '", child, "' go back ", edge->back, " times"),
             "do two programs publish it?");
      }
      std::vector<double> stamps = edge->stamps;
      std::sort(stamps.begin(), stamps.end());
      const auto [first, last] = std::minmax_element(stamps_.begin(), stamps_.end());
      double longest = 0.0;
      double where = 0.0;
      for (std::size_t k = 1; k < stamps.size() && first != stamps_.end(); ++k) {
        if (stamps[k] < *first || stamps[k - 1U] > *last) continue;
        if (stamps[k] - stamps[k - 1U] > longest) {
          longest = stamps[k] - stamps[k - 1U];
          where = stamps[k - 1U] - *first;
        }
      }
      report_.longest_tf_gap_s = std::max(report_.longest_tf_gap_s, longest);
      if (longest > kLongestTfGap) {
        warn("tf",
             textOf("'", parent, "' -> '", child, "' has a gap of ", longest, " s, ", where,
                    " s after the first scan: in between the pose is guessed"),
             textOf("let the SLAM publish at 10 Hz or more, best at each scan; leave scans in gaps "
                    "over ",
                    kLongestTfGap, " s out"));
      }
      report_.latest_tf_s = std::max(report_.latest_tf_s, quantile(edge->lags, 0.99));
    }
  }
  if (report_.latest_tf_s > kTfTimeout) {
    warn("tf",
         textOf("transforms come ", report_.latest_tf_s,
                " s after what they are for (99 % within that)"),
         textOf(
             "set tf_timeout above that for live use",
             report_.latest_tf_s > kPlayerAhead ? " and the player's tf_ahead for a replay" : ""));
  }
  std::size_t unplaced = 0U;
  for (const auto& entry : unplaced_) unplaced += entry.second;
  if (unplaced == 0U) return;
  const std::string what = textOf(unplaced, " of ", report_.scans,
                                  " scans have no transform at their stamp: ", before_tf_,
                                  " before the first one, ", after_tf_, " after the last one");
  const std::string cure =
      "start recording when the SLAM runs, and end it after the last scan; are scans and "
      "transforms "
      "stamped by the same clock?";
  if (report_.scans_placed == 0U) {
    fail("tf", what, cure);
  } else {
    warn("tf", what, cure);
  }
}

void Checker::judgeDensity() {
  if (used_ == 0U) return;
  countBlocks(true);
  report_.soil_share = static_cast<double>(blocks_with_soil_) / static_cast<double>(blocks_);
  if (blocks_with_soil_ == 0U) {
    warn("density", textOf("no soil was found in any of ", blocks_, " blocks"),
         "is z up in '" + target_ + "'? Was the soil cropped away? Heights need it");
  }
  std::vector<double> densities;
  for (const auto& cell : cells_) {
    densities.push_back(static_cast<double>(cell.second) / (kDensityCell * kDensityCell));
  }
  report_.area_m2 = static_cast<double>(cells_.size()) * kDensityCell * kDensityCell;
  if (densities.empty()) {
    fail("density", textOf("nothing is higher above the soil than ", kLeastPlantHeight, " m"),
         "is this a field with plants, in metres, with z up? Does the sensor look at it?");
    return;
  }
  report_.density = medianOf(densities);
  report_.plant_height = medianOf(plant_heights_);
  const std::string what =
      textOf(std::lround(report_.density), " points per square metre lie ",
             kStemBandLow * report_.plant_height, " to ", kStemBandHigh * report_.plant_height,
             " m above the soil, where plants of ", report_.plant_height,
             " m have stems (median over ", report_.area_m2, " m^2)");
  const std::string cure = "drive slower or nearer, on both sides of each row";
  if (report_.density < kDensityLeast) {
    fail("density", textOf(what, ": a diameter needs at least ", kDensityLeast), cure);
  } else if (report_.density < kDensityEnough) {
    warn("density", textOf(what, ": some diameters will be missing below ", kDensityEnough), cure);
  }
}

}  // namespace

BagReport checkBag(const BagCheckRequest& request) {
  return Checker(request).run();
}

}  // namespace field_phenotyping
