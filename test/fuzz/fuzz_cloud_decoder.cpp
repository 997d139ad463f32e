// Hands libFuzzer's bytes to the cloud decoder, as a sensor_msgs/PointCloud2 in ROS's wire format,
// and what it reads on to the voxel map. A message must be read whole or be refused by
// CloudFormatError.
#include <sensor_msgs/PointCloud2.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "cloud_decoder.hpp"

namespace field_phenotyping {
namespace {

// More points only make a run slow: what is special about a layout shows with few.
constexpr std::size_t kMostPointsPlaced = 512U;

/// Reads wire format. Where the bytes end it gives zeros, so that no input is in vain.
class WireReader {
 public:
  WireReader(const std::uint8_t* data, std::size_t size) : data_(data), left_(size) {}

  template <class Value>
  Value value() {
    Value result{};
    const std::size_t size = std::min(sizeof(Value), left_);
    std::memcpy(&result, data_, size);
    skip(size);
    return result;
  }
  std::size_t length() { return std::min<std::size_t>(value<std::uint32_t>(), left_); }
  std::string text() {
    const std::size_t size = length();
    std::string result(reinterpret_cast<const char*>(data_), size);
    skip(size);
    return result;
  }
  std::vector<std::uint8_t> bytes() {
    const std::size_t size = length();
    std::vector<std::uint8_t> result(data_, data_ + size);
    skip(size);
    return result;
  }

 private:
  void skip(std::size_t size) {
    data_ += size;
    left_ -= size;
  }

  const std::uint8_t* data_;
  std::size_t left_;
};

sensor_msgs::PointCloud2 messageFrom(WireReader wire) {
  sensor_msgs::PointCloud2 message;
  message.header.seq = wire.value<std::uint32_t>();
  message.header.stamp.sec = wire.value<std::uint32_t>();
  message.header.stamp.nsec = wire.value<std::uint32_t>();
  message.header.frame_id = wire.text();
  message.height = wire.value<std::uint32_t>();
  message.width = wire.value<std::uint32_t>();
  message.fields.resize(wire.length());
  for (sensor_msgs::PointField& field : message.fields) {
    field.name = wire.text();
    field.offset = wire.value<std::uint32_t>();
    field.datatype = wire.value<std::uint8_t>();
    field.count = wire.value<std::uint32_t>();
  }
  message.is_bigendian = wire.value<std::uint8_t>();
  message.point_step = wire.value<std::uint32_t>();
  message.row_step = wire.value<std::uint32_t>();
  message.data = wire.bytes();
  message.is_dense = wire.value<std::uint8_t>();
  return message;
}

void require(bool holds) {
  if (!holds) std::abort();
}

void decode(const sensor_msgs::PointCloud2& message) {
  Scan scan;
  try {
    scan = toScan(message);
  } catch (const CloudFormatError& error) {
    require(std::strlen(error.what()) > 0U);
    return;
  }
  require(scan.cloud.size() == std::uint64_t{message.width} * message.height);
  require(!scan.cloud.hasColors() || scan.cloud.colors.size() == scan.cloud.size());
  require(scan.cloud.origin.allFinite());
  require(!(coordinateResolution(message, scan) < 0.0));
  if (scan.cloud.size() > kMostPointsPlaced) return;
  Preprocessor preprocessor(PreprocessingParameters(), "map");
  const ScanReport report = preprocessor.addScan(scan, Eigen::Isometry3d::Identity());
  require(report.points == scan.cloud.size());
  require(report.non_finite + report.out_of_range + report.used == report.points);
}

}  // namespace
}  // namespace field_phenotyping

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  field_phenotyping::decode(field_phenotyping::messageFrom({data, size}));
  return 0;
}
