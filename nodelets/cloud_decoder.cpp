#include "cloud_decoder.hpp"

#include <sensor_msgs/PointField.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "field_phenotyping/common/float_step.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/usual_density.hpp"

namespace field_phenotyping {
namespace {

using sensor_msgs::PointCloud2;
using sensor_msgs::PointField;

// Beyond this distance from the frame's origin a cloud gets a local origin of its own [m].
constexpr double kFarFromOrigin = 500.0;
// So many points say where a cloud is; more of them would only take time.
constexpr std::size_t kOriginSamples = 101U;

template <class Value>
Value load(const std::uint8_t* bytes, bool swap) {
  std::array<std::uint8_t, sizeof(Value)> raw;
  std::copy_n(bytes, sizeof(Value), raw.begin());
  if (swap) std::reverse(raw.begin(), raw.end());
  Value value;
  std::memcpy(&value, raw.data(), sizeof(Value));
  return value;
}

std::string typeName(std::uint8_t datatype) {
  static const std::array<const char*, 9> names = {
      "type 0", "INT8", "UINT8", "INT16", "UINT16", "INT32", "UINT32", "FLOAT32", "FLOAT64"};
  return datatype < names.size() ? names[datatype] : "type " + std::to_string(datatype);
}

std::string fieldList(const PointCloud2& message) {
  // A broken message may hold thousands.
  constexpr std::size_t kMostListed = 20U;
  if (message.fields.empty()) return "none";
  std::string list;
  for (std::size_t i = 0; i < std::min(message.fields.size(), kMostListed); ++i) {
    const PointField& field = message.fields[i];
    list += (i == 0U ? "" : ", ") + field.name + " (" + typeName(field.datatype) + ")";
  }
  return message.fields.size() > kMostListed ? list + ", ..." : list;
}

/// The only field of this name; nullptr where there is none.
const PointField* findField(const PointCloud2& message, const char* name) {
  const PointField* found = nullptr;
  for (const PointField& field : message.fields) {
    if (field.name != name) continue;
    if (found != nullptr) {
      throw CloudFormatError("the cloud has two fields '" + field.name +
                             "': which of them counts? " + fieldList(message));
    }
    found = &field;
  }
  return found;
}

std::size_t sizeOf(const PointField& field) {
  return field.datatype == PointField::FLOAT64 ? 8U : 4U;
}

void requireInsidePoint(const PointField& field, const PointCloud2& message) {
  if (std::uint64_t{field.offset} + sizeOf(field) <= message.point_step) return;
  std::ostringstream what;
  what << "field " << field.name << " at offset " << field.offset << " reaches beyond the "
       << message.point_step << " bytes of a point; the driver that made the cloud is at fault";
  throw CloudFormatError(what.str());
}

const PointField& coordinateField(const PointCloud2& message, const char* name) {
  const PointField* field = findField(message, name);
  if (field == nullptr) {
    throw CloudFormatError("the cloud has no field '" + std::string(name) +
                           "', only: " + fieldList(message) + "; x, y and z are needed");
  }
  if (field->datatype != PointField::FLOAT32 && field->datatype != PointField::FLOAT64) {
    throw CloudFormatError("field '" + std::string(name) + "' is " + typeName(field->datatype) +
                           "; FLOAT32 or FLOAT64 is needed");
  }
  if (field->count > 1U) {
    throw CloudFormatError("field '" + std::string(name) + "' holds " +
                           std::to_string(field->count) + " values a point; one is needed");
  }
  requireInsidePoint(*field, message);
  return *field;
}

/// The packed colour, if the cloud has one that can be read.
const PointField* colorField(const PointCloud2& message) {
  for (const char* name : {"rgb", "rgba"}) {
    const PointField* field = findField(message, name);
    const bool packed =
        field != nullptr && field->count <= 1U &&
        (field->datatype == PointField::FLOAT32 || field->datatype == PointField::UINT32 ||
         field->datatype == PointField::INT32);
    if (!packed) continue;
    requireInsidePoint(*field, message);
    return field;
  }
  return nullptr;
}

/// Bytes from one row to the next. No product here can pass 64 bits: the message's counts have 32,
/// and a row of more than 32 bits is refused where there is more than one.
std::uint64_t checkedRowStep(const PointCloud2& message) {
  const std::uint64_t row = std::uint64_t{message.width} * message.point_step;
  // Many drivers leave row_step unset where there is only one row.
  const std::uint64_t step = message.height <= 1U ? row : message.row_step;
  if (step < row) {
    std::ostringstream what;
    what << "row_step is " << step << " bytes, but a row of " << message.width << " points of "
         << message.point_step << " bytes needs " << row
         << "; the driver that made the cloud is at fault";
    throw CloudFormatError(what.str());
  }
  const std::uint64_t needed =
      message.height == 0U || row == 0U ? 0U : step * (message.height - 1U) + row;
  if (message.data.size() < needed) {
    std::ostringstream what;
    what << "the cloud holds " << message.data.size() << " bytes, but " << message.width << " x "
         << message.height << " points need " << needed << "; it was cut short";
    throw CloudFormatError(what.str());
  }
  return step;
}

/// Where in its message each value of a point is. Holds only while the message does.
class PointReader {
 public:
  explicit PointReader(const PointCloud2& message)
      : message_(message),
        axes_({&coordinateField(message, "x"), &coordinateField(message, "y"),
               &coordinateField(message, "z")}),
        color_(colorField(message)),
        row_step_(checkedRowStep(message)),
        swap_((message.is_bigendian != 0U) != hostIsBigEndian()) {}

  std::size_t size() const { return std::size_t{message_.width} * message_.height; }
  bool hasColor() const { return color_ != nullptr; }

  const std::uint8_t* row(std::size_t index) const {
    return message_.data.data() + index * row_step_;
  }
  const std::uint8_t* point(std::size_t index) const {
    return row(index / message_.width) + index % message_.width * message_.point_step;
  }
  Eigen::Vector3d position(const std::uint8_t* point) const {
    return {coordinate(point, 0U), coordinate(point, 1U), coordinate(point, 2U)};
  }
  std::uint32_t color(const std::uint8_t* point) const {
    return load<std::uint32_t>(point + color_->offset, swap_) & 0xffffffU;
  }

 private:
  double coordinate(const std::uint8_t* point, std::size_t axis) const {
    const PointField& field = *axes_[axis];
    return field.datatype == PointField::FLOAT32
               ? static_cast<double>(load<float>(point + field.offset, swap_))
               : load<double>(point + field.offset, swap_);
  }

  const PointCloud2& message_;
  std::array<const PointField*, 3> axes_;
  const PointField* color_;
  std::uint64_t row_step_;
  bool swap_;
};

/// Whether every coordinate is one that a float can hold.
bool fitsFloat(const Eigen::Vector3d& p) {
  return p.array().abs().maxCoeff() <= double{std::numeric_limits<float>::max()} && p.allFinite();
}

/// Origin amid the cloud, on whole metres, or zero where the frame's own is near enough. By
/// medians, so that no stray point decides it.
Eigen::Vector3d chooseOrigin(const PointReader& reader) {
  std::array<std::vector<double>, 3> samples;
  const std::size_t step = std::max<std::size_t>(1U, reader.size() / kOriginSamples);
  for (std::size_t begin = 0; begin < reader.size(); begin += step) {
    // The first finite point of each stretch, for many scans hold more misses than returns.
    for (std::size_t i = begin; i < std::min(begin + step, reader.size()); ++i) {
      const Eigen::Vector3d p = reader.position(reader.point(i));
      if (!fitsFloat(p)) continue;
      for (std::size_t axis = 0; axis < 3U; ++axis) {
        samples[axis].push_back(p[static_cast<Eigen::Index>(axis)]);
      }
      break;
    }
  }
  if (samples[0].empty()) return Eigen::Vector3d::Zero();
  const Eigen::Vector3d middle(medianOf(std::move(samples[0])), medianOf(std::move(samples[1])),
                               medianOf(std::move(samples[2])));
  if (middle.cwiseAbs().maxCoeff() < kFarFromOrigin) return Eigen::Vector3d::Zero();
  return middle.array().round();
}

}  // namespace

bool hostIsBigEndian() {
  const std::uint16_t one = 1U;
  std::uint8_t first = 0U;
  std::memcpy(&first, &one, 1U);
  return first == 0U;
}

void requireValidStamp(const PointCloud2& message) {
  constexpr std::uint32_t kSecond = 1000000000U;  // [ns]
  if (message.header.stamp.nsec < kSecond) return;
  std::ostringstream what;
  what << "its stamp is " << message.header.stamp.sec << " s and " << message.header.stamp.nsec
       << " ns, more than a second of them; the driver that made the cloud is at fault";
  throw CloudFormatError(what.str());
}

Scan toScan(const PointCloud2& message) {
  requireValidStamp(message);
  const PointReader reader(message);
  Scan scan;
  scan.stamp_ns = message.header.stamp.toNSec();
  if (reader.size() == 0U) return scan;  // four billion rows of nothing are soon read
  scan.cloud.points.reserve(reader.size());
  if (reader.hasColor()) scan.cloud.colors.reserve(reader.size());
  scan.cloud.origin = chooseOrigin(reader);
  const Eigen::Vector3f no_point =
      Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN());
  for (std::size_t row = 0; row < message.height; ++row) {
    const std::uint8_t* point = reader.row(row);
    for (std::size_t column = 0; column < message.width; ++column, point += message.point_step) {
      const Eigen::Vector3d local = reader.position(point) - scan.cloud.origin;
      scan.cloud.points.push_back(fitsFloat(local) ? local.cast<float>() : no_point);
      if (reader.hasColor()) scan.cloud.colors.push_back(reader.color(point));
    }
  }
  return scan;
}

void requireMetres(const Scan& scan) {
  constexpr std::size_t kFewPoints = 1000U;  // are worked quickly whatever they are
  constexpr float kWide = 1000.0F;           // [m] so far no scan reaches, and no plot of a field
  constexpr std::size_t kLeast = 3U;         // [1/m^2]
  if (scan.cloud.size() < kFewPoints) return;
  Eigen::Array2f low = Eigen::Array2f::Constant(std::numeric_limits<float>::infinity());
  Eigen::Array2f high = -low;
  for (const Eigen::Vector3f& point : scan.cloud.points) {
    if (!point.allFinite()) continue;
    low = low.min(point.head<2>().array());
    high = high.max(point.head<2>().array());
  }
  const float width = (high - low).maxCoeff();
  if (!(width > kWide) || usualDensity(scan.cloud) >= kLeast) return;
  std::ostringstream text;
  text << "its points reach over " << width << " m and lie a metre or more apart: x y z must be in "
       << "metres";
  throw CloudFormatError(text.str());
}

double coordinateResolution(const PointCloud2& message, const Scan& scan) {
  constexpr std::array<const char*, 3> kNames = {"x", "y", "z"};
  double coarsest = 0.0;
  for (std::size_t axis = 0; axis < kNames.size(); ++axis) {
    const PointField* field = findField(message, kNames[axis]);
    if (field == nullptr || field->datatype != PointField::FLOAT32) continue;
    coarsest = std::max(coarsest, floatStep(scan.cloud.origin[static_cast<Eigen::Index>(axis)]));
  }
  return coarsest;
}

}  // namespace field_phenotyping
