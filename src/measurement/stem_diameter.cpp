#include "field_phenotyping/measurement/stem_diameter.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/stem_coverage.hpp"

namespace field_phenotyping {
namespace {

// A LiDAR's noise lies along its beams: of beams that meet the surface from all sides that it can
// be met from, 2 / 3 of the variance across the axis lies along the normal, an elongation of 0.17.
// Of a sensor that passes close by it is more; the map's own noise has no direction.
const Trait kBeamNoise{0.15, 0.2};
constexpr double kMaxRelativeStddev = 0.25;
constexpr double kMaxOutlierShare = 0.5;
constexpr double kPriorDrivenShare = 0.5;
constexpr double kShapeStddev = 0.01;  // nodes and grooves: no stem is an exact ellipse
constexpr double kMaxTilt = 0.02;      // [rad] beyond which the section is cut anew
constexpr double kNear = 0.2;          // [m] from the height asked for, that the stem is to be seen
constexpr int kShiftSteps = 6;         // heights tried each way
// Points are taken from above this share of the height asked for, and below this share of the stem.
constexpr double kFootShare = 0.3;
constexpr double kTopShare = 0.8;
constexpr double kLeastSpanShare = 0.1;  // of the stem, that points are taken from in any case

/// Coordinates across and along a piece of stem, from a smooth curve along its axis.
struct StemFrame {
  Eigen::Vector3d origin;  // on the axis at the measuring height
  Eigen::Matrix3d axes;    // columns: across (near x), across (near y), along
  Eigen::Matrix<double, 4, 2> curve = Eigen::Matrix<double, 4, 2>::Zero();  // powers of `along`

  Eigen::Vector3d straight(const Eigen::Vector3d& point) const {
    return axes.transpose() * (point - origin);
  }
  Eigen::Vector3d local(const Eigen::Vector3d& point) const {
    Eigen::Vector3d result = straight(point);
    result.head<2>() -= curve.transpose() * powers(result.z());
    return result;
  }
  static Eigen::Vector4d powers(double h) { return {1.0, h, h * h, h * h * h}; }
};

Eigen::Matrix3d axesAlong(const Eigen::Vector3d& direction) {
  Eigen::Matrix3d axes;
  axes.col(2) = direction.normalized();
  axes.col(0) = (Eigen::Vector3d::UnitX() - axes.col(2).x() * axes.col(2)).normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

/// Heights between which stem points are taken, local z.
struct Window {
  double low = 0.0;
  double high = 0.0;
};

/// Frame along the axis in the window: its origin at `origin_z`, its curve the cubic that follows
/// the axis best; the axis itself has kinks.
StemFrame frameAlong(const StemAxis& axis, const Window& window, double origin_z) {
  constexpr int kSamples = 24;
  const auto at = [&](double z) -> Eigen::Vector3d {
    return axis.pointAtHeight(static_cast<float>(z)).cast<double>();
  };
  StemFrame frame;
  frame.axes = axesAlong(at(window.high) - at(window.low));
  frame.origin = at(origin_z);
  Eigen::Matrix4d normal = 1e-9 * Eigen::Matrix4d::Identity();
  Eigen::Matrix<double, 4, 2> right = Eigen::Matrix<double, 4, 2>::Zero();
  for (int i = 0; i <= kSamples; ++i) {
    const double z = window.low + (window.high - window.low) * i / kSamples;
    const Eigen::Vector3d local = frame.straight(at(z));
    const Eigen::Vector4d row = StemFrame::powers(local.z());
    normal += row * row.transpose();
    right += row * local.head<2>().transpose();
  }
  frame.curve = normal.ldlt().solve(right);
  return frame;
}

/// Stem points in the window, local to the frame.
std::vector<Eigen::Vector3d> pointsIn(const SegmentedBlock& block, const Plant& plant,
                                      const StemFrame& frame, const Window& window) {
  std::vector<Eigen::Vector3d> points;
  for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
    const Eigen::Vector3d point = block.cloud.points[i].cast<double>();
    if (point.z() >= window.low && point.z() <= window.high) points.push_back(frame.local(point));
  }
  return points;
}

std::size_t countIn(const SegmentedBlock& block, const Plant& plant, const Window& window) {
  std::size_t count = 0;
  for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
    const double z = static_cast<double>(block.cloud.points[i].z());
    if (z >= window.low && z <= window.high) ++count;
  }
  return count;
}

/// The span round `z`, but clear of the flared foot of the stem and of its end among the leaves.
Window windowRound(const Plant& plant, double z, double span) {
  const double base = static_cast<double>(plant.base.z());
  const double length = static_cast<double>(plant.axis.length());
  const double half = 0.5 * span;
  const double least = 0.5 * std::min(half, kLeastSpanShare * length);
  const double low = std::max(z - half, base + kFootShare * (z - base));
  const double high = std::min(z + half, base + kTopShare * length);
  return {std::min(low, z - least), std::max(high, z + least)};
}

/// Window of the height to take points from: the span round `wished`, longer where it holds few
/// points, if the stem is seen round there, else the best populated one in reach.
Window populatedWindow(const SegmentedBlock& block, const Plant& plant, double wished,
                       const MeasurementParameters& p) {
  constexpr std::size_t kEnough = 60U;
  Window best_window = windowRound(plant, wished, p.diameter_span);
  std::size_t best = countIn(block, plant, best_window);
  for (int step = 1; step <= kShiftSteps && best < kEnough; ++step) {
    const double more = 2.0 * p.max_shift * step / kShiftSteps;
    best_window = windowRound(plant, wished, p.diameter_span + more);
    best = countIn(block, plant, best_window);
  }
  if (best >= static_cast<std::size_t>(p.min_points)) return best_window;
  for (int step = 1; step <= kShiftSteps; ++step) {
    for (const double side : {-1.0, 1.0}) {
      const double z = wished + side * p.max_shift * step / kShiftSteps;
      const Window window = windowRound(plant, z, p.diameter_span);
      const std::size_t count = countIn(block, plant, window);
      if (count > best) {
        best = count;
        best_window = window;
      }
    }
  }
  return best_window;
}

double withShape(const Trait& diameter) {
  return std::hypot(diameter.stddev, kShapeStddev * diameter.value);
}

/// Volume from the soil to `height` above it, where the section was fitted: pi a b along the axis.
/// @param slope length of stem a metre of height
Trait volumeBelow(const StemCrossSection& section, double height, double slope) {
  constexpr int kSteps = 40;
  constexpr double kFootStddev = 0.03;  // share: the flared foot is not fitted
  const double radius = section.radius.value;
  const double roundness =
      std::max(1.0 - section.ellipticity.squaredNorm() -
                   2.0 * section.ellipticity_stddev * section.ellipticity_stddev,
               0.0);
  double integral = 0.0, by_taper = 0.0, by_change = 0.0;
  const double step = height * slope / kSteps;
  for (int i = 0; i < kSteps; ++i) {
    const double h = (i + 0.5) * step - height * slope;
    const double relative = 1.0 + h * (section.taper.value + h * section.taper_change.value);
    integral += relative * relative * step;
    by_taper += 2.0 * relative * h * step;
    by_change += 2.0 * relative * h * h * step;
  }
  const double scale = M_PI * roundness * radius * radius;
  const double volume = scale * integral;
  const double by_radius = 2.0 * volume / radius * section.radius.stddev;
  const double by_shape =
      scale * std::hypot(by_taper * section.taper.stddev, by_change * section.taper_change.stddev);
  return {volume, std::hypot(std::hypot(by_radius, by_shape), kFootStddev * volume)};
}

/// A plant's stem on the way to its diameter.
struct StemCut {
  StemDiameter result;
  Window window;
  StemFrame frame;
  bool to_fit = false;
  StemPiece piece;  ///< of the stem, to be fitted
};

/// Cuts the stem along its axis, or as before.
void cut(const SegmentedBlock& block, const Plant& plant, double wished_z,
         const CrossSectionPrior& prior, const StemDiameter& before, StemCut& stem) {
  stem.frame = frameAlong(plant.axis, stem.window, wished_z);
  if (before.section.valid) {
    stem.frame.origin = before.section_origin;
    stem.frame.axes = before.section_axes;
  }
  stem.piece = {pointsIn(block, plant, stem.frame, stem.window), prior, before.section};
}

/// Cuts a stem anew that leans away from where it was thought to go. @return whether it does
bool cutAnew(const SegmentedBlock& block, const Plant& plant, StemCrossSection section,
             StemCut& stem) {
  if (!section.valid || section.tilt.norm() <= kMaxTilt) return false;
  StemFrame& frame = stem.frame;
  frame.origin += frame.axes.leftCols<2>() * section.center;
  frame.axes = axesAlong(frame.axes * Eigen::Vector3d(section.tilt.x(), section.tilt.y(), 1.0));
  section.center.setZero();
  section.tilt.setZero();
  stem.piece.points = pointsIn(block, plant, frame, stem.window);
  stem.piece.near = section;
  return true;
}

void takeFit(const StemCrossSection& section, int min_points, StemCut& stem) {
  StemDiameter& result = stem.result;
  const StemFrame& frame = stem.frame;
  if (!section.valid) {
    result.flags |=
        stem.piece.points.size() < static_cast<std::size_t>(min_points) ? kTooFewPoints : kPoorFit;
    return;
  }
  result.major = {section.major.value, withShape(section.major)};
  result.minor = {section.minor.value, withShape(section.minor)};
  result.equivalent = {section.equivalent.value, withShape(section.equivalent)};
  const Eigen::Vector3d major = frame.axes.col(0) * std::cos(section.major_angle) +
                                frame.axes.col(1) * std::sin(section.major_angle);
  result.major_azimuth = std::atan2(major.y(), major.x());
  result.noise = section.noise;
  result.prior_share = section.prior_share;
  result.section = section;
  result.section_origin = frame.origin;
  result.section_axes = frame.axes;
  result.volume = volumeBelow(section, result.height, 1.0 / frame.axes(2, 2));
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

/// Up to the fit, which is left to do where there is a piece to be fitted.
StemCut cutStem(const SegmentedBlock& block, const Plant& plant,
                const MeasurementParameters& parameters, const CrossSectionPrior& prior,
                const StemDiameter& before) {
  StemCut stem;
  StemDiameter& result = stem.result;
  if (plant.axis.empty()) {
    result.flags |= kTooFewPoints;
    return stem;
  }
  // 1. Height to measure at.
  const double share = parameters.diameter_height_share * plant.axis.length();
  result.height = std::min(parameters.diameter_height, share);
  if (share < parameters.diameter_height) result.flags |= kShortStem;

  // 2. Points to measure with.
  const double wished_z = plant.base.z() + result.height;
  const auto least = static_cast<std::size_t>(parameters.min_points);
  if (countIn(block, plant, {wished_z - kNear, wished_z + kNear}) < least) {
    result.flags |= kHeightShifted;
  }
  stem.window = populatedWindow(block, plant, wished_z, parameters);
  if (countIn(block, plant, stem.window) < least) {
    result.flags |= kTooFewPoints;
    return stem;
  }

  // 3. Ellipse across the stem.
  if (parameters.mode == "paper") {
    fitAsPrinted(block, plant, wished_z, parameters, result);
  } else {
    cut(block, plant, wished_z, prior, before, stem);
    stem.to_fit = true;
  }
  return stem;
}

StemDiameter judged(const StemDiameter& measured, const MeasurementParameters& parameters) {
  StemDiameter result = measured;
  if (result.arc_coverage < parameters.min_arc) result.flags |= kArcBelow;
  if (result.major.stddev > kMaxRelativeStddev * result.major.value) result.flags |= kPoorFit;
  return result;
}

/// Step by step, so that a GPU has all fits at once.
std::vector<StemDiameter> measureAll(const SegmentedBlock& block,
                                     const std::vector<const Plant*>& plants,
                                     const MeasurementParameters& parameters,
                                     const CrossSectionPrior& prior,
                                     const std::vector<StemDiameter>& before,
                                     const ComputeDevice& device) {
  std::vector<StemCut> stems(plants.size());
  parallelFor(plants.size(), [&](std::size_t i) {
    stems[i] =
        cutStem(block, *plants[i], parameters, prior, before.empty() ? StemDiameter() : before[i]);
  });
  std::vector<StemCrossSection> sections(plants.size());
  const auto fit = [&](const std::vector<std::size_t>& which) {
    std::vector<StemPiece> pieces;
    for (const std::size_t i : which) pieces.push_back(stems[i].piece);
    const std::vector<StemCrossSection> found = fitStemCrossSections(pieces, device);
    for (std::size_t k = 0; k < which.size(); ++k) sections[which[k]] = found[k];
  };
  std::vector<std::size_t> to_fit;
  for (std::size_t i = 0; i < stems.size(); ++i) {
    if (stems[i].to_fit) to_fit.push_back(i);
  }
  fit(to_fit);
  std::vector<std::size_t> anew;
  for (const std::size_t i : to_fit) {
    if (cutAnew(block, *plants[i], sections[i], stems[i])) anew.push_back(i);
  }
  fit(anew);
  for (const std::size_t i : to_fit) takeFit(sections[i], parameters.min_points, stems[i]);
  std::vector<StemDiameter> results;
  for (const StemCut& stem : stems) results.push_back(judged(stem.result, parameters));
  return results;
}

}  // namespace

CrossSectionPrior weakPrior(const MeasurementParameters& parameters) {
  CrossSectionPrior prior;
  prior.noise = parameters.noise;
  prior.ellipticity_stddev = parameters.ellipticity_prior;
  prior.elongation = kBeamNoise;
  return prior;
}

StemDiameter measureStemDiameter(const SegmentedBlock& block, const Plant& plant,
                                 const MeasurementParameters& parameters,
                                 const CrossSectionPrior& prior, const StemDiameter& before) {
  return measureAll(block, {&plant}, parameters, prior, {before}, {}).front();
}

std::vector<StemDiameter> measureStemDiameters(const SegmentedBlock& block,
                                               const std::vector<std::size_t>& plants,
                                               const MeasurementParameters& parameters,
                                               const CrossSectionPrior& prior,
                                               const std::vector<StemDiameter>& before,
                                               const ComputeDevice& device) {
  std::vector<const Plant*> wanted;
  for (const std::size_t i : plants) wanted.push_back(&block.plants[i]);
  return measureAll(block, wanted, parameters, prior, before, device);
}

}  // namespace field_phenotyping
