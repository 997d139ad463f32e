// The whole pipeline over one cloud: labels, tile borders, threads, far coordinates, bad input.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <set>
#include <stdexcept>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/pipeline.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using testing::matchBases;
using testing::PlantTruth;
using testing::Scene;

/// Tiles so small that a few square metres show what happens at their borders.
Parameters smallTiles() {
  Parameters parameters;
  parameters.preprocessing.block_size = 1.9;
  return parameters;
}

/// A field over four such tiles; with plants on their borders and their common corner at (2, 2).
const Scene& borderField() {
  static const Scene field = [] {
    Scene scene(testing::slopingSoil(3.0, 20.0), 1U);
    scene.addSoil({0.0, 0.0}, {4.0, 4.0}, 2500.0);
    for (const Eigen::Vector2d& base :
         {Eigen::Vector2d(2.0, 2.0), Eigen::Vector2d(2.0, 0.7), Eigen::Vector2d(1.999, 3.3),
          Eigen::Vector2d(0.7, 2.0), Eigen::Vector2d(3.3, 2.001), Eigen::Vector2d(1.2, 1.2),
          Eigen::Vector2d(2.8, 2.8), Eigen::Vector2d(1.93, 1.3), Eigen::Vector2d(2.07, 2.7)}) {
      PlantTruth plant;
      plant.base = base;
      scene.addPlant(plant);
    }
    return scene;
  }();
  return field;
}

std::vector<Eigen::Vector2d> basesOf(const PipelineResult& result,
                                     const Eigen::Vector3d& origin = Eigen::Vector3d::Zero()) {
  std::vector<Eigen::Vector2d> bases;
  for (const Phenotype& plant : result.plants) bases.push_back((plant.base - origin).head<2>());
  return bases;
}

void expectSame(const PipelineResult& a, const PipelineResult& b) {
  ASSERT_EQ(a.plants.size(), b.plants.size());
  const auto same = [](double x, double y) { return x == y || (std::isnan(x) && std::isnan(y)); };
  for (std::size_t i = 0; i < a.plants.size(); ++i) {
    EXPECT_EQ(a.plants[i].id, b.plants[i].id);
    EXPECT_EQ(a.plants[i].base, b.plants[i].base);
    EXPECT_TRUE(same(a.plants[i].height.value, b.plants[i].height.value));
    EXPECT_TRUE(same(a.plants[i].height.stddev, b.plants[i].height.stddev));
    EXPECT_TRUE(same(a.plants[i].stem_diameter.value, b.plants[i].stem_diameter.value));
    EXPECT_TRUE(same(a.plants[i].stem_diameter.stddev, b.plants[i].stem_diameter.stddev));
    EXPECT_EQ(a.plants[i].stem_points, b.plants[i].stem_points);
    EXPECT_EQ(a.plants[i].flags, b.plants[i].flags);
  }
  ASSERT_EQ(a.labels.size(), b.labels.size());
  for (std::size_t i = 0; i < a.labels.size(); ++i) {
    ASSERT_EQ(a.labels[i].plant_id, b.labels[i].plant_id) << i;
    ASSERT_EQ(a.labels[i].part, b.labels[i].part) << i;
  }
  ASSERT_EQ(a.blocks.size(), b.blocks.size());
  for (std::size_t k = 0; k < a.blocks.size(); ++k) {
    ASSERT_EQ(a.blocks[k]->synthetic.points.size(), b.blocks[k]->synthetic.points.size());
    for (std::size_t i = 0; i < a.blocks[k]->synthetic.size(); ++i) {
      ASSERT_EQ(a.blocks[k]->synthetic.points[i], b.blocks[k]->synthetic.points[i]);
    }
  }
}

TEST(Pipeline, EveryPlantOnceAlsoOnBordersAndCorners) {
  const Scene& scene = borderField();
  const PipelineResult result = phenotypeCloud(scene.cloud, smallTiles());
  const auto matches = matchBases(testing::basesOf(scene), basesOf(result));
  std::printf("bases within %.4f m\n", matches.worst);
  EXPECT_EQ(matches.pairs.size(), scene.plants.size()) << "none is lost";
  EXPECT_EQ(result.plants.size(), scene.plants.size()) << "none is reported twice";
  EXPECT_LT(matches.worst, 0.02);
  EXPECT_EQ(result.blocks.size(), 4U);
  EXPECT_EQ(result.blocks_without_soil, 0U);

  std::set<std::int32_t> ids;
  for (const Phenotype& plant : result.plants) {
    EXPECT_TRUE(ids.empty() || plant.id > *ids.rbegin()) << "ordered by id";
    ids.insert(plant.id);
    EXPECT_TRUE(plant.final);
  }
  std::set<std::int32_t> owned;
  for (const auto& block : result.blocks) {
    for (const Plant& plant : block->segmented->plants) {
      if (plant.owned) {
        EXPECT_TRUE(owned.insert(plant.id).second);
      }
    }
  }
  EXPECT_EQ(owned, ids) << "table and blocks tell of the same plants";

  for (const auto& [truth, found] : matches.pairs) {
    const Phenotype& plant = result.plants[found];
    const PlantTruth& expected = scene.plants[truth];
    EXPECT_NEAR(plant.height.value, scene.heightOf(static_cast<int>(truth)), 0.03);
    EXPECT_NEAR(plant.stem_diameter.value, 2.0 * expected.radius, 0.002);
    EXPECT_NEAR(plant.base.z(), scene.baseOf(expected).z(), 0.01);
  }
}

TEST(Pipeline, NoMoreTilesThanTheCloudNeeds) {
  // Wherever it lies: 4 m take two tiles of some 2 m on either side, and one where 6 m are allowed.
  PointCloud cloud = borderField().cloud;
  for (const double shift : {0.0, 0.7, -1.3}) {
    cloud.origin = borderField().cloud.origin + Eigen::Vector3d(shift, -shift, 0.0);
    Parameters parameters = smallTiles();
    EXPECT_EQ(phenotypeCloud(cloud, parameters).blocks.size(), 4U) << "moved by " << shift << " m";
    parameters.preprocessing.block_size = 3.0;
    EXPECT_EQ(phenotypeCloud(cloud, parameters).blocks.size(), 1U) << "moved by " << shift << " m";
  }
}

void expectLabelsOfTheInputPoints(const Parameters& parameters) {
  const Scene& scene = borderField();
  const PipelineResult result = phenotypeCloud(scene.cloud, parameters);
  ASSERT_EQ(result.labels.size(), scene.cloud.size());
  const auto matches = matchBases(testing::basesOf(scene), basesOf(result));
  std::map<std::int32_t, int> truth_of;
  for (const auto& [truth, found] : matches.pairs) {
    truth_of[result.plants[found].id] = static_cast<int>(truth);
  }
  std::vector<bool> truly, claimed;
  double plant_points = 0.0, right = 0.0, soil = 0.0, soil_taken = 0.0;
  for (std::size_t i = 0; i < result.labels.size(); ++i) {
    const PointLabel& label = result.labels[i];
    ASSERT_EQ(label.plant_id < 0, label.part == Part::kNone) << i;
    if (label.plant_id >= 0) {
      ASSERT_EQ(truth_of.count(label.plant_id), 1U) << "a plant that is not in the table";
    }
    truly.push_back(scene.truth[i].stem);
    claimed.push_back(label.part == Part::kStem);
    if (scene.truth[i].plant >= 0) {
      plant_points += 1.0;
      right += label.plant_id >= 0 && truth_of[label.plant_id] == scene.truth[i].plant ? 1.0 : 0.0;
    }
    if (scene.truth[i].soil) {
      soil += 1.0;
      soil_taken += label.plant_id >= 0 ? 1.0 : 0.0;
    }
  }
  const testing::StemScore stems = testing::scoreStems(truly, claimed);
  std::printf("stem F1 %.3f, plant accuracy %.3f, soil taken %.5f\n", stems.f1,
              right / plant_points, soil_taken / soil);
  EXPECT_GT(stems.f1, 0.85);
  EXPECT_GT(right / plant_points, 0.85);
  EXPECT_LT(soil_taken / soil, 0.01);
}

TEST(Pipeline, LabelsAreThoseOfTheInputPoints) {
  expectLabelsOfTheInputPoints(smallTiles());
}

TEST(Pipeline, LabelsAreThoseOfTheInputPointsAlsoWhereTheyAreThinned) {
  Parameters parameters = smallTiles();
  parameters.preprocessing.max_density = 2000.0;
  std::size_t points = 0U;
  std::size_t thinned_points = 0U;
  for (const auto& block : phenotypeCloud(borderField().cloud, smallTiles()).blocks) {
    points += block->segmented->cloud.size();
  }
  for (const auto& block : phenotypeCloud(borderField().cloud, parameters).blocks) {
    thinned_points += block->segmented->cloud.size();
  }
  ASSERT_LT(3U * thinned_points, 2U * points);
  expectLabelsOfTheInputPoints(parameters);
}

TEST(Pipeline, PointsOfOneVoxelShareALabel) {
  // Each point twice: the copies must fare alike.
  const Scene& scene = borderField();
  PointCloud twice = scene.cloud;
  twice.points.insert(twice.points.end(), scene.cloud.points.begin(), scene.cloud.points.end());
  const PipelineResult result = phenotypeCloud(twice, smallTiles());
  const std::size_t half = scene.cloud.size();
  for (std::size_t i = 0; i < half; ++i) {
    ASSERT_EQ(result.labels[i].plant_id, result.labels[half + i].plant_id);
    ASSERT_EQ(result.labels[i].part, result.labels[half + i].part);
  }
}

TEST(Pipeline, SameResultWhateverTheThreads) {
  const Scene& scene = borderField();
  PipelineResult one;
  {
    const ThreadLimit limit(1);
    one = phenotypeCloud(scene.cloud, smallTiles());
  }
  ASSERT_FALSE(one.plants.empty());
  for (const int threads : {2, 4}) {
    const ThreadLimit limit(threads);
    expectSame(one, phenotypeCloud(scene.cloud, smallTiles()));
  }
}

TEST(Pipeline, FarFromTheOriginAsAtIt) {
  const Scene& scene = borderField();
  const PipelineResult near_result = phenotypeCloud(scene.cloud, smallTiles());
  PointCloud shifted = scene.cloud;
  shifted.origin = {500000.0, 4500000.0, 90.0};
  const PipelineResult far_result = phenotypeCloud(shifted, smallTiles());
  ASSERT_EQ(far_result.plants.size(), near_result.plants.size());
  const auto matches = matchBases(basesOf(near_result), basesOf(far_result, shifted.origin));
  ASSERT_EQ(matches.pairs.size(), near_result.plants.size());
  std::printf("bases within %.5f m\n", matches.worst);
  EXPECT_LT(matches.worst, 0.002);
  for (const auto& [a, b] : matches.pairs) {
    const Phenotype& near_plant = near_result.plants[a];
    const Phenotype& far_plant = far_result.plants[b];
    EXPECT_NEAR(far_plant.base.z() - 90.0, near_plant.base.z(), 0.001);
    EXPECT_NEAR(far_plant.height.value, near_plant.height.value, 0.005);
    EXPECT_NEAR(far_plant.stem_diameter.value, near_plant.stem_diameter.value, 0.0005);
  }
  std::size_t differ = 0U;
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    differ += far_result.labels[i].part != near_result.labels[i].part ? 1U : 0U;
  }
  EXPECT_LT(static_cast<double>(differ), 0.005 * static_cast<double>(scene.cloud.size()));
}

TEST(Pipeline, EmptyNanAndSinglePointClouds) {
  const PipelineResult empty = phenotypeCloud(PointCloud(), smallTiles());
  EXPECT_TRUE(empty.plants.empty());
  EXPECT_TRUE(empty.labels.empty());
  EXPECT_TRUE(empty.blocks.empty());

  const float nan = std::numeric_limits<float>::quiet_NaN();
  PointCloud nans;
  nans.points.assign(1000U, {nan, 1.0F, 2.0F});
  const PipelineResult nothing = phenotypeCloud(nans, smallTiles());
  EXPECT_TRUE(nothing.plants.empty());
  ASSERT_EQ(nothing.labels.size(), 1000U);
  for (const PointLabel& label : nothing.labels) EXPECT_EQ(label.plant_id, -1);

  for (const std::size_t count : {1U, 2U, 3U, 7U}) {
    PointCloud few;
    for (std::size_t i = 0; i < count; ++i) {
      few.points.emplace_back(1.0F, 1.0F, 0.3F * static_cast<float>(i));
    }
    const PipelineResult result = phenotypeCloud(few, smallTiles());
    EXPECT_TRUE(result.plants.empty()) << count << " points";
    ASSERT_EQ(result.labels.size(), count);
  }
}

TEST(Pipeline, NanPointsAmongOthersChangeNothing) {
  const Scene& scene = borderField();
  const PipelineResult clean = phenotypeCloud(scene.cloud, smallTiles());
  PointCloud mixed;
  const float infinity = std::numeric_limits<float>::infinity();
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    mixed.points.push_back(scene.cloud.points[i]);
    mixed.points.emplace_back(std::nanf(""), 0.5F, -infinity);
  }
  const PipelineResult result = phenotypeCloud(mixed, smallTiles());
  ASSERT_EQ(result.labels.size(), mixed.size());
  ASSERT_EQ(result.plants.size(), clean.plants.size());
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    ASSERT_EQ(result.labels[2U * i].plant_id, clean.labels[i].plant_id);
    ASSERT_EQ(result.labels[2U * i + 1U].plant_id, -1);
    ASSERT_EQ(result.labels[2U * i + 1U].part, Part::kNone);
  }
}

TEST(Pipeline, AStrayPointCostsOnlyItself) {
  // One wrong return kilometres away, first or last in the file, must not cost the whole cloud.
  Scene scene(testing::levelSoil(), 5U);
  scene.addSoil({0.0, 0.0}, {2.0, 2.0}, 2000.0);
  PlantTruth plant;
  plant.base = {1.0, 1.0};
  scene.addPlant(plant);
  for (const Eigen::Vector3f& stray :
       {Eigen::Vector3f(1.0F, 1.0F, 5000.0F), Eigen::Vector3f(1.0F, 1.0F, -1e30F),
        Eigen::Vector3f(1e30F, 0.0F, 0.0F), Eigen::Vector3f(-1e7F, 1e7F, 0.0F)}) {
    for (const bool first : {false, true}) {
      PointCloud cloud = scene.cloud;
      cloud.points.insert(first ? cloud.points.begin() : cloud.points.end(), stray);
      PipelineResult result;
      ASSERT_NO_THROW(result = phenotypeCloud(cloud, smallTiles()))
          << stray.transpose() << (first ? " first" : " last");
      ASSERT_EQ(result.labels.size(), cloud.size());
      EXPECT_EQ(result.plants.size(), 1U) << stray.transpose() << (first ? " first" : " last");
      EXPECT_EQ((first ? result.labels.front() : result.labels.back()).plant_id, -1);
    }
  }
}

TEST(Pipeline, BareSoilHasNoPlants) {
  for (const double degrees : {0.0, 8.0}) {
    Scene scene(testing::slopingSoil(degrees), 2U);
    scene.addSoil({-2.0, -2.0}, {4.0, 4.0}, 2500.0, 0.008);
    const PipelineResult result = phenotypeCloud(scene.cloud, smallTiles());
    EXPECT_TRUE(result.plants.empty());
    for (const PointLabel& label : result.labels) ASSERT_EQ(label.plant_id, -1);
  }
}

TEST(Pipeline, SoilCroppedAwayIsSaid) {
  Scene scene(testing::levelSoil(), 3U);
  for (const double x : {0.5, 1.1, 1.7}) {
    PlantTruth plant;
    plant.base = {x, 1.0};
    scene.addPlant(plant);
  }
  const PipelineResult result = phenotypeCloud(scene.cloud, smallTiles());
  EXPECT_EQ(matchBases(testing::basesOf(scene), basesOf(result)).pairs.size(), 3U);
  EXPECT_EQ(result.plants.size(), 3U);
  EXPECT_EQ(result.blocks_without_soil, result.blocks.size());
  for (const Phenotype& plant : result.plants) {
    EXPECT_NE(plant.flags & kGroundMissing, 0U);
    EXPECT_NEAR(plant.height.value, 1.5, 0.12);
  }
}

TEST(Pipeline, OtherBlockSizesGiveTheSamePlants) {
  const Scene& scene = borderField();
  for (const double size : {1.0, 3.0, 10.0}) {
    Parameters parameters;
    parameters.preprocessing.block_size = size;
    const PipelineResult result = phenotypeCloud(scene.cloud, parameters);
    const auto matches = matchBases(testing::basesOf(scene), basesOf(result));
    EXPECT_EQ(matches.pairs.size(), scene.plants.size()) << "blocks of " << size << " m";
    EXPECT_EQ(result.plants.size(), scene.plants.size()) << "blocks of " << size << " m";
  }
}

TEST(Pipeline, RangeIsNotCutFromAnAccumulatedCloud) {
  // max_range is the sensor's; a whole cloud has none.
  Scene scene(testing::levelSoil(), 4U);
  scene.addSoil({100.0, 100.0}, {102.0, 102.0}, 2000.0);
  PlantTruth plant;
  plant.base = {101.0, 101.0};
  scene.addPlant(plant);
  EXPECT_EQ(phenotypeCloud(scene.cloud, smallTiles()).plants.size(), 1U);
  // The crop box holds.
  Parameters cropped;
  cropped.preprocessing.max_x = 100.5;
  EXPECT_TRUE(phenotypeCloud(scene.cloud, cropped).plants.empty());
}

TEST(Pipeline, ReportsProgressAndTimes) {
  const Scene& scene = borderField();
  std::vector<double> shares;
  const PipelineResult result =
      phenotypeCloud(scene.cloud, smallTiles(), [&](double share) { shares.push_back(share); });
  ASSERT_FALSE(shares.empty());
  EXPECT_TRUE(std::is_sorted(shares.begin(), shares.end()));
  EXPECT_GT(shares.front(), 0.0);
  EXPECT_DOUBLE_EQ(shares.back(), 1.0);
  std::vector<std::string> stages;
  for (const StageTime& time : result.times) {
    stages.push_back(time.stage);
    EXPECT_GE(time.seconds, 0.0);
  }
  EXPECT_EQ(stages, (std::vector<std::string>{"preprocessing", "segmentation", "completion",
                                              "measurement"}));
  EXPECT_GT(result.times.front().points, 0U);
}

// ---------------------------------------------------------------------------- parameters

/// The whole text of what phenotypeCloud() says about wrong parameters; empty when it says nothing.
std::string complaintAbout(const Parameters& parameters) {
  try {
    phenotypeCloud(PointCloud(), parameters);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(Parameters, DefaultsAreValid) {
  EXPECT_EQ(checkParameters(smallTiles()), "");
}

TEST(Parameters, EachIsNamedWhenOutOfRange) {
  // Every number of every section, pushed beyond both ends of its range and to NaN.
  struct Pusher {
    Parameters& parameters;
    const std::string section;
    int& checked;

    void operator()(const ParameterInfo& info, double& value, double low, double high) {
      const double kept = value;
      for (const double wrong :
           {std::nextafter(low, -1e300) - 1e-6 * std::abs(low) - 1e-9,
            high + 1e-6 * std::abs(high) + 1e-9, std::numeric_limits<double>::quiet_NaN()}) {
        value = wrong;
        expectNamed(info);
      }
      value = kept;
    }
    void operator()(const ParameterInfo& info, int& value, int low, int high) {
      const int kept = value;
      for (const int wrong : {low - 1, high + 1}) {
        value = wrong;
        expectNamed(info);
      }
      value = kept;
    }
    void operator()(const ParameterInfo& info, std::string& value, const char*, const char*) {
      const std::string kept = value;
      value = "no such mode";
      expectNamed(info);
      value = kept;
    }
    void operator()(const ParameterInfo&, bool&, bool, bool) {}

    void expectNamed(const ParameterInfo& info) {
      const std::string complaint = complaintAbout(parameters);
      EXPECT_NE(complaint.find(section + "/" + info.name), std::string::npos)
          << section << "/" << info.name << " is not named in '" << complaint << "'";
      ++checked;
    }
  };
  Parameters parameters;
  int checked = 0;
  Parameters::visitSections(parameters, [&](const char* section, auto& values) {
    std::decay_t<decltype(values)>::visit(values, Pusher{parameters, section, checked});
  });
  EXPECT_GT(checked, 100);
  EXPECT_EQ(checkParameters(parameters), "") << "all put back";
}

TEST(Parameters, CombinationsAreChecked) {
  Parameters parameters;
  parameters.preprocessing.min_range = 40.0;
  EXPECT_NE(complaintAbout(parameters).find("min_range"), std::string::npos);
  parameters = {};
  parameters.preprocessing.min_y = 3.0;
  parameters.preprocessing.max_y = 2.0;
  EXPECT_NE(complaintAbout(parameters).find("crop box"), std::string::npos);
  parameters = {};
  parameters.segmentation.seed_min_height = 1.5;
  EXPECT_NE(complaintAbout(parameters).find("seed_min_height"), std::string::npos);
  parameters = {};
  parameters.segmentation.alpha = 0.0;
  parameters.segmentation.beta = 0.0;
  EXPECT_NE(complaintAbout(parameters).find("alpha"), std::string::npos);
}

TEST(Parameters, AllComplaintsAtOnce) {
  Parameters parameters;
  parameters.segmentation.M = 1.5;
  parameters.measurement.mode = "guess";
  parameters.completion.max_centers = 1;
  const std::string complaint = complaintAbout(parameters);
  EXPECT_EQ(std::count(complaint.begin(), complaint.end(), '\n'), 3) << complaint;
}

TEST(Parameters, NamesAreUniqueAndDescribed) {
  const Parameters parameters;
  std::set<std::string> names;
  Parameters::visitSections(parameters, [&](const char* section, const auto& values) {
    std::decay_t<decltype(values)>::visit(
        values, [&](const ParameterInfo& info, const auto&, const auto&, const auto&) {
          EXPECT_TRUE(names.insert(std::string(section) + "/" + info.name).second) << info.name;
          EXPECT_GT(std::string(info.description).size(), 10U) << info.name;
        });
  });
  for (const char* name : {"segmentation/M", "segmentation/r1", "segmentation/alpha",
                           "segmentation/beta", "measurement/mode"}) {
    EXPECT_EQ(names.count(name), 1U) << name;
  }
}

}  // namespace
}  // namespace field_phenotyping
