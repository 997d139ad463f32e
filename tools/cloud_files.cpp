#include "cloud_files.hpp"

#include <pcl/io/pcd_io.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "point_file.hpp"

namespace field_phenotyping {
namespace {

using pcl::PCLPointCloud2;
using pcl::PCLPointField;

/// The coordinates of a file, read in double precision.
class CoordinateReader {
 public:
  CoordinateReader(const std::string& path, const PCLPointCloud2& contents)
      : axes_{requireField(contents, "x", path), requireField(contents, "y", path),
              requireField(contents, "z", path)} {}

  Eigen::Vector3d operator()(const std::uint8_t* point) const {
    return {axes_[0].at(point), axes_[1].at(point), axes_[2].at(point)};
  }
  bool isDouble() const { return axes_[0].isDouble(); }

 private:
  std::array<Field, 3> axes_;
};

const PCLPointField* findColor(const PCLPointCloud2& contents) {
  for (const PCLPointField& field : contents.fields) {
    const bool named = field.name == "rgb" || field.name == "rgba";
    if (named && Field(field).isFourBytes()) return &field;
  }
  return nullptr;
}

void addField(PCLPointCloud2& contents, const char* name, std::uint8_t type, std::uint32_t size) {
  PCLPointField field;
  field.name = name;
  field.offset = contents.point_step;
  field.datatype = type;
  field.count = 1;
  contents.fields.push_back(field);
  contents.point_step += size;
}

/// An empty cloud whose x y z are as precise as the input's.
PCLPointCloud2 cloudLike(const CloudFile& input, std::size_t count) {
  const bool wide = CoordinateReader("input", input.contents).isDouble();
  PCLPointCloud2 out;
  out.point_step = 0;
  for (const char* axis : {"x", "y", "z"}) {
    addField(out, axis, wide ? PCLPointField::FLOAT64 : PCLPointField::FLOAT32, wide ? 8U : 4U);
  }
  out.height = 1;
  out.width = static_cast<std::uint32_t>(count);
  return out;
}

void allocate(PCLPointCloud2& contents) {
  contents.row_step = contents.point_step * contents.width;
  contents.data.resize(static_cast<std::size_t>(contents.point_step) * contents.width);
}

template <class Value>
void store(PCLPointCloud2& contents, std::size_t point, std::size_t field, Value value) {
  std::memcpy(&contents.data[point * contents.point_step + contents.fields[field].offset], &value,
              sizeof(Value));
}

void storePosition(PCLPointCloud2& contents, std::size_t point, const Eigen::Vector3d& p) {
  for (int axis = 0; axis < 3; ++axis) {
    const auto field = static_cast<std::size_t>(axis);
    if (contents.fields[field].datatype == PCLPointField::FLOAT64) {
      store(contents, point, field, p[axis]);
    } else {
      store(contents, point, field, static_cast<float>(p[axis]));
    }
  }
}

void write(const std::string& path, const PCLPointCloud2& contents) {
  int status = -1;
  if (contents.width > 0U) {
    status = pcl::PCDWriter().writeBinary(path, contents);
  } else {
    status = pcl::PCDWriter().writeASCII(path, contents);  // PCL cannot map an empty binary file
  }
  if (status < 0) {
    throw std::runtime_error(path +
                             ": cannot be written; is the disk full or the folder read-only?");
  }
}

/// Whole metres near the middle of the finite points; NaN when there are none. The median, so that
/// a stray point does not set the origin that all others are stored relative to.
template <class PointAt>
Eigen::Vector3d medianPosition(std::size_t count, PointAt pointAt) {
  std::array<std::vector<double>, 3> values;
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d p = pointAt(i);
    if (!p.allFinite()) continue;
    for (int axis = 0; axis < 3; ++axis) values[static_cast<std::size_t>(axis)].push_back(p[axis]);
  }
  Eigen::Vector3d median = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double>& sorted = values[static_cast<std::size_t>(axis)];
    if (sorted.empty()) return median;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2U);
    std::nth_element(sorted.begin(), middle, sorted.end());
    median[axis] = std::round(*middle);
  }
  return median;
}

/// Colours that differ well from one plant to the next: hues a golden angle apart.
std::uint32_t plantColor(std::int32_t id) {
  constexpr double kGoldenRatio = 0.618033988749895;
  const double hue = std::fmod(kGoldenRatio * id, 1.0) * 6.0;
  const auto channel = [&](double shift) {
    const double k = std::fmod(hue + shift, 6.0);
    const double value = 1.0 - 0.75 * std::max(0.0, std::min({k, 4.0 - k, 1.0}));
    return static_cast<std::uint32_t>(255.0 * value);
  };
  return channel(5.0) << 16U | channel(3.0) << 8U | channel(1.0);
}

constexpr std::uint32_t kSyntheticColor = 0xFF0000U;

}  // namespace

CloudFile readCloudFile(const std::string& path) {
  CloudFile file;
  file.contents = readPointFile(path);
  const CoordinateReader coordinates(path, file.contents);
  const std::size_t count = static_cast<std::size_t>(file.contents.width) * file.contents.height;
  const PCLPointField* rgb = findColor(file.contents);

  const auto pointAt = [&](std::size_t i) {
    return coordinates(&file.contents.data[i * file.contents.point_step]);
  };
  file.cloud.origin = medianPosition(count, pointAt);
  if (!file.cloud.origin.allFinite()) {
    throw std::runtime_error(path + ": all " + std::to_string(count) +
                             " points are NaN or infinite; nothing can be measured");
  }
  file.cloud.points.resize(count);
  if (rgb != nullptr) file.cloud.colors.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    file.cloud.points[i] = (pointAt(i) - file.cloud.origin).cast<float>();
    if (rgb != nullptr) {
      file.cloud.colors[i] =
          Field(*rgb).bitsAt(&file.contents.data[i * file.contents.point_step]) & 0xFFFFFFU;
    }
  }
  return file;
}

void writeLabels(const std::string& path, const CloudFile& input,
                 const std::vector<PointLabel>& labels) {
  PCLPointCloud2 out = cloudLike(input, labels.size());
  addField(out, "plant_id", PCLPointField::INT32, 4U);
  addField(out, "part", PCLPointField::UINT8, 1U);
  allocate(out);
  const CoordinateReader coordinates(path, input.contents);
  for (std::size_t i = 0; i < labels.size(); ++i) {
    storePosition(out, i, coordinates(&input.contents.data[i * input.contents.point_step]));
    store(out, i, 3U, labels[i].plant_id);
    store(out, i, 4U, static_cast<std::uint8_t>(labels[i].part));
  }
  write(path, out);
}

void writeCompleted(const std::string& path, const CloudFile& input, const PipelineResult& result) {
  std::size_t count = 0U;
  for (const auto& block : result.blocks) {
    for (const Plant& plant : block->segmented->plants) {
      if (plant.owned) count += plant.stem.size();
    }
    count += block->synthetic.size();
  }
  PCLPointCloud2 out = cloudLike(input, count);
  addField(out, "rgb", PCLPointField::FLOAT32, 4U);
  addField(out, "plant_id", PCLPointField::INT32, 4U);
  addField(out, "synthetic", PCLPointField::UINT8, 1U);
  addField(out, "stddev", PCLPointField::FLOAT32, 4U);
  allocate(out);

  std::size_t next = 0U;
  const auto append = [&](const Eigen::Vector3d& position, std::int32_t id, bool synthetic,
                          float stddev) {
    storePosition(out, next, position);
    store(out, next, 3U, synthetic ? kSyntheticColor : plantColor(id));
    store(out, next, 4U, id);
    store(out, next, 5U, static_cast<std::uint8_t>(synthetic ? 1U : 0U));
    store(out, next, 6U, stddev);
    ++next;
  };
  for (const auto& block : result.blocks) {
    const SegmentedBlock& segmented = *block->segmented;
    for (std::size_t k = 0; k < segmented.plants.size(); ++k) {
      const Plant& plant = segmented.plants[k];
      if (!plant.owned) continue;
      const std::vector<Eigen::Vector3f>& smoothed = block->stems[k].smoothed;
      for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
        append(smoothed.empty()
                   ? segmented.cloud.mapPoint(i)
                   : segmented.cloud.origin + smoothed[i - plant.stem.begin].cast<double>(),
               plant.id, false, std::numeric_limits<float>::quiet_NaN());
      }
      const IndexSpan& filled = block->synthetic_span[k];
      for (std::uint32_t i = filled.begin; i < filled.end; ++i) {
        append(block->synthetic.mapPoint(i), plant.id, true, block->synthetic_stddev[i]);
      }
    }
  }
  write(path, out);
}

}  // namespace field_phenotyping
