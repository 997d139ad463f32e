#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {
namespace testing {

constexpr double kDegree = M_PI / 180.0;

/// Height of the soil [m] at x, y.
using Soil = std::function<double(double, double)>;

inline Soil levelSoil() {
  return [](double, double) { return 0.0; };
}

/// A plane that rises by `degrees` towards `azimuth` [deg from x].
inline Soil slopingSoil(double degrees, double azimuth = 0.0) {
  const double rise = std::tan(degrees * kDegree);
  const double a = rise * std::cos(azimuth * kDegree);
  const double b = rise * std::sin(azimuth * kDegree);
  return [=](double x, double y) { return a * x + b * y; };
}

/// Ridges along x, `height` from furrow to crest.
inline Soil ridgedSoil(double height, double wavelength) {
  return [=](double, double y) { return 0.5 * height * std::cos(2.0 * M_PI * y / wavelength); };
}

/// What a plant of the scene truly is. Metres, radians.
struct PlantTruth {
  Eigen::Vector2d base{0.0, 0.0};
  double stem_length = 1.5;
  double radius = 0.011;    // at the soil
  double top_radius = 0.0;  // 0: as at the soil
  double lean = 0.0;        // towards `azimuth`
  double azimuth = 0.0;
  int leaves = 4;
  double gap_low = 0.0, gap_high = 0.0;  // lengths along the stem without any point
  int stem_points_per_metre = 1500;
};

/// Which thing of the scene a point is.
struct PointTruth {
  int plant = -1;  // index into Scene::plants
  bool stem = false;
  bool soil = false;
};

/// A field of straight stems with arched leaves on soil of a given shape: every point's plant and
/// organ is known exactly. Same seed, same points.
class Scene {
 public:
  explicit Scene(Soil soil = levelSoil(), unsigned seed = 1U, double noise = 0.001)
      : soil_(std::move(soil)), random_(seed), noise_(0.0, noise) {}

  PointCloud cloud;
  std::vector<PointTruth> truth;  // one per point
  std::vector<PlantTruth> plants;

  double soilAt(double x, double y) const { return soil_(x, y); }
  Eigen::Vector3d baseOf(const PlantTruth& plant) const {
    return {plant.base.x(), plant.base.y(), soilAt(plant.base.x(), plant.base.y())};
  }

  /// Soil seen from above, `density` points a square metre.
  Scene& addSoil(const Eigen::Vector2d& low, const Eigen::Vector2d& high, double density,
                 double roughness = 0.003) {
    std::normal_distribution<double> rough(0.0, roughness);
    const auto count = static_cast<int>((high - low).prod() * density);
    for (int k = 0; k < count; ++k) {
      const double x = low.x() + (high - low).x() * unit_(random_);
      const double y = low.y() + (high - low).y() * unit_(random_);
      add({x, y, soilAt(x, y) + rough(random_)}, {-1, false, true});
    }
    return *this;
  }

  Scene& addPlant(const PlantTruth& plant) {
    const auto index = static_cast<int>(plants.size());
    plants.push_back(plant);
    const Eigen::Vector3d base = baseOf(plant);
    const Eigen::Matrix3d turn = (Eigen::AngleAxisd(plant.azimuth, Eigen::Vector3d::UnitZ()) *
                                  Eigen::AngleAxisd(plant.lean, Eigen::Vector3d::UnitY()))
                                     .toRotationMatrix();
    const auto stem_points = static_cast<int>(plant.stem_length * plant.stem_points_per_metre);
    for (int k = 0; k < stem_points; ++k) {
      const double s = plant.stem_length * unit_(random_);
      const double angle = 2.0 * M_PI * unit_(random_);
      const double r = radiusAt(plant, s) + noise_(random_);
      if (s > plant.gap_low && s < plant.gap_high) continue;
      add(base + turn * Eigen::Vector3d(r * std::cos(angle), r * std::sin(angle), s),
          {index, true, false});
    }
    for (int leaf = 0; leaf < plant.leaves; ++leaf) addLeaf(plant, index, leaf, base, turn);
    return *this;
  }

  /// A tuft of grass: thin blades that spread from one place.
  Scene& addWeed(const Eigen::Vector2d& place, double height) {
    constexpr int kBlades = 8;
    constexpr int kPoints = 60;
    for (int blade = 0; blade < kBlades; ++blade) {
      const double azimuth = 2.0 * M_PI * unit_(random_);
      const double spread = (0.4 + 0.6 * unit_(random_)) * height;
      for (int k = 0; k < kPoints; ++k) {
        const double s = unit_(random_);
        const double x = place.x() + s * spread * std::cos(azimuth) + noise_(random_);
        const double y = place.y() + s * spread * std::sin(azimuth) + noise_(random_);
        add({x, y, soilAt(x, y) + height * (2.0 * s - s * s) + noise_(random_)}, {});
      }
    }
    return *this;
  }

  /// Height of the plant's highest point above the soil at its base.
  double heightOf(int plant) const {
    double top = 0.0;
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      if (truth[i].plant == plant) top = std::max(top, static_cast<double>(cloud.points[i].z()));
    }
    const PlantTruth& p = plants[static_cast<std::size_t>(plant)];
    return top - soilAt(p.base.x(), p.base.y());
  }

 private:
  static double radiusAt(const PlantTruth& plant, double s) {
    const double top = plant.top_radius > 0.0 ? plant.top_radius : plant.radius;
    return plant.radius + (top - plant.radius) * s / plant.stem_length;
  }

  void addLeaf(const PlantTruth& plant, int index, int leaf, const Eigen::Vector3d& base,
               const Eigen::Matrix3d& turn) {
    constexpr double kLength = 0.35;
    constexpr double kWidth = 0.04;
    constexpr int kPoints = 700;
    const double start = plant.stem_length * (0.3 + 0.6 * leaf / std::max(plant.leaves, 1));
    const double azimuth = M_PI * leaf + 0.3;
    const Eigen::Vector3d out(std::cos(azimuth), std::sin(azimuth), 0.0);
    const Eigen::Vector3d across(-out.y(), out.x(), 0.0);
    const Eigen::Vector3d insertion = base + turn * Eigen::Vector3d(0.0, 0.0, start);
    for (int k = 0; k < kPoints; ++k) {
      const double s = kLength * unit_(random_);
      const double rise = 0.8 * s - 1.6 * s * s;
      const double offset = kWidth * (1.0 - 0.5 * s / kLength) * (unit_(random_) - 0.5);
      add(insertion + out * (plant.radius + s) + across * offset +
              Eigen::Vector3d(0.0, 0.0, rise + noise_(random_)),
          {index, false, false});
    }
  }

  void add(const Eigen::Vector3d& point, const PointTruth& point_truth) {
    cloud.points.push_back(point.cast<float>());
    truth.push_back(point_truth);
  }

  Soil soil_;
  std::mt19937 random_;
  std::normal_distribution<double> noise_;
  std::uniform_real_distribution<double> unit_{0.0, 1.0};
};

/// The soil of a scene, known exactly, round the middle of a tile.
inline GroundModel exactGround(const Soil& soil, float half_width = 2.0F) {
  constexpr float kSpacing = 0.05F;
  const int nodes_a_side = static_cast<int>(2.0F * half_width / kSpacing) + 1;
  std::vector<GroundModel::Node> nodes;
  for (int j = 0; j < nodes_a_side; ++j) {
    for (int i = 0; i < nodes_a_side; ++i) {
      const float x = -half_width + kSpacing * static_cast<float>(i);
      const float y = -half_width + kSpacing * static_cast<float>(j);
      nodes.push_back({static_cast<float>(soil(x, y)), 0.004F, 1U});
    }
  }
  return {{-half_width, -half_width}, kSpacing, nodes_a_side, nodes_a_side, std::move(nodes), true};
}

/// The scene's points above the soil as one block, whose tile is centred on the scene's origin.
/// @param source index in the scene of each point of the block
inline Block blockOf(const Scene& scene, const Soil& soil,
                     std::vector<std::size_t>* source = nullptr) {
  Block block;
  block.header.tile_size = 2.0;
  block.header.margin = 1.0;
  block.header.frame_id = "map";
  block.header.revision = 1U;
  block.cloud.origin = {1.0, 1.0, 0.0};  // the middle of tile (0, 0)
  block.ground = exactGround(soil);
  for (std::size_t i = 0; i < scene.cloud.size(); ++i) {
    if (scene.truth[i].soil) {
      ++block.ground_points;
      continue;
    }
    block.cloud.points.push_back(scene.cloud.points[i]);
    if (source != nullptr) source->push_back(i);
  }
  return block;
}

/// One-to-one match of found to true bases, nearest first.
struct BaseMatches {
  std::vector<std::pair<std::size_t, std::size_t>> pairs;  // true, found
  double worst = 0.0;                                      // horizontal distance of a pair [m]
};

inline BaseMatches matchBases(const std::vector<Eigen::Vector2d>& truth,
                              const std::vector<Eigen::Vector2d>& found, double radius = 0.04) {
  BaseMatches matches;
  std::vector<bool> true_used(truth.size(), false);
  std::vector<bool> found_used(found.size(), false);
  for (;;) {
    double nearest = radius;
    std::pair<std::size_t, std::size_t> best{truth.size(), found.size()};
    for (std::size_t a = 0; a < truth.size(); ++a) {
      for (std::size_t b = 0; b < found.size(); ++b) {
        if (true_used[a] || found_used[b] || (truth[a] - found[b]).norm() >= nearest) continue;
        nearest = (truth[a] - found[b]).norm();
        best = {a, b};
      }
    }
    if (best.first == truth.size()) return matches;
    true_used[best.first] = found_used[best.second] = true;
    matches.pairs.push_back(best);
    matches.worst = std::max(matches.worst, nearest);
  }
}

inline std::vector<Eigen::Vector2d> basesOf(const Scene& scene) {
  std::vector<Eigen::Vector2d> bases;
  for (const PlantTruth& plant : scene.plants) bases.push_back(plant.base);
  return bases;
}

/// Local, horizontal.
inline std::vector<Eigen::Vector2d> basesOf(const SegmentedBlock& block) {
  std::vector<Eigen::Vector2d> bases;
  for (const Plant& plant : block.plants) bases.push_back(plant.base.head<2>().cast<double>());
  return bases;
}

/// How well stem points were told from all others.
struct StemScore {
  double precision = 0.0;
  double recall = 0.0;
  double f1 = 0.0;
};

inline StemScore scoreStems(const std::vector<bool>& truly, const std::vector<bool>& claimed) {
  double hits = 0.0, wrong = 0.0, missed = 0.0;
  for (std::size_t i = 0; i < truly.size(); ++i) {
    hits += truly[i] && claimed[i] ? 1.0 : 0.0;
    wrong += !truly[i] && claimed[i] ? 1.0 : 0.0;
    missed += truly[i] && !claimed[i] ? 1.0 : 0.0;
  }
  return {hits / std::max(hits + wrong, 1.0), hits / std::max(hits + missed, 1.0),
          2.0 * hits / std::max(2.0 * hits + wrong + missed, 1.0)};
}

}  // namespace testing
}  // namespace field_phenotyping
