#include "point_file.hpp"

#include <pcl/console/print.h>
#include <pcl/io/pcd_io.h>
#include <pcl/io/ply_io.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <fstream>
#include <new>
#include <numeric>

namespace field_phenotyping {
namespace {

namespace fs = std::filesystem;

constexpr const char* kNoPoints = " holds no points. Give a cloud that has some.";

std::string lowerCaseExtension(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

/// pcl::PCDReader turns words and missing numbers into zeros.
void checkNumbers(const fs::path& path, unsigned data_begin, std::size_t numbers_per_point) {
  std::ifstream file(path);
  file.seekg(data_begin);
  std::string line;
  for (std::size_t number = 1; std::getline(file, line); ++number) {
    const char* text = line.c_str();
    std::size_t found = 0;
    for (char* end = nullptr; std::strtod(text, &end), end != text; text = end) {
      ++found;
    }
    const bool rest_is_blank =
        line.find_first_not_of(" \t\r", static_cast<std::size_t>(text - line.c_str())) ==
        std::string::npos;
    if (!rest_is_blank || (found != 0 && found != numbers_per_point)) {
      throw std::runtime_error(path.string() + ": line " + std::to_string(number) +
                               " after DATA is not " + std::to_string(numbers_per_point) +
                               " numbers. Repair it.");
    }
  }
}

/// Refuses what makes pcl::PCDReader::read crash (PCL issue 5854) or fail without saying why.
void checkPcd(const fs::path& path) {
  pcl::PCLPointCloud2 header;
  Eigen::Vector4f origin;
  Eigen::Quaternionf orientation;
  int version = 0;
  int encoding = 0;  // 0 ASCII, 1 binary, 2 binary compressed
  unsigned data_begin = 0;
  const int result = pcl::PCDReader().readHeader(path.string(), header, origin, orientation,
                                                 version, encoding, data_begin);
  if (result < 0 || header.fields.empty()) {
    throw std::runtime_error(path.string() +
                             " has no valid PCD header. Give a .pcd or .ply point cloud.");
  }
  const std::uintmax_t points = static_cast<std::uintmax_t>(header.width) * header.height;
  if (points == 0) {
    throw std::runtime_error(path.string() + kNoPoints);
  }
  if (encoding == 0) {
    const std::size_t numbers_per_point =
        std::accumulate(header.fields.begin(), header.fields.end(), std::size_t{0},
                        [](std::size_t sum, const auto& field) { return sum + field.count; });
    checkNumbers(path, data_begin, numbers_per_point);
  }
  if (encoding == 1 && fs::file_size(path) < data_begin + points * header.point_step) {
    throw std::runtime_error(path.string() + " ends before its " + std::to_string(points) +
                             " points do: it was cut off. Write or copy it anew.");
  }
}

std::string namesOf(const pcl::PCLPointCloud2& data) {
  std::string names;
  for (const pcl::PCLPointField& field : data.fields) {
    names += (names.empty() ? "" : ", ") + field.name;
  }
  return names.empty() ? "none" : names;
}

}  // namespace

pcl::PCLPointCloud2 readPointFile(const fs::path& path) {
  // PCL reports through its own console; the caller gets one clear error instead.
  pcl::console::setVerbosityLevel(pcl::console::L_ALWAYS);
  if (!std::ifstream(path).good() || !fs::is_regular_file(path)) {
    throw std::runtime_error("cannot read " + path.string() +
                             ". Check that the file is there and may be read.");
  }
  const std::string extension = lowerCaseExtension(path);
  pcl::PCLPointCloud2 cloud;
  int result = -1;
  if (extension == ".pcd") {
    try {
      checkPcd(path);
      result = pcl::PCDReader().read(path.string(), cloud);
    } catch (const std::bad_alloc&) {
      throw std::runtime_error(path.string() +
                               ": its header promises more points than memory holds. It is broken, "
                               "or must be cut into parts.");
    }
  } else if (extension == ".ply") {
    Eigen::Vector4f origin;
    Eigen::Quaternionf orientation;
    int version = 0;
    result = pcl::PLYReader().read(path.string(), cloud, origin, orientation, version);
  } else {
    throw std::runtime_error(
        path.string() + " is neither .pcd nor .ply. Convert it, for instance with CloudCompare.");
  }
  if (result < 0) {
    throw std::runtime_error(
        path.string() + " is not a valid " + extension.substr(1) +
        " point cloud: its header is broken or points are missing. Write it anew.");
  }
  const std::size_t size = static_cast<std::size_t>(cloud.width) * cloud.height;
  if (size == 0 || cloud.data.size() < size * cloud.point_step) {
    throw std::runtime_error(path.string() + kNoPoints);
  }
  return cloud;
}

Field requireField(const pcl::PCLPointCloud2& contents, const std::string& name,
                   const fs::path& path) {
  for (const pcl::PCLPointField& field : contents.fields) {
    if (field.name == name) return Field(field);
  }
  throw std::runtime_error(path.string() + " has no field " + name + "; it has " +
                           namesOf(contents) + ". Give a cloud with x, y and z in metres.");
}

}  // namespace field_phenotyping
