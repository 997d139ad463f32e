#include "timed_runs.hpp"

#include <chrono>
#include <cstddef>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping::benchmark {
namespace {

/// NaN is like NaN.
bool same(double a, double b) {
  return a == b || (a != a && b != b);
}

}  // namespace

double secondsOf(const std::function<void()>& work) {
  const auto begin = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

std::vector<std::vector<double>> timeInTurn(const std::vector<TimedTask>& tasks, int repeats,
                                            const std::function<void(double)>& progress) {
  std::vector<std::vector<double>> seconds(tasks.size());
  const double runs = static_cast<double>(tasks.size()) * (repeats + 1);
  double done = 0.0;
  for (int repeat = -1; repeat < repeats; ++repeat) {
    for (std::size_t t = 0; t < tasks.size(); ++t) {
      const double took = tasks[t]();
      if (repeat >= 0) seconds[t].push_back(took);
      if (progress) progress(++done / runs);
    }
  }
  return seconds;
}

std::vector<PipelineSetting> pipelineSettings(const ComputeDevice& gpu) {
  std::vector<PipelineSetting> settings = {{"one core", 1, {}}};
  if (hasTaskLibrary()) settings.push_back({"all cores", 0, {}});
  if (gpu.hasGpu()) {
    settings.push_back({gpu.use().device + ", one core", 1, gpu});
    if (hasTaskLibrary()) settings.push_back({gpu.use().device + ", all cores", 0, gpu});
  }
  return settings;
}

double timePipeline(const PointCloud& cloud, const PipelineSetting& setting,
                    PipelineResult& result) {
  const ThreadLimit limit(setting.threads);
  return secondsOf([&] { result = phenotypeCloud(cloud, Parameters(), {}, setting.device); });
}

bool samePlants(const PipelineResult& a, const PipelineResult& b) {
  if (a.plants.size() != b.plants.size()) return false;
  for (std::size_t k = 0; k < a.plants.size(); ++k) {
    const Phenotype& first = a.plants[k];
    const Phenotype& second = b.plants[k];
    if (first.base != second.base || !same(first.height.value, second.height.value) ||
        !same(first.stem_diameter.value, second.stem_diameter.value)) {
      return false;
    }
  }
  return true;
}

}  // namespace field_phenotyping::benchmark
