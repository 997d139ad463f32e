#include "phenotype_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>

#include "field_phenotyping/completion/completion_flags.hpp"

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
  visit("row_spacing", p.row_spacing.value);
  visit("row_spacing_stddev", p.row_spacing.stddev);
  visit("stem_volume", p.stem_volume.value);
  visit("stem_volume_stddev", p.stem_volume.stddev);
  visit("diameter_prior_share", p.diameter_prior_share);
  visit("completeness", p.completeness);
  visit("diameter_points", p.diameter_points);
  visit("synthetic_points", p.synthetic_points);
  visit("completion", completionFlagNames(p.completion_flags));
  visit("segmentation_quality", static_cast<double>(p.segmentation_quality));
  visit("score", p.score);
  visit("revision", p.revision);
  visit("final", p.final);
  visit("passes", p.passes);
}

/// A plant as growth.csv has it.
struct GrownPlant {
  std::int32_t id = -1;
  Eigen::Vector3d base = Eigen::Vector3d::Zero();  ///< map frame [m]
  GrowthSummary growth;
  std::uint32_t stem_points = 0U;
};

/// The same of every column of growth.csv.
template <class Visitor>
void visitColumns(const GrownPlant& p, Visitor&& visit) {
  const auto count = [&](bool RegionSummary::*property) {
    return std::count_if(p.growth.regions.begin(), p.growth.regions.end(),
                         [&](const RegionSummary& region) { return region.*property; });
  };
  visit("plant_id", p.id);
  visit("x", p.base.x());
  visit("y", p.base.y());
  visit("z", p.base.z());
  visit("quality", static_cast<double>(p.growth.quality));
  visit("iterations", p.growth.iterations);
  visit("r1", static_cast<double>(p.growth.r1));
  visit("M", static_cast<double>(p.growth.M));
  visit("alpha", static_cast<double>(p.growth.alpha));
  visit("beta", static_cast<double>(p.growth.beta));
  visit("regions", p.growth.regions.size());
  visit("branchings", count(&RegionSummary::branching));
  visit("merged_regions", count(&RegionSummary::merged));
  visit("stem_points", p.stem_points);
}

/// A region as growth_regions.csv has it.
struct PlacedRegion {
  std::int32_t plant_id = -1;
  std::size_t number = 0U;                          ///< from the base up
  Eigen::Vector3d start = Eigen::Vector3d::Zero();  ///< map frame [m]
  Eigen::Vector3d end = Eigen::Vector3d::Zero();
  RegionSummary summary;
};

/// The same of every column of growth_regions.csv.
template <class Visitor>
void visitColumns(const PlacedRegion& r, Visitor&& visit) {
  visit("plant_id", r.plant_id);
  visit("region", r.number);
  visit("start_x", r.start.x());
  visit("start_y", r.start.y());
  visit("start_z", r.start.z());
  visit("end_x", r.end.x());
  visit("end_y", r.end.y());
  visit("end_z", r.end.z());
  visit("M", static_cast<double>(r.summary.M));
  visit("branching", r.summary.branching);
  visit("merged", r.summary.merged);
  visit("points", r.summary.points);
}

/// The same of every column of rows.csv.
template <class Visitor>
void visitColumns(const RowSummary& r, Visitor&& visit) {
  visit("row", r.row);
  visit("plants", r.plants);
  visit("plants_stddev", r.plants_stddev);
  visit("gaps", r.gaps);
  visit("missing_plants", r.missing);
  visit("longest_gap", r.longest_gap);
  visit("length", r.length);
  visit("plant_spacing", r.spacing.value);
  visit("plant_spacing_stddev", r.spacing.stddev);
  visit("row_spacing", r.row_spacing.value);
  visit("row_spacing_stddev", r.row_spacing.stddev);
  visit("start_x", r.start.x());
  visit("start_y", r.start.y());
  visit("end_x", r.end.x());
  visit("end_y", r.end.y());
}

/// The same of every column of canopy.csv.
template <class Visitor>
void visitColumns(const CanopyLayer& layer, Visitor&& visit) {
  visit("height", layer.height);
  visit("cover", layer.cover.value);
  visit("cover_stddev", layer.cover.stddev);
}

std::string cell(double value) {
  if (!std::isfinite(value)) return "nan";
  constexpr double kSmall = 1e-2;  // as volumes of stems are [m^3]
  char text[64];
  const bool small = value != 0.0 && std::abs(value) < kSmall;
  std::snprintf(text, sizeof(text), small ? "%.9f" : "%.6f", value);
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

template <class Row>
void writeCsv(const std::string& path, const std::vector<Row>& rows) {
  std::string text;
  visitColumns(Row(), [&](const char* name, const auto&) {
    text += (text.empty() ? "" : ",") + std::string(name);
  });
  text += "\n";
  for (const Row& row : rows) {
    const char* separator = "";
    visitColumns(row, [&](const char*, const auto& value) {
      text += separator + cell(value);
      separator = ",";
    });
    text += "\n";
  }
  replaceFile(path, text);
}

/// A plant that its block reports, and the origin of the block's local frame.
struct OwnedPlant {
  const Plant* plant;
  Eigen::Vector3d origin;

  Eigen::Vector3d inMap(const Eigen::Vector3f& p) const { return origin + p.cast<double>(); }
};

/// In the order of their ids, as plants.csv has them.
std::vector<OwnedPlant> ownedPlants(
    const std::vector<std::shared_ptr<const CompletedBlock>>& blocks) {
  std::vector<OwnedPlant> owned;
  for (const auto& block : blocks) {
    for (const Plant& plant : block->segmented->plants) {
      if (plant.owned) owned.push_back({&plant, block->segmented->cloud.origin});
    }
  }
  std::sort(owned.begin(), owned.end(),
            [](const OwnedPlant& a, const OwnedPlant& b) { return a.plant->id < b.plant->id; });
  return owned;
}

}  // namespace

void writePhenotypeCsv(const std::string& path, const std::vector<Phenotype>& plants) {
  writeCsv(path, plants);
}

void writeRowsCsv(const std::string& path, const std::vector<Phenotype>& plants) {
  writeCsv(path, summariseRows(plants));
}

void writeCanopyCsv(const std::string& path, const std::vector<CanopyLayer>& layers) {
  writeCsv(path, layers);
}

void writeGrowthCsv(const std::string& path,
                    const std::vector<std::shared_ptr<const CompletedBlock>>& blocks) {
  std::vector<GrownPlant> rows;
  for (const OwnedPlant& owned : ownedPlants(blocks)) {
    const Plant& plant = *owned.plant;
    rows.push_back({plant.id, owned.inMap(plant.base), plant.growth, plant.stem.size()});
  }
  writeCsv(path, rows);
}

void writeGrowthRegionsCsv(const std::string& path,
                           const std::vector<std::shared_ptr<const CompletedBlock>>& blocks) {
  std::vector<PlacedRegion> rows;
  for (const OwnedPlant& owned : ownedPlants(blocks)) {
    const std::vector<RegionSummary>& regions = owned.plant->growth.regions;
    for (std::size_t r = 0; r < regions.size(); ++r) {
      rows.push_back({owned.plant->id, r, owned.inMap(regions[r].start),
                      owned.inMap(regions[r].end), regions[r]});
    }
  }
  writeCsv(path, rows);
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
