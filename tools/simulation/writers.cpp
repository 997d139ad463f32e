#include "simulation/writers.hpp"

#include <cmath>
#include <cstring>
#include <fstream>
#include <locale>
#include <stdexcept>
#include <vector>

namespace field_phenotyping::simulation {
namespace {

struct PcdField {
  const char* name;
  int size;
  char type;
};

/// Appends binary records to a PCD file.
class PcdFile {
 public:
  PcdFile(const std::string& path, const std::vector<PcdField>& fields, std::uint64_t points)
      : path_(path), file_(path, std::ios::binary) {
    std::string names, sizes, types, counts;
    for (const PcdField& field : fields) {
      names += std::string(" ") + field.name;
      sizes += " " + std::to_string(field.size);
      types += std::string(" ") + field.type;
      counts += " 1";
    }
    const std::string count = std::to_string(points);
    file_ << "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS" << names << "\nSIZE"
          << sizes << "\nTYPE" << types << "\nCOUNT" << counts << "\nWIDTH " << count
          << "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " << count << "\nDATA binary\n";
  }

  template <typename Value>
  void put(Value value) {
    char bytes[sizeof(Value)];
    std::memcpy(bytes, &value, sizeof(Value));
    buffer_.insert(buffer_.end(), bytes, bytes + sizeof(Value));
    if (buffer_.size() > (1U << 20U)) {
      flush();
    }
  }

  void putPosition(const Eigen::Vector3d& position, bool double_precision) {
    for (Eigen::Index i = 0; i < 3; ++i) {
      if (double_precision) {
        put(position[i]);
      } else {
        put(static_cast<float>(position[i]));
      }
    }
  }

  void close() {
    flush();
    file_.close();
    if (!file_) {
      throw std::runtime_error("cannot write " + path_ + ": is the disk full or read-only?");
    }
  }

 private:
  void flush() {
    file_.write(buffer_.data(), static_cast<std::streamsize>(buffer_.size()));
    buffer_.clear();
  }

  std::string path_;
  std::ofstream file_;
  std::vector<char> buffer_;
};

std::vector<PcdField> positionFields(bool double_precision) {
  const int size = double_precision ? 8 : 4;
  return {{"x", size, 'F'}, {"y", size, 'F'}, {"z", size, 'F'}};
}

/// A CSV file; numbers with a full stop whatever the locale of the user.
class CsvFile {
 public:
  CsvFile(const std::string& path, const char* header) : path_(path), file_(path) {
    file_.imbue(std::locale::classic());
    file_ << header << '\n' << std::fixed;
  }

  CsvFile& integer(std::int64_t value) {
    separate();
    file_ << value;
    return *this;
  }
  CsvFile& number(double value, int decimals = 6) {
    separate();
    file_.precision(decimals);
    if (std::isnan(value)) {
      file_ << "nan";
    } else {
      file_ << value;
    }
    return *this;
  }
  CsvFile& text(const std::string& value) {
    separate();
    file_ << value;
    return *this;
  }
  void endLine() {
    file_ << '\n';
    first_ = true;
  }
  void close() {
    file_.close();
    if (!file_) {
      throw std::runtime_error("cannot write " + path_ + ": is the disk full or read-only?");
    }
  }

 private:
  void separate() {
    if (!first_) {
      file_ << ',';
    }
    first_ = false;
  }

  std::string path_;
  std::ofstream file_;
  bool first_ = true;
};

}  // namespace

bool needsDoublePrecision(const Eigen::Vector3d& origin) {
  constexpr double kFloatLimit = 1000.0;
  return origin.cwiseAbs().maxCoeff() > kFloatLimit;
}

void writeCloud(const Simulation& simulation, const std::string& path) {
  const Eigen::Vector3d& origin = simulation.settings.origin;
  const bool double_precision = needsDoublePrecision(origin);
  std::vector<PcdField> fields = positionFields(double_precision);
  fields.insert(fields.end(), {{"plant_id", 4, 'I'}, {"part", 1, 'U'}, {"intensity", 4, 'F'}});
  PcdFile file(path, fields, simulation.pointCount());
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      file.putPosition(origin + scan.mapPosition(point), double_precision);
      file.put(point.plant_id);
      file.put(static_cast<std::uint8_t>(point.part));
      file.put(point.intensity);
    }
  }
  file.close();
}

void writeStemSurface(const Simulation& simulation, const std::string& path) {
  constexpr double kSpacing = 0.002;
  const Eigen::Vector3d& origin = simulation.settings.origin;
  const bool double_precision = needsDoublePrecision(origin);
  std::vector<std::vector<Eigen::Vector3d>> points, normals;
  std::uint64_t count = 0;
  for (const MaizePlant& plant : simulation.field->plants) {
    normals.emplace_back();
    points.push_back(sampleStemSurface(plant.stem, kSpacing, normals.back()));
    count += points.back().size();
  }
  std::vector<PcdField> fields = positionFields(double_precision);
  fields.insert(
      fields.end(),
      {{"normal_x", 4, 'F'}, {"normal_y", 4, 'F'}, {"normal_z", 4, 'F'}, {"plant_id", 4, 'I'}});
  PcdFile file(path, fields, count);
  for (std::size_t plant = 0; plant < points.size(); ++plant) {
    for (std::size_t i = 0; i < points[plant].size(); ++i) {
      file.putPosition(origin + points[plant][i], double_precision);
      file.putPosition(normals[plant][i], false);
      file.put(simulation.field->plants[plant].id);
    }
  }
  file.close();
}

void writeTruth(const Simulation& simulation, const std::string& path) {
  CsvFile file(path,
               "plant_id,row,x,y,z,height,stem_diameter,stem_diameter_minor,diameter_height,"
               "stem_length,lean,lean_azimuth,stage,visible_points,visible_stem_points,"
               "highest_visible_z,axis_x,axis_y,axis_z");
  const std::string stage = stageName(simulation.settings.field.plant.stage);
  for (const PlantTruth& truth : simulation.truth()) {
    file.integer(truth.plant_id).integer(truth.row);
    file.number(truth.base.x()).number(truth.base.y()).number(truth.base.z());
    file.number(truth.height).number(truth.stem_diameter).number(truth.stem_diameter_minor);
    file.number(truth.diameter_height).number(truth.stem_length);
    file.number(truth.lean).number(truth.lean_azimuth).text(stage);
    file.integer(static_cast<std::int64_t>(truth.visible_points));
    file.integer(static_cast<std::int64_t>(truth.visible_stem_points));
    file.number(truth.highest_visible_z);
    file.number(truth.axis.x()).number(truth.axis.y()).number(truth.axis.z());
    file.endLine();
  }
  file.close();
}

void writeTrajectory(const Simulation& simulation, double start_time, const std::string& path) {
  CsvFile file(path, "scan,time,x,y,z,qx,qy,qz,qw,points");
  for (std::size_t i = 0; i < simulation.scans.size(); ++i) {
    const Scan& scan = simulation.scans[i];
    const Eigen::Vector3d position = simulation.settings.origin + scan.T_map_lidar.translation();
    const Eigen::Quaterniond rotation(scan.T_map_lidar.linear());
    file.integer(static_cast<std::int64_t>(i)).number(start_time + scan.time);
    file.number(position.x()).number(position.y()).number(position.z());
    file.number(rotation.x(), 9).number(rotation.y(), 9).number(rotation.z(), 9);
    file.number(rotation.w(), 9).integer(static_cast<std::int64_t>(scan.points.size()));
    file.endLine();
  }
  file.close();
}

}  // namespace field_phenotyping::simulation
