#pragma once

#include <functional>
#include <string>
#include <vector>

#include "field_phenotyping/pipeline.hpp"

namespace field_phenotyping::benchmark {

/// Seconds that pass while `work` runs.
double secondsOf(const std::function<void()>& work);

/// Something to be timed: runs once and returns the seconds that count.
using TimedTask = std::function<double()>;

/// Seconds of every task. The tasks take turns, so that what else the machine does meets them
/// alike; before that each runs once without counting.
/// @param progress called with the share that is done, in [0, 1]
std::vector<std::vector<double>> timeInTurn(const std::vector<TimedTask>& tasks, int repeats,
                                            const std::function<void(double)>& progress = {});

/// One way to run the pipeline.
struct PipelineSetting {
  std::string name;
  int threads;  ///< 0: all cores
  ComputeDevice device;
};

/// One core, all cores where the task library is there, and both with the GPU where there is one.
std::vector<PipelineSetting> pipelineSettings(const ComputeDevice& gpu);

/// Runs the pipeline with default parameters and returns its seconds.
double timePipeline(const PointCloud& cloud, const PipelineSetting& setting,
                    PipelineResult& result);

/// Whether two results have the same plants, bit for bit.
bool samePlants(const PipelineResult& a, const PipelineResult& b);

}  // namespace field_phenotyping::benchmark
