#include "simulation/simulation.hpp"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <numeric>
#include <stdexcept>

#include "simulation/random.hpp"

namespace field_phenotyping::simulation {
namespace {

constexpr double kSurplus = 1.04;
constexpr double kSlowest = 0.005;  // [m/s]

/// Share of the pulses that return, from a stratified sample of firings.
double returnShare(const Lidar& lidar, std::int32_t beams, std::uint64_t seed) {
  constexpr std::uint64_t kSamples = 20000;
  const std::uint64_t columns = lidar.columnCount();
  const std::uint64_t samples = std::min(kSamples, columns);
  std::vector<std::uint32_t> returns(samples);
  tbb::parallel_for(std::uint64_t{0}, samples, [&](std::uint64_t i) {
    const double place = static_cast<double>(i) + RandomStream(seed, Stream::kPilot, i).uniform();
    const auto column = static_cast<std::uint64_t>(place * static_cast<double>(columns) /
                                                   static_cast<double>(samples));
    returns[i] = lidar.countReturns(std::min(column, columns - 1));
  });
  const auto sum = std::accumulate(returns.begin(), returns.end(), std::uint64_t{0});
  return static_cast<double>(sum) / (static_cast<double>(samples) * beams);
}

/// The speed at which the merged cloud has `points` points; no faster than the rover's own, at
/// which it has more.
double speedForPoints(const SimulationSettings& settings, const Field& field,
                      const RayCaster& caster, double points) {
  RoverSettings rover = settings.rover;
  double share = 0.4;
  for (int pass = 0; pass < 3; ++pass) {  // the share depends a little on the speed itself
    const double pulses = points / share;
    const double length = Trajectory(field, rover, settings.seed).length();
    rover.speed = length / (pulses / settings.lidar.point_rate);
    const Trajectory trajectory(field, rover, settings.seed);
    const Lidar lidar(settings.lidar, field.mesh, caster, trajectory, settings.seed);
    share = returnShare(lidar, settings.lidar.beams, settings.seed);
    if (share <= 0.0) {
      throw std::runtime_error(
          "the LiDAR sees nothing of the field: check its height, tilt and ranges");
    }
    rover.speed = length / (points / share / settings.lidar.point_rate);
  }
  if (rover.speed < kSlowest) {
    throw std::runtime_error(
        "so many points need a rover slower than 5 mm/s: ask for fewer "
        "points, or simulate a larger field");
  }
  return std::min(rover.speed, settings.rover.speed);
}

/// Removes all but `target` points, chosen by a hash of their number.
void thin(std::uint64_t target, std::uint64_t seed, std::vector<Scan>& scans) {
  std::vector<std::uint64_t> keys;
  for (const Scan& scan : scans) {
    for (std::size_t i = 0; i < scan.points.size(); ++i) {
      keys.push_back(RandomStream(seed, Stream::kThinning, keys.size()).bits());
    }
  }
  if (keys.size() <= target) {
    return;
  }
  std::vector<std::uint64_t> ordered = keys;
  const auto limit = ordered.begin() + static_cast<std::ptrdiff_t>(target);
  std::nth_element(ordered.begin(), limit, ordered.end());
  std::size_t number = 0;
  for (Scan& scan : scans) {
    const auto dropped = [&](const LidarPoint&) { return keys[number++] >= *limit; };
    // remove_if visits the points once and in order, as `number` needs.
    scan.points.erase(std::remove_if(scan.points.begin(), scan.points.end(), dropped),
                      scan.points.end());
  }
}

void takeScans(const ProgressCallback& progress, Simulation& simulation) {
  simulation.scans.resize(simulation.lidar->scanCount());
  std::mutex mutex;
  std::size_t done = 0;
  tbb::parallel_for(std::size_t{0}, simulation.scans.size(), [&](std::size_t i) {
    simulation.scans[i] = simulation.lidar->scan(i);
    const std::lock_guard<std::mutex> lock(mutex);
    ++done;
    progress("casting rays",
             static_cast<double>(done) / static_cast<double>(simulation.scans.size()));
  });
}

}  // namespace

std::uint64_t Simulation::pointCount() const {
  std::uint64_t count = 0;
  for (const Scan& scan : scans) {
    count += scan.points.size();
  }
  return count;
}

std::vector<PlantTruth> Simulation::truth() const {
  std::vector<PlantTruth> truths;
  for (const MaizePlant& plant : field->plants) {
    const Stem& stem = plant.stem;
    PlantTruth truth;
    truth.plant_id = plant.id;
    truth.row = plant.row;
    truth.base = settings.origin + stem.base;
    truth.height = plant.plant_height;
    truth.stem_diameter = 2.0 * stem.smoothSemiMajor(plant.diameter_height);
    truth.stem_diameter_minor = truth.stem_diameter * stem.axis_ratio;
    truth.diameter_height = plant.diameter_height;
    truth.stem_length = stem.length();
    truth.axis = stem.chordDirection();
    truth.lean = std::acos(std::min(truth.axis.z(), 1.0));
    truth.lean_azimuth = std::atan2(truth.axis.y(), truth.axis.x());
    truth.highest_visible_z = std::numeric_limits<double>::quiet_NaN();
    truths.push_back(truth);
  }
  for (const Scan& scan : scans) {
    for (const LidarPoint& point : scan.points) {
      if (point.plant_id < 0) {
        continue;
      }
      PlantTruth& truth = truths[static_cast<std::size_t>(point.plant_id)];
      const double z = settings.origin.z() + scan.mapPosition(point).z();
      truth.highest_visible_z =
          truth.visible_points == 0 ? z : std::max(truth.highest_visible_z, z);
      ++truth.visible_points;
      truth.visible_stem_points += point.part == Part::kStem ? 1U : 0U;
    }
  }
  return truths;
}

Simulation simulate(const SimulationSettings& settings, const ProgressCallback& progress) {
  Simulation simulation;
  simulation.settings = settings;
  validate(settings.rover);
  validate(settings.lidar);
  progress("growing the field", 0.0);
  simulation.field = std::make_unique<Field>(growField(settings.field, settings.seed));
  progress("growing the field", 0.5);
  const Field& field = *simulation.field;
  simulation.caster = std::make_unique<RayCaster>(field.mesh);
  progress("growing the field", 1.0);

  RoverSettings& rover = simulation.settings.rover;
  if (settings.target_points > 0) {
    rover.speed = speedForPoints(settings, field, *simulation.caster,
                                 kSurplus * static_cast<double>(settings.target_points));
  }
  simulation.trajectory = std::make_unique<Trajectory>(field, rover, settings.seed);
  simulation.lidar = std::make_unique<Lidar>(settings.lidar, field.mesh, *simulation.caster,
                                             *simulation.trajectory, settings.seed);
  takeScans(progress, simulation);
  if (settings.target_points > 0) {
    thin(settings.target_points, settings.seed, simulation.scans);
  }
  if (simulation.pointCount() == 0) {
    throw std::runtime_error(
        "the LiDAR sees nothing of the field: check its height, tilt and ranges");
  }
  return simulation;
}

}  // namespace field_phenotyping::simulation
