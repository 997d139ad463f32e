// Times of the whole pipeline on made fields of the four growth stages (Table 4 of the paper): one
// core, all cores, GPU. Needs nothing but the core, so that it also runs where scripts/gpu_check
// does.

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <string>
#include <thread>
#include <vector>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "test_scene.hpp"
#include "timed_runs.hpp"

namespace field_phenotyping {
namespace {

using testing::PlantTruth;
using testing::Scene;

struct GrowthStage {
  const char* name;
  double stem_length;  // [m]
  double diameter;     // [m]
  int leaves;
};
constexpr GrowthStage kStages[] = {{"seedling", 0.3, 0.010, 4},
                                   {"jointing", 0.9, 0.019, 7},
                                   {"tasselling", 1.8, 0.022, 12},
                                   {"ripe", 1.8, 0.0215, 10}};

struct Field {
  Scene scene;
  std::vector<double> heights;  // [m] of the plants
};

/// Four rows, 0.75 x 0.20 m. Straight stems, arched leaves: simulate_field makes better plants, but
/// needs Embree.
Field makeField(const GrowthStage& stage, int plants_in_row, unsigned seed) {
  constexpr int kRows = 4;
  constexpr double kRowSpacing = 0.75;
  constexpr double kPlantSpacing = 0.20;
  constexpr double kMargin = 0.5;          // [m] of bare soil round the plants
  constexpr double kSoilDensity = 2500.0;  // [1/m^2]
  constexpr double kNoise = 0.003;         // [m]
  Field field{Scene(testing::slopingSoil(2.0, 30.0), seed, kNoise), {}};
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  field.scene.addSoil({-kMargin, -kMargin},
                      {kPlantSpacing * plants_in_row + kMargin, kRowSpacing * kRows + kMargin},
                      kSoilDensity);
  for (int row = 0; row < kRows; ++row) {
    for (int k = 0; k < plants_in_row; ++k) {
      PlantTruth plant;
      plant.base = {kPlantSpacing * k + 0.015 * normal(random),
                    kRowSpacing * row + 0.015 * normal(random)};
      plant.stem_length = stage.stem_length * (1.0 + 0.06 * normal(random));
      plant.radius = 0.5 * stage.diameter * (1.0 + 0.06 * normal(random));
      plant.lean = std::abs(2.0 * testing::kDegree * normal(random));
      plant.azimuth = M_PI * normal(random);
      plant.leaves = stage.leaves;
      field.scene.addPlant(plant);
    }
  }
  field.heights.assign(field.scene.plants.size(), 0.0);
  for (std::size_t i = 0; i < field.scene.cloud.size(); ++i) {
    const int owner = field.scene.truth[i].plant;
    if (owner < 0) continue;
    const PlantTruth& plant = field.scene.plants[static_cast<std::size_t>(owner)];
    double& height = field.heights[static_cast<std::size_t>(owner)];
    height = std::max(height, field.scene.cloud.points[i].z() -
                                  field.scene.soilAt(plant.base.x(), plant.base.y()));
  }
  return field;
}

struct Scores {
  double recall = 0.0;
  double height_rmse = NAN;    // [m]
  double diameter_rmse = NAN;  // [m]
};

Scores scoresOf(const PipelineResult& result, const Field& field) {
  std::vector<Eigen::Vector2d> truth;
  std::vector<Eigen::Vector2d> found;
  for (const PlantTruth& plant : field.scene.plants) truth.push_back(plant.base);
  for (const Phenotype& plant : result.plants) found.push_back(plant.base.head<2>());
  const testing::BaseMatches matches = testing::matchBases(truth, found, 0.06);
  Scores scores;
  scores.recall = static_cast<double>(matches.pairs.size()) / static_cast<double>(truth.size());
  double heights = 0.0;
  double diameters = 0.0;
  double with_diameter = 0.0;
  for (const auto& [is, was] : matches.pairs) {
    const Phenotype& plant = result.plants[was];
    heights += std::pow(plant.height.value - field.heights[is], 2);
    if (std::isnan(plant.stem_diameter.value)) continue;
    diameters += std::pow(plant.stem_diameter.value - 2.0 * field.scene.plants[is].radius, 2);
    with_diameter += 1.0;
  }
  if (!matches.pairs.empty()) {
    scores.height_rmse = std::sqrt(heights / static_cast<double>(matches.pairs.size()));
  }
  if (with_diameter > 0.0) scores.diameter_rmse = std::sqrt(diameters / with_diameter);
  return scores;
}

/// Seconds of segmentation, completion and measurement, summed over the blocks.
double secondsOfPlants(const PipelineResult& result) {
  double seconds = 0.0;
  for (std::size_t k = 1; k < result.times.size(); ++k) seconds += result.times[k].seconds;
  return seconds;
}

struct Options {
  std::string stage;  ///< the one to time; empty: all
  int plants_in_row = 29;
  int repeats = 3;
  unsigned seed = 1U;
};

void printTable(const Options& options) {
  const ComputeDevice gpu = ComputeDevice::choose("auto");
  const std::vector<benchmark::PipelineSetting> settings = benchmark::pipelineSettings(gpu);
  if (!gpu.hasGpu()) {
    std::printf("NOT RUN, the GPU: %s\n\n", gpu.use().why_cpu.c_str());
  }
  if (!hasTaskLibrary()) {
    std::printf("NOT RUN, all cores: this was built without oneTBB (CMake's TBB_DIR)\n\n");
  }
  std::printf(
      "%u cores. Seconds are medians of %d runs, taken in turn, after one that does not count; "
      "those of plants are of segmentation, completion and measurement, summed over the "
      "blocks.\n\n",
      std::thread::hardware_concurrency(), options.repeats);
  std::printf(
      "| field | points | blocks | device | seconds | times faster than one core "
      "| seconds of plants | times faster | recall | height RMSE [cm] | diameter RMSE [mm] "
      "| plants as on one core |\n"
      "|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  for (const GrowthStage& stage : kStages) {
    if (!options.stage.empty() && options.stage != stage.name) continue;
    const Field field = makeField(stage, options.plants_in_row, options.seed);
    std::vector<PipelineResult> results(settings.size());
    std::vector<std::vector<double>> of_plants(settings.size());
    std::vector<benchmark::TimedTask> tasks;
    for (std::size_t s = 0; s < settings.size(); ++s) {
      tasks.emplace_back([&, s] {
        const double all = benchmark::timePipeline(field.scene.cloud, settings[s], results[s]);
        of_plants[s].push_back(secondsOfPlants(results[s]));
        return all;
      });
    }
    const std::vector<std::vector<double>> seconds = benchmark::timeInTurn(tasks, options.repeats);
    for (std::vector<double>& runs : of_plants) runs.erase(runs.begin());  // does not count
    const double serial = medianOf(seconds[0]);
    const double serial_of_plants = medianOf(of_plants[0]);
    for (std::size_t s = 0; s < settings.size(); ++s) {
      const Scores scores = scoresOf(results[s], field);
      const double median = medianOf(seconds[s]);
      const double median_of_plants = medianOf(of_plants[s]);
      std::printf("| %s | %zu | %zu | %s | %.3f | %.2f | %.3f | %.2f | %.3f | %.1f | %.2f | %s |\n",
                  stage.name, field.scene.cloud.size(), results[s].blocks.size(),
                  settings[s].name.c_str(), median, serial / median, median_of_plants,
                  serial_of_plants / median_of_plants, scores.recall, 100.0 * scores.height_rmse,
                  1000.0 * scores.diameter_rmse,
                  benchmark::samePlants(results[s], results[0]) ? "the same" : "NOT THE SAME");
      std::fflush(stdout);
      for (const StageTime& time : results[s].times) {
        if (time.use.fallbacks == 0U) continue;
        std::printf("The GPU failed in %zu steps of %s: %s\n", time.use.fallbacks,
                    time.stage.c_str(), time.use.last_failure.c_str());
      }
    }
  }
  rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  std::printf("\nMost memory, with all fields and results: %ld MB\n", usage.ru_maxrss / 1024);
}

constexpr const char* kHelp =
    "Usage: time_pipeline [--stage NAME] [--plants-per-row N] [--repeats N] [--seed N]\n"
    "Prints Table 4 of the paper, on made fields of four rows: seconds of the whole pipeline on "
    "one\n"
    "core, on all cores and on the GPU, where there is one, beside its accuracy there; NAME is one "
    "of\n"
    "seedling, jointing, tasselling, ripe: that row alone. Nothing else should run meanwhile.\n";

int run(int argc, char** argv) {
  Options options;
  for (int k = 1; k < argc; ++k) {
    const std::string name = argv[k];
    if (name == "--help") {
      std::fputs(kHelp, stdout);
      return 0;
    }
    if (name == "--stage") {
      const auto isNamed = [&](const GrowthStage& stage) {
        return k + 1 < argc && std::strcmp(stage.name, argv[k + 1]) == 0;
      };
      if (std::none_of(std::begin(kStages), std::end(kStages), isNamed)) {
        std::fprintf(stderr,
                     "time_pipeline: --stage needs seedling, jointing, tasselling or ripe\n%s",
                     kHelp);
        return 2;
      }
      options.stage = argv[++k];
      continue;
    }
    char* end = nullptr;
    const long value = k + 1 < argc ? std::strtol(argv[k + 1], &end, 10) : 0;
    if (end == nullptr || *end != '\0' || value < 1 || value > 100000) {
      std::fprintf(stderr, "time_pipeline: %s needs a whole number from 1 to 100000\n%s",
                   name.c_str(), kHelp);
      return 2;
    }
    if (name == "--plants-per-row") {
      options.plants_in_row = static_cast<int>(value);
    } else if (name == "--repeats") {
      options.repeats = static_cast<int>(value);
    } else if (name == "--seed") {
      options.seed = static_cast<unsigned>(value);
    } else {
      std::fprintf(stderr, "time_pipeline: %s is not known\n%s", name.c_str(), kHelp);
      return 2;
    }
    ++k;
  }
  printTable(options);
  return 0;
}

}  // namespace
}  // namespace field_phenotyping

int main(int argc, char** argv) {
  try {
    return field_phenotyping::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "time_pipeline: error: %s\n", error.what());
    return 1;
  }
}
