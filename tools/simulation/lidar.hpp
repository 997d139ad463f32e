#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <vector>

#include "simulation/mesh.hpp"
#include "simulation/ray_caster.hpp"
#include "simulation/trajectory.hpp"

namespace field_phenotyping::simulation {

/// Settings of a rotating multi-beam LiDAR on a mast, its head turning slowly.
struct LidarSettings {
  std::int32_t beams = 16;
  double vertical_fov_deg = 30.0;  ///< lowest to highest beam, centred [deg]
  double point_rate = 300000.0;    ///< pulses per second
  double scan_rate = 10.0;         ///< turns per second, each one scan [Hz]
  double mount_height = 1.5;       ///< of the optical centre above the soil [m]
  double head_tilt_deg = 50.0;     ///< of the spin axis from the mast [deg]
  double head_rate = 2.3;          ///< turns of the tilted head round the mast [Hz]
  double range_noise = 0.003;      ///< standard deviation along the beam [m]
  double divergence_mrad = 2.0;    ///< full angle at 1/e^2 of the intensity [mrad]
  double range_resolution = 0.10;  ///< echoes closer than this merge into one [m]
  double dropout_share = 0.0;      ///< of the returns lost at random, [0, 1)
  double min_range = 0.1;          ///< [m]
  double max_range = 30.0;         ///< [m]
};

/// One return.
struct LidarPoint {
  Eigen::Vector3f position;  ///< in the sensor frame at the scan's time [m]
  float intensity = 0.0F;    ///< share of the light sent back, 0 to 255
  std::int32_t plant_id = -1;
  Part part = Part::kGround;
};

/// One turn of the LiDAR, motion-compensated: points are where the sensor would have seen them
/// from its pose at `time`, as a SLAM front end hands them on.
struct Scan {
  double time = 0.0;  ///< of its first pulse, from the start [s]
  Eigen::Isometry3d T_map_lidar = Eigen::Isometry3d::Identity();  ///< estimated, local map frame
  std::vector<LidarPoint> points;

  /// @return Position of a point in the local map frame [m].
  Eigen::Vector3d mapPosition(const LidarPoint& point) const {
    return T_map_lidar * point.position.cast<double>();
  }
};

/// @brief A LiDAR carried along a trajectory through a mesh.
///
/// A pulse is five rays of equal energy: the centre and four on a ring at 0.68 of the beam's half
/// angle. Hits closer to their neighbour in range than the range resolution form one echo; its
/// range is the energy-weighted mean of its hits (a mixed pixel where they lie on two surfaces) and
/// its label that of the surface with most energy. The strongest echo is returned, the nearest of
/// equals; an echo below 1 % of the emitted energy (grazing incidence) is lost. Everything
/// random is a function of (seed, pulse number): thread-safe and independent of threads.
class Lidar {
 public:
  Lidar(const LidarSettings& settings, const TriangleMesh& mesh, const RayCaster& caster,
        const Trajectory& trajectory, std::uint64_t seed);

  std::uint64_t columnsPerScan() const { return columns_per_scan_; }
  /// @return Firings of all beams during the whole trajectory.
  std::uint64_t columnCount() const;
  std::uint64_t scanCount() const;

  /// @return Scan number `index`, of [0, scanCount()).
  Scan scan(std::uint64_t index) const;

  /// @return Number of returns of one firing of all beams.
  std::uint32_t countReturns(std::uint64_t column) const;

  /// @return T_base_mast: fixed, the optical centre with the axes of the rover.
  Eigen::Isometry3d mast() const;
  /// @return T_mast_lidar: the spin axis is the sensor's z axis.
  Eigen::Isometry3d head(double time) const;

 private:
  struct Return {
    double range;
    double energy;
    Surface surface;
  };
  double columnTime(std::uint64_t column) const;
  Eigen::Vector3d beamDirection(std::uint64_t column, std::int32_t beam) const;
  std::optional<Return> fire(const Eigen::Isometry3d& T_map_lidar, std::uint64_t column,
                             std::int32_t beam) const;

  LidarSettings settings_;
  const TriangleMesh& mesh_;
  const RayCaster& caster_;
  const Trajectory& trajectory_;
  std::uint64_t seed_;
  std::uint64_t columns_per_scan_;
};

/// @throws std::invalid_argument Naming the setting and its range.
void validate(const LidarSettings& settings);

}  // namespace field_phenotyping::simulation
