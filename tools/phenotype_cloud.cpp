#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "cloud_check.hpp"
#include "cloud_files.hpp"
#include "config_file.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/pipeline.hpp"
#include "phenotype_files.hpp"
#include "simulation/progress.hpp"

namespace field_phenotyping {
namespace {

struct Options {
  std::string input;
  std::string output;
  std::string config;
  std::string device = "auto";
  std::vector<std::string> assignments;
  int threads = 0;
  bool debug = false;
};

void writeTiming(const std::string& path, const PipelineResult& result) {
  nlohmann::ordered_json timing;
  for (const StageTime& time : result.times) {
    auto& entry = timing[time.stage];
    entry = {{"seconds", time.seconds}, {"points", time.points}, {"device", time.use.device}};
    if (!time.use.why_cpu.empty()) {
      entry["why_cpu"] = time.use.why_cpu;
      continue;
    }
    entry["gpu_steps"] = time.use.gpu_steps;
    entry["cpu_fallbacks"] = time.use.fallbacks;
    if (time.use.fallbacks > 0U) entry["gpu_failure"] = time.use.last_failure;
  }
  std::ofstream file(path);
  file << timing.dump(2) << "\n";
  if (!file.flush()) {
    throw std::runtime_error(path +
                             " cannot be written; is the disk full or the folder read-only?");
  }
}

/// What the segmenter decided; without --debug, files of an earlier run are taken away, for they
/// tell of other plants.
void writeDebug(const Options& options, const PipelineResult& result) {
  const std::string plants = options.output + "/growth.csv";
  const std::string regions = options.output + "/growth_regions.csv";
  if (options.debug) {
    writeGrowthCsv(plants, result.blocks);
    writeGrowthRegionsCsv(regions, result.blocks);
    return;
  }
  for (const std::string& path : {plants, regions}) {
    std::error_code failure;
    std::filesystem::remove(path, failure);
    if (failure) {
      throw std::runtime_error(
          path + ": is of an earlier run and cannot be removed: " + failure.message());
    }
  }
}

std::size_t countLabelled(const PipelineResult& result) {
  std::size_t count = 0U;
  for (const PointLabel& label : result.labels) count += label.plant_id >= 0 ? 1U : 0U;
  return count;
}

void run(const Options& options) {
  Parameters parameters;
  if (!options.config.empty()) readConfigFile(options.config, parameters);
  setParameters(options.assignments, parameters);
  const ComputeDevice device = ComputeDevice::choose(options.device);
  const ThreadLimit limit(options.threads);

  std::error_code failure;
  std::filesystem::create_directories(options.output, failure);
  if (failure) {
    throw std::runtime_error(options.output + ": cannot be made: " + failure.message());
  }

  simulation::ProgressBar progress;
  progress.update("reading", 0.0);
  const CloudFile input = readCloudFile(options.input);
  requireMetres(options.input, input);
  const PipelineResult result = phenotypeCloud(
      input.cloud, parameters, [&](double share) { progress.update("measuring plants", share); },
      device);

  progress.update("writing", 0.0);
  writePhenotypeCsv(options.output + "/plants.csv", result.plants);
  writePhenotypeGeoJson(options.output + "/plants.geojson", result.plants);
  writeRowsCsv(options.output + "/rows.csv", result.plants);
  writeCanopyCsv(options.output + "/canopy.csv", canopyProfile(result.blocks));
  writeLabels(options.output + "/labels.pcd", input, result.labels);
  writeCompleted(options.output + "/completed.pcd", input, result);
  writeTiming(options.output + "/timing.json", result);
  writeDebug(options, result);
  progress.update("writing", 1.0);

  std::printf("%zu plants in %zu points (%zu of them on plants) -> %s\n", result.plants.size(),
              input.cloud.size(), countLabelled(result), options.output.c_str());
  for (const StageTime& time : result.times) {
    if (time.use.fallbacks == 0U) continue;
    std::fprintf(
        stderr,
        "phenotype_cloud: warning: %s: the GPU failed in %zu steps, which the CPU did: %s\n",
        time.stage.c_str(), time.use.fallbacks, time.use.last_failure.c_str());
  }
  for (const std::string& doubt : doubtsAbout(input, result, parameters)) {
    std::fprintf(stderr, "phenotype_cloud: warning: %s\n", doubt.c_str());
  }
}

}  // namespace
}  // namespace field_phenotyping

int main(int argc, char** argv) {
  field_phenotyping::Options options;
  CLI::App app(
      "Measures every plant in one point cloud: height and stem diameter, each with its standard "
      "deviation.\n"
      "Writes plants.csv and plants.geojson (one row a plant; metres, radians), rows.csv, "
      "canopy.csv "
      "(height profile),\n"
      "labels.pcd (plant and organ of every input point, in the input's order), completed.pcd "
      "(stems "
      "with their gaps\n"
      "filled) and timing.json.");
  app.add_option("input", options.input, "Cloud to measure: .pcd or .ply, x y z in metres, z up")
      ->required();
  app.add_option("-o,--output", options.output, "Folder for the results; made when missing")
      ->required();
  app.add_option("-c,--config", options.config, "YAML file of stage: {parameter: value}");
  app.add_option("--set", options.assignments, "Set one parameter: stage/parameter=value");
  app.add_option("--device", options.device,
                 "Where to compute: cpu; cuda; auto: on a GPU if there is one")
      ->check(CLI::IsMember({"auto", "cpu", "cuda"}))
      ->capture_default_str();
  app.add_option("--threads", options.threads, "Threads to use; 0: all cores")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  app.add_flag("--debug", options.debug,
               "Also write what the segmenter decided: growth.csv (one row a plant) and "
               "growth_regions.csv (one row a region of its stem), for plot_growth");
  app.add_flag_callback(
      "--list-parameters",
      [] {
        std::fputs(field_phenotyping::describeParameters().c_str(), stdout);
        throw CLI::Success();
      },
      "Print every parameter with default, unit, range and meaning");
  CLI11_PARSE(app, argc, argv);
  try {
    field_phenotyping::run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "phenotype_cloud: error: %s\n", error.what());
    return 1;
  }
  return 0;
}
