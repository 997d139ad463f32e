#include "field_phenotyping/measurement/cross_section_model.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

// Weak priors that only matter where points are few or seen from one side.
// Whether half or all of a stem is seen, its points are 2 r wide; of a quarter they are 1.2 r wide.
constexpr double kSizeMean = 1.2;    // relative to what their width says of a half or a whole one
constexpr double kSizeStddev = 0.4;  // the same
constexpr double kTiltStddev = 0.3;
constexpr double kCurvatureStddev = 0.5;  // [1/m]
constexpr double kTwistStddev = 0.3;      // [1/m^2]
constexpr double kNoiseMean = 0.2;        // relative to the radius
constexpr double kLogNoiseStddev = 1.0;
constexpr double kLogNoiseKnown = 1e-3;
// Not left to the points: what they lie like along the surface is not known either.
constexpr double kElongationKnown = 1e-3;

/// Offsets from the parabola in height that fits the points best.
std::vector<Eigen::Vector2d> straightened(const std::vector<Eigen::Vector3d>& points) {
  Eigen::Matrix3d normal = 1e-12 * Eigen::Matrix3d::Identity();
  Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d row(1.0, point.z(), point.z() * point.z());
    normal += row * row.transpose();
    right += row * point.head<2>().transpose();
  }
  const Eigen::Matrix<double, 3, 2> line = normal.ldlt().solve(right);
  std::vector<Eigen::Vector2d> offsets;
  offsets.reserve(points.size());
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d row(1.0, point.z(), point.z() * point.z());
    offsets.emplace_back(point.head<2>() - line.transpose() * row);
  }
  return offsets;
}

}  // namespace

Eigen::Vector2d centerAt(const CrossSectionVector& p, double height) {
  return p.segment<2>(kCenter) +
         height * (p.segment<2>(kTilt) +
                   height * (p.segment<2>(kCurvature) + height * p.segment<2>(kTwist)));
}

double radiusAt(const CrossSectionVector& p, double height) {
  const double radius = p[kRadius] + height * (p[kTaper] + height * p[kTaperChange]);
  return std::max(radius, 0.1 * p[kRadius]);
}

SurfaceMotion surfaceMotion(const Eigen::Vector2d& u, const Eigen::Vector2d& direction) {
  const Eigen::Vector2d& d = direction;
  SurfaceMotion motion;
  motion << d, u.dot(d), u.x() * d.x() - u.y() * d.y(), u.x() * d.y() + u.y() * d.x();
  return motion;
}

HeightPowers heightPowers(double height) {
  HeightPowers powers;
  powers[0] = 1.0;
  for (int i = 1; i < kHeightPowers; ++i) powers[i] = height * powers[i - 1];
  return powers;
}

CrossSectionVector spread(const LocalVector& local, const HeightPowers& powers) {
  CrossSectionVector result;
  for (int i = 0; i < kCrossSectionSize; ++i) {
    const ParameterEffect& effect = kParameterEffects[static_cast<std::size_t>(i)];
    result[i] = powers[effect.power] * local[effect.local];
  }
  return result;
}

CrossSectionMatrix HeightSums::total() const {
  CrossSectionMatrix result;
  for (int j = 0; j < kCrossSectionSize; ++j) {
    const ParameterEffect& b = kParameterEffects[static_cast<std::size_t>(j)];
    for (int i = 0; i < kCrossSectionSize; ++i) {
      const ParameterEffect& a = kParameterEffects[static_cast<std::size_t>(i)];
      result(i, j) = sums_(a.power + b.power, localPair(a.local, b.local));
    }
  }
  return result;
}

void limitStep(const CrossSectionVector& parameters, CrossSectionVector& step) {
  const double radius = parameters[kRadius];
  const double length = std::max(
      {std::abs(step[kRadius]), step.segment<2>(kCenter).norm(), step.segment<2>(kEllipse).norm()});
  step *= std::min(
      {1.0, 0.2 * radius / std::max(length, 1e-12), 0.4 / std::max(std::abs(step[kNoise]), 1e-12)});
  const double low = std::log(kLeastBlur * radius) - parameters[kNoise];
  const double high = std::log(2.0 * radius) - parameters[kNoise];
  step[kNoise] = std::max(std::min(step[kNoise], high), low);
  const double wished = (parameters + step).segment<2>(kEllipse).norm();
  const double most = 0.5 * (radius + step[kRadius]);
  if (wished > most) {
    step.segment<2>(kEllipse) = (parameters + step).segment<2>(kEllipse) * (most / wished) -
                                parameters.segment<2>(kEllipse);
  }
}

StemExtent extentOf(const std::vector<Eigen::Vector3d>& points) {
  constexpr double kTrim = 2.5;  // median distances
  StemExtent extent;
  for (const Eigen::Vector3d& point : points) {
    extent.reach = std::max(extent.reach, point.head<2>().norm());
  }
  const std::vector<Eigen::Vector2d> offsets = straightened(points);
  std::vector<double> distances;
  for (const Eigen::Vector2d& offset : offsets) distances.push_back(offset.norm());
  const double limit = kTrim * medianOf(distances);
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  double count = 0.0;
  for (const Eigen::Vector2d& offset : offsets) {
    if (offset.norm() > limit) continue;
    scatter += offset * offset.transpose();
    count += 1.0;
  }
  const double mean = 0.5 * scatter.trace() / count;
  const double difference =
      std::hypot(0.5 * (scatter(0, 0) - scatter(1, 1)), scatter(0, 1)) / count;
  extent.width_variance = mean + difference;  // the larger eigenvalue
  return extent;
}

ParameterPrior::ParameterPrior(const CrossSectionPrior& prior, const StemExtent& extent,
                               const CrossSectionVector& parameters) {
  const double radius = parameters[kRadius];
  const auto set = [&](int first, int size, double value, double stddev) {
    mean.segment(first, size).setConstant(value);
    weight.segment(first, size).setConstant(1.0 / (stddev * stddev));
  };
  set(kTilt, 2, 0.0, kTiltStddev);
  set(kCurvature, 2, 0.0, kCurvatureStddev);
  set(kTwist, 2, 0.0, kTwistStddev);
  const double noise = std::exp(parameters[kNoise]);
  const double variance = extent.width_variance;
  const double size = std::sqrt(2.0 * std::max(variance - noise * noise, 0.25 * variance));
  if (prior.radius.stddev > 0.0) {
    set(kRadius, 1, prior.radius.value, prior.radius.stddev);
  } else {
    set(kRadius, 1, kSizeMean * size, kSizeStddev * size);
  }
  set(kTaper, 1, prior.taper.value * radius, prior.taper.stddev * radius);
  set(kTaperChange, 1, prior.taper_change.value * radius, prior.taper_change.stddev * radius);
  set(kEllipse, 2, 0.0, std::max(prior.ellipticity_stddev, 1e-4) * radius);
  set(kElongation, 1, prior.elongation.value, kElongationKnown);
  if (prior.noise > 0.0) {
    set(kNoise, 1, std::log(std::max(prior.noise, kLeastBlur * radius)), kLogNoiseKnown);
  } else if (prior.log_noise.stddev > 0.0) {
    set(kNoise, 1, prior.log_noise.value, prior.log_noise.stddev);
  } else {
    set(kNoise, 1, std::log(kNoiseMean * radius), kLogNoiseStddev);
  }
}

}  // namespace field_phenotyping
