#include "stage_rivals.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "completion_rivals.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/stem_completion.hpp"
#include "field_phenotyping/preprocessing/ground_estimation.hpp"
#include "field_phenotyping/preprocessing/outlier_filter.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "pcl_stages.hpp"
#include "timed_runs.hpp"
#include "whole_cloud.hpp"

namespace field_phenotyping::benchmark {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180.0;  // [rad]
// Normals and regions with the settings of the Point Cloud Library's own tutorial.
constexpr int kNormalNeighbours = 50;
constexpr RegionGrowth kRegionGrowth = {50, 30, 3.0 * kDegree, 1.0};
constexpr const char* kMlsSettings = "local plane, reach 10 mm, search radius 20 mm, order 2";

using Points = std::vector<Eigen::Vector3f>;

/// The finite points of a cloud by tile, from the tile's origin.
std::vector<Points> cutIntoTiles(const PointCloud& cloud,
                                 const PreprocessingParameters& parameters) {
  const VoxelMap map(parameters.block_size, parameters.voxel_size);
  std::map<BlockIndex, Points> tiles;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    if (!cloud.points[i].allFinite()) continue;
    const Eigen::Vector3d p = cloud.mapPoint(i);
    const BlockIndex tile = map.tileAt(p.x(), p.y());
    tiles[tile].push_back((p - map.originOf(tile)).cast<float>());
  }
  std::vector<Points> cut;
  for (auto& [index, points] : tiles) cut.push_back(std::move(points));
  return cut;
}

Points voxelCentroids(const Points& points, float edge) {
  VoxelTile tile;
  tile.insertAll(points, edge, {});
  Points centroids;
  centroids.reserve(tile.size());
  for (std::size_t i = 0; i < tile.size(); ++i) centroids.push_back(tile.centroid(i));
  return centroids;
}

/// The blocks of a cloud, as far as finishBlock() takes them before it looks for soil.
std::vector<PointCloud> withoutOutliers(const Preprocessor& preprocessor) {
  std::vector<PointCloud> blocks;
  const PreprocessingParameters& parameters = preprocessor.parameters();
  for (const BlockIndex& index : preprocessor.dueBlocks(true)) {
    const PointCloud cloud = preprocessor.collect({index}, true).cloud;
    const auto keep = radiusOutlierFilter(cloud, static_cast<float>(parameters.outlier_radius),
                                          parameters.outlier_min_neighbors);
    PointCloud kept;
    kept.origin = cloud.origin;
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      if (keep[i] != 0U) kept.points.push_back(cloud.points[i]);
    }
    blocks.push_back(std::move(kept));
  }
  return blocks;
}

/// What stands on the soil, each point once, from the origin of the cloud.
Points aboveSoil(const Preprocessor& preprocessor, const Eigen::Vector3d& origin) {
  Points above;
  for (const BlockIndex& index : preprocessor.dueBlocks(true)) {
    const Block block = preprocessor.makeBlock(index, true);
    for (std::size_t i = 0; i < block.cloud.size(); ++i) {
      const Eigen::Vector3d p = block.cloud.mapPoint(i);
      if (block.header.holds(p.x(), p.y())) above.push_back((p - origin).cast<float>());
    }
  }
  return above;
}

/// A stem as the segmentation has found it, for our completion and for moving least squares.
struct FieldStem {
  GappyStem stem;
  double density = 0.0;  // that gaps are filled to [1/m^2]
};

std::vector<FieldStem> stemsOf(const PipelineResult& result, int every) {
  std::vector<FieldStem> stems;
  int number = 0;
  for (const auto& completed : result.blocks) {
    const SegmentedBlock& block = *completed->segmented;
    for (const Plant& plant : block.plants) {
      if (!plant.owned || number++ % every != 0) continue;
      FieldStem stem;
      stem.stem.cloud.origin = block.cloud.origin;
      stem.stem.cloud.points.assign(block.cloud.points.begin() + plant.stem.begin,
                                    block.cloud.points.begin() + plant.stem.end);
      stem.stem.axis = plant.axis;
      stem.stem.ground = block.ground;
      const auto size = static_cast<std::uint32_t>(stem.stem.cloud.size());
      stem.density =
          completeStem(stem.stem.cloud, {0U, size}, plant.axis, block.ground, {}).density;
      if (stem.density > 0.0) stems.push_back(std::move(stem));
    }
  }
  return stems;
}

Rival movingLeastSquares() {
  for (Rival& rival : rivalMethods()) {
    if (rival.method == "MLS" && rival.settings == kMlsSettings) return std::move(rival);
  }
  throw std::logic_error(std::string("no moving least squares with ") + kMlsSettings);
}

/// Tasks that are timed in turn, each with its row.
class Rows {
 public:
  /// @param work does it once and returns how many it found
  void add(const std::string& stage, const std::string& method, std::size_t points,
           std::function<std::size_t()> work, int threads = 1) {
    const std::size_t row = rows_.size();
    rows_.push_back({{"stage", stage}, {"method", method}, {"points", points}});
    tasks_.emplace_back([this, row, threads, work = std::move(work)] {
      std::size_t found = 0U;
      const ThreadLimit limit(threads);
      const double seconds = secondsOf([&] { found = work(); });
      rows_[row]["found"] = found;
      return seconds;
    });
  }

  nlohmann::json time(const StageTiming& timing) {
    const auto seconds = timeInTurn(tasks_, timing.repeats, timing.progress);
    for (std::size_t k = 0; k < rows_.size(); ++k) rows_[k]["seconds"] = seconds[k];
    return rows_;
  }

 private:
  nlohmann::json rows_ = nlohmann::json::array();
  std::vector<TimedTask> tasks_;
};

std::size_t sizeOf(const std::vector<Points>& parts) {
  std::size_t size = 0U;
  for (const Points& part : parts) size += part.size();
  return size;
}

}  // namespace

nlohmann::json timeStages(const PointCloud& cloud, const StageTiming& timing) {
  Rows rows;
  const Preprocessor preprocessor = accumulate(cloud);
  const PreprocessingParameters parameters = preprocessor.parameters();

  // 2.3.1 Voxel grid.
  const auto edge = static_cast<float>(parameters.voxel_size);
  const std::vector<Points> tiles = cutIntoTiles(cloud, parameters);
  std::vector<PclPoints::Ptr> pcl_tiles;
  for (const Points& tile : tiles) pcl_tiles.push_back(toPcl(tile));
  rows.add("voxel grid", "ours, tile by tile", sizeOf(tiles), [&] {
    std::size_t found = 0U;
    for (const Points& tile : tiles) found += voxelCentroids(tile, edge).size();
    return found;
  });
  rows.add("voxel grid", "pcl::VoxelGrid, tile by tile", sizeOf(tiles), [&] {
    std::size_t found = 0U;
    for (const PclPoints::Ptr& tile : pcl_tiles) found += voxelGrid(tile, edge)->size();
    return found;
  });
  const PclPoints::Ptr whole = toPcl(cloud.points);
  rows.add("voxel grid", "pcl::VoxelGrid, whole plot", whole->size(),
           [&] { return voxelGrid(whole, edge)->size(); });

  // 2.3.2 Soil.
  const std::vector<PointCloud> blocks = withoutOutliers(preprocessor);
  std::vector<PclPoints::Ptr> pcl_blocks;
  std::size_t block_points = 0U;
  for (const PointCloud& block : blocks) {
    pcl_blocks.push_back(toPcl(block.points));
    block_points += block.size();
  }
  rows.add("soil", "ours", block_points, [&] {
    std::size_t found = 0U;
    for (const PointCloud& block : blocks) {
      const auto is_soil = classifyGround(block, estimateGround(block, parameters), parameters);
      found += static_cast<std::size_t>(std::count(is_soil.begin(), is_soil.end(), 1U));
    }
    return found;
  });
  PlaneSearch plane;
  plane.tolerance = 2.0 * parameters.ground_distance;  // as our own RANSAC
  plane.max_tilt = parameters.ground_max_tilt * kDegree;
  rows.add("soil", "pcl::SACSegmentation", block_points, [&] {
    std::size_t found = 0U;
    for (const PclPoints::Ptr& block : pcl_blocks)
      found += planePoints(block, plane).indices.size();
    return found;
  });

  // 2.4 Segmentation, and all of it.
  const PclPoints::Ptr above = toPcl(aboveSoil(preprocessor, cloud.origin));
  PclNormals::Ptr normals;
  const auto addRegions = [&](const PclPoints::Ptr& points, const std::string& of,
                              const std::vector<int>& all_threads) {
    for (const int threads : all_threads) {
      rows.add("segmentation",
               "pcl::NormalEstimationOMP, " + of + (threads == 0 ? ", all cores" : ", one core"),
               points->size(), [&normals, points, threads] {
                 normals = estimateNormals(points, kNormalNeighbours, threads);
                 return normals->size();
               });
    }
    rows.add("segmentation", "pcl::RegionGrowing, " + of, points->size(),
             [&normals, points] { return growRegions(points, normals, kRegionGrowth).size(); });
  };
  addRegions(above, "above the soil", {0, 1});
  addRegions(whole, "whole cloud", {1});
  PipelineResult result;
  std::vector<double> segmentation;
  for (const int threads : {1, 0}) {
    rows.add(
        "whole pipeline", threads == 1 ? "ours, one core" : "ours, all cores", cloud.size(),
        [&, threads] {
          result = phenotypeCloud(cloud, Parameters());
          if (threads == 1) segmentation.push_back(result.times[1].seconds);
          return result.plants.size();
        },
        threads);
  }

  // 2.5 Completion.
  const ThreadLimit one_thread(1);
  const std::vector<FieldStem> stems =
      stemsOf(phenotypeCloud(cloud, Parameters()), timing.every_stem);
  std::size_t stem_points = 0U;
  for (const FieldStem& stem : stems) stem_points += stem.stem.cloud.size();
  const std::string count = std::to_string(stems.size()) + " stems";
  rows.add("completion", "ours, " + count, stem_points, [&] {
    std::size_t found = 0U;
    for (const FieldStem& s : stems) {
      const auto size = static_cast<std::uint32_t>(s.stem.cloud.size());
      found += completeStem(s.stem.cloud, {0U, size}, s.stem.axis, s.stem.ground, {}).points.size();
    }
    return found;
  });
  const Rival mls = movingLeastSquares();
  rows.add("completion", "pcl::MovingLeastSquares, " + count, stem_points, [&] {
    std::size_t found = 0U;
    for (const FieldStem& s : stems) found += mls.fill(s.stem, s.density).filled.size();
    return found;
  });

  nlohmann::json timed = rows.time(timing);
  segmentation.erase(segmentation.begin());  // the run that does not count
  timed.push_back({{"stage", "segmentation"},
                   {"method", "ours, one core"},
                   {"points", above->size()},
                   {"found", result.plants.size()},
                   {"seconds", segmentation}});
  return timed;
}

nlohmann::json countWork(const PointCloud& cloud, const StageTiming& timing) {
  const ThreadLimit one_thread(1);
  nlohmann::json work;
  const Preprocessor preprocessor = accumulate(cloud);
  const PreprocessingParameters parameters = preprocessor.parameters();
  work["points"] = cloud.size();
  work["voxels"] = preprocessor.voxels();
  work["min_neighbors"] = parameters.outlier_min_neighbors;

  // Each point once: what blocks have in common is not counted twice.
  std::size_t plant_points = 0U;
  std::size_t kept = 0U;
  std::uint64_t neighbours = 0U;
  const auto radius = static_cast<float>(SegmentationParameters().seed_radius);
  for (const BlockIndex& index : preprocessor.dueBlocks(true)) {
    const Block block = preprocessor.makeBlock(index, true);
    const auto shapes =
        computeLocalShapes(block.cloud.points, NeighborGrid(block.cloud.points, radius), radius);
    for (std::size_t i = 0; i < block.cloud.size(); ++i) {
      const Eigen::Vector3d p = block.cloud.mapPoint(i);
      if (!block.header.holds(p.x(), p.y())) continue;
      ++plant_points;
      neighbours += shapes[i].neighbors;
    }
  }
  const std::vector<PointCloud> blocks = withoutOutliers(preprocessor);
  const VoxelMap map(parameters.block_size, parameters.voxel_size);
  const std::vector<BlockIndex> due = preprocessor.dueBlocks(true);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    for (std::size_t i = 0; i < blocks[b].size(); ++i) {
      const Eigen::Vector3d p = blocks[b].mapPoint(i);
      kept += map.tileAt(p.x(), p.y()) == due[b] ? 1U : 0U;
    }
  }
  work["plant_points"] = plant_points;
  work["soil_points"] = kept - plant_points;
  work["neighbours"] = neighbours;

  PipelineResult result;
  std::vector<std::vector<double>> stage_seconds;
  const std::vector<TimedTask> tasks = {
      [&] { return secondsOf([&] { accumulate(cloud); }); },
      [&] { return secondsOf([&] { withoutOutliers(preprocessor); }); },
      [&] {
        return secondsOf([&] {
          for (const PointCloud& block : blocks) {
            classifyGround(block, estimateGround(block, parameters), parameters);
          }
        });
      },
      [&] {
        const double seconds = secondsOf([&] { result = phenotypeCloud(cloud, Parameters()); });
        stage_seconds.emplace_back();
        for (const StageTime& time : result.times) stage_seconds.back().push_back(time.seconds);
        return seconds;
      }};
  const auto seconds = timeInTurn(tasks, timing.repeats, timing.progress);
  work["seconds"] = {{"voxel grid", seconds[0]},
                     {"outliers", seconds[1]},
                     {"soil", seconds[2]},
                     {"whole pipeline", seconds[3]}};
  const std::vector<std::string> stages = {"preprocessing", "segmentation", "completion",
                                           "measurement"};
  for (std::size_t s = 1; s < stages.size(); ++s) {
    for (std::size_t run = 1; run < stage_seconds.size(); ++run) {
      work["seconds"][stages[s]].push_back(stage_seconds[run][s]);
    }
  }
  std::uint64_t stem_points = 0U;
  std::uint64_t filled = 0U;
  std::uint64_t diameter_points = 0U;
  for (const auto& block : result.blocks) filled += block->synthetic.size();
  for (const Phenotype& plant : result.plants) {
    stem_points += plant.stem_points;
    diameter_points += plant.diameter_points;
  }
  work["stem_points"] = stem_points;
  work["filled_points"] = filled;
  work["diameter_points"] = diameter_points;
  work["plants"] = result.plants.size();
  return work;
}

}  // namespace field_phenotyping::benchmark
