// Writes a point cloud from a file as PointCloud2 messages of a ROS 1 bag.

#include <pcl/PCLPointCloud2.h>
#include <pcl/PCLPointField.h>
#include <rosbag/bag.h>
#include <sensor_msgs/PointCloud2.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <boost/make_shared.hpp>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "point_file.hpp"
#include "simulation/progress.hpp"

namespace {

namespace fs = std::filesystem;
using field_phenotyping::Field;
using field_phenotyping::readPointFile;
using field_phenotyping::requireField;
using field_phenotyping::simulation::ProgressBar;

constexpr double kLargestRounding = 1e-4;  // [m] that float32 may move a point by
constexpr double kCoarseInput = 1e-3;  // [m] steps of the input's own coordinates worth a warning
constexpr double kLatestStamp = 4294967295.0;  // [s] ros::Time counts seconds in 32 bits

struct Options {
  std::string input;
  std::string output;
  std::string topic = "/points";
  std::string frame = "map";
  std::size_t chunks = 1;
  double rate = 10.0;
  double stamp = 1700000000.0;
};

/// The fields of a file's cloud that a sensor would give.
struct Cloud {
  pcl::PCLPointCloud2 data;
  std::vector<Field> position;  // x, y, z
  std::optional<Field> rgb;
  std::optional<Field> intensity;
  std::vector<std::string> left_out;

  std::size_t size() const {
    return static_cast<std::size_t>(data.width) * static_cast<std::size_t>(data.height);
  }
  const std::uint8_t* point(std::size_t i) const { return data.data.data() + i * data.point_step; }
};

struct Extent {
  std::size_t finite_points = 0;
  double rounding = 0.0;  // [m] furthest that float32 would move a coordinate
  double largest = 0.0;   // [m] largest absolute coordinate
};

Cloud readCloud(const fs::path& path) {
  Cloud cloud;
  cloud.data = readPointFile(path);
  for (const char* axis : {"x", "y", "z"}) {
    cloud.position.push_back(requireField(cloud.data, axis, path));
  }
  for (const pcl::PCLPointField& field : cloud.data.fields) {
    const bool is_position = field.name == "x" || field.name == "y" || field.name == "z";
    if ((field.name == "rgb" || field.name == "rgba") && Field(field).isFourBytes()) {
      cloud.rgb = Field(field);
    } else if (field.name == "intensity") {
      cloud.intensity = Field(field);
    } else if (!is_position && field.name != "_") {
      cloud.left_out.push_back(field.name);
    }
  }
  return cloud;
}

Extent measure(const Cloud& cloud) {
  Extent extent;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    bool finite = true;
    for (const Field& axis : cloud.position) {
      const double value = axis.at(cloud.point(i));
      finite = finite && std::isfinite(value);
      if (std::isfinite(value)) {
        extent.rounding = std::max(
            extent.rounding, std::abs(static_cast<double>(static_cast<float>(value)) - value));
        extent.largest = std::max(extent.largest, std::abs(value));
      }
    }
    extent.finite_points += finite ? 1 : 0;
  }
  return extent;
}

/// Writes points [begin, end) of a cloud as messages: x y z, and rgb and intensity when there.
class MessageMaker {
 public:
  MessageMaker(const Cloud& cloud, bool double_positions, std::string frame)
      : cloud_(cloud), double_positions_(double_positions), frame_(std::move(frame)) {
    const std::uint8_t type =
        double_positions_ ? sensor_msgs::PointField::FLOAT64 : sensor_msgs::PointField::FLOAT32;
    for (const char* axis : {"x", "y", "z"}) {
      addField(axis, type, double_positions_ ? sizeof(double) : sizeof(float));
    }
    if (cloud_.rgb) {
      addField("rgb", sensor_msgs::PointField::FLOAT32, sizeof(float));
    }
    if (cloud_.intensity) {
      addField("intensity", sensor_msgs::PointField::FLOAT32, sizeof(float));
    }
  }

  std::size_t pointStep() const { return point_step_; }

  sensor_msgs::PointCloud2 make(std::size_t begin, std::size_t end, const ros::Time& stamp) const {
    sensor_msgs::PointCloud2 message;
    message.header.stamp = stamp;
    message.header.frame_id = frame_;
    message.height = 1;
    message.width = static_cast<std::uint32_t>(end - begin);
    message.fields = fields_;
    message.is_bigendian = 0;
    message.point_step = point_step_;
    message.row_step = message.width * point_step_;
    message.is_dense = 1;
    message.data.resize(message.row_step);
    std::uint8_t* out = message.data.data();
    for (std::size_t i = begin; i < end; ++i) {
      const bool finite = writePoint(cloud_.point(i), out);
      message.is_dense = message.is_dense != 0 && finite ? 1 : 0;
      out += point_step_;
    }
    return message;
  }

 private:
  void addField(const char* name, std::uint8_t type, std::size_t size) {
    sensor_msgs::PointField field;
    field.name = name;
    field.offset = point_step_;
    field.datatype = type;
    field.count = 1;
    fields_.push_back(field);
    point_step_ += static_cast<std::uint32_t>(size);
  }

  bool writePoint(const std::uint8_t* point, std::uint8_t* out) const {
    bool finite = true;
    const auto put = [&out](auto number) {
      std::memcpy(out, &number, sizeof(number));
      out += sizeof(number);
    };
    for (const Field& axis : cloud_.position) {
      const double value = axis.at(point);
      finite = finite && std::isfinite(value);
      if (double_positions_) {
        put(value);
      } else {
        put(static_cast<float>(value));
      }
    }
    if (cloud_.rgb) {
      put(cloud_.rgb->bitsAt(point));
    }
    if (cloud_.intensity) {
      put(static_cast<float>(cloud_.intensity->at(point)));
    }
    return finite;
  }

  const Cloud& cloud_;
  bool double_positions_;
  std::string frame_;
  std::vector<sensor_msgs::PointField> fields_;
  std::uint32_t point_step_ = 0;
};

void checkOptions(const Options& options) {
  if (options.frame.empty() || options.frame.front() == '/') {
    throw std::runtime_error("--frame \"" + options.frame +
                             "\" is not a tf frame: it must be a name without a leading slash.");
  }
  const bool topic_valid =
      options.topic.size() > 1 && options.topic.front() == '/' &&
      std::all_of(options.topic.begin(), options.topic.end(),
                  [](unsigned char c) { return std::isalnum(c) != 0 || c == '_' || c == '/'; });
  if (!topic_valid) {
    throw std::runtime_error("--topic \"" + options.topic +
                             "\" is not a topic: write a slash, then letters, digits, _ and /.");
  }
  if (!(options.rate > 0.0) || !std::isfinite(options.rate)) {
    throw std::runtime_error("--rate must be above 0 Hz.");
  }
  const double last = options.stamp + static_cast<double>(options.chunks) / options.rate;
  if (!(options.stamp > 0.0) || !(last < kLatestStamp)) {
    throw std::runtime_error(
        "--stamp must be above 0 s, and the last message before 4294967295 s.");
  }
}

void checkChunks(const Options& options, const Cloud& cloud, std::size_t point_step) {
  if (options.chunks < 1 || options.chunks > cloud.size()) {
    throw std::runtime_error("--chunks must be from 1 to the number of points, " +
                             std::to_string(cloud.size()) + ".");
  }
  const std::size_t bytes = (cloud.size() / options.chunks + 1) * point_step;
  if (bytes > std::numeric_limits<std::int32_t>::max()) {
    throw std::runtime_error("a message of " + std::to_string(bytes / 1000000) +
                             " MB is more than ROS carries (2147 MB). Give a larger --chunks.");
  }
}

/// rosbag play repeats what the header of a connection says: latched or not.
boost::shared_ptr<ros::M_string> connectionHeader(bool latched) {
  const auto header = boost::make_shared<ros::M_string>();
  using Message = sensor_msgs::PointCloud2;
  (*header)["type"] = ros::message_traits::DataType<Message>::value();
  (*header)["md5sum"] = ros::message_traits::MD5Sum<Message>::value();
  (*header)["message_definition"] = ros::message_traits::Definition<Message>::value();
  (*header)["callerid"] = "/cloud_to_bag";
  (*header)["latching"] = latched ? "1" : "0";
  return header;
}

void writeMessages(const Options& options, const Cloud& cloud, const MessageMaker& maker,
                   const fs::path& path) {
  ProgressBar progress;
  rosbag::Bag bag(path.string(), rosbag::bagmode::Write);
  const auto header = connectionHeader(options.chunks == 1);
  for (std::size_t i = 0; i < options.chunks; ++i) {
    const ros::Time stamp(options.stamp + static_cast<double>(i) / options.rate);
    const std::size_t begin = i * cloud.size() / options.chunks;
    const std::size_t end = (i + 1) * cloud.size() / options.chunks;
    bag.write(options.topic, stamp, maker.make(begin, end, stamp), header);
    progress.update("writing the bag",
                    static_cast<double>(i + 1) / static_cast<double>(options.chunks));
  }
  bag.close();
}

/// The bag appears under its name only when it is whole.
void writeBag(const Options& options, const Cloud& cloud, const MessageMaker& maker) {
  const fs::path unfinished = options.output + ".active";
  try {
    writeMessages(options, cloud, maker, unfinished);
    fs::rename(unfinished, options.output);
  } catch (const std::exception& error) {
    std::error_code ignored;
    fs::remove(unfinished, ignored);
    throw std::runtime_error("cannot write " + options.output + " (" + error.what() +
                             "). Check that its folder is there, may be written and has room.");
  }
}

void describeInput(const Options& options, const Cloud& cloud, const Extent& extent) {
  if (extent.finite_points < cloud.size()) {
    std::printf("%zu points are not finite; they stay in place and the message says is_dense 0.\n",
                cloud.size() - extent.finite_points);
  }
  if (!cloud.left_out.empty()) {
    std::string names;
    for (const std::string& name : cloud.left_out) {
      names += " " + name;
    }
    std::printf("Fields left out, as no sensor gives them:%s\n", names.c_str());
  }
  const double step = extent.largest * static_cast<double>(std::numeric_limits<float>::epsilon());
  if (!cloud.position.front().isDouble() && step > kCoarseInput) {
    std::fprintf(stderr,
                 "cloud_to_bag: warning: %s holds 32-bit coordinates up to %.0f m, which lie about "
                 "%.1f mm apart. Export it with 64-bit coordinates or move it nearer to zero.\n",
                 options.input.c_str(), extent.largest, 1000.0 * step);
  }
}

void run(const Options& options) {
  checkOptions(options);
  std::fprintf(stderr, "reading %s\n", options.input.c_str());
  const Cloud cloud = readCloud(options.input);
  const Extent extent = measure(cloud);
  if (extent.finite_points == 0) {
    throw std::runtime_error("none of the " + std::to_string(cloud.size()) + " points of " +
                             options.input + " is finite. Export the cloud anew.");
  }
  describeInput(options, cloud, extent);
  const bool double_positions = extent.rounding > kLargestRounding;
  if (double_positions) {
    std::printf("x y z are written as FLOAT64: FLOAT32 would move points by up to %.1f mm.\n",
                1000.0 * extent.rounding);
  }
  const MessageMaker maker(cloud, double_positions, options.frame);
  checkChunks(options, cloud, maker.pointStep());
  writeBag(options, cloud, maker);
  std::printf("Wrote %zu points in %zu message%s on %s, frame %s, to %s\n", cloud.size(),
              options.chunks, options.chunks == 1 ? " (latched)" : "s", options.topic.c_str(),
              options.frame.c_str(), options.output.c_str());
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{
      "Writes a point cloud as a ROS 1 bag of sensor_msgs/PointCloud2: x y z in metres, and rgb "
      "and\n"
      "intensity when there. One latched message, or the points in the file's order as chunks. "
      "Play\n"
      "a latched one with rosbag play --clock --keep-alive. x y z are FLOAT32, or FLOAT64 where\n"
      "FLOAT32 would move a point by over 0.1 mm (coordinates far from zero)."};
  app.add_option("input", options.input, "Point cloud, .pcd or .ply, x y z in metres")->required();
  app.add_option("--output", options.output, "Bag to write")->required();
  app.add_option("--topic", options.topic, "Topic of the messages")->capture_default_str();
  app.add_option("--frame", options.frame, "tf frame that x y z are given in")
      ->capture_default_str();
  app.add_option("--chunks", options.chunks, "Number of messages [count]; 1 makes it latched")
      ->capture_default_str();
  app.add_option("--rate", options.rate, "Messages per second of bag time [Hz]")
      ->capture_default_str();
  app.add_option("--stamp", options.stamp, "Time of the first message [s since 1970]")
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "cloud_to_bag: error: %s\n", error.what());
    return 2;
  }
  return 0;
}
