// Times the pipeline and its stages on clouds, beside the Point Cloud Library; see --help.

#include <pcl/console/print.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "cloud_files.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "machine_speed.hpp"
#include "phenotype_files.hpp"
#include "rows_file.hpp"
#include "simulation/progress.hpp"
#include "stage_rivals.hpp"
#include "timed_runs.hpp"

namespace field_phenotyping::benchmark {
namespace {

struct Options {
  std::string command;
  std::vector<std::string> clouds;
  std::string output;
  std::string results;
  std::vector<int> threads;
  StageTiming timing;
};

std::vector<PipelineSetting> settingsOf(const Options& options, const ComputeDevice& gpu) {
  if (options.threads.empty()) return pipelineSettings(gpu);
  std::vector<PipelineSetting> settings;
  for (const int threads : options.threads) {
    settings.push_back(
        {std::to_string(threads) + (threads == 1 ? " core" : " cores"), threads, {}});
  }
  return settings;
}

void writeRun(const std::string& folder, const CloudFile& input, const PipelineResult& result) {
  std::filesystem::create_directories(folder);
  writePhenotypeCsv(folder + "/plants.csv", result.plants);
  writeLabels(folder + "/labels.pcd", input, result.labels);
}

/// The whole pipeline on every cloud in every setting, in turn.
nlohmann::json timePipelines(const Options& options) {
  const ComputeDevice gpu = ComputeDevice::choose("auto");
  const std::vector<PipelineSetting> settings = settingsOf(options, gpu);
  std::vector<CloudFile> clouds;
  for (const std::string& path : options.clouds) clouds.push_back(readCloudFile(path));

  nlohmann::json rows = nlohmann::json::array();
  std::vector<TimedTask> tasks;
  std::vector<PipelineResult> results(clouds.size() * settings.size());
  for (std::size_t c = 0; c < clouds.size(); ++c) {
    for (std::size_t s = 0; s < settings.size(); ++s) {
      const std::size_t row = rows.size();
      rows.push_back({{"cloud", options.clouds[c]},
                      {"setting", settings[s].name},
                      {"gpu", settings[s].device.hasGpu()},
                      {"points", clouds[c].cloud.size()}});
      tasks.emplace_back([&, c, s, row] {
        const double seconds = timePipeline(clouds[c].cloud, settings[s], results[row]);
        for (const StageTime& time : results[row].times) {
          rows[row]["stages"][time.stage].push_back(time.seconds);
          rows[row]["fallbacks"][time.stage] = time.use.fallbacks;
        }
        return seconds;
      });
    }
  }
  const auto seconds = timeInTurn(tasks, options.timing.repeats, options.timing.progress);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    rows[k]["seconds"] = seconds[k];
    for (auto& [stage, of_runs] : rows[k]["stages"].items()) of_runs.erase(0);  // the first round
    rows[k]["plants"] = results[k].plants.size();
    const std::size_t cloud = k / settings.size();
    rows[k]["same"] = samePlants(results[k], results[cloud * settings.size()]);
    if (options.results.empty()) continue;
    const std::string folder = options.results + "/" + std::to_string(k);
    writeRun(folder, clouds[cloud], results[k]);
    rows[k]["run"] = folder;
  }
  if (!gpu.hasGpu()) rows.push_back({{"why_no_gpu", gpu.use().why_cpu}});
  return rows;
}

/// Most memory held until each step was done, in a run as phenotype_cloud makes it.
nlohmann::json watchMemory(const Options& options) {
  const ThreadLimit limit(options.threads.empty() ? 0 : options.threads.front());
  const double empty = peakMemory();
  const CloudFile input = readCloudFile(options.clouds.front());
  const double read = peakMemory();
  std::vector<double> peaks = {read};  // and after every step of every block, as progress goes
  // The kernel rounds by a few pages, so that its peak may seem to fall.
  const auto note = [&peaks] { peaks.push_back(std::max(peaks.back(), peakMemory())); };
  const PipelineResult result = phenotypeCloud(input.cloud, Parameters(), [&](double share) {
    note();
    if (options.timing.progress) options.timing.progress(share);
  });
  note();
  // One step for the voxel grid; then two, and two more, for every block.
  const std::size_t blocks = result.blocks.size();
  return {{"points", input.cloud.size()},
          {"plants", result.plants.size()},
          {"blocks", blocks},
          {"empty", empty},
          {"reading", read},
          {"voxel grid", peaks.at(1)},
          {"segmentation", peaks.at(1U + 2U * blocks)},
          {"measurement", peaks.at(1U + 4U * blocks)},
          {"whole pipeline", peaks.back()}};
}

nlohmann::json describeMachine() {
  const MachineSpeed speed = measureMachine();
#ifdef __clang__
  const std::string compiler = std::string("Clang ") + __clang_version__;
#else
  const std::string compiler = std::string("GCC ") + __VERSION__;
#endif
  return {{"compiler", compiler},
          {"bytes_per_second", speed.bytes_per_second},
          {"operations_per_second", speed.operations_per_second}};
}

nlohmann::json run(const Options& options) {
  if (options.command == "machine") return describeMachine();
  if (options.clouds.empty()) throw std::runtime_error(options.command + " needs a cloud");
  if (options.command == "pipeline") return timePipelines(options);
  if (options.command == "memory") return watchMemory(options);
  const CloudFile input = readCloudFile(options.clouds.front());
  if (options.command == "floors") return countWork(input.cloud, options.timing);
  return timeStages(input.cloud, options.timing);
}

}  // namespace
}  // namespace field_phenotyping::benchmark

int main(int argc, char** argv) {
  field_phenotyping::benchmark::Options options;
  CLI::App app(
      "Times the pipeline and its stages on clouds; benchmark_pipeline makes tables of it. What is "
      "compared takes\n"
      "turns, after a round that does not count. Seconds are wall time: let nothing else run.\n"
      "  pipeline  the whole pipeline on every cloud: on one core, on all, and on the GPU if there "
      "is one, or with --threads\n"
      "  rivals    stages of the first cloud beside what the Point Cloud Library has for them\n"
      "  floors    what each stage of the first cloud has to work on, and its seconds on one core\n"
      "  machine   what one core copies and computes at most; needs no cloud\n"
      "  memory    most memory held [bytes] before and after the file was read, with the voxel "
      "grid filled, all "
      "blocks segmented,\n"
      "            completed and measured, and at the end; one run on the first cloud");
  app.add_option("command", options.command, "pipeline, rivals, floors, machine or memory")
      ->required()
      ->check(CLI::IsMember({"pipeline", "rivals", "floors", "machine", "memory"}));
  app.add_option("clouds", options.clouds, "Clouds to work, .pcd or .ply, metres, z up");
  app.add_option("-o,--output", options.output, "JSON file to write")->required();
  app.add_option("--results", options.results,
                 "Folder for plants.csv and labels.pcd of each cloud and setting (pipeline)");
  app.add_option("--threads", options.threads, "Threads to use, one setting each; 0: all cores")
      ->check(CLI::Range(0, 1024));
  app.add_option("--repeats", options.timing.repeats, "Rounds that count")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  app.add_option("--every-stem", options.timing.every_stem,
                 "Complete only every so many-th stem (rivals)")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  CLI11_PARSE(app, argc, argv);
  try {
    pcl::console::setVerbosityLevel(pcl::console::L_ERROR);  // the tables say what it warns of
    field_phenotyping::simulation::ProgressBar bar;
    options.timing.progress = [&](double share) { bar.update("timing", share); };
    const nlohmann::json rows = field_phenotyping::benchmark::run(options);
    field_phenotyping::benchmark::writeRows(rows, options.output);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "time_stages: error: %s\n", error.what());
    return 1;
  }
  return 0;
}
