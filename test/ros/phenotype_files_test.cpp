#include "phenotype_files.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

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

/// Two blocks: plants 9 and 4, the second with two regions, and a neighbour's plant, which is not
/// reported.
std::vector<std::shared_ptr<const CompletedBlock>> grownBlocks() {
  const auto block = [](std::vector<Plant> plants, const Eigen::Vector3d& origin) {
    auto segmented = std::make_shared<SegmentedBlock>();
    segmented->cloud.origin = origin;
    segmented->plants = std::move(plants);
    auto completed = std::make_shared<CompletedBlock>();
    completed->segmented = std::move(segmented);
    return std::shared_ptr<const CompletedBlock>(std::move(completed));
  };
  Plant bare;
  bare.id = 9;
  Plant neighbor;
  neighbor.id = 4;
  neighbor.owned = false;
  Plant grown;
  grown.id = 4;
  grown.base = {1.0F, 2.0F, 0.5F};
  grown.stem = {10U, 52U};
  grown.growth = {0.75F, 3U, 0.05F, 0.45F, 0.25F, 0.85F, {}};
  grown.growth.regions.push_back({{1.0F, 2.0F, 0.5F}, {1.0F, 2.0F, 1.0F}, 0.45F, false, true, 30U});
  grown.growth.regions.push_back({{1.0F, 2.0F, 1.0F}, {1.0F, 2.25F, 2.0F}, 0.36F, true, false, 8U});
  return {block({bare, neighbor}, Eigen::Vector3d::Zero()),
          block({grown}, {448000.0, 5411000.0, 90.0})};
}

TEST_F(PhenotypeFiles, GrowthHasOneRowAReportedPlantInTheMapFrame) {
  const auto file = directory_ / "growth.csv";
  writeGrowthCsv(file, grownBlocks());
  EXPECT_EQ(read(file),
            "plant_id,x,y,z,quality,iterations,r1,M,alpha,beta,regions,branchings,merged_regions,"
            "stem_points\n"
            "4,448001.000000,5411002.000000,90.500000,0.750000,3,0.050000,0.450000,0.250000,"
            "0.850000,2,1,1,42\n"
            "9,0.000000,0.000000,0.000000,0.000000,0,0.000000,0.000000,0.000000,0.000000,0,0,0,"
            "0\n");
  writeGrowthCsv(file, {});
  const std::string text = read(file);
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1);
}

TEST_F(PhenotypeFiles, GrowthRegionsHaveOneRowARegionFromTheBaseUp) {
  const auto file = directory_ / "growth_regions.csv";
  writeGrowthRegionsCsv(file, grownBlocks());
  EXPECT_EQ(read(file),
            "plant_id,region,start_x,start_y,start_z,end_x,end_y,end_z,M,branching,merged,points\n"
            "4,0,448001.000000,5411002.000000,90.500000,448001.000000,5411002.000000,91.000000,"
            "0.450000,0,1,30\n"
            "4,1,448001.000000,5411002.000000,91.000000,448001.000000,5411002.250000,92.000000,"
            "0.360000,1,0,8\n");
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
