// The clustering of the Point Cloud Library as a peer to compare with, see --help.

#include <pcl/search/kdtree.h>
#include <pcl/segmentation/extract_clusters.h>

#include <CLI/CLI.hpp>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "cloud_files.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"
#include "pcl_stages.hpp"
#include "phenotype_files.hpp"
#include "point_file.hpp"
#include "simulation/progress.hpp"
#include "whole_cloud.hpp"

namespace field_phenotyping {
namespace {

using Clock = std::chrono::steady_clock;
using Points = benchmark::PclPoints;
using Normals = benchmark::PclNormals;
using Indices = std::vector<int>;  // as PCL 1.10 and 1.13 both have them

constexpr double kDegree = 3.14159265358979323846 / 180.0;  // [rad]
constexpr int kMinClusterPoints = 20;
constexpr std::uint8_t kStemPart = 1U;  // in the field `part` of the truth

double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// The values to try, every combination of them.
struct Grid {
  std::vector<int> normal_neighbours = {20, 40, 80};
  std::vector<int> neighbours = {15, 30, 60};
  std::vector<double> smoothness = {10.0, 20.0, 30.0, 45.0};  // [deg]
  std::vector<double> curvature = {0.05, 0.1, 0.2};
  std::vector<double> tolerance = {0.005, 0.0075, 0.01, 0.015, 0.02, 0.03};  // [m]
  std::vector<double> tilt = {15.0, 25.0, 40.0};                             // [deg]
  std::vector<double> thickness = {0.012, 0.02, 0.03, 0.06};                 // [m]
  std::vector<double> length = {0.05, 0.1, 0.2, 0.4};                        // [m]
  std::vector<double> elongation = {1.0, 2.0, 4.0, 8.0};
  std::vector<double> foot = {0.3, 0.8, 2.0};  // [m]
};

struct Options {
  std::string input;
  std::string output;
  std::string method;
  Grid grid;
};

/// What the clustering is given: the points that our own segmentation would get, without the
/// margins by which blocks overlap.
struct AboveGround {
  Points::Ptr points{new Points};
  std::vector<float> height;               ///< above the soil, one a point [m]
  std::vector<std::int32_t> voxel_of;      ///< of each input point; -1: ground, outlier, not finite
  std::vector<std::uint32_t> inputs;       ///< input points in each voxel
  std::vector<std::uint32_t> stem_inputs;  ///< those of them that are truly stem
  std::uint64_t true_stem_points = 0U;     ///< of the whole input
  double seconds = 0.0;
};

AboveGround removeGround(const CloudFile& input, const std::string& path) {
  const Field part = requireField(input.contents, "part", path);
  const Clock::time_point start = Clock::now();
  const Preprocessor preprocessor = benchmark::accumulate(input.cloud);
  const PreprocessingParameters& parameters = preprocessor.parameters();

  AboveGround above;
  VoxelMap map(parameters.block_size, parameters.voxel_size);
  std::map<BlockIndex, std::unordered_map<VoxelKey, std::int32_t>> voxels;
  const auto keyOf = [&](const Eigen::Vector3d& p, const BlockIndex& tile) {
    return voxelKey((p - map.originOf(tile)).cast<float>(), map.voxelSize());
  };
  bool first = true;
  for (const BlockIndex& index : preprocessor.dueBlocks(true)) {
    const Block block = preprocessor.makeBlock(index, true);
    if (first) map.setHeightDatum(block.cloud.origin.z());
    first = false;
    for (std::size_t i = 0; i < block.cloud.size(); ++i) {
      const Eigen::Vector3d p = block.cloud.mapPoint(i);
      if (!block.header.holds(p.x(), p.y())) continue;
      voxels[index][keyOf(p, index)] = static_cast<std::int32_t>(above.points->size());
      const Eigen::Vector3f local = (p - input.cloud.origin).cast<float>();
      above.points->push_back(pcl::PointXYZ(local.x(), local.y(), local.z()));
      above.height.push_back(block.ground.heightAbove(block.cloud.points[i]));
    }
  }
  above.seconds = secondsSince(start);

  above.voxel_of.assign(input.cloud.size(), -1);
  above.inputs.assign(above.points->size(), 0U);
  above.stem_inputs.assign(above.points->size(), 0U);
  for (std::size_t i = 0; i < input.cloud.size(); ++i) {
    const bool stem = part.at(&input.contents.data[i * input.contents.point_step]) == kStemPart;
    above.true_stem_points += stem ? 1U : 0U;
    if (!input.cloud.points[i].allFinite()) continue;
    const Eigen::Vector3d p = input.cloud.mapPoint(i);
    const BlockIndex tile = map.tileAt(p.x(), p.y());
    const auto in_tile = voxels.find(tile);
    if (in_tile == voxels.end()) continue;
    const auto voxel = in_tile->second.find(keyOf(p, tile));
    if (voxel == in_tile->second.end()) continue;
    above.voxel_of[i] = voxel->second;
    ++above.inputs[static_cast<std::size_t>(voxel->second)];
    if (stem) ++above.stem_inputs[static_cast<std::size_t>(voxel->second)];
  }
  return above;
}

/// The shape of a cluster, by which it is taken for a stem or not.
struct Shape {
  double tilt = 0.0;        ///< of the first principal axis from vertical [rad]
  double thickness = 0.0;   ///< root mean square distance from that axis [m]
  double length = 0.0;      ///< along the axis [m]
  double elongation = 0.0;  ///< standard deviation along the axis to the greater one across
  double foot = 0.0;        ///< height of the lowest point above the soil [m]
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< upwards
  double soil = 0.0;                                ///< z of the soil below the lowest point [m]
  std::uint64_t inputs = 0U;
  std::uint64_t stem_inputs = 0U;
};

Shape describe(const Indices& cluster, const AboveGround& above) {
  Shape shape;
  const auto at = [&](int i) {
    return above.points->points[static_cast<std::size_t>(i)].getVector3fMap().cast<double>();
  };
  for (const int i : cluster) shape.mean += at(i);
  shape.mean /= static_cast<double>(cluster.size());
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const int i : cluster) {
    const Eigen::Vector3d d = at(i) - shape.mean;
    covariance += d * d.transpose();
  }
  covariance /= static_cast<double>(cluster.size());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
  const Eigen::Vector3d variances = solver.eigenvalues().cwiseMax(0.0);
  shape.axis = solver.eigenvectors().col(2);
  if (shape.axis.z() < 0.0) shape.axis = -shape.axis;
  shape.tilt = std::acos(std::min(1.0, shape.axis.z()));
  shape.thickness = std::sqrt(variances[0] + variances[1]);
  constexpr double kLeastVariance = 1e-12;  // [m^2] keeps the ratio finite for points on a line
  shape.elongation = std::sqrt(variances[2] / std::max(kLeastVariance, variances[1]));
  double low = std::numeric_limits<double>::infinity(), high = -low;
  shape.foot = std::numeric_limits<double>::infinity();
  for (const int i : cluster) {
    const auto point = static_cast<std::size_t>(i);
    const double along = shape.axis.dot(at(i) - shape.mean);
    low = std::min(low, along);
    high = std::max(high, along);
    if (static_cast<double>(above.height[point]) < shape.foot) {
      shape.foot = static_cast<double>(above.height[point]);
      shape.soil = at(i).z() - shape.foot;
    }
    shape.inputs += above.inputs[point];
    shape.stem_inputs += above.stem_inputs[point];
  }
  shape.length = high - low;
  return shape;
}

/// When a cluster is a stem.
struct Rule {
  double tilt = 0.0;        ///< at most [rad]
  double thickness = 0.0;   ///< at most [m]
  double length = 0.0;      ///< at least [m]
  double elongation = 0.0;  ///< at least
  double foot = 0.0;        ///< at most [m]

  bool holds(const Shape& shape) const {
    return shape.tilt <= tilt && shape.thickness <= thickness && shape.length >= length &&
           shape.elongation >= elongation && shape.foot <= foot;
  }
};

std::vector<Rule> allRules(const Grid& grid) {
  std::vector<Rule> rules;
  for (const double tilt : grid.tilt) {
    for (const double thickness : grid.thickness) {
      for (const double length : grid.length) {
        for (const double elongation : grid.elongation) {
          for (const double foot : grid.foot) {
            rules.push_back({tilt * kDegree, thickness, length, elongation, foot});
          }
        }
      }
    }
  }
  return rules;
}

/// F1 of the stem class over all input points, as `evaluate` has it.
double stemF1(const std::vector<Shape>& shapes, const Rule& rule, const AboveGround& above) {
  std::uint64_t claimed = 0U, hits = 0U;
  for (const Shape& shape : shapes) {
    if (!rule.holds(shape)) continue;
    claimed += shape.inputs;
    hits += shape.stem_inputs;
  }
  const std::uint64_t all = claimed + above.true_stem_points;
  return all == 0U ? 0.0 : 2.0 * static_cast<double>(hits) / static_cast<double>(all);
}

/// One clustering, with the rule that suits it best.
struct Result {
  double f1 = -1.0;
  nlohmann::ordered_json settings;
  std::vector<pcl::PointIndices> clusters;
  std::vector<Shape> shapes;
  Rule rule;
  double normal_seconds = 0.0;
  double clustering_seconds = 0.0;
  double rule_seconds = 0.0;  ///< to describe the clusters and judge them by one rule
};

/// Keeps the better of `best` and `tried`; `tried` gets its rule here.
void judge(Result&& tried, const std::vector<Rule>& rules, const AboveGround& above, Result& best) {
  const Clock::time_point start = Clock::now();
  for (const pcl::PointIndices& cluster : tried.clusters) {
    tried.shapes.push_back(describe(cluster.indices, above));
  }
  tried.rule_seconds = secondsSince(start);
  for (const Rule& rule : rules) {
    const double f1 = stemF1(tried.shapes, rule, above);
    if (f1 <= tried.f1) continue;
    tried.f1 = f1;
    tried.rule = rule;
  }
  if (tried.f1 > best.f1) best = std::move(tried);
}

using Progress = std::function<void(double)>;

Result growRegions(const AboveGround& above, const Grid& grid, const std::vector<Rule>& rules,
                   const Progress& progress) {
  Result best;
  const double total = static_cast<double>(grid.normal_neighbours.size() * grid.neighbours.size() *
                                           grid.smoothness.size() * grid.curvature.size());
  double done = 0.0;
  for (const int normal_neighbours : grid.normal_neighbours) {
    Clock::time_point start = Clock::now();
    const Normals::Ptr normals = benchmark::estimateNormals(above.points, normal_neighbours, 1);
    const double normal_seconds = secondsSince(start);
    for (const int neighbours : grid.neighbours) {
      for (const double smoothness : grid.smoothness) {
        for (const double curvature : grid.curvature) {
          start = Clock::now();
          Result tried;
          tried.clusters = benchmark::growRegions(
              above.points, normals,
              {kMinClusterPoints, neighbours, smoothness * kDegree, curvature});
          tried.normal_seconds = normal_seconds;
          tried.clustering_seconds = secondsSince(start);
          tried.settings = {{"normal_neighbours", normal_neighbours},
                            {"neighbours", neighbours},
                            {"smoothness_deg", smoothness},
                            {"curvature", curvature}};
          judge(std::move(tried), rules, above, best);
          progress(++done / total);
        }
      }
    }
  }
  return best;
}

Result clusterByDistance(const AboveGround& above, const Grid& grid, const std::vector<Rule>& rules,
                         const Progress& progress) {
  Result best;
  double done = 0.0;
  for (const double tolerance : grid.tolerance) {
    const Clock::time_point start = Clock::now();
    const pcl::search::KdTree<pcl::PointXYZ>::Ptr tree(new pcl::search::KdTree<pcl::PointXYZ>);
    tree->setInputCloud(above.points);
    pcl::EuclideanClusterExtraction<pcl::PointXYZ> extraction;
    extraction.setClusterTolerance(tolerance);
    extraction.setMinClusterSize(kMinClusterPoints);
    extraction.setMaxClusterSize(std::numeric_limits<int>::max());
    extraction.setSearchMethod(tree);
    extraction.setInputCloud(above.points);
    Result tried;
    extraction.extract(tried.clusters);
    tried.clustering_seconds = secondsSince(start);
    tried.settings = {{"tolerance_m", tolerance}};
    judge(std::move(tried), rules, above, best);
    progress(++done / static_cast<double>(grid.tolerance.size()));
  }
  return best;
}

/// Where the cluster's axis meets the soil, in the frame of `above`.
Eigen::Vector3d baseOf(const Shape& shape) {
  return shape.mean + shape.axis * ((shape.soil - shape.mean.z()) / shape.axis.z());
}

/// Stem clusters by plant, for a stem breaks into pieces. A piece belongs to the plant whose
/// longest piece's axis it lies near to, or meets the soil near to: nearer than two plants may
/// stand.
struct Plants {
  std::vector<Phenotype> plants;
  std::vector<std::int32_t> plant_of;  ///< of each cluster; -1 where it is no stem
};

Plants joinPieces(const Result& result, const Eigen::Vector3d& origin) {
  const double spacing = SegmentationParameters().min_plant_spacing;
  std::vector<std::size_t> stems;
  for (std::size_t c = 0; c < result.shapes.size(); ++c) {
    if (result.rule.holds(result.shapes[c])) stems.push_back(c);
  }
  std::stable_sort(stems.begin(), stems.end(), [&](std::size_t a, std::size_t b) {
    return result.shapes[a].length > result.shapes[b].length;
  });
  Plants joined;
  joined.plant_of.assign(result.shapes.size(), -1);
  for (const std::size_t c : stems) {
    const Shape& shape = result.shapes[c];
    const Eigen::Vector3d base = origin + baseOf(shape);
    const Eigen::Vector3d mean = origin + shape.mean;
    auto same =
        std::find_if(joined.plants.begin(), joined.plants.end(), [&](const Phenotype& plant) {
          const double rise = (mean.z() - plant.base.z()) / plant.axis.z();
          const Eigen::Vector3d at_height = plant.base + rise * plant.axis;
          return (at_height - mean).head<2>().norm() < spacing ||
                 (plant.base - base).head<2>().norm() < spacing;
        });
    if (same == joined.plants.end()) {
      Phenotype plant;
      plant.id = static_cast<std::int32_t>(joined.plants.size());
      plant.base = base;
      plant.axis = shape.axis;
      same = joined.plants.insert(joined.plants.end(), plant);
    }
    same->stem_points += static_cast<std::uint32_t>(shape.inputs);
    same->plant_points = same->stem_points;
    joined.plant_of[c] = same->id;
  }
  return joined;
}

std::vector<PointLabel> labelPoints(const Result& result, const Plants& plants,
                                    const AboveGround& above) {
  std::vector<PointLabel> of_voxel(above.points->size());
  for (std::size_t c = 0; c < result.clusters.size(); ++c) {
    if (plants.plant_of[c] < 0) continue;
    for (const int i : result.clusters[c].indices) {
      of_voxel[static_cast<std::size_t>(i)] = {plants.plant_of[c], Part::kStem};
    }
  }
  std::vector<PointLabel> labels(above.voxel_of.size());
  for (std::size_t i = 0; i < labels.size(); ++i) {
    if (above.voxel_of[i] >= 0) labels[i] = of_voxel[static_cast<std::size_t>(above.voxel_of[i])];
  }
  return labels;
}

void writeResult(const std::string& path, const Options& options, const Result& result,
                 const AboveGround& above, std::size_t plants) {
  nlohmann::ordered_json json;
  json["method"] = options.method;
  json["settings"] = result.settings;
  json["rule"] = {{"max_tilt_deg", result.rule.tilt / kDegree},
                  {"max_thickness_m", result.rule.thickness},
                  {"min_length_m", result.rule.length},
                  {"min_elongation", result.rule.elongation},
                  {"max_foot_m", result.rule.foot}};
  json["seconds"] = {{"preprocessing", above.seconds},
                     {"normals", result.normal_seconds},
                     {"clustering", result.clustering_seconds},
                     {"rule", result.rule_seconds}};
  json["points"] = above.points->size();
  json["clusters"] = result.clusters.size();
  json["plants"] = plants;
  json["stem_f1"] = result.f1;
  std::ofstream file(path);
  file << json.dump(2) << "\n";
  if (!file.flush()) {
    throw std::runtime_error(path +
                             " cannot be written; is the disk full or the folder read-only?");
  }
}

void run(const Options& options) {
  std::error_code failure;
  std::filesystem::create_directories(options.output, failure);
  if (failure) {
    throw std::runtime_error(options.output + ": cannot be made: " + failure.message());
  }
  const ThreadLimit one_thread(1);
  simulation::ProgressBar bar;
  bar.update("reading", 0.0);
  const CloudFile input = readCloudFile(options.input);
  const AboveGround above = removeGround(input, options.input);
  if (above.points->empty()) {
    throw std::runtime_error(options.input + ": no point is above the soil; nothing to cluster");
  }
  const std::vector<Rule> rules = allRules(options.grid);
  const Progress progress = [&](double share) { bar.update("clustering", share); };
  const Result best = options.method == "euclidean"
                          ? clusterByDistance(above, options.grid, rules, progress)
                          : growRegions(above, options.grid, rules, progress);
  const Plants plants = joinPieces(best, input.cloud.origin);
  bar.update("writing", 0.0);
  writePhenotypeCsv(options.output + "/plants.csv", plants.plants);
  writeLabels(options.output + "/labels.pcd", input, labelPoints(best, plants, above));
  writeResult(options.output + "/result.json", options, best, above, plants.plants.size());
  bar.update("writing", 1.0);
  std::printf("%zu clusters, %zu plants, stem F1 %.3f, %s -> %s\n", best.clusters.size(),
              plants.plants.size(), best.f1, best.settings.dump().c_str(), options.output.c_str());
}

template <typename Value>
void addGrid(CLI::App& app, const std::string& name, std::vector<Value>& values, const char* unit,
             const std::string& help) {
  app.add_option(name, values, help)
      ->capture_default_str()
      ->type_name(std::string("[") + unit + "] ...")
      ->check(CLI::PositiveNumber);
}

}  // namespace
}  // namespace field_phenotyping

int main(int argc, char** argv) {
  field_phenotyping::Options options;
  field_phenotyping::Grid& grid = options.grid;
  CLI::App app(
      "Finds stems with the clustering of the Point Cloud Library, to compare with "
      "phenotype_cloud.\n"
      "Soil and outliers are taken out as there. Every combination of the values below is tried "
      "on one thread,\n"
      "and the one with the best F1 of the stem class is kept: the truth, field part of the input "
      "(1 stem), is\n"
      "used to choose. Writes plants.csv, labels.pcd (part 1 for stems; leaves are left out) and "
      "result.json\n"
      "(the settings kept and their seconds).");
  app.add_option("input", options.input, "Cloud with a field part, .pcd or .ply, metres, z up")
      ->required();
  app.add_option("-o,--output", options.output, "Folder for the results; made when missing")
      ->required();
  app.add_option("--method", options.method, "region_growing or euclidean")
      ->required()
      ->check(CLI::IsMember({"region_growing", "euclidean"}));
  using field_phenotyping::addGrid;
  addGrid(app, "--normal-neighbours", grid.normal_neighbours, "count",
          "Neighbours of a normal (region_growing)");
  addGrid(app, "--neighbours", grid.neighbours, "count",
          "Neighbours a region grows to (region_growing)");
  addGrid(app, "--smoothness", grid.smoothness, "deg",
          "Most angle between neighbouring normals (region_growing)");
  addGrid(app, "--curvature", grid.curvature, "-",
          "Most curvature of a point to grow on from (region_growing)");
  addGrid(app, "--tolerance", grid.tolerance, "m",
          "Most distance of neighbours in a cluster (euclidean)");
  addGrid(app, "--tilt", grid.tilt, "deg",
          "A stem's first principal axis is at most this far from vertical");
  addGrid(app, "--thickness", grid.thickness, "m",
          "Most root mean square distance of a stem's points from that axis");
  addGrid(app, "--length", grid.length, "m", "Least length of a stem along that axis");
  addGrid(app, "--elongation", grid.elongation, "-",
          "Least ratio of a stem's standard deviations along and across");
  addGrid(app, "--foot", grid.foot, "m", "Most height of a stem's lowest point above the soil");
  CLI11_PARSE(app, argc, argv);
  try {
    field_phenotyping::run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "pcl_clusters: error: %s\n", error.what());
    return 1;
  }
  return 0;
}
