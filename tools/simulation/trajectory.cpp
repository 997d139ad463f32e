#include "simulation/trajectory.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace field_phenotyping::simulation {
namespace {

/// Place and heading after `distance` along a line or an arc.
void advance(double distance, double curvature, Eigen::Vector2d& place, double& heading) {
  const double turned = distance * curvature;
  if (curvature == 0.0) {
    place += distance * Eigen::Vector2d(std::cos(heading), std::sin(heading));
    return;
  }
  place += Eigen::Vector2d(std::sin(heading + turned) - std::sin(heading),
                           std::cos(heading) - std::cos(heading + turned)) /
           curvature;
  heading += turned;
}

}  // namespace

Trajectory::Trajectory(const Field& field, const RoverSettings& settings, std::uint64_t seed)
    : settings_(settings), row_azimuth_(field.settings.row_azimuth_deg * M_PI / 180.0) {
  validate(settings);
  slope_gradient_ = {field.terrain.slopeHeight(Eigen::Vector2d::UnitX()),
                     field.terrain.slopeHeight(Eigen::Vector2d::UnitY())};
  const Eigen::Vector3d up(-slope_gradient_.x(), -slope_gradient_.y(), 1.0);
  slope_rotation_ = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), up.normalized());

  const double lane_length = field.length + 2.0 * settings.headland;
  const double lane_distance = field.settings.row_spacing * settings.lane_every;
  segments_.push_back({{-settings.headland, -0.5 * field.settings.row_spacing}, 0.0, 0.0, 0.0});
  const std::int32_t lanes = field.settings.rows / settings.lane_every + 1;
  double side = 1.0;
  const auto turn = [&](double distance) {
    addSegment(0.5 * M_PI * distance, side * 2.0 / distance);
    side = -side;
  };
  RandomStream directions(seed, Stream::kPoseNoise, 1);
  for (std::int32_t pass = 0; pass < settings.passes; ++pass) {
    shifts_.push_back({Eigen::Vector2d::Zero(), 0.0});
    if (pass > 0) {
      turn(field.settings.row_spacing);
      side = -side;  // back over the field
      const double direction = directions.uniform(0.0, 2.0 * M_PI);
      shifts_.back() = {
          settings.map_shift * Eigen::Vector2d(std::cos(direction), std::sin(direction)),
          length_ / settings.speed};
    }
    for (std::int32_t lane = 0; lane < lanes; ++lane) {
      if (lane > 0) turn(lane_distance);
      addSegment(lane_length, 0.0);
    }
  }

  const auto oscillations = [](RandomStream& random, double stddev, double slowest,
                               double fastest) {
    constexpr int kCount = 4;
    std::vector<Oscillation> result;
    for (int i = 0; i < kCount; ++i) {
      Oscillation oscillation;
      oscillation.amplitude = stddev * std::sqrt(2.0 / kCount);
      oscillation.frequency = random.uniform(slowest, fastest);
      oscillation.phase = random.uniform(0.0, 2.0 * M_PI);
      result.push_back(oscillation);
    }
    return result;
  };
  RandomStream sway(seed, Stream::kSway, 0);
  roll_ = oscillations(sway, settings.sway_stddev_deg * M_PI / 180.0, 0.3, 2.0);
  pitch_ = oscillations(sway, settings.sway_stddev_deg * M_PI / 180.0, 0.3, 2.0);
  RandomStream error(seed, Stream::kPoseNoise, 0);
  for (std::vector<Oscillation>& coordinate : error_) {
    coordinate = oscillations(error, settings.pose_noise, 0.05, 0.5);
  }
}

void Trajectory::addSegment(double length, double curvature) {
  Segment segment = segments_.back();
  advance(segment.length, segment.curvature, segment.start, segment.heading);
  segment.length = length;
  segment.curvature = curvature;
  segments_.push_back(segment);
  length_ += length;
}

double Trajectory::evaluate(const std::vector<Oscillation>& oscillations, double time) {
  double sum = 0.0;
  for (const Oscillation& o : oscillations) {
    sum += o.amplitude * std::sin(2.0 * M_PI * o.frequency * time + o.phase);
  }
  return sum;
}

Eigen::Isometry3d Trajectory::pose(double time) const {
  double distance = std::clamp(time * settings_.speed, 0.0, length_);
  std::size_t i = 0;
  while (i + 1 < segments_.size() && distance > segments_[i].length) {
    distance -= segments_[i].length;
    ++i;
  }
  Eigen::Vector2d place = segments_[i].start;
  double heading = segments_[i].heading;
  advance(std::min(distance, segments_[i].length), segments_[i].curvature, place, heading);

  const Eigen::Vector2d horizontal = Eigen::Rotation2Dd(row_azimuth_) * place;
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() << horizontal, slope_gradient_.dot(horizontal);
  pose.rotate(slope_rotation_);
  pose.rotate(Eigen::AngleAxisd(row_azimuth_ + heading, Eigen::Vector3d::UnitZ()));
  pose.rotate(Eigen::AngleAxisd(evaluate(pitch_, time), Eigen::Vector3d::UnitY()));
  pose.rotate(Eigen::AngleAxisd(evaluate(roll_, time), Eigen::Vector3d::UnitX()));
  return pose;
}

Eigen::Isometry3d Trajectory::estimatedPose(double time) const {
  const Eigen::Vector3d error(evaluate(error_[0], time), evaluate(error_[1], time),
                              evaluate(error_[2], time));
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();
  for (const Shift& pass : shifts_) {
    if (time >= pass.time) shift = pass.shift;
  }
  return Eigen::Translation3d(error + Eigen::Vector3d(shift.x(), shift.y(), 0.0)) * pose(time);
}

void validate(const RoverSettings& settings) {
  const auto require = [](bool ok, const char* message) {
    if (!ok) {
      throw std::invalid_argument(message);
    }
  };
  require(settings.speed > 0.0, "the rover's speed must be above 0 m/s");
  require(settings.lane_every >= 1, "the rover must drive every 1st, 2nd, ... lane");
  require(settings.headland >= 0.0, "the headland must not be negative");
  require(settings.sway_stddev_deg >= 0.0 && settings.sway_stddev_deg <= 15.0,
          "the sway must be 0 to 15 deg");
  require(settings.passes >= 1, "the rover must pass at least once");
  require(settings.map_shift >= 0.0, "the shift of the map must not be negative");
  require(settings.pose_noise >= 0.0, "the pose noise must not be negative");
}

}  // namespace field_phenotyping::simulation
