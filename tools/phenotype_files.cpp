#include "phenotype_files.hpp"

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>

namespace field_phenotyping {
namespace {

/// Calls visit(name, value) for every column of plants.csv, in their order.
template <class Visitor>
void visitColumns(const Phenotype& p, Visitor&& visit) {
  visit("plant_id", p.id);
  visit("x", p.base.x());
  visit("y", p.base.y());
  visit("z", p.base.z());
  visit("height", p.height.value);
  visit("height_stddev", p.height.stddev);
  visit("stem_diameter", p.stem_diameter.value);
  visit("stem_diameter_stddev", p.stem_diameter.stddev);
  visit("stem_diameter_minor", p.stem_diameter_minor.value);
  visit("diameter_height", p.diameter_height);
  visit("lean", p.lean.value);
  visit("arc_coverage", p.arc_coverage);
  visit("stem_points", p.stem_points);
  visit("plant_points", p.plant_points);
  visit("quality", flagNames(p.flags));
  visit("axis_x", p.axis.x());
  visit("axis_y", p.axis.y());
  visit("axis_z", p.axis.z());
  visit("stem_diameter_minor_stddev", p.stem_diameter_minor.stddev);
  visit("stem_diameter_equivalent", p.stem_diameter_equivalent.value);
  visit("stem_diameter_equivalent_stddev", p.stem_diameter_equivalent.stddev);
  visit("lean_stddev", p.lean.stddev);
  visit("lean_azimuth", p.lean_azimuth);
  visit("spacing", p.spacing.value);
  visit("spacing_stddev", p.spacing.stddev);
  visit("completeness", p.completeness);
  visit("diameter_points", p.diameter_points);
  visit("synthetic_points", p.synthetic_points);
  visit("segmentation_quality", static_cast<double>(p.segmentation_quality));
  visit("revision", p.revision);
  visit("final", p.final);
}

std::string cell(double value) {
  if (!std::isfinite(value)) return "nan";
  char text[64];
  std::snprintf(text, sizeof(text), "%.6f", value);
  return text;
}
std::string cell(const std::string& value) {
  return value;
}
std::string cell(bool value) {
  return value ? "1" : "0";
}
template <class Integer>
std::string cell(Integer value) {
  return std::to_string(value);
}

nlohmann::json property(double value) {
  if (!std::isfinite(value)) return nullptr;
  return value;
}
template <class Value>
nlohmann::json property(const Value& value) {
  return value;
}

void replaceFile(const std::string& path, const std::string& content) {
  const std::string part = path + ".part";
  std::ofstream stream(part, std::ios::binary | std::ios::trunc);
  stream << content;
  stream.close();
  if (!stream) {
    throw std::runtime_error("cannot write " + part +
                             ": does the folder exist, may it be written, is the disk full?");
  }
  std::error_code error;
  std::filesystem::rename(part, path, error);
  if (error) throw std::runtime_error("cannot write " + path + ": " + error.message());
}

}  // namespace

void writePhenotypeCsv(const std::string& path, const std::vector<Phenotype>& plants) {
  std::string text;
  visitColumns(Phenotype(), [&](const char* name, const auto&) {
    text += (text.empty() ? "" : ",") + std::string(name);
  });
  text += "\n";
  for (const Phenotype& plant : plants) {
    const char* separator = "";
    visitColumns(plant, [&](const char*, const auto& value) {
      text += separator + cell(value);
      separator = ",";
    });
    text += "\n";
  }
  replaceFile(path, text);
}

void writePhenotypeGeoJson(const std::string& path, const std::vector<Phenotype>& plants,
                           const std::string& frame_id) {
  using Json = nlohmann::json;
  Json features = Json::array();
  for (const Phenotype& plant : plants) {
    Json properties;
    visitColumns(plant,
                 [&](const char* name, const auto& value) { properties[name] = property(value); });
    features.push_back(
        {{"type", "Feature"},
         {"id", plant.id},
         {"geometry",
          {{"type", "Point"},
           {"coordinates", Json::array({plant.base.x(), plant.base.y(), plant.base.z()})}}},
         {"properties", properties}});
  }
  const Json collection = {{"type", "FeatureCollection"},
                           {"frame_id", frame_id},
                           {"units", "m, rad"},
                           {"features", features}};
  replaceFile(path, collection.dump(1) + "\n");
}

}  // namespace field_phenotyping
