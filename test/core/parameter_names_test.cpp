// What is said of a parameter that is given wrongly.

#include "field_phenotyping/parameter_names.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "field_phenotyping/common/nearest_name.hpp"

namespace field_phenotyping {
namespace {

TEST(EditDistance, CountsInsertionsDeletionsAndReplacements) {
  EXPECT_EQ(editDistance("", ""), 0U);
  EXPECT_EQ(editDistance("", "abc"), 3U);
  EXPECT_EQ(editDistance("abc", ""), 3U);
  EXPECT_EQ(editDistance("kitten", "sitting"), 3U);
  EXPECT_EQ(editDistance("voxel_size", "voxelsize"), 1U);
  EXPECT_EQ(editDistance("ab", "ba"), 2U);
}

TEST(NearestName, IsTheFirstOfTheNearest) {
  const std::vector<std::string> names = {"max_x", "max_y", "voxel_size"};
  EXPECT_EQ(nearestName("max_z", names), "max_x");
  EXPECT_EQ(nearestName("voxelsize", names), "voxel_size");
}

TEST(UnknownParameter, NamesTheNearestWithItsRange) {
  EXPECT_EQ(unknownParameter("preprocessing", "voxelsize"),
            "there is no parameter 'preprocessing/voxelsize'; did you mean "
            "'preprocessing/voxel_size' (0.0005 ... 0.1 m)?");
  EXPECT_NE(unknownParameter("measurement", "moed").find("'measurement/mode' (robust or paper)"),
            std::string::npos);
  EXPECT_NE(unknownParameter("completion", "enable").find("'completion/enabled' (true or false)"),
            std::string::npos);
}

TEST(UnknownParameter, FindsNamesOfOtherStages) {
  EXPECT_NE(unknownParameter("segmentation", "block_size").find("'preprocessing/block_size'"),
            std::string::npos);
  // Both stages have one of this name; the one asked for is nearer.
  EXPECT_NE(unknownParameter("measurement", "min_point").find("'measurement/min_points'"),
            std::string::npos);
}

TEST(UnknownParameter, OffersFurtherNamesOfTheStage) {
  EXPECT_NE(unknownParameter("preprocessing", "targetframe", {"target_frame"})
                .find("did you mean 'preprocessing/target_frame'?"),
            std::string::npos);
}

TEST(UnknownStage, NamesTheNearest) {
  EXPECT_EQ(unknownStage("segmentaton"),
            "there is no stage 'segmentaton'; did you mean 'segmentation'?");
}

TEST(MisspeltStage, IsFoundOnlyWhereItIsNear) {
  EXPECT_EQ(misspeltStage("segmentaton"), "segmentation");
  EXPECT_EQ(misspeltStage("Preprocesing"), "preprocessing");
  EXPECT_EQ(misspeltStage("segmentation"), "") << "this one is right";
  EXPECT_EQ(misspeltStage("record_phenotypes"), "");
  EXPECT_EQ(misspeltStage("manager"), "");
}

TEST(CheckParameters, NamesRangeAndNearestValue) {
  Parameters parameters;
  parameters.segmentation.M = 1.3;
  EXPECT_EQ(checkParameters(parameters), "segmentation/M: 1.3 is outside 0.01 ... 1\n");
  parameters = {};
  parameters.measurement.mode = "papr";
  EXPECT_NE(checkParameters(parameters).find("did you mean 'paper'?"), std::string::npos);
}

TEST(CheckParameters, ComparesValuesThatDependOnOneAnother) {
  struct Case {
    void (*set)(Parameters&);
    const char* named;
    bool within_a_stage;
  };
  const std::vector<Case> cases = {
      {[](Parameters& p) { p.preprocessing.min_range = 40.0; }, "min_range", true},
      {[](Parameters& p) { p.preprocessing.max_z = -2e8, p.preprocessing.min_z = 0.0; }, "crop box",
       true},
      {[](Parameters& p) { p.preprocessing.outlier_radius = 0.003; }, "outlier_radius", true},
      {[](Parameters& p) { p.preprocessing.block_size = 0.5; }, "block_margin", true},
      {[](Parameters& p) { p.preprocessing.ground_cell = 4.5; }, "ground_cell", true},
      {[](Parameters& p) { p.segmentation.seed_min_height = 1.2; }, "seed_min_height", true},
      {[](Parameters& p) { p.segmentation.seed_max_height = 0.1; }, "seed_min_length", true},
      {[](Parameters& p) { p.segmentation.alpha = p.segmentation.beta = 0.0; }, "alpha", true},
      {[](Parameters& p) { p.segmentation.plant_spacing = 0.05; }, "plant_spacing", true},
      {[](Parameters& p) { p.segmentation.row_spacing = 0.05; }, "row_spacing", true},
      {[](Parameters& p) { p.preprocessing.voxel_size = 0.03; }, "max_stem_radius", false},
      {[](Parameters& p) {
         p.preprocessing.ground_distance = 0.3;
         p.segmentation.seed_max_height = 0.25;
       },
       "ground_distance", false},
  };
  for (const Case& wrong : cases) {
    Parameters parameters;
    wrong.set(parameters);
    EXPECT_NE(checkParameters(parameters).find(wrong.named), std::string::npos) << wrong.named;
    EXPECT_EQ(checkStages(parameters).empty(), !wrong.within_a_stage) << checkStages(parameters);
  }
  Parameters parameters;
  parameters.preprocessing.outlier_radius = 0.003;
  parameters.preprocessing.outlier_min_neighbors = 0;
  EXPECT_EQ(checkParameters(parameters), "") << "nobody looks for neighbours";
}

}  // namespace
}  // namespace field_phenotyping
