#include "field_phenotyping/measurement/stem_diameter.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/stem_coverage.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping {
namespace {

constexpr double kMaxRelativeStddev = 0.25;
constexpr double kMaxOutlierShare = 0.5;
constexpr double kPriorDrivenShare = 0.5;
constexpr double kShapeStddev = 0.01;  // nodes and grooves: no stem is an exact ellipse
constexpr double kMaxTilt = 0.02;      // [rad] beyond which the section is cut anew
constexpr int kShiftSteps = 6;         // heights tried each way

/// Coordinates across and along a straight piece of stem.
struct StemFrame {
  Eigen::Vector3d origin;  // on the axis at the measuring height
  Eigen::Matrix3d axes;    // columns: across (near x), across (near y), along

  Eigen::Vector3d local(const Eigen::Vector3f& point) const {
    return axes.transpose() * (point.cast<double>() - origin);
  }
};

Eigen::Matrix3d axesAlong(const Eigen::Vector3d& direction) {
  Eigen::Matrix3d axes;
  axes.col(2) = direction.normalized();
  axes.col(0) = (Eigen::Vector3d::UnitX() - axes.col(2).x() * axes.col(2)).normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

/// Frame along the chord of the axis around height `z`, its origin carried on to `origin_z`.
StemFrame frameAround(const StemAxis& axis, double z, double span, double origin_z) {
  const Eigen::Vector3d low = axis.pointAtHeight(static_cast<float>(z - 0.5 * span)).cast<double>();
  const Eigen::Vector3d high =
      axis.pointAtHeight(static_cast<float>(z + 0.5 * span)).cast<double>();
  StemFrame frame;
  frame.axes = axesAlong(high - low);
  frame.origin = low + (origin_z - low.z()) / (high.z() - low.z()) * (high - low);
  return frame;
}

/// Stem points, local, within half of `span` of height `z`.
std::vector<Eigen::Vector3d> pointsAround(const SegmentedBlock& block, const Plant& plant,
                                          const StemFrame& frame, double z, double span) {
  const double middle = (z - frame.origin.z()) / frame.axes(2, 2);
  std::vector<Eigen::Vector3d> points;
  for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
    const Eigen::Vector3d local = frame.local(block.cloud.points[i]);
    if (std::abs(local.z() - middle) <= 0.5 * span) points.push_back(local);
  }
  return points;
}

std::size_t countAround(const SegmentedBlock& block, const Plant& plant, double z, double span) {
  std::size_t count = 0;
  for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
    if (std::abs(block.cloud.points[i].z() - z) <= 0.5 * span) ++count;
  }
  return count;
}

/// Local z of the height to take points from: `wished` if the stem is seen there, else the best
/// populated one in reach.
double populatedHeight(const SegmentedBlock& block, const Plant& plant, double wished,
                       const MeasurementParameters& p) {
  double best_z = wished;
  std::size_t best = countAround(block, plant, wished, p.diameter_span);
  if (best >= static_cast<std::size_t>(p.min_points)) return wished;
  for (int step = 1; step <= kShiftSteps; ++step) {
    for (const double side : {-1.0, 1.0}) {
      const double z = wished + side * p.max_shift * step / kShiftSteps;
      const std::size_t count = countAround(block, plant, z, p.diameter_span);
      if (count > best) {
        best = count;
        best_z = z;
      }
    }
  }
  return best_z;
}

double withShape(const Trait& diameter) {
  return std::hypot(diameter.stddev, kShapeStddev * diameter.value);
}

void fitRobust(const SegmentedBlock& block, const Plant& plant, double wished_z, double z,
               const MeasurementParameters& p, StemDiameter& result) {
  StemFrame frame = frameAround(plant.axis, z, p.diameter_span, wished_z);
  std::vector<Eigen::Vector3d> points = pointsAround(block, plant, frame, z, p.diameter_span);
  CrossSectionPrior prior;
  prior.noise = p.noise;
  prior.ellipticity_stddev = p.ellipticity_prior;
  StemCrossSection section = fitStemCrossSection(points, prior);
  if (section.valid && section.tilt.norm() > kMaxTilt) {
    frame.origin += frame.axes.leftCols<2>() * section.center;
    frame.axes = axesAlong(frame.axes * Eigen::Vector3d(section.tilt.x(), section.tilt.y(), 1.0));
    points = pointsAround(block, plant, frame, z, p.diameter_span);
    section = fitStemCrossSection(points, prior);
  }
  if (!section.valid) {
    result.flags |=
        points.size() < static_cast<std::size_t>(p.min_points) ? kTooFewPoints : kPoorFit;
    return;
  }
  result.major = {section.major.value, withShape(section.major)};
  result.minor = {section.minor.value, withShape(section.minor)};
  result.equivalent = {section.equivalent.value, withShape(section.equivalent)};
  const Eigen::Vector3d major = frame.axes.col(0) * std::cos(section.major_angle) +
                                frame.axes.col(1) * std::sin(section.major_angle);
  result.major_azimuth = std::atan2(major.y(), major.x());
  result.noise = section.noise;
  result.arc_coverage = section.arc_coverage;
  result.points = static_cast<std::uint32_t>(std::lround(section.points));
  if (!section.converged || section.outlier_share > kMaxOutlierShare) result.flags |= kPoorFit;
  if (section.prior_share > kPriorDrivenShare) result.flags |= kPriorDriven;
}

/// Eq 27 as printed.
void fitAsPrinted(const SegmentedBlock& block, const Plant& plant, double z,
                  const MeasurementParameters& p, StemDiameter& result) {
  std::vector<Eigen::Vector2d> points;
  for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
    const Eigen::Vector3d point = block.cloud.points[i].cast<double>();
    if (std::abs(point.z() - z) <= 0.5 * p.diameter_span) points.emplace_back(point.head<2>());
  }
  const EllipseFit fit = fitAlgebraicEllipse(points);
  if (!fit.valid) {
    result.flags |= kPoorFit;
    return;
  }
  const double a = fit.semi_major;
  const double b = fit.semi_minor;
  result.major = {2.0 * a, 2.0 * fit.semi_major_stddev};
  result.minor = {2.0 * b, 2.0 * fit.semi_minor_stddev};
  result.equivalent = {2.0 * std::sqrt(a * b),
                       std::hypot(std::sqrt(b / a) * fit.semi_major_stddev,
                                  std::sqrt(a / b) * fit.semi_minor_stddev)};
  result.major_azimuth = fit.angle;
  std::vector<double> angles;
  for (const Eigen::Vector2d& point : points) {
    const Eigen::Vector2d offset = point - fit.center;
    angles.push_back(std::atan2(offset.y(), offset.x()));
  }
  result.arc_coverage = arcCoverage(angles);
  result.points = static_cast<std::uint32_t>(points.size());
}

}  // namespace

StemDiameter measureStemDiameter(const SegmentedBlock& block, const Plant& plant,
                                 const MeasurementParameters& parameters) {
  StemDiameter result;
  if (plant.axis.empty()) {
    result.flags |= kTooFewPoints;
    return result;
  }
  // 1. Height to measure at.
  const double share = parameters.diameter_height_share * plant.axis.length();
  result.height = std::min(parameters.diameter_height, share);
  if (share < parameters.diameter_height) result.flags |= kShortStem;

  // 2. Points to measure with.
  const double wished_z = plant.base.z() + result.height;
  const double z = populatedHeight(block, plant, wished_z, parameters);
  if (z != wished_z) result.flags |= kHeightShifted;
  if (countAround(block, plant, z, parameters.diameter_span) <
      static_cast<std::size_t>(parameters.min_points)) {
    result.flags |= kTooFewPoints;
    return result;
  }

  // 3. Ellipse across the stem.
  if (parameters.mode == "paper") {
    fitAsPrinted(block, plant, z, parameters, result);
  } else {
    fitRobust(block, plant, wished_z, z, parameters, result);
  }
  if (result.arc_coverage < parameters.min_arc) result.flags |= kArcBelow;
  if (result.major.stddev > kMaxRelativeStddev * result.major.value) result.flags |= kPoorFit;
  return result;
}

}  // namespace field_phenotyping
