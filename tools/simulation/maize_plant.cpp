#include "simulation/maize_plant.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

namespace field_phenotyping::simulation {
namespace {

constexpr double kDegree = M_PI / 180.0;
constexpr float kStemReflectance = 0.45F;
constexpr float kLeafReflectance = 0.55F;
constexpr float kDryReflectance = 0.65F;

/// Typical plant of a stage. Lengths in metres, angles in degrees from vertical.
struct StageProfile {
  double plant_height;  ///< nominal, to the highest point
  double stem_length;
  double stem_diameter;    ///< major axis at the measuring height
  double diameter_stddev;  ///< share of the diameter
  int nodes;               ///< above the soil
  int bare_nodes;          ///< lowest ones, whose leaves have withered
  double last_node;        ///< share of the stem's length
  double leaf_length;      ///< longest
  double lowest_leaf;      ///< length relative to the longest
  double highest_leaf;     ///< the same
  double leaf_width;       ///< widest
  double insertion_lowest, insertion_highest;
  double tip_lowest, tip_highest;
  double droop_exponent;
  bool tassel;
  bool ear;
};

const StageProfile& stageProfile(GrowthStage stage) {
  static const StageProfile kSeedling{0.40, 0.16,  0.010, 0.09, 6,     1,    0.97, 0.33,  0.50,
                                      0.80, 0.030, 42.0,  14.0, 115.0, 55.0, 1.6,  false, false};
  static const StageProfile kJointing{1.20, 0.68,  0.019, 0.08, 10,    2,    0.98, 0.66,  0.60,
                                      0.80, 0.065, 38.0,  10.0, 125.0, 50.0, 1.7,  false, false};
  static const StageProfile kTasselling{2.05, 1.70,  0.022, 0.08, 14,    3,    0.88, 0.80, 0.70,
                                        0.48, 0.085, 38.0,  22.0, 135.0, 85.0, 1.5,  true, false};
  static const StageProfile kRipe{2.00, 1.66,  0.0215, 0.09, 14,    4,     0.88, 0.74, 0.65,
                                  0.48, 0.065, 45.0,   30.0, 172.0, 155.0, 0.8,  true, true};
  switch (stage) {
    case GrowthStage::kSeedling:
      return kSeedling;
    case GrowthStage::kJointing:
      return kJointing;
    case GrowthStage::kTasselling:
      return kTasselling;
    case GrowthStage::kRipe:
      return kRipe;
  }
  throw std::invalid_argument("unknown growth stage");
}

double lerp(double low, double high, double share) {
  return low + (high - low) * share;
}

/// Internodes are short at the foot, long in the middle and a little shorter again above.
std::vector<StemNode> drawNodes(const StageProfile& profile, double stem_height,
                                RandomStream& random) {
  std::vector<double> tops;
  double top = 0.0;
  for (int i = 0; i < profile.nodes; ++i) {
    const double share = (i + 0.5) / profile.nodes;
    const double length = 0.30 + 1.1 * std::sin(M_PI * std::min(share * 0.8, 1.0));
    top += length * random.normal(1.0, 0.08);
    tops.push_back(top);
  }
  std::vector<StemNode> nodes;
  for (const double node_top : tops) {
    StemNode node;
    node.height = node_top / top * profile.last_node * stem_height;
    node.swelling = random.uniform(0.03, 0.08);
    nodes.push_back(node);
  }
  return nodes;
}

Stem drawStem(const StageProfile& profile, const PlantSettings& settings, double size,
              const Eigen::Vector3d& base, RandomStream& random) {
  Stem stem;
  stem.base = base;
  const double lean = std::min(std::abs(random.normal(0.0, settings.lean_stddev_deg)), 60.0);
  const double lean_azimuth = random.uniform(0.0, 2.0 * M_PI);
  stem.slope =
      std::tan(lean * kDegree) * Eigen::Vector2d(std::cos(lean_azimuth), std::sin(lean_azimuth));
  stem.height = profile.stem_length * size * std::cos(lean * kDegree);
  stem.bow = {random.normal(0.0, 0.007), random.normal(0.0, 0.007)};
  stem.wave = {random.normal(0.0, 0.0015), random.normal(0.0, 0.0015)};
  const double mean_diameter =
      settings.mean_stem_diameter > 0.0 ? settings.mean_stem_diameter : profile.stem_diameter;
  stem.reference_semi_major = 0.5 * mean_diameter * random.normal(1.0, profile.diameter_stddev);
  stem.reference_height = diameterHeight(stem.length(), settings.diameter_height);
  stem.axis_ratio = random.uniform(0.80, 0.95);
  stem.major_azimuth = random.uniform(0.0, 2.0 * M_PI);
  stem.nodes = drawNodes(profile, stem.height, random);
  return stem;
}

/// The longest leaf sits a little above the middle.
double leafLengthShare(const StageProfile& profile, double rank) {
  constexpr double kLongest = 0.55;
  const double end = rank < kLongest ? profile.lowest_leaf : profile.highest_leaf;
  const double offset =
      rank < kLongest ? 1.0 - rank / kLongest : (rank - kLongest) / (1 - kLongest);
  return lerp(1.0, end, offset * offset);
}

Blade drawLeaf(const StageProfile& profile, const Stem& stem, double node_height, double rank,
               double azimuth, double size, RandomStream& random) {
  Blade blade;
  const double length_share = leafLengthShare(profile, rank);
  blade.azimuth = azimuth;
  blade.azimuth_drift = random.normal(0.0, 0.25);
  blade.length = profile.leaf_length * size * length_share * random.normal(1.0, 0.08);
  blade.width = profile.leaf_width * size * std::sqrt(length_share) * random.normal(1.0, 0.08);
  blade.insertion_angle = lerp(profile.insertion_lowest, profile.insertion_highest, rank) *
                          kDegree * random.normal(1.0, 0.15);
  blade.tip_angle =
      lerp(profile.tip_lowest, profile.tip_highest, rank) * kDegree * random.normal(1.0, 0.12);
  blade.droop_exponent = profile.droop_exponent * random.uniform(0.75, 1.35);
  blade.roll = random.normal(0.0, 0.5);
  blade.trough_angle = random.uniform(10.0, 28.0) * kDegree;
  blade.ripple = random.uniform(0.05, 0.13) * blade.width;
  blade.ripple_phase = random.uniform(0.0, 2.0 * M_PI);
  constexpr double kClearance = 0.0005;
  blade.clasp_radius = stem.semiMajor(node_height) + kClearance;
  blade.start = stem.surfacePointTowards(node_height, azimuth) +
                kClearance * Eigen::Vector3d(std::cos(azimuth), std::sin(azimuth), 0.0);
  return blade;
}

/// A tapering branch that starts at `angle` from vertical and bends over by `droop`.
void addBranch(const Eigen::Vector3d& start, double azimuth, double angle, double droop,
               double length, double radius, TriangleMesh& mesh) {
  constexpr int kSegments = 8;
  std::vector<Eigen::Vector3d> line{start};
  std::vector<double> radii{radius};
  for (int i = 1; i <= kSegments; ++i) {
    const double share = static_cast<double>(i) / kSegments;
    const double a = angle + droop * share * share;
    line.push_back(line.back() + length / kSegments *
                                     Eigen::Vector3d(std::sin(a) * std::cos(azimuth),
                                                     std::sin(a) * std::sin(azimuth), std::cos(a)));
    radii.push_back(radius * (1.0 - 0.6 * share));
  }
  addTubeMesh(line, radii, 6, mesh);
}

void addTassel(const Stem& stem, double size, RandomStream& random, TriangleMesh& mesh) {
  const Eigen::Vector3d top = stem.axisPoint(stem.height);
  const Eigen::Vector3d direction = stem.axisDirection(stem.height);
  const double azimuth = std::atan2(direction.y(), direction.x());
  const double angle = std::acos(std::clamp(direction.z(), -1.0, 1.0));
  const double spike = random.uniform(0.28, 0.40) * size;
  const double spike_droop = random.uniform(0.0, 0.35);
  addBranch(top, azimuth, angle, spike_droop, spike, 0.0045, mesh);
  const int branches = 6 + static_cast<int>(random.uniform(0.0, 8.0));
  for (int i = 0; i < branches; ++i) {
    const Eigen::Vector3d start = top + direction * (0.02 + 0.10 * size * i / branches);
    addBranch(start, random.uniform(0.0, 2.0 * M_PI), random.uniform(18.0, 50.0) * kDegree,
              random.uniform(10.0, 75.0) * kDegree, random.uniform(0.13, 0.24) * size, 0.0025,
              mesh);
  }
}

/// A spindle on a short shank that keeps it clear of the stem.
void addEar(const Stem& stem, double node_height, double azimuth, double size, RandomStream& random,
            TriangleMesh& mesh) {
  constexpr int kRings = 12;
  constexpr double kShankLength = 0.035;
  constexpr double kShankAngle = 55.0 * kDegree;
  constexpr double kShankRadius = 0.007;
  const double length = random.uniform(0.17, 0.23) * size;
  const double radius = random.uniform(0.021, 0.027);
  const double angle = random.uniform(8.0, 40.0) * kDegree;
  const auto direction = [azimuth](double from_vertical) {
    return Eigen::Vector3d(std::sin(from_vertical) * std::cos(azimuth),
                           std::sin(from_vertical) * std::sin(azimuth), std::cos(from_vertical));
  };
  std::vector<Eigen::Vector3d> line{stem.surfacePointTowards(node_height, azimuth)};
  std::vector<double> radii{kShankRadius};
  const Eigen::Vector3d foot = line.front() + kShankLength * direction(kShankAngle);
  for (int i = 0; i <= kRings; ++i) {
    const double share = static_cast<double>(i) / kRings;
    const double spindle = std::pow(std::sin(M_PI * std::pow(share, 0.7)), 0.7);
    line.push_back(foot + share * length * direction(angle));
    radii.push_back(i < kRings ? std::max(radius * spindle, kShankRadius) : 0.002);
  }
  addTubeMesh(line, radii, 14, mesh);
}

double highestPoint(const TriangleMesh& mesh, std::size_t first_vertex) {
  float highest = -std::numeric_limits<float>::infinity();
  for (std::size_t i = first_vertex; i < mesh.vertices.size(); ++i) {
    highest = std::max(highest, mesh.vertices[i].z());
  }
  return static_cast<double>(highest);
}

}  // namespace

std::string stageName(GrowthStage stage) {
  switch (stage) {
    case GrowthStage::kSeedling:
      return "seedling";
    case GrowthStage::kJointing:
      return "jointing";
    case GrowthStage::kTasselling:
      return "tasselling";
    case GrowthStage::kRipe:
      return "ripe";
  }
  throw std::invalid_argument("unknown growth stage");
}

GrowthStage stageFromName(const std::string& name) {
  for (const GrowthStage stage : {GrowthStage::kSeedling, GrowthStage::kJointing,
                                  GrowthStage::kTasselling, GrowthStage::kRipe}) {
    if (stageName(stage) == name) {
      return stage;
    }
  }
  throw std::invalid_argument("unknown growth stage '" + name +
                              "': use seedling, jointing, tasselling or ripe");
}

MaizePlant growMaizePlant(const PlantSettings& settings, std::int32_t id, std::int32_t row,
                          const Eigen::Vector3d& base, RandomStream random, TriangleMesh& mesh) {
  const StageProfile& profile = stageProfile(settings.stage);
  const double scale =
      settings.mean_height > 0.0 ? settings.mean_height / profile.plant_height : 1.0;
  const double size = scale * random.normal(1.0, settings.size_stddev);
  const std::size_t first_vertex = mesh.vertices.size();

  MaizePlant plant;
  plant.id = id;
  plant.row = row;
  plant.stem = drawStem(profile, settings, size, base, random);
  plant.diameter_height = plant.stem.reference_height;
  mesh.beginSurface({id, Part::kStem, kStemReflectance});
  addStemMesh(plant.stem, mesh);

  const bool dry = settings.stage == GrowthStage::kRipe;
  mesh.beginSurface({id, Part::kOrgan, dry ? kDryReflectance : kLeafReflectance});
  const double first_azimuth = random.uniform(0.0, 2.0 * M_PI);
  const int ear_node = profile.nodes / 2 - static_cast<int>(random.uniform(0.0, 2.0));
  for (int i = profile.bare_nodes; i < profile.nodes; ++i) {
    const double rank = static_cast<double>(i - profile.bare_nodes) /
                        std::max(1, profile.nodes - 1 - profile.bare_nodes);
    const double azimuth = first_azimuth + M_PI * (i % 2) + random.normal(0.0, 0.22);
    const double node_height = plant.stem.nodes[static_cast<std::size_t>(i)].height;
    constexpr double kDryLeafLost = 0.15;
    const bool lost = random.uniform() < kDryLeafLost;
    const Blade leaf = drawLeaf(profile, plant.stem, node_height, rank, azimuth, size, random);
    if (!(dry && lost)) {
      addBladeMesh(leaf, mesh);
      ++plant.leaf_count;
    }
    if (profile.ear && i == ear_node) {
      addEar(plant.stem, node_height, azimuth, size, random, mesh);
    }
  }
  if (profile.tassel) {
    addTassel(plant.stem, size, random, mesh);
  }
  plant.plant_height = highestPoint(mesh, first_vertex) - base.z();
  return plant;
}

void validate(const PlantSettings& settings) {
  const auto require = [](bool ok, const char* message) {
    if (!ok) {
      throw std::invalid_argument(message);
    }
  };
  require(settings.mean_height == 0.0 || (settings.mean_height > 0.05 && settings.mean_height < 6),
          "the mean plant height must be 0 (the stage's own) or 0.05 to 6 m");
  require(settings.mean_stem_diameter == 0.0 ||
              (settings.mean_stem_diameter >= 0.002 && settings.mean_stem_diameter <= 0.1),
          "the mean stem diameter must be 0 (the stage's own) or 2 to 100 mm");
  require(settings.size_stddev >= 0.0 && settings.size_stddev <= 0.3,
          "the spread of plant sizes must be 0 to 0.3 of the mean");
  require(settings.lean_stddev_deg >= 0.0 && settings.lean_stddev_deg <= 45.0,
          "the standard deviation of the lean must be 0 to 45 deg");
  require(settings.diameter_height > 0.0, "the diameter's height must be above 0 m");
}

}  // namespace field_phenotyping::simulation
