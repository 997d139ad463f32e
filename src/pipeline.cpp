#include "field_phenotyping/pipeline.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <limits>
#include <map>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "field_phenotyping/common/key_map.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/completion.hpp"
#include "field_phenotyping/measurement/measurement.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "field_phenotyping/segmentation/segmentation.hpp"

namespace field_phenotyping {
namespace {

using Clock = std::chrono::steady_clock;

double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Adds up the stages' times and reports progress; called from many threads.
class Bookkeeper {
 public:
  Bookkeeper(std::size_t work, const ProgressCallback& progress)
      : work_(work), progress_(progress) {}

  void add(std::size_t stage, double seconds, std::size_t points) {
    const std::lock_guard<std::mutex> lock(mutex_);
    times_[stage].seconds += seconds;
    times_[stage].points += points;
    ++done_;
    if (progress_) progress_(static_cast<double>(done_) / static_cast<double>(work_));
  }
  const std::vector<StageTime>& times() const { return times_; }

 private:
  std::mutex mutex_;
  std::vector<StageTime> times_ = {
      {"preprocessing"}, {"segmentation"}, {"completion"}, {"measurement"}};
  std::size_t work_;
  std::size_t done_ = 0U;
  const ProgressCallback& progress_;
};

/// A segmented block, and what its points were made of.
struct LabelledBlock {
  std::shared_ptr<SegmentedBlock> block;
  DensePoints dense;
};

/// The labels of voxels by tile: block clouds hold voxel centroids, which lie in their own voxel.
class VoxelLabels {
 public:
  VoxelLabels(const PreprocessingParameters& parameters, const Eigen::Vector2d& tile_corner)
      : map_(parameters.block_size, parameters.voxel_size, tile_corner) {}

  void setHeightDatum(double z) { map_.setHeightDatum(z); }

  /// Plants reach into their neighbours' tiles; a block has the last word in its own, else the
  /// first one has it.
  void add(const std::vector<LabelledBlock>& blocks) {
    // What each block says, tile by tile; then what each tile hears, block by block.
    std::vector<std::map<BlockIndex, std::vector<LabelledVoxel>>> said(blocks.size());
    parallelFor(blocks.size(), [&](std::size_t b) { said[b] = labelsOf(blocks[b]); });
    for (const auto& of_block : said) {
      for (const auto& of_tile : of_block) labels_[of_tile.first];
    }
    std::vector<std::pair<BlockIndex, KeyMap<PointLabel>*>> tiles;
    for (auto& [tile, labels] : labels_) tiles.emplace_back(tile, &labels);
    parallelFor(tiles.size(), [&](std::size_t t) {
      const auto& [tile, labels] = tiles[t];
      std::size_t most = 0U;
      for (const auto& of_block : said) {
        const auto found = of_block.find(tile);
        if (found != of_block.end()) most += found->second.size();
      }
      labels->reserve(most);
      for (std::size_t b = 0; b < blocks.size(); ++b) {
        const auto found = said[b].find(tile);
        if (found == said[b].end()) continue;
        const std::vector<LabelledVoxel>& voxels = found->second;
        for (std::size_t k = 0; k < voxels.size(); ++k) {
          if (k + kBatch < voxels.size()) labels->prefetch(voxels[k + kBatch].key);
          const LabelledVoxel& voxel = voxels[k];
          const auto [label, is_new] = labels->tryEmplace(voxel.key, voxel.label);
          if (!is_new && tile == blocks[b].block->header.index) *label = voxel.label;
        }
      }
    });
  }

  /// Of the cloud's points number `begin` ... `end` - 1.
  void writeLabels(const PointCloud& cloud, std::size_t begin, std::size_t end,
                   std::vector<PointLabel>& labels) const {
    std::array<Asked, kBatch> asked;
    while (begin < end) {
      const std::size_t count = std::min(kBatch, end - begin);
      for (std::size_t k = 0; k < count; ++k) {
        asked[k] = askFor(cloud, begin + k);
        if (asked[k].labels != nullptr) asked[k].labels->prefetch(asked[k].key);
      }
      for (std::size_t k = 0; k < count; ++k) {
        if (asked[k].labels == nullptr) continue;
        if (const PointLabel* label = asked[k].labels->find(asked[k].key)) {
          labels[begin + k] = *label;
        }
      }
      begin += count;
    }
  }

 private:
  struct LabelledVoxel {
    VoxelKey key;
    PointLabel label;
  };

  std::map<BlockIndex, std::vector<LabelledVoxel>> labelsOf(const LabelledBlock& labelled) const {
    std::map<BlockIndex, std::vector<LabelledVoxel>> labels;
    const SegmentedBlock& block = *labelled.block;
    BlockIndex tile;
    std::vector<LabelledVoxel>* of_tile = nullptr;  // where the last one went: most follow it there
    const auto note = [&](const Eigen::Vector3f& point, const PointLabel& label) {
      const Eigen::Vector3d p = block.cloud.origin + point.cast<double>();
      const BlockIndex at = map_.tileAt(p.x(), p.y());
      if (of_tile == nullptr || !(at == tile)) {
        tile = at;
        of_tile = &labels[tile];
      }
      of_tile->push_back({keyOf(localOf(p, tile)), label});
    };
    std::vector<PointLabel> of_source(labelled.dense.points.size());  // more than there are
    for (const Plant& plant : block.plants) {
      if (!plant.owned) continue;
      for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
        const PointLabel label{plant.id, i < plant.stem.end ? Part::kStem : Part::kOther};
        if (of_source.empty()) {
          note(block.cloud.points[i], label);
        } else {
          of_source[block.source_index[i]] = label;
        }
      }
    }
    for (std::size_t i = 0; i < labelled.dense.points.size(); ++i) {
      const PointLabel& label = of_source[labelled.dense.thinned[i]];
      if (label.plant_id >= 0) note(labelled.dense.points[i], label);
    }
    return labels;
  }

  static constexpr std::size_t kBatch = 32U;  // voxels whose memory is fetched at once

  /// A voxel, and the tile that may know it: none where none can.
  struct Asked {
    const KeyMap<PointLabel>* labels = nullptr;
    VoxelKey key = 0U;
  };
  Asked askFor(const PointCloud& cloud, std::size_t i) const {
    constexpr double kMostDistance = 1e9;  // [m] beyond it tiles cannot be numbered
    if (!cloud.points[i].allFinite()) return {};
    const Eigen::Vector3d p = cloud.mapPoint(i);
    if (!(p.cwiseAbs().maxCoeff() < kMostDistance)) return {};
    const BlockIndex tile = map_.tileAt(p.x(), p.y());
    const auto labels = labels_.find(tile);
    if (labels == labels_.end()) return {};
    const Eigen::Vector3f local = localOf(p, tile);
    if (!hasVoxelKey(local, map_.voxelSize())) return {};
    return {&labels->second, keyOf(local)};
  }

  Eigen::Vector3f localOf(const Eigen::Vector3d& p, const BlockIndex& tile) const {
    return (p - map_.originOf(tile)).cast<float>();
  }
  VoxelKey keyOf(const Eigen::Vector3f& local) const {
    return voxelKeyOf({local.x(), local.y(), local.z()}, map_.voxelSize());
  }

  VoxelMap map_;
  std::map<BlockIndex, KeyMap<PointLabel>> labels_;
};

/// How a whole cloud is cut into square tiles.
struct Tiling {
  double edge;             // [m]
  Eigen::Vector2d corner;  // of tile (0, 0) [m], in the map frame
};

/// Margins are worked by all tiles that they lie in: tiles begin where fewest cover the cloud, and
/// are up to half as wide again as asked for where that leaves less to work, and up to twice as
/// wide where it leaves much less: they are also what processors share. There are no scans to wait
/// for.
Tiling leastWork(const PointCloud& cloud, const PreprocessingParameters& parameters) {
  const Eigen::Array2d least(parameters.min_x, parameters.min_y);
  const Eigen::Array2d most(parameters.max_x, parameters.max_y);
  Eigen::Array2d low = most;
  Eigen::Array2d high = least;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const Eigen::Array2d place = cloud.mapPoint(i).head<2>().array();
    if (!place.allFinite() || (place < least).any() || (place > most).any()) continue;
    low = low.min(place);
    high = high.max(place);
  }
  const double wanted = parameters.block_size;
  if ((low > high).any()) return {wanted, Eigen::Vector2d::Zero()};
  const Eigen::Array2d extent = high - low;
  const auto tilesOf = [&](double edge) -> Eigen::Array2d { return (extent / edge).floor() + 1.0; };
  const auto workOf = [&](double edge) {
    return (extent + 2.0 * parameters.block_margin * (tilesOf(edge) - 1.0)).prod();
  };
  constexpr int kSteps = 20;
  constexpr double kWide = 1.5;    // of what is asked for
  constexpr double kWidest = 2.0;  // the same
  constexpr double kMuch = 0.1;    // of the work
  double edge = wanted;
  for (int k = 1; k <= kSteps; ++k) {
    const double wider = wanted * (1.0 + (kWidest - 1.0) * k / kSteps);
    const double gain = wider > kWide * wanted ? kMuch : 0.0;
    if (workOf(wider) < (1.0 - gain) * workOf(edge)) edge = wider;
  }
  return {edge, low - 0.5 * (tilesOf(edge) * edge - extent)};
}

}  // namespace

PipelineResult phenotypeCloud(const PointCloud& cloud, const Parameters& parameters,
                              const ProgressCallback& progress, const ComputeDevice& device) {
  const std::string errors = checkParameters(parameters);
  if (!errors.empty()) throw std::invalid_argument(errors);

  // 2.3 Preprocessing. The cloud comes in the map frame: there is no sensor to measure range from.
  const Clock::time_point start = Clock::now();
  PreprocessingParameters preprocessing = parameters.preprocessing;
  preprocessing.min_range = 0.0;
  preprocessing.max_range = std::numeric_limits<double>::infinity();
  const ComputeDevice preprocessing_device = device.withOwnCounts();
  const ComputeDevice segmentation_device = device.withOwnCounts();
  const ComputeDevice completion_device = device.withOwnCounts();
  const ComputeDevice measurement_device = device.withOwnCounts();
  const Tiling tiling = leastWork(cloud, preprocessing);
  preprocessing.block_size = tiling.edge;
  Preprocessor preprocessor(preprocessing, "map", tiling.corner);
  Scan scan;
  scan.cloud = cloud;
  preprocessor.addScan(scan, Eigen::Isometry3d::Identity(), preprocessing_device);
  const std::vector<BlockIndex> due = preprocessor.dueBlocks(true);
  constexpr std::size_t kStages = 4U;
  Bookkeeper bookkeeper(1U + kStages * due.size(), progress);
  bookkeeper.add(0U, secondsSince(start), 0U);

  // 2.3, 2.4: blocks are independent of one another.
  std::vector<std::shared_ptr<SegmentedBlock>> segmented(due.size());
  std::vector<DensePoints> dense(due.size());
  std::vector<std::uint8_t> has_soil(due.size(), 0U);
  parallelFor(due.size(), [&](std::size_t b) {
    Clock::time_point stage_start = Clock::now();
    const Block block = preprocessor.makeBlock(due[b], true, preprocessing_device, &dense[b]);
    has_soil[b] = block.ground.observed() ? 1U : 0U;
    bookkeeper.add(0U, secondsSince(stage_start), block.cloud.size() + block.ground_points);
    stage_start = Clock::now();
    segmented[b] = std::make_shared<SegmentedBlock>(
        segmentBlock(block, parameters.segmentation, segmentation_device));
    bookkeeper.add(1U, secondsSince(stage_start), block.cloud.size());
  });
  // Ids in the blocks' order, so that they do not depend on which block was ready first.
  PlantRegistry registry;
  for (const auto& block : segmented) registry.identify(*block);

  std::vector<LabelledBlock> labelled(due.size());
  for (std::size_t b = 0; b < due.size(); ++b) labelled[b] = {segmented[b], std::move(dense[b])};
  VoxelLabels voxel_labels(preprocessing, tiling.corner);
  if (!segmented.empty()) voxel_labels.setHeightDatum(segmented.front()->cloud.origin.z());

  // 2.5, 2.7, 2.8; and beside them, for it takes one core, what the voxels are of.
  PipelineResult result;
  result.blocks.resize(due.size());
  std::vector<std::vector<Phenotype>> measured(due.size());
  parallelFor(due.size() + 1U, [&](std::size_t b) {
    if (b == due.size()) {
      voxel_labels.add(labelled);
      return;
    }
    Clock::time_point stage_start = Clock::now();
    auto completed = std::make_shared<CompletedBlock>(
        completeBlock(segmented[b], parameters.completion, nullptr, completion_device));
    bookkeeper.add(2U, secondsSince(stage_start), completed->synthetic.size());
    stage_start = Clock::now();
    measured[b] = measureBlock(*completed, parameters.measurement, measurement_device);
    bookkeeper.add(3U, secondsSince(stage_start), segmented[b]->cloud.size());
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
  result.times[0].use = preprocessing_device.use();
  result.times[1].use = segmentation_device.use();
  result.times[2].use = completion_device.use();
  result.times[3].use = measurement_device.use();
  return result;
}

}  // namespace field_phenotyping
