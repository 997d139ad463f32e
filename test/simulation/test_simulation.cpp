#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <string>

#include "simulation/random.hpp"
#include "simulation/simulation.hpp"
#include "simulation/writers.hpp"

namespace field_phenotyping::simulation {
namespace {

void noProgress(const char*, double) {}

SimulationSettings smallSimulation() {
  SimulationSettings settings;
  settings.field.rows = 2;
  settings.field.plants_per_row = 4;
  settings.target_points = 60000;
  return settings;
}

SimulationSettings exactSensor() {
  SimulationSettings settings = smallSimulation();
  settings.lidar.range_noise = 0.0;
  settings.lidar.divergence_mrad = 0.0;
  return settings;
}

std::string fileBytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

std::string outputBytes(const SimulationSettings& settings, std::size_t threads) {
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
  const Simulation simulation = simulate(settings, noProgress);
  const std::string stem = testing::TempDir() + "simulation_bytes";
  writeCloud(simulation, stem + ".pcd");
  writeTruth(simulation, stem + ".csv");
  return fileBytes(stem + ".pcd") + fileBytes(stem + ".csv");
}

/// Whether the segment from `a` to `b` crosses a triangle (Moeller and Trumbore).
bool crosses(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const TriangleMesh& mesh,
             const std::array<std::uint32_t, 3>& triangle) {
  const Eigen::Vector3d v0 = mesh.vertices[triangle[0]].cast<double>();
  const Eigen::Vector3d e1 = mesh.vertices[triangle[1]].cast<double>() - v0;
  const Eigen::Vector3d e2 = mesh.vertices[triangle[2]].cast<double>() - v0;
  const Eigen::Vector3d direction = b - a;
  const Eigen::Vector3d p = direction.cross(e2);
  const double determinant = e1.dot(p);
  if (std::abs(determinant) < 1e-15) {
    return false;
  }
  const Eigen::Vector3d s = a - v0;
  const double u = s.dot(p) / determinant;
  const Eigen::Vector3d q = s.cross(e1);
  const double v = direction.dot(q) / determinant;
  const double t = e2.dot(q) / determinant;
  constexpr double kEdge = 1e-3;  // rays along a shared edge may pass either triangle
  return u > kEdge && v > kEdge && u + v < 1.0 - kEdge && t > 0.0 && t < 1.0;
}

TEST(Simulation, SameSeedSameBytesWhateverTheThreads) {
  const SimulationSettings settings = smallSimulation();
  const std::string first = outputBytes(settings, 1);
  EXPECT_GT(first.size(), 60000U * 17U);
  EXPECT_TRUE(first == outputBytes(settings, 1));
  EXPECT_TRUE(first == outputBytes(settings, 2));
  EXPECT_TRUE(first == outputBytes(settings, 5));
  SimulationSettings other = settings;
  other.seed = 2;
  EXPECT_FALSE(first == outputBytes(other, 2));
}

TEST(Simulation, ReachesTheNumberOfPointsAskedFor) {
  for (const double target : {20000.0, 150000.0}) {
    for (const GrowthStage stage : {GrowthStage::kSeedling, GrowthStage::kTasselling}) {
      SimulationSettings settings = smallSimulation();
      settings.field.plant.stage = stage;
      settings.lidar.dropout_share = 0.2;
      settings.target_points = static_cast<std::uint64_t>(target);
      const Simulation simulation = simulate(settings, noProgress);
      EXPECT_NEAR(static_cast<double>(simulation.pointCount()), target, 0.05 * target);
    }
  }
}

TEST(Simulation, ExactSensorHitsTheTrueStemSurface) {
  const Simulation simulation = simulate(exactSensor(), noProgress);
  std::size_t checked = 0;
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      if (point.part != Part::kStem) {
        continue;
      }
      const Stem& stem = simulation.field->plants[static_cast<std::size_t>(point.plant_id)].stem;
      EXPECT_LT(std::abs(stem.signedDistance(scan.mapPosition(point))), 1e-4);
      ++checked;
    }
  }
  EXPECT_GT(checked, 1000U);
}

TEST(Simulation, NoiseHasItsStandardDeviationAlongTheBeam) {
  SimulationSettings settings = exactSensor();
  settings.target_points = 0;
  settings.rover.speed = 3.0;
  const Simulation exact = simulate(settings, noProgress);
  settings.lidar.range_noise = 0.005;
  const Simulation noisy = simulate(settings, noProgress);
  ASSERT_EQ(exact.pointCount(), noisy.pointCount());  // noise changes no plant and no hit
  double sum = 0.0;
  double sum_of_squares = 0.0;
  for (std::size_t i = 0; i < exact.scans.size(); ++i) {
    for (std::size_t k = 0; k < exact.scans[i].points.size(); ++k) {
      const LidarPoint& a = exact.scans[i].points[k];
      const LidarPoint& b = noisy.scans[i].points[k];
      ASSERT_EQ(a.plant_id, b.plant_id);
      const double along = static_cast<double>((b.position - a.position).norm());
      const bool farther = b.position.norm() > a.position.norm();
      sum += farther ? along : -along;
      sum_of_squares += along * along;
    }
  }
  const double count = static_cast<double>(exact.pointCount());
  EXPECT_NEAR(sum / count, 0.0, 1e-4);
  EXPECT_NEAR(std::sqrt(sum_of_squares / count), 0.005, 1e-4);
}

/// Ellipse of the stem's points of a band, brought to one height along the true axis and taper.
TEST(Simulation, TrueDiameterIsRecoveredFromExactPoints) {
  SimulationSettings settings = exactSensor();
  settings.target_points = 600000;
  const Simulation simulation = simulate(settings, noProgress);
  const std::vector<PlantTruth> truths = simulation.truth();
  for (std::size_t id = 0; id < truths.size(); ++id) {
    const Stem& stem = simulation.field->plants[id].stem;
    const double h0 = truths[id].diameter_height;
    const Eigen::Vector3d up = stem.axisDirection(h0);
    const Eigen::Vector3d e1 = up.unitOrthogonal();
    const Eigen::Vector3d e2 = up.cross(e1);
    Eigen::Matrix3d normal_matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right_side = Eigen::Vector3d::Zero();
    int used = 0;
    for (const Scan& scan : simulation.scans) {
      for (const LidarPoint& point : scan.points) {
        const Eigen::Vector3d position = scan.mapPosition(point);
        const double h = position.z() - stem.base.z();
        if (point.part != Part::kStem || point.plant_id != static_cast<std::int32_t>(id) ||
            std::abs(h - h0) > 0.08 || stem.semiMajor(h) > 1.002 * stem.smoothSemiMajor(h)) {
          continue;
        }
        const Eigen::Vector3d offset =
            (position - stem.axisPoint(h)) * (stem.smoothSemiMajor(h0) / stem.smoothSemiMajor(h));
        const double x = 1e2 * offset.dot(e1);
        const double y = 1e2 * offset.dot(e2);
        const Eigen::Vector3d row(x * x, 2.0 * x * y, y * y);
        normal_matrix += row * row.transpose();
        right_side += row;
        ++used;
      }
    }
    ASSERT_GT(used, 30);
    const Eigen::Vector3d q = normal_matrix.ldlt().solve(right_side);
    Eigen::Matrix2d conic;
    conic << q.x(), q.y(), q.y(), q.z();
    const Eigen::Vector2d semi_axes = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(conic)
                                          .eigenvalues()
                                          .cwiseInverse()
                                          .cwiseSqrt();
    EXPECT_NEAR(2e-2 * semi_axes[0], truths[id].stem_diameter, 1.5e-4);
    EXPECT_NEAR(2e-2 * semi_axes[1], truths[id].stem_diameter_minor, 1.5e-4);
  }
}

TEST(Simulation, NothingIsSeenThroughAnything) {
  SimulationSettings settings = exactSensor();
  settings.target_points = 3000;
  settings.field.plants_per_row = 2;
  const Simulation simulation = simulate(settings, noProgress);
  const TriangleMesh& mesh = simulation.field->mesh;
  const Lidar& lidar = *simulation.lidar;
  const double column_time =
      1.0 / (settings.lidar.scan_rate * static_cast<double>(lidar.columnsPerScan()));
  int occluded = 0;
  int checked = 0;
  std::size_t number = 0;
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      if (number++ % 20 != 0) {
        continue;
      }
      // The pulse's own time is not kept: it follows from the azimuth, up to the head's motion.
      const Eigen::Vector3d hit = scan.mapPosition(point);
      double best = 1e9;
      Eigen::Vector3d sensor = Eigen::Vector3d::Zero();
      for (std::uint64_t column = 0; column < lidar.columnsPerScan(); ++column) {
        const double time = scan.time + column_time * static_cast<double>(column);
        const Eigen::Isometry3d pose =
            simulation.trajectory->pose(time) * lidar.mast() * lidar.head(time);
        const Eigen::Vector3d seen = pose.inverse() * hit;
        const double azimuth =
            2.0 * M_PI * static_cast<double>(column) / static_cast<double>(lidar.columnsPerScan());
        const double off =
            std::abs(std::remainder(std::atan2(seen.y(), seen.x()) - azimuth, 2.0 * M_PI));
        if (off < best) {
          best = off;
          sensor = pose.translation();
        }
      }
      ASSERT_LT(best, 1e-4);
      const Eigen::Vector3d before = sensor + 0.9995 * (hit - sensor);
      occluded += std::any_of(
          mesh.triangles.begin(), mesh.triangles.end(),
          [&](const auto& triangle) { return crosses(sensor, before, mesh, triangle); });
      ++checked;
    }
  }
  EXPECT_GT(checked, 100);
  EXPECT_EQ(occluded, 0);
}

TEST(RayCaster, AStemHidesWhatIsBehindIt) {
  TriangleMesh mesh;
  mesh.beginSurface({7, Part::kStem, 0.5F});
  Stem stem;
  stem.base = {1.0, 0.0, -0.5};
  addStemMesh(stem, mesh);
  mesh.beginSurface({-1, Part::kGround, 0.5F});  // a wall behind
  const std::uint32_t first = mesh.addVertex({2.0, -1.0, -1.0});
  mesh.addVertex({2.0, 1.0, -1.0});
  mesh.addVertex({2.0, -1.0, 1.0});
  mesh.addVertex({2.0, 1.0, 1.0});
  mesh.addGrid(first, 2, 2, false);
  const RayCaster caster(mesh);

  const auto ahead = caster.cast(Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitX(), 10.0);
  ASSERT_TRUE(ahead);
  EXPECT_EQ(mesh.surfaces[ahead->surface].plant_id, 7);
  EXPECT_NEAR(ahead->range, 0.99, 0.003);
  const auto beside =
      caster.cast(Eigen::Vector3d::Zero(), Eigen::Vector3d(1.0, 0.05, 0.0).normalized(), 10.0);
  ASSERT_TRUE(beside);
  EXPECT_EQ(mesh.surfaces[beside->surface].plant_id, -1);
  EXPECT_FALSE(caster.cast(Eigen::Vector3d::Zero(), -Eigen::Vector3d::UnitX(), 10.0));
  EXPECT_FALSE(caster.cast(Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitX(), 0.5));
}

TEST(Simulation, MixedPixelsLieBetweenSurfaces) {
  SimulationSettings settings = exactSensor();
  settings.lidar.divergence_mrad = 4.0;
  const auto shareOff = [&settings](double range_resolution) {
    settings.lidar.range_resolution = range_resolution;
    const Simulation simulation = simulate(settings, noProgress);
    double stem_points = 0.0;
    double off = 0.0;
    for (const Scan& scan : simulation.scans) {
      for (const LidarPoint& point : scan.points) {
        if (point.part == Part::kStem) {
          const auto id = static_cast<std::size_t>(point.plant_id);
          stem_points += 1.0;
          off +=
              std::abs(simulation.field->plants[id].stem.signedDistance(scan.mapPosition(point))) >
              0.005;
        }
      }
    }
    return off / stem_points;
  };
  EXPECT_GT(shareOff(0.3), 0.01);
  EXPECT_LT(shareOff(0.003), 0.001);
}

TEST(Simulation, TruthCountsThePointsOfTheCloud) {
  SimulationSettings settings = smallSimulation();
  settings.field.weeds = 20;
  settings.origin = {100.0, -50.0, 90.0};
  const Simulation simulation = simulate(settings, noProgress);
  const std::vector<PlantTruth> truths = simulation.truth();
  ASSERT_EQ(truths.size(), 8U);
  std::uint64_t of_plants = 0;
  for (const PlantTruth& truth : truths) {
    EXPECT_GT(truth.visible_stem_points, 20U);
    EXPECT_GT(truth.visible_points, truth.visible_stem_points);
    EXPECT_LT(truth.highest_visible_z, truth.base.z() + truth.height + 0.015);
    EXPECT_GT(truth.highest_visible_z, truth.base.z() + 0.8 * truth.height);
    EXPECT_NEAR(truth.base.z(), 90.0, 0.1);
    of_plants += truth.visible_points;
  }
  std::uint64_t labelled = 0;
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      EXPECT_EQ(point.plant_id < 0, point.part == Part::kGround);
      labelled += point.plant_id >= 0 ? 1U : 0U;
    }
  }
  EXPECT_EQ(labelled, of_plants);
}

TEST(Simulation, BareFieldHasNoPlant) {
  SimulationSettings settings = smallSimulation();
  settings.field.plants_per_row = 0;
  settings.field.weeds = 30;
  const Simulation simulation = simulate(settings, noProgress);
  EXPECT_TRUE(simulation.truth().empty());
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      EXPECT_EQ(point.plant_id, -1);
    }
  }
}

TEST(Simulation, DropoutsThinTheCloud) {
  SimulationSettings settings = smallSimulation();
  settings.target_points = 0;
  settings.rover.speed = 3.0;
  const auto all = static_cast<double>(simulate(settings, noProgress).pointCount());
  settings.lidar.dropout_share = 0.35;
  const auto kept = static_cast<double>(simulate(settings, noProgress).pointCount());
  EXPECT_NEAR(kept / all, 0.65, 0.01);
}

TEST(Simulation, RangesAreKept) {
  SimulationSettings settings = exactSensor();
  settings.lidar.min_range = 0.8;
  settings.lidar.max_range = 1.5;
  settings.lidar.scan_rate = 1000.0;  // so short that motion within a scan is nothing
  const Simulation simulation = simulate(settings, noProgress);
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      EXPECT_GT(point.position.norm(), 0.75F);
      EXPECT_LT(point.position.norm(), 1.55F);
    }
  }
}

TEST(Simulation, PoseNoiseMovesTheMapButNotTheTruth) {
  SimulationSettings settings = smallSimulation();
  const Simulation still = simulate(settings, noProgress);
  settings.rover.pose_noise = 0.02;
  const Simulation shaken = simulate(settings, noProgress);
  EXPECT_EQ(still.truth()[3].base, shaken.truth()[3].base);
  double sum_of_squares = 0.0;
  for (std::size_t i = 0; i < still.scans.size(); ++i) {
    sum_of_squares +=
        (still.scans[i].T_map_lidar.translation() - shaken.scans[i].T_map_lidar.translation())
            .squaredNorm();
  }
  const double rms = std::sqrt(sum_of_squares / static_cast<double>(still.scans.size()));
  EXPECT_GT(rms, 0.005);
  EXPECT_LT(rms, 0.08);
}

TEST(Trajectory, DrivesEveryLane) {
  SimulationSettings settings = smallSimulation();
  const Field field = growField(settings.field, 1);
  RoverSettings rover;
  rover.speed = 1.0;
  rover.sway_stddev_deg = 0.0;
  const Trajectory trajectory(field, rover, 1);
  // Three lanes 0.75 m apart and two half circles.
  EXPECT_NEAR(trajectory.length(), 3.0 * (0.6 + 1.0) + M_PI * 0.75, 1e-9);
  const Eigen::Vector3d start = trajectory.pose(0.0).translation();
  EXPECT_NEAR(start.x(), -0.5, 1e-9);
  EXPECT_NEAR(start.y(), -0.375, 1e-9);
  const Eigen::Isometry3d end = trajectory.pose(trajectory.duration());
  EXPECT_NEAR(end.translation().x(), 1.1, 1e-6);
  EXPECT_NEAR(end.translation().y(), 1.125, 1e-6);
  EXPECT_NEAR(end.linear()(0, 0), 1.0, 1e-6);
  double previous_step = 0.0;
  for (double time = 0.01; time < trajectory.duration(); time += 0.01) {
    const double step =
        (trajectory.pose(time).translation() - trajectory.pose(time - 0.01).translation()).norm();
    EXPECT_NEAR(step, 0.01, 1e-4);
    previous_step = step;
  }
  EXPECT_GT(previous_step, 0.0);
}

TEST(Trajectory, PassesAgainFromTheOtherSideInAMapThatHasMoved) {
  SimulationSettings settings = smallSimulation();  // two rows
  const Field field = growField(settings.field, 1);
  RoverSettings rover;
  rover.speed = 1.0;
  rover.sway_stddev_deg = 0.0;
  rover.lane_every = 2;
  rover.passes = 2;
  rover.map_shift = 0.1;
  const Trajectory trajectory(field, rover, 1);
  // Lanes 0 and 2, then 3 and 1.
  const double lane = 0.6 + 1.0;
  EXPECT_NEAR(trajectory.length(), 4.0 * lane + M_PI * (0.75 + 0.375 + 0.75), 1e-9);
  const double second = 2.0 * lane + M_PI * (0.75 + 0.375);
  EXPECT_NEAR(trajectory.pose(second + 0.5 * lane).translation().y(), 2.5 * 0.75, 1e-6);
  EXPECT_NEAR(trajectory.pose(trajectory.duration()).translation().y(), 0.5 * 0.75, 1e-6);
  ASSERT_EQ(trajectory.shifts().size(), 2U);
  const Trajectory::Shift& shift = trajectory.shifts()[1];
  EXPECT_NEAR(shift.shift.norm(), 0.1, 1e-9);
  for (const double time : {shift.time - 0.01, shift.time + 0.01}) {
    const Eigen::Vector3d off =
        trajectory.estimatedPose(time).translation() - trajectory.pose(time).translation();
    EXPECT_NEAR((off.head<2>() - (time < shift.time ? Eigen::Vector2d(0, 0) : shift.shift)).norm(),
                0.0, 1e-9);
  }
}

TEST(Writers, CloudFarFromTheOriginIsInDoublePrecision) {
  SimulationSettings settings = smallSimulation();
  settings.target_points = 5000;
  const Simulation near = simulate(settings, noProgress);
  settings.origin = {431234.5, 5432109.25, 90.0};
  const Simulation far = simulate(settings, noProgress);
  const std::string path = testing::TempDir() + "far.pcd";
  writeCloud(far, path);
  const std::string bytes = fileBytes(path);
  EXPECT_NE(bytes.find("SIZE 8 8 8 4 1 4"), std::string::npos);
  const std::size_t data = bytes.find("DATA binary\n") + 12;
  constexpr std::size_t kRecord = 3 * 8 + 4 + 1 + 4;
  ASSERT_EQ(bytes.size() - data, kRecord * far.pointCount());
  const Eigen::Vector3d expected =
      settings.origin + near.scans[0].mapPosition(near.scans[0].points[0]);
  Eigen::Vector3d first;
  std::memcpy(first.data(), bytes.data() + data, 24);
  EXPECT_LT((first - expected).norm(), 1e-8);
}

TEST(Writers, TruthHasOneLinePerPlantUnderItsHeader) {
  const Simulation simulation = simulate(smallSimulation(), noProgress);
  const std::string path = testing::TempDir() + "truth.csv";
  writeTruth(simulation, path);
  std::istringstream lines(fileBytes(path));
  std::string header;
  std::getline(lines, header);
  EXPECT_EQ(header,
            "plant_id,row,x,y,z,height,stem_diameter,stem_diameter_minor,diameter_height,"
            "stem_length,lean,lean_azimuth,stage,visible_points,visible_stem_points,"
            "highest_visible_z,axis_x,axis_y,axis_z");
  int count = 0;
  for (std::string line; std::getline(lines, line);) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), 18);
    ++count;
  }
  EXPECT_EQ(count, 8);
}

TEST(Writers, UnwritablePathIsAnError) {
  const Simulation simulation = simulate(smallSimulation(), noProgress);
  EXPECT_THROW(writeCloud(simulation, "/nowhere/cloud.pcd"), std::runtime_error);
  EXPECT_THROW(writeTruth(simulation, "/nowhere/truth.csv"), std::runtime_error);
}

TEST(Simulation, RefusesImpossibleSettings) {
  SimulationSettings settings = smallSimulation();
  settings.lidar.beams = 0;
  EXPECT_THROW(simulate(settings, noProgress), std::invalid_argument);
  settings = smallSimulation();
  settings.rover.lane_every = 0;
  EXPECT_THROW(simulate(settings, noProgress), std::invalid_argument);
  settings = smallSimulation();
  settings.field.plants_per_row = 0;
  settings.lidar.max_range = 1.0;  // the soil is farther away
  EXPECT_THROW(simulate(settings, noProgress), std::runtime_error);
  settings = smallSimulation();
  settings.target_points = 1000000000;
  EXPECT_THROW(simulate(settings, noProgress), std::runtime_error);
}

}  // namespace
}  // namespace field_phenotyping::simulation
