#include "gappy_stems.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <stdexcept>
#include <utility>

#include "cloud_files.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/completion/stem_frame.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "found_stem.hpp"
#include "simulation/maize_plant.hpp"

namespace field_phenotyping::benchmark {
namespace {

using Eigen::Vector3d;
using simulation::RandomStream;
using simulation::Stem;
using simulation::Stream;

constexpr double kPi = 3.14159265358979323846;
constexpr double kSampleSpacing = 0.002;  // [m] of the true surface
constexpr double kCell = 0.01;            // [m] edge of the cells that density is counted in
constexpr double kAxisError = 0.003;      // [m] of the axis as segmented
constexpr double kRadiusError = 0.15;     // share, of its radius

/// Decides which points of a stem are seen.
class Mask {
 public:
  Mask(const Damage& damage, double length, RandomStream& random) : damage_(damage) {
    const double room = std::max(0.8 * length - damage.gap, 0.0);
    gap_begin_ = 0.1 * length + random.uniform() * room;
    const double shadow = std::min(damage.shadow, length);
    shadow_begin_ = random.uniform() * (length - shadow);
    shadow_azimuth_ = random.uniform(-kPi, kPi);
  }
  /// @param s from the lower end of the stem [m] @param theta round it [rad]
  bool hides(double s, double theta, RandomStream& random) const {
    if (random.uniform() < damage_.thinned_share) return true;
    if (s > gap_begin_ && s < gap_begin_ + damage_.gap) return true;
    return s > shadow_begin_ && s < shadow_begin_ + damage_.shadow &&
           std::cos(theta - shadow_azimuth_) < 0.0;
  }

 private:
  Damage damage_;
  double gap_begin_ = 0.0;
  double shadow_begin_ = 0.0;
  double shadow_azimuth_ = 0.0;
};

GroundModel levelGround() {
  constexpr float kHalf = 5.0F;  // [m]
  return GroundModel({-kHalf, -kHalf}, 2.0F * kHalf, 2, 2,
                     std::vector<GroundModel::Node>(4, {0.0F, 0.005F, 1U}), true);
}

Stem drawStem(std::uint64_t seed, int index) {
  constexpr std::array<simulation::GrowthStage, 3> kStages{simulation::GrowthStage::kTasselling,
                                                           simulation::GrowthStage::kJointing,
                                                           simulation::GrowthStage::kRipe};
  simulation::PlantSettings settings;
  settings.stage = kStages[static_cast<std::size_t>(index) % kStages.size()];
  simulation::TriangleMesh mesh;
  return simulation::growMaizePlant(
             settings, index, 0, Vector3d::Zero(),
             RandomStream(seed, Stream::kPlant, static_cast<std::uint64_t>(index)), mesh)
      .stem;
}

/// Samples of the exact surface, in rings, and the cell of each.
TrueSurface exactSurface(const Stem& stem) {
  TrueSurface surface;
  const int rings = std::max(1, static_cast<int>(std::lround(stem.length() / kSampleSpacing)));
  const double ring_length = stem.length() / rings;
  const int rings_a_cell = static_cast<int>(std::lround(kCell / kSampleSpacing));
  std::uint32_t first_cell = 0U;
  int cells = 1;
  for (int ring = 0; ring < rings; ++ring) {
    const double h = stem.height * (ring + 0.5) / rings;
    const double perimeter = kPi * stem.semiMajor(h) * (1.0 + stem.axis_ratio);
    if (ring % rings_a_cell == 0) {
      first_cell = static_cast<std::uint32_t>(surface.cell_area.size());
      cells = std::max(3, static_cast<int>(std::lround(perimeter / kCell)));
      surface.cell_area.resize(surface.cell_area.size() + static_cast<std::size_t>(cells), 0.0);
    }
    const int sides = std::max(8, static_cast<int>(std::lround(perimeter / kSampleSpacing)));
    for (int side = 0; side < sides; ++side) {
      const double share = (side + 0.5) / sides;
      surface.samples.push_back(stem.surfacePoint(h, 2.0 * kPi * share));
      surface.cell.push_back(first_cell + static_cast<std::uint32_t>(share * cells));
      surface.cell_area[surface.cell.back()] += perimeter / sides * ring_length;
    }
  }
  surface.distance = [stem](const Vector3d& point) {
    return SurfaceDistance{stem.signedDistance(point), 0.0};
  };
  return surface;
}

StemAxis segmentedAxis(const Stem& stem, RandomStream& random) {
  constexpr double kNodeSpacing = 0.06;  // [m]
  std::vector<StemAxis::Node> nodes;
  const int steps = std::max(2, static_cast<int>(stem.height / kNodeSpacing));
  const Vector3d offset = kAxisError * Vector3d(random.normal(), random.normal(), 0.0);
  for (int i = 0; i <= steps; ++i) {
    const double h = stem.height * i / steps;
    const Vector3d own = 0.5 * kAxisError * Vector3d(random.normal(), random.normal(), 0.0);
    nodes.push_back({(stem.axisPoint(h) + offset + own).cast<float>(),
                     static_cast<float>((1.0 + kRadiusError) * stem.smoothSemiMajor(h))});
  }
  return StemAxis(std::move(nodes));
}

/// The undamaged stem as measured, on the unrolled stem: a plane through the points near a place,
/// as real scanners have noise too; its own standard deviation is from their scatter. It is known
/// where points were cut out: beside those that were left, what is filled in has no measured point
/// of its own to be compared with.
class UndamagedSurface {
 public:
  UndamagedSurface(StemFrame frame, const std::vector<UnrolledPoint>& points,
                   std::vector<char> is_cut, double radius)
      : frame_(std::move(frame)), points_(points), is_cut_(std::move(is_cut)) {
    std::vector<SurfacePosition> positions;
    for (const UnrolledPoint& p : points) positions.push_back({p.theta, p.s});
    index_ = SurfaceIndex(positions, radius);
  }

  SurfaceDistance distance(const Vector3d& at) const {
    constexpr double kReach = 0.006;  // [m]
    constexpr double kKnown = 0.004;  // [m] nothing is known farther from every measured point
    constexpr int kEnough = 6;
    constexpr int kUnknowns = 3;  // of a plane
    const UnrolledPoint p = frame_.unroll(at);
    double nearest = kReach * kReach;
    bool was_cut = false;
    int count = 0;
    Eigen::Matrix3d squares = 1e-12 * Eigen::Matrix3d::Identity();
    Vector3d sums = Vector3d::Zero();
    double square_sum = 0.0;
    index_.forEachWithin({p.theta, p.s}, kReach, [&](std::uint32_t i, double squared_distance) {
      const UnrolledPoint& q = points_[i];
      const Vector3d row(1.0, std::remainder(q.theta - p.theta, 2.0 * kPi) * index_.radius(),
                         q.s - p.s);
      squares += row * row.transpose();
      sums += (q.r - p.r) * row;
      square_sum += (q.r - p.r) * (q.r - p.r);
      if (squared_distance < nearest) {
        nearest = squared_distance;
        was_cut = is_cut_[i] != 0;
      }
      ++count;
    });
    if (!was_cut || count < kEnough || nearest > kKnown * kKnown) {
      return {std::numeric_limits<double>::quiet_NaN(), 0.0};
    }
    const Eigen::Matrix3d inverse = squares.inverse();
    const Vector3d plane = inverse * sums;
    const double scatter = std::max(square_sum - plane.dot(sums), 0.0) / (count - kUnknowns);
    return {-plane[0], std::sqrt(scatter * inverse(0, 0))};
  }

 private:
  StemFrame frame_;
  std::vector<UnrolledPoint> points_;
  std::vector<char> is_cut_;
  SurfaceIndex index_;
};

StemFrame frameOf(const StemAxis& axis) {
  constexpr float kStep = 0.01F;  // [m]
  std::vector<Vector3d> curve;
  const int steps = std::max(1, static_cast<int>(std::ceil(axis.length() / kStep)));
  for (int i = 0; i <= steps; ++i) {
    curve.push_back(axis.pointAt(axis.length() * static_cast<float>(i) / static_cast<float>(steps))
                        .cast<double>());
  }
  return StemFrame(curve);
}

/// Where the branches of a fork lie beside the axis at height `h` [m].
Vector3d forkShift(const Damage& damage, const Stem& stem, double h, bool left) {
  const double above = std::max(h - 0.5 * stem.height, 0.0);
  return {(left ? 1.0 : -1.0) * std::tan(0.5 * damage.fork) * above, 0.0, 0.0};
}

TrueSurface forkedSurface(const Stem& stem, const Damage& damage) {
  TrueSurface surface = exactSurface(stem);
  for (std::size_t i = 0; i < surface.samples.size(); ++i) {
    surface.samples[i] += forkShift(damage, stem, surface.samples[i].z(), i % 2U == 0U);
  }
  surface.distance = [stem, damage](const Vector3d& point) {
    const double left = stem.signedDistance(point - forkShift(damage, stem, point.z(), true));
    const double right = stem.signedDistance(point - forkShift(damage, stem, point.z(), false));
    return SurfaceDistance{std::abs(left) < std::abs(right) ? left : right, 0.0};
  };
  return surface;
}

}  // namespace

std::vector<Damage> standardDamages() {
  std::vector<Damage> damages(6);
  damages[0].name = "as seen";
  damages[1].name = "gap 5 cm";
  damages[1].gap = 0.05;
  damages[2].name = "gap 10 cm";
  damages[2].gap = 0.10;
  damages[3].name = "gap 20 cm";
  damages[3].gap = 0.20;
  damages[4].name = "half-circle shadow";
  damages[4].shadow = 0.40;
  damages[5].name = "50 % thinned";
  damages[5].thinned_share = 0.5;
  return damages;
}

std::vector<Damage> oddStems() {
  std::vector<Damage> damages(6);
  damages[0].name = "one side only";
  damages[0].shadow = 1e9;
  damages[1].name = "bent by 20 deg, gap 20 cm";
  damages[1].bend = 20.0 * kPi / 180.0;
  damages[1].gap = 0.20;
  damages[2].name = "fork of 15 deg";
  damages[2].fork = 15.0 * kPi / 180.0;
  damages[3].name = "40 points";
  damages[3].points = 40;
  damages[4].name = "8 points";
  damages[4].points = 8;
  damages[5].name = "no points";
  damages[5].points = 0;
  return damages;
}

GappyStem simulatedStem(const SimulatedStems& settings, int index, const Damage& damage) {
  Stem stem = drawStem(settings.seed, index);
  stem.bow += Eigen::Vector2d(damage.bend / 8.0, 0.0);  // the axis' slope goes from 4 bow to -4 bow
  GappyStem result;
  result.name = "simulated " + std::to_string(index);
  result.truth = damage.fork > 0.0 ? forkedSurface(stem, damage) : exactSurface(stem);
  result.ground = levelGround();
  RandomStream random(settings.seed, Stream::kRangeNoise, static_cast<std::uint64_t>(index));
  const Mask mask(damage, stem.length(), random);
  double widest = 0.0;
  for (const double h : {0.0, 0.5 * stem.height, stem.height}) {
    widest = std::max(widest, 1.1 * stem.semiMajor(h));
  }
  const int points = damage.points >= 0 ? damage.points : settings.points;
  for (int drawn = 0; drawn < points;) {
    const double h = stem.height * random.uniform();
    const double angle = random.uniform(-kPi, kPi);
    if (random.uniform() * widest > stem.semiMajor(h)) continue;
    ++drawn;
    const Vector3d noise = Vector3d(random.normal(), random.normal(), random.normal());
    if (mask.hides(h / stem.height * stem.length(), angle, random)) continue;
    result.cloud.points.push_back((stem.surfacePoint(h, angle) +
                                   forkShift(damage, stem, h, drawn % 2 == 0) +
                                   settings.noise * noise)
                                      .cast<float>());
  }
  result.axis = segmentedAxis(stem, random);
  return result;
}

GappyStem realStem(const std::string& path, std::uint64_t seed, const Damage& damage) {
  const CloudFile file = readCloudFile(path);
  const FoundStem found = findStem(file.cloud, path);
  const PointCloud& cloud = found.block->segmented->cloud;
  GappyStem result;
  result.name = std::filesystem::path(path).stem().string();
  result.axis = found.plant->axis;
  result.cloud.origin = cloud.origin;

  const StemFrame frame = frameOf(result.axis);
  std::vector<UnrolledPoint> whole;
  std::vector<double> radii;
  for (std::uint32_t i = found.plant->stem.begin; i < found.plant->stem.end; ++i) {
    whole.push_back(frame.unroll(cloud.points[i].cast<double>()));
    radii.push_back(whole.back().r);
  }
  const double radius = medianOf(radii);
  const double columns = std::max(3.0, std::round(2.0 * kPi * radius / kCell));

  RandomStream random(seed, Stream::kDropout, 0U);
  const Mask mask(damage, frame.length(), random);
  std::map<std::pair<long, long>, std::uint32_t> cells;
  std::vector<char> is_cut;
  for (std::size_t k = 0; k < whole.size(); ++k) {
    const UnrolledPoint& p = whole[k];
    const Eigen::Vector3f& point = cloud.points[found.plant->stem.begin + k];
    const std::pair<long, long> key{
        std::lround(std::floor(p.s / kCell)),
        std::lround(std::floor((p.theta + kPi) / (2.0 * kPi) * columns))};
    const auto [cell, is_new] = cells.insert({key, static_cast<std::uint32_t>(cells.size())});
    if (is_new) result.truth.cell_area.push_back(2.0 * kPi * radius / columns * kCell);
    result.truth.samples.push_back(point.cast<double>());
    result.truth.cell.push_back(cell->second);
    is_cut.push_back(mask.hides(p.s, p.theta, random) ? 1 : 0);
    if (is_cut.back() == 0) result.cloud.points.push_back(point);
  }
  const auto surface = std::make_shared<UndamagedSurface>(frame, whole, std::move(is_cut), radius);
  result.truth.distance = [surface](const Vector3d& at) { return surface->distance(at); };
  return result;
}

}  // namespace field_phenotyping::benchmark
