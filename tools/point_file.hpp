#pragma once

#include <pcl/PCLPointCloud2.h>
#include <pcl/PCLPointField.h>

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <string>

namespace field_phenotyping {

/// A number in every point of a cloud, whatever its type.
class Field {
 public:
  explicit Field(const pcl::PCLPointField& field) : field_(field) {}

  double at(const std::uint8_t* point) const {
    switch (field_.datatype) {
      case pcl::PCLPointField::FLOAT64:
        return read<double>(point);
      case pcl::PCLPointField::FLOAT32:
        return static_cast<double>(read<float>(point));
      case pcl::PCLPointField::INT8:
        return read<std::int8_t>(point);
      case pcl::PCLPointField::UINT8:
        return read<std::uint8_t>(point);
      case pcl::PCLPointField::INT16:
        return read<std::int16_t>(point);
      case pcl::PCLPointField::UINT16:
        return read<std::uint16_t>(point);
      case pcl::PCLPointField::INT32:
        return read<std::int32_t>(point);
      case pcl::PCLPointField::UINT32:
        return read<std::uint32_t>(point);
      default:
        throw std::runtime_error("field " + field_.name +
                                 " has a type that is not known. Convert it to float.");
    }
  }

  std::uint32_t bitsAt(const std::uint8_t* point) const { return read<std::uint32_t>(point); }
  bool isDouble() const { return field_.datatype == pcl::PCLPointField::FLOAT64; }
  bool isFourBytes() const {
    return field_.datatype == pcl::PCLPointField::FLOAT32 ||
           field_.datatype == pcl::PCLPointField::UINT32 ||
           field_.datatype == pcl::PCLPointField::INT32;
  }

 private:
  template <typename Number>
  Number read(const std::uint8_t* point) const {
    Number number;
    std::memcpy(&number, point + field_.offset, sizeof(number));
    return number;
  }

  pcl::PCLPointField field_;
};

/// Reads a .pcd or .ply file with all its fields; it holds at least one point.
/// @throws std::runtime_error naming the file, what is wrong with it and what would help
pcl::PCLPointCloud2 readPointFile(const std::filesystem::path& path);

/// @throws std::runtime_error naming the fields that are there when `name` is not
Field requireField(const pcl::PCLPointCloud2& contents, const std::string& name,
                   const std::filesystem::path& path);

}  // namespace field_phenotyping
