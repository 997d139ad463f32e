#include "phenotype_files.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

namespace field_phenotyping {
namespace {

class PhenotypeFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    directory_ = std::filesystem::temp_directory_path() /
                 ("phenotype_files_test_" + std::to_string(::getpid()));
    std::filesystem::create_directories(directory_);
    Phenotype measured;
    measured.id = 7;
    measured.base = {448262.1234, 2.5, -1.0};
    measured.height = {1.5, 0.01};
    measured.stem_diameter = {0.0213, 0.0004};
    measured.stem_points = 99U;
    measured.flags = kArcBelow | kShortStem;
    Phenotype unmeasured;
    unmeasured.id = 8;
    plants_ = {measured, unmeasured};
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  static std::string read(const std::filesystem::path& file) {
    std::ifstream stream(file);
    return {std::istreambuf_iterator<char>(stream), {}};
  }

  std::filesystem::path directory_;
  std::vector<Phenotype> plants_;
};

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream stream(line);
  for (std::string cell; std::getline(stream, cell, ',');) cells.push_back(cell);
  return cells;
}

TEST_F(PhenotypeFiles, CsvHasTheColumnsPromisedAndOneRowAPlant) {
  const auto file = directory_ / "plants.csv";
  writePhenotypeCsv(file, plants_);
  std::istringstream lines(read(file));
  std::string header, first, second, none;
  std::getline(lines, header);
  std::getline(lines, first);
  std::getline(lines, second);
  EXPECT_FALSE(std::getline(lines, none));
  EXPECT_EQ(header.rfind("plant_id,x,y,z,height,height_stddev,stem_diameter,stem_diameter_stddev,"
                         "stem_diameter_minor,diameter_height,lean,arc_coverage,stem_points,"
                         "plant_points,quality,",
                         0),
            0U)
      << header;
  const auto names = split(header), measured = split(first), unmeasured = split(second);
  ASSERT_EQ(measured.size(), names.size());
  ASSERT_EQ(unmeasured.size(), names.size());
  EXPECT_EQ(measured[0], "7");
  EXPECT_EQ(measured[1], "448262.123400");
  EXPECT_EQ(measured[4], "1.500000");
  EXPECT_EQ(measured[6], "0.021300");
  EXPECT_EQ(measured[12], "99");
  EXPECT_EQ(measured[14], flagNames(kArcBelow | kShortStem));
  EXPECT_EQ(unmeasured[4], "nan");
  EXPECT_EQ(unmeasured[14], "ok");
}

TEST_F(PhenotypeFiles, GeoJsonIsValidAndHasNullForWhatIsMissing) {
  const auto file = directory_ / "plants.geojson";
  writePhenotypeGeoJson(file, plants_, "field");
  const auto json = nlohmann::json::parse(read(file));
  EXPECT_EQ(json["type"], "FeatureCollection");
  EXPECT_EQ(json["frame_id"], "field");
  ASSERT_EQ(json["features"].size(), 2U);
  const auto& plant = json["features"][0];
  EXPECT_EQ(plant["geometry"]["type"], "Point");
  EXPECT_EQ(plant["geometry"]["coordinates"][0], 448262.1234);
  EXPECT_EQ(plant["properties"]["height"], 1.5);
  EXPECT_TRUE(json["features"][1]["properties"]["height"].is_null());
}

TEST_F(PhenotypeFiles, ReplacesAnOlderFileAndLeavesNoOther) {
  const auto file = directory_ / "plants.csv";
  writePhenotypeCsv(file, plants_);
  writePhenotypeCsv(file, {});
  const std::string text = read(file);
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(directory_), {}), 1);
}

TEST_F(PhenotypeFiles, NamesTheFileThatCannotBeWritten) {
  try {
    writePhenotypeCsv(directory_ / "missing" / "plants.csv", plants_);
    FAIL() << "no error";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("missing/plants.csv"), std::string::npos);
  }
}

}  // namespace
}  // namespace field_phenotyping
