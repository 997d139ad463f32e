#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "simulation/field.hpp"

namespace field_phenotyping::simulation {

/// Settings of the rover and of the localisation.
struct RoverSettings {
  double speed = 1.5;            ///< [m/s]
  std::int32_t lane_every = 1;   ///< drive every n-th lane, from the outer side of the first row
  double headland = 0.5;         ///< driven beyond the first and last plant [m]
  double sway_stddev_deg = 0.7;  ///< of roll and of pitch [deg]
  double pose_noise = 0.0;       ///< of each coordinate of the estimated position, slow [m]
  std::int32_t passes = 1;       ///< times over the field
  double map_shift = 0.0;        ///< of the estimated map from pass to pass, horizontal [m]
};

/// @brief The rover's path: lane after lane, back and forth, half circles between.
///
/// Lane 0 lies half a row spacing outside the first row, the next ones between rows, the last one
/// outside the last row. The next pass comes back over the lanes beside those of the pass before,
/// and with every other lane driven sees each row from its other side. Frame: local map frame. Time
/// in seconds from the start.
class Trajectory {
 public:
  Trajectory(const Field& field, const RoverSettings& settings, std::uint64_t seed);

  double length() const { return length_; }                      ///< of the path [m]
  double duration() const { return length_ / settings_.speed; }  ///< [s]

  /// @return Where the rover is: x forwards, z up, on the soil. T_map_base.
  Eigen::Isometry3d pose(double time) const;

  /// @return Where the localisation believes it to be, as on /tf: pose() plus a slow error and,
  /// from the second pass on, the shift of the map.
  Eigen::Isometry3d estimatedPose(double time) const;

  /// Of the map since the first pass [m], and when it takes effect [s].
  struct Shift {
    Eigen::Vector2d shift;
    double time;
  };
  /// One a pass; the first is none.
  const std::vector<Shift>& shifts() const { return shifts_; }

 private:
  struct Segment {
    Eigen::Vector2d start;  // along, across [m]
    double heading;         // at the start, from the rows' direction [rad]
    double length;          // [m]
    double curvature;       // [1/m], to the left
  };
  struct Oscillation {
    double amplitude, frequency, phase;
  };

  void addSegment(double length, double curvature);
  static double evaluate(const std::vector<Oscillation>& oscillations, double time);

  RoverSettings settings_;
  double row_azimuth_;
  Eigen::Quaterniond slope_rotation_;
  Eigen::Vector2d slope_gradient_;
  std::vector<Segment> segments_;
  double length_ = 0.0;
  std::vector<Oscillation> roll_, pitch_;
  std::vector<Oscillation> error_[3];
  std::vector<Shift> shifts_;
};

/// @throws std::invalid_argument Naming the setting and its range.
void validate(const RoverSettings& settings);

}  // namespace field_phenotyping::simulation
