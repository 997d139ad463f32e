#include "field_phenotyping/pipeline.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <limits>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/completion.hpp"
#include "field_phenotyping/measurement/measurement.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "field_phenotyping/segmentation/segmentation.hpp"
#include "tiling.hpp"
#include "voxel_labels.hpp"

namespace field_phenotyping {
namespace {

using Clock = std::chrono::steady_clock;

double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

enum Stage : std::size_t { kPreprocessing, kSegmentation, kCompletion, kMeasurement, kStages };

/// What the stages compute on, what they took and how far they are. Thread-safe.
class Bookkeeper {
 public:
  Bookkeeper(const ComputeDevice& device, const ProgressCallback& progress) : progress_(progress) {
    for (ComputeDevice& of_stage : devices_) of_stage = device.withOwnCounts();
  }

  const ComputeDevice& deviceOf(Stage stage) const { return devices_[stage]; }

  /// How many steps there will be; to be called before the first is added.
  void expect(std::size_t steps) { expected_ = steps; }
  /// One step of a stage has been done.
  void add(Stage stage, Clock::time_point start, std::size_t points) {
    const double seconds = secondsSince(start);
    const std::lock_guard<std::mutex> lock(mutex_);
    times_[stage].seconds += seconds;
    times_[stage].points += points;
    ++done_;
    if (progress_) progress_(static_cast<double>(done_) / static_cast<double>(expected_));
  }
  std::vector<StageTime> times() const {
    std::vector<StageTime> times = times_;
    for (std::size_t stage = 0; stage < kStages; ++stage) times[stage].use = devices_[stage].use();
    return times;
  }

 private:
  std::mutex mutex_;
  std::array<ComputeDevice, kStages> devices_;
  std::vector<StageTime> times_ = {
      {"preprocessing"}, {"segmentation"}, {"completion"}, {"measurement"}};
  std::size_t expected_ = 1U;
  std::size_t done_ = 0U;
  const ProgressCallback& progress_;
};

}  // namespace

PipelineResult phenotypeCloud(const PointCloud& cloud, const Parameters& parameters,
                              const ProgressCallback& progress, const ComputeDevice& device) {
  const std::string errors = checkParameters(parameters);
  if (!errors.empty()) throw std::invalid_argument(errors);
  Bookkeeper bookkeeper(device, progress);

  // 2.3 Preprocessing. The cloud comes in the map frame: there is no sensor to measure range from.
  const Clock::time_point start = Clock::now();
  PreprocessingParameters preprocessing = parameters.preprocessing;
  preprocessing.min_range = 0.0;
  preprocessing.max_range = std::numeric_limits<double>::infinity();
  const Tiling tiling = leastWork(cloud, preprocessing);
  preprocessing.block_size = tiling.edge;
  Preprocessor preprocessor(preprocessing, "map", tiling.corner);
  Scan scan;
  scan.cloud = cloud;
  preprocessor.addScan(scan, Eigen::Isometry3d::Identity(), bookkeeper.deviceOf(kPreprocessing));
  const std::vector<BlockIndex> due = preprocessor.dueBlocks(true);
  bookkeeper.expect(1U + kStages * due.size());
  bookkeeper.add(kPreprocessing, start, 0U);

  // 2.3, 2.4: blocks are independent of one another.
  std::vector<std::shared_ptr<SegmentedBlock>> segmented(due.size());
  std::vector<LabelledBlock> labelled(due.size());
  std::vector<std::uint8_t> has_soil(due.size(), 0U);
  parallelFor(due.size(), [&](std::size_t b) {
    Clock::time_point stage_start = Clock::now();
    const Block block = preprocessor.makeBlock(due[b], true, bookkeeper.deviceOf(kPreprocessing),
                                               &labelled[b].dense);
    has_soil[b] = block.ground.observed() ? 1U : 0U;
    bookkeeper.add(kPreprocessing, stage_start, block.cloud.size() + block.ground_points);
    stage_start = Clock::now();
    segmented[b] = std::make_shared<SegmentedBlock>(
        segmentBlock(block, parameters.segmentation, bookkeeper.deviceOf(kSegmentation)));
    labelled[b].block = segmented[b];
    bookkeeper.add(kSegmentation, stage_start, block.cloud.size());
  });
  // Ids in the blocks' order, so that they do not depend on which block was ready first.
  PlantRegistry registry;
  for (const auto& block : segmented) registry.identify(*block);

  // 2.5, 2.7, 2.8; and beside them, for it takes one core, what the voxels are of.
  PipelineResult result;
  result.blocks.resize(due.size());
  std::vector<std::vector<Phenotype>> measured(due.size());
  const double height_datum = segmented.empty() ? 0.0 : segmented.front()->cloud.origin.z();
  VoxelLabels voxel_labels(preprocessing, tiling.corner, height_datum);
  parallelFor(due.size() + 1U, [&](std::size_t b) {
    if (b == due.size()) {
      voxel_labels.add(labelled);
      return;
    }
    Clock::time_point stage_start = Clock::now();
    auto completed = std::make_shared<CompletedBlock>(completeBlock(
        segmented[b], parameters.completion, nullptr, bookkeeper.deviceOf(kCompletion)));
    bookkeeper.add(kCompletion, stage_start, completed->synthetic.size());
    stage_start = Clock::now();
    measured[b] =
        measureBlock(*completed, parameters.measurement, bookkeeper.deviceOf(kMeasurement));
    bookkeeper.add(kMeasurement, stage_start, segmented[b]->cloud.size());
    result.blocks[b] = std::move(completed);
  });

  for (std::size_t b = 0; b < due.size(); ++b) {
    result.plants.insert(result.plants.end(), measured[b].begin(), measured[b].end());
    if (has_soil[b] == 0U) ++result.blocks_without_soil;
  }
  std::sort(result.plants.begin(), result.plants.end(),
            [](const Phenotype& a, const Phenotype& b) { return a.id < b.id; });
  result.labels.resize(cloud.size());
  constexpr std::size_t kChunk = 8192U;
  parallelChunks(cloud.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    voxel_labels.writeLabels(cloud, begin, end, result.labels);
  });
  result.times = bookkeeper.times();
  return result;
}

}  // namespace field_phenotyping
