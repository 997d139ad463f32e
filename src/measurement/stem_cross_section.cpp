#include "field_phenotyping/measurement/stem_cross_section.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/rice_distribution.hpp"
#include "field_phenotyping/measurement/stem_coverage.hpp"

namespace field_phenotyping {
namespace {

// The parameters, in this order: center, tilt, curvature, twist (the powers of height from 0 to 3,
// x and y each), radius, its change with height and with the square of height, ellipticity (S = r I
// + [c s; s -c]), log of the noise.
enum Index {
  kCenter = 0,
  kTilt = 2,
  kCurvature = 4,
  kTwist = 6,
  kRadius = 8,
  kTaper = 9,
  kTaperChange = 10,
  kEllipse = 11,
  kNoise = 13
};
constexpr int kSize = 14;
using Parameters = Eigen::Matrix<double, kSize, 1>;
using Information = Eigen::Matrix<double, kSize, kSize>;

constexpr int kStartSteps = 15;
constexpr int kMaxSteps = 120;
constexpr int kNewtonSteps = 20;
constexpr double kConverged = 1e-5;     // step, relative to the radius
constexpr double kMaxBlur = 0.4;        // noise over radius beyond which a circle is fitted
constexpr double kArcEndStddev = 0.35;  // of the radius, in standard deviations of the noise
constexpr double kArcEndBlur = 0.7;     // share of the arc that noise over radius adds
constexpr double kFullArc = 0.72;
// A range sensor's noise lies along its beams, and less of it than assumed moves points outwards:
// by up to noise^2 / (2 radius), of which this share, from fields seen from two sides, is
// uncertain.
constexpr double kUnevenNoiseStddev = 0.5 * 0.25;
constexpr double kPartArc = 0.15;
constexpr int kSectors = 12;  // patches that the covariance is checked on
constexpr int kSlabs = 3;
constexpr double kMinNoise = 1e-3;  // relative to the radius

// Weak priors that only matter where points are few or seen from one side.
// Whether half or all of a stem is seen, its points are 2 r wide; seen less, somewhat narrower.
constexpr double kSizeStddev = 0.35;  // relative to what their width says
constexpr double kTiltStddev = 0.3;
constexpr double kCurvatureStddev = 0.5;  // [1/m]
constexpr double kTwistStddev = 0.3;      // [1/m^2]
constexpr double kNoiseMean = 0.2;        // relative to the radius
constexpr double kLogNoiseStddev = 1.0;
constexpr double kLogNoiseKnown = 1e-3;

Eigen::Vector2d centerAt(const Parameters& p, double height) {
  return p.segment<2>(kCenter) +
         height * (p.segment<2>(kTilt) +
                   height * (p.segment<2>(kCurvature) + height * p.segment<2>(kTwist)));
}

double radiusAt(const Parameters& p, double height) {
  const double radius = p[kRadius] + height * (p[kTaper] + height * p[kTaperChange]);
  return std::max(radius, 0.1 * p[kRadius]);
}

/// The ellipse at one height.
struct Ellipse {
  Eigen::Matrix2d shape;    // S
  Eigen::Matrix2d inverse;  // of S
};

Ellipse ellipseAt(const Parameters& p, double height) {
  const double radius = radiusAt(p, height);
  const double c = p[kEllipse];
  const double s = p[kEllipse + 1];
  Ellipse ellipse;
  ellipse.shape << radius + c, s, s, radius - c;
  ellipse.inverse << radius - c, -s, -s, radius + c;
  ellipse.inverse /= std::max(radius * radius - c * c - s * s, 1e-6 * radius * radius);
  return ellipse;
}

/// A place on the ellipse, given by the unit vector u(t) of its parameter.
struct Foot {
  Eigen::Vector2d direction;  // u(t)
  Eigen::Vector2d normal;     // outwards
  double radius;              // distance of the tangent from the center
  double flatness;            // that distance over the radius of curvature
};

Foot footAt(const Ellipse& ellipse, const Eigen::Vector2d& direction) {
  Foot foot;
  foot.direction = direction;
  foot.normal = ellipse.inverse * direction;
  foot.radius = 1.0 / foot.normal.norm();
  foot.normal *= foot.radius;
  const Eigen::Vector2d tangent(-foot.normal.y(), foot.normal.x());
  foot.flatness = (foot.radius * ellipse.inverse * tangent).squaredNorm();
  return foot;
}

/// Place of the ellipse whose normal passes through `offset` (from the center).
Foot footOf(const Ellipse& ellipse, const Eigen::Vector2d& offset) {
  constexpr int kIterations = 3;
  // offset = S u + l S^-1 u; starts from the ray through the center.
  Eigen::Vector2d direction = ellipse.inverse * offset;
  if (!(direction.norm() > 0.0)) direction = Eigen::Vector2d::UnitX();
  Foot foot = footAt(ellipse, direction.normalized());
  const double least = -0.8 / ellipse.inverse.squaredNorm();  // keeps clear of the evolute
  for (int i = 0; i < kIterations; ++i) {
    const double distance = foot.normal.dot(offset - ellipse.shape * foot.direction);
    const double l = std::max(distance * foot.radius, least);
    direction = (ellipse.shape + l * ellipse.inverse).inverse() * offset;
    if (direction.norm() > 0.0) foot = footAt(ellipse, direction.normalized());
  }
  return foot;
}

// A point's log-likelihood depends on the parameters through three things: how far the surface is
// shifted along its normal, how far it has grown along its normal, and the noise.
using Local = Eigen::Vector3d;
using LocalInformation = Eigen::Matrix3d;

/// How far the surface moves along its normal at `foot` by a shift in x and y, by the radius, and
/// by the two components of ellipticity.
using Motion = Eigen::Matrix<double, 5, 1>;

Motion motionAt(const Foot& foot) {
  const Eigen::Vector2d& u = foot.direction;
  const Eigen::Vector2d& n = foot.normal;
  Motion motion;
  motion << n, n.dot(u), n.x() * u.x() - n.y() * u.y(), n.x() * u.y() + n.y() * u.x();
  return motion;
}

/// Second derivative of the motion along the ellipse.
Motion secondDerivative(const Ellipse& ellipse, const Eigen::Vector2d& direction) {
  constexpr double kStep = 0.1;  // [rad]
  Motion value[3];
  double speed[3];  // length of ellipse per angle
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector2d u = Eigen::Rotation2Dd(kStep * (i - 1)) * direction;
    const Foot foot = footAt(ellipse, u);
    value[i] = motionAt(foot);
    speed[i] = (ellipse.shape * Eigen::Vector2d(-u.y(), u.x())).norm();
  }
  return ((value[2] - value[1]) / (0.5 * (speed[2] + speed[1])) -
          (value[1] - value[0]) / (0.5 * (speed[1] + speed[0]))) /
         (kStep * kStep * speed[1]);
}

Eigen::Matrix<double, kSize, 3> jacobianOf(const Motion& motion, double height) {
  Eigen::Matrix<double, kSize, 3> jacobian = Eigen::Matrix<double, kSize, 3>::Zero();
  jacobian.block<2, 1>(kCenter, 0) = motion.head<2>();
  jacobian.block<2, 1>(kTilt, 0) = height * motion.head<2>();
  jacobian.block<2, 1>(kCurvature, 0) = height * height * motion.head<2>();
  jacobian.block<2, 1>(kTwist, 0) = height * height * height * motion.head<2>();
  jacobian(kRadius, 1) = motion[2];
  jacobian(kTaper, 1) = height * motion[2];
  jacobian(kTaperChange, 1) = height * height * motion[2];
  jacobian.block<2, 1>(kEllipse, 1) = motion.tail<2>();
  jacobian(kNoise, 2) = 1.0;
  return jacobian;
}

/// What the points say at one place of the parameters.
struct Evaluation {
  double value = 0.0;
  Parameters score = Parameters::Zero();
  Information observed = Information::Zero();  // may be indefinite far from the solution
  Information expected = Information::Zero();  // never is
  double outliers = 0.0;
};

/// What the points look like before anything is fitted.
struct Extent {
  double reach = 0.0;           // largest distance from the reference axis
  double width_variance = 0.0;  // across the stem, in the direction in which it is largest
};

/// Solves the estimating equations from one starting point.
class CrossSectionSolver {
 public:
  CrossSectionSolver(const std::vector<Eigen::Vector3d>& points, const CrossSectionPrior& prior,
                     const Extent& extent, const Parameters& start)
      : points_(&points),
        prior_(prior),
        outlier_radius_(extent.reach),
        width_variance_(extent.width_variance),
        parameters_(start) {
    evaluate();
  }

  /// Up to `steps` scoring steps; true once nothing moves.
  bool run(int steps) {
    for (int i = 0; i < steps; ++i) {
      // Scoring is slower than Newton's method but has no cycles.
      Parameters step = i < kNewtonSteps ? newtonStep() : scoringStep();
      if (!step.allFinite()) return false;
      limit(step);
      parameters_ += step;
      evaluate();
      const double moved = step.segment<2>(kCenter).norm() + std::abs(step[kRadius]) +
                           step.segment<2>(kEllipse).norm();
      if (moved < kConverged * parameters_[kRadius] && std::abs(step[kNoise]) < 1e-4) return true;
    }
    return false;
  }

  double value() const { return evaluation_.value; }
  const Parameters& parameters() const { return parameters_; }
  const Parameters& priorWeight() const { return prior_weight_; }
  const Information& information() const { return evaluation_.observed; }
  double outlierShare() const { return outlier_share_; }
  double surfacePoints() const { return count() - evaluation_.outliers; }
  /// Points that the noise is known from, beyond those that the shape takes; its prior counts too.
  double freedom() const { return surfacePoints() - fitted_ + 0.5 * prior_weight_[kNoise]; }

  /// Covariance by how much patches of the surface disagree ("sandwich"): errors that neighbouring
  /// points share, such as drift of the map or a node, show in it.
  Information patchCovariance(const Information& covariance) const {
    std::array<Parameters, kSectors * kSlabs> patches;
    patches.fill(Parameters::Zero());
    const auto [low, high] = std::minmax_element(
        points_->begin(), points_->end(),
        [](const Eigen::Vector3d& a, const Eigen::Vector3d& b) { return a.z() < b.z(); });
    const double slab = std::max(high->z() - low->z(), 1e-9) / kSlabs;
    for (const Eigen::Vector3d& point : *points_) {
      const Eigen::Vector2d offset = point.head<2>() - centerAt(parameters_, point.z());
      const double turn = std::atan2(offset.y(), offset.x()) / (2.0 * M_PI) + 0.5;
      const int sector = std::min(static_cast<int>(turn * kSectors), kSectors - 1);
      const int level = std::min(static_cast<int>((point.z() - low->z()) / slab), kSlabs - 1);
      Evaluation single;
      addPoint(point, single);
      patches[static_cast<std::size_t>(level * kSectors + sector)] += single.score;
    }
    Information scatter = Information::Zero();
    for (const Parameters& patch : patches) scatter.noalias() += patch * patch.transpose();
    return covariance * scatter * covariance;
  }

 private:
  double count() const { return static_cast<double>(points_->size()); }

  void evaluate() {
    setPriors();
    evaluation_ = Evaluation();
    for (const Eigen::Vector3d& point : *points_) addPoint(point, evaluation_);
    constexpr double kPseudoOutliers = 0.5, kPseudoPoints = 5.0;  // keep the share off 0 and 1
    outlier_share_ = (evaluation_.outliers + kPseudoOutliers) / (count() + kPseudoPoints);
    addPriors();
  }

  void addPoint(const Eigen::Vector3d& point, Evaluation& evaluation) const {
    const Ellipse ellipse = ellipseAt(parameters_, point.z());
    const Eigen::Vector2d offset = point.head<2>() - centerAt(parameters_, point.z());
    const Foot foot = footOf(ellipse, offset);
    const double distance = std::max(foot.normal.dot(offset), 1e-3 * foot.radius);
    const double noise = std::exp(parameters_[kNoise]);
    const RiceTerms rice = riceTerms(distance, foot.radius, noise);

    // Where the surface curves more or less than a circle would, the noise along it moves points
    // outwards more or less.
    const double excess = 0.5 * (foot.flatness - 1.0);
    const double log_surface =
        rice.value + excess * std::log(distance / foot.radius) + std::log1p(-outlier_share_);
    const double log_outlier =
        std::log(2.0 * distance * outlier_share_) - 2.0 * std::log(outlier_radius_);
    const double top = std::max(log_surface, log_outlier);
    const double log_density =
        top + std::log(std::exp(log_surface - top) + std::exp(log_outlier - top));
    const double member = std::exp(log_surface - log_density);

    Local score(-rice.by_distance - excess / distance, rice.by_radius - excess / foot.radius,
                rice.by_log_noise);
    LocalInformation second;
    second << -rice.by_distance2 + excess / (distance * distance), rice.by_distance_radius,
        rice.by_distance_noise,  //
        rice.by_distance_radius, -rice.by_radius2 - excess / (foot.radius * foot.radius),
        -rice.by_radius_noise,  //
        rice.by_distance_noise, -rice.by_radius_noise, -rice.by_log_noise2;
    second = (member * second - member * (1.0 - member) * score * score.transpose()).eval();
    score *= member;
    const double precision = member / (noise * noise);
    LocalInformation expected;
    expected << precision, precision, 0.0, precision, precision, 0.0, 0.0, 0.0, 2.0 * member;

    const Motion motion = motionAt(foot);
    const auto jacobian = jacobianOf(motion, point.z());
    evaluation.value += log_density;
    evaluation.outliers += 1.0 - member;
    evaluation.score.noalias() += jacobian * score;
    addBend(ellipse, foot, point.z(), member, evaluation);
    evaluation.observed.noalias() += jacobian * second * jacobian.transpose();
    evaluation.expected.noalias() += jacobian * expected * jacobian.transpose();
  }

  /// Noise along the surface moves a point away from where its motion was taken. Without this term
  /// the ends of a half-seen arc pull on the fit: E[score] = -s^2/2 k J'' for motion J and
  /// curvature k, the damping being a stand-in for higher orders.
  void addBend(const Ellipse& ellipse, const Foot& foot, double height, double member,
               Evaluation& evaluation) const {
    const double noise = std::exp(parameters_[kNoise]) / foot.radius;
    const double weight = 0.5 * noise * noise / (1.0 + noise * noise) * member;
    const Motion bend =
        weight * foot.flatness * foot.radius * secondDerivative(ellipse, foot.direction);
    evaluation.score.segment<2>(kCenter) += bend.head<2>();
    evaluation.score.segment<2>(kTilt) += height * bend.head<2>();
    evaluation.score.segment<2>(kCurvature) += height * height * bend.head<2>();
    evaluation.score.segment<2>(kTwist) += height * height * height * bend.head<2>();
    evaluation.score[kRadius] += bend[2];
    evaluation.score[kTaper] += height * bend[2];
    evaluation.score[kTaperChange] += height * height * bend[2];
    evaluation.score.segment<2>(kEllipse) += bend.tail<2>();
  }

  /// Priors that scale with the stem, at the present radius.
  void setPriors() {
    const double radius = parameters_[kRadius];
    const auto set = [&](int first, int size, double mean, double stddev) {
      prior_mean_.segment(first, size).setConstant(mean);
      prior_weight_.segment(first, size).setConstant(1.0 / (stddev * stddev));
    };
    set(kTilt, 2, 0.0, kTiltStddev);
    set(kCurvature, 2, 0.0, kCurvatureStddev);
    const double noise = std::exp(parameters_[kNoise]);
    const double size =
        std::sqrt(2.0 * std::max(width_variance_ - noise * noise, 0.25 * width_variance_));
    if (prior_.radius.stddev > 0.0) {
      set(kRadius, 1, prior_.radius.value, prior_.radius.stddev);
    } else {
      set(kRadius, 1, size, kSizeStddev * size);
    }
    set(kTwist, 2, 0.0, kTwistStddev);
    set(kTaper, 1, prior_.taper.value * radius, prior_.taper.stddev * radius);
    set(kTaperChange, 1, prior_.taper_change.value * radius, prior_.taper_change.stddev * radius);
    set(kEllipse, 2, 0.0, std::max(prior_.ellipticity_stddev, 1e-4) * radius);
    if (prior_.noise > 0.0) {
      set(kNoise, 1, std::log(std::max(prior_.noise, kMinNoise * radius)), kLogNoiseKnown);
    } else if (prior_.log_noise.stddev > 0.0) {
      set(kNoise, 1, prior_.log_noise.value, prior_.log_noise.stddev);
    } else {
      set(kNoise, 1, std::log(kNoiseMean * radius), kLogNoiseStddev);
    }
  }

  void addPriors() {
    const Parameters deviation = parameters_ - prior_mean_;
    evaluation_.value -= 0.5 * deviation.dot(prior_weight_.cwiseProduct(deviation));
    evaluation_.score -= prior_weight_.cwiseProduct(deviation);
    evaluation_.observed.diagonal() += prior_weight_;
    evaluation_.expected.diagonal() += prior_weight_;

    // Residual maximum likelihood: the shape was fitted to the same points as the noise.
    const Information inverse = evaluation_.expected.llt().solve(Information::Identity());
    fitted_ = kNoise - prior_weight_.head<kNoise>().dot(inverse.diagonal().head<kNoise>());
    evaluation_.score[kNoise] += fitted_;
  }

  Parameters newtonStep() const {
    const Eigen::LLT<Information> newton(evaluation_.observed);
    if (newton.info() == Eigen::Success) return newton.solve(evaluation_.score);
    return scoringStep();
  }

  Parameters scoringStep() const { return evaluation_.expected.llt().solve(evaluation_.score); }

  /// Keeps a step within what the local quadratic model can be trusted for.
  void limit(Parameters& step) const {
    const double radius = parameters_[kRadius];
    const double length = std::max({std::abs(step[kRadius]), step.segment<2>(kCenter).norm(),
                                    step.segment<2>(kEllipse).norm()});
    step *= std::min({1.0, 0.2 * radius / std::max(length, 1e-12),
                      0.4 / std::max(std::abs(step[kNoise]), 1e-12)});
    const double low = std::log(kMinNoise * radius) - parameters_[kNoise];
    const double high = std::log(2.0 * radius) - parameters_[kNoise];
    step[kNoise] = std::max(std::min(step[kNoise], high), low);
    const double wished = (parameters_ + step).segment<2>(kEllipse).norm();
    const double most = 0.5 * (radius + step[kRadius]);
    if (wished > most) {
      step.segment<2>(kEllipse) = (parameters_ + step).segment<2>(kEllipse) * (most / wished) -
                                  parameters_.segment<2>(kEllipse);
    }
  }

  const std::vector<Eigen::Vector3d>* points_;
  CrossSectionPrior prior_;
  double outlier_radius_;
  double width_variance_;
  Parameters parameters_;
  Parameters prior_mean_ = Parameters::Zero();
  Parameters prior_weight_ = Parameters::Zero();  // inverse variances
  Evaluation evaluation_;
  double outlier_share_ = 0.1;
  double fitted_ = 0.0;  // parameters that the points, not the priors, decide
};

/// A circle round `center` through the middle of the points.
Parameters circleStart(const std::vector<Eigen::Vector3d>& points, const Eigen::Vector2d& center,
                       const CrossSectionPrior& prior) {
  std::vector<double> distances;
  distances.reserve(points.size());
  for (const Eigen::Vector3d& point : points) {
    distances.push_back((point.head<2>() - center).norm());
  }
  const double radius = std::max(medianOf(distances), 1e-6);
  for (double& distance : distances) distance = std::abs(distance - radius);
  const double scatter = prior.noise > 0.0 ? prior.noise : 1.48 * medianOf(distances);
  Parameters start = Parameters::Zero();
  start.segment<2>(kCenter) = center;
  start[kRadius] = radius;
  start[kTaper] = prior.taper.value * radius;
  start[kTaperChange] = prior.taper_change.value * radius;
  start[kNoise] = std::log(std::clamp(scatter, 0.05 * radius, 0.9 * radius));
  return start;
}

/// Angles of the points on the surface.
std::vector<double> surfaceAngles(const std::vector<Eigen::Vector3d>& points, const Parameters& p) {
  std::vector<double> angles;
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector2d unrolled =
        ellipseAt(p, point.z()).inverse * (point.head<2>() - centerAt(p, point.z()));
    if (std::abs(unrolled.norm() - 1.0) * p[kRadius] > 3.0 * std::exp(p[kNoise])) continue;
    angles.push_back(std::atan2(unrolled.y(), unrolled.x()));
  }
  return angles;
}

/// Mean of |z| for z ~ N(mean, covariance) in the plane: |z| is a quarter of the integral of
/// |z . d| over all directions d, and the mean of each |z . d| is known in closed form.
double meanNorm(const Eigen::Vector2d& mean, const Eigen::Matrix2d& covariance) {
  constexpr int kDirections = 32;
  double sum = 0.0;
  for (int i = 0; i < kDirections; ++i) {
    const double angle = M_PI * (i + 0.5) / kDirections;
    const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    const double m = mean.dot(direction);
    const double s = std::sqrt(std::max(direction.dot(covariance * direction), 1e-300));
    sum += s * std::sqrt(2.0 / M_PI) * std::exp(-0.5 * (m / s) * (m / s)) +
           m * std::erf(m / (s * std::sqrt(2.0)));
  }
  return sum * 0.5 * M_PI / kDirections;
}

/// Diameters and their standard deviations from the posterior's normal approximation.
void setDiameters(const Parameters& p, const Information& covariance, StemCrossSection& result) {
  const double radius = p[kRadius];
  const double radius_variance = covariance(kRadius, kRadius);
  const Eigen::Vector2d ellipse = p.segment<2>(kEllipse);
  const Eigen::Matrix2d ellipse_covariance = covariance.block<2, 2>(kEllipse, kEllipse);
  const double half_difference = meanNorm(ellipse, ellipse_covariance);
  const double mean_square = ellipse.squaredNorm() + ellipse_covariance.trace();
  const double difference_variance = std::max(mean_square - half_difference * half_difference, 0.0);
  const double cross =
      covariance.block<1, 2>(kRadius, kEllipse).dot(ellipse.transpose()) / std::sqrt(mean_square);

  result.radius = {radius, std::sqrt(radius_variance)};
  result.major = {
      2.0 * (radius + half_difference),
      2.0 * std::sqrt(std::max(radius_variance + difference_variance + 2.0 * cross, 0.0))};
  result.minor = {
      2.0 * (radius - half_difference),
      2.0 * std::sqrt(std::max(radius_variance + difference_variance - 2.0 * cross, 0.0))};
  result.equivalent = {2.0 * std::sqrt(std::max(radius * radius - mean_square, 0.0)),
                       2.0 * std::sqrt(radius_variance)};
  result.major_angle = 0.5 * std::atan2(ellipse.y(), ellipse.x());
}

/// Share of the priors in what is known of 2a, and of its ellipticity: their precision over that of
/// the result.
void setPriorShares(double radius_variance, double ellipse_variance, const Information& covariance,
                    StemCrossSection& result) {
  const double ellipse_known = 0.5 * covariance.diagonal().segment<2>(kEllipse).sum();
  const double known = result.major.stddev * result.major.stddev;
  result.ellipticity_prior_share = std::clamp(ellipse_known / ellipse_variance, 0.0, 1.0);
  result.prior_share = std::clamp(0.25 * known / (radius_variance + ellipse_variance), 0.0, 1.0);
}

/// Widens the covariance of some parameters to at least that of `other`.
void widen(const Information& other, int first, int size, Information& covariance) {
  const double ratio = other.diagonal().segment(first, size).sum() /
                       covariance.diagonal().segment(first, size).sum();
  if (!(ratio > 1.0)) return;
  covariance.middleRows(first, size) *= std::sqrt(ratio);
  covariance.middleCols(first, size) *= std::sqrt(ratio);
}

/// Nothing is known worse of the ellipticity than its prior says; `only_prior`: nor better.
void limitEllipticity(bool only_prior, double prior_variance, Information& covariance) {
  const double variance = 0.5 * covariance.diagonal().segment<2>(kEllipse).sum();
  if (!only_prior && variance <= prior_variance) return;
  covariance.middleRows<2>(kEllipse).setZero();
  covariance.middleCols<2>(kEllipse).setZero();
  covariance.diagonal().segment<2>(kEllipse).setConstant(prior_variance);
}

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

Extent extentOf(const std::vector<Eigen::Vector3d>& points) {
  constexpr double kTrim = 2.5;  // median distances
  Extent extent;
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

/// The better of two starts: from the reference axis, and from a circle through all points.
CrossSectionSolver startSolver(const std::vector<Eigen::Vector3d>& points,
                               const CrossSectionPrior& prior, const Extent& extent) {
  CrossSectionSolver best(points, prior, extent,
                          circleStart(points, Eigen::Vector2d::Zero(), prior));
  best.run(kStartSteps);
  std::vector<Eigen::Vector2d> flat;
  flat.reserve(points.size());
  for (const Eigen::Vector3d& point : points) flat.push_back(point.head<2>());
  const CircleFit guess = fitCircle(flat);
  if (guess.valid && guess.radius < 2.0 * extent.reach) {
    CrossSectionSolver other(points, prior, extent, circleStart(points, guess.center, prior));
    other.run(kStartSteps);
    if (!(other.value() <= best.value())) best = other;
  }
  return best;
}

}  // namespace

StemCrossSection fitStemCrossSection(const std::vector<Eigen::Vector3d>& points,
                                     const CrossSectionPrior& prior) {
  StemCrossSection result;
  if (points.size() < 5U) return result;
  const Extent extent = extentOf(points);
  if (!(extent.width_variance > 0.0)) return result;

  // 1. Solve; noise nearly as large as the stem leaves no shape to be seen but its size.
  CrossSectionSolver solver = startSolver(points, prior, extent);
  result.converged = solver.run(kMaxSteps);
  const double blur = std::exp(solver.parameters()[kNoise]) / solver.parameters()[kRadius];
  const bool shapeless = !(blur < kMaxBlur);
  if (shapeless) {
    CrossSectionPrior round = prior;
    round.ellipticity_stddev = 0.0;
    solver = startSolver(points, round, extent);
    result.converged = solver.run(kMaxSteps);
  }

  // 2. Covariance.
  const Parameters& p = solver.parameters();
  const Eigen::LLT<Information> information(solver.information());
  if (!p.allFinite() || information.info() != Eigen::Success) return result;
  Information covariance = information.solve(Information::Identity());
  const Information patches = solver.patchCovariance(covariance);
  // With the noise estimated from few points the errors follow Student's distribution.
  const double freedom = std::max(solver.freedom(), 3.0);
  covariance *= freedom / (freedom - 2.0);
  widen(patches, kRadius, 1, covariance);
  widen(patches, kEllipse, 2, covariance);
  const double ellipse_variance =
      std::pow(std::max(prior.ellipticity_stddev, 1e-4) * p[kRadius], 2);
  limitEllipticity(shapeless, ellipse_variance, covariance);

  // 3. The ends of a half-seen arc, blurred by the noise, look like more of a smaller stem; found
  // by simulation over noise 1-3 mm, 60-1000 points, arcs 120-360 degrees.
  result.arc_coverage = arcCoverage(surfaceAngles(points, p));
  const double noise = std::exp(p[kNoise]);
  const double seen = result.arc_coverage - kArcEndBlur * noise / p[kRadius];
  const double unseen = std::clamp((kFullArc - seen) / kPartArc, 0.0, 1.0);
  covariance(kRadius, kRadius) += std::pow(kArcEndStddev * unseen * noise, 2);
  covariance(kRadius, kRadius) += std::pow(kUnevenNoiseStddev * noise * noise / p[kRadius], 2);

  // 4. Traits.
  result.valid = true;
  result.center = p.segment<2>(kCenter);
  result.tilt = p.segment<2>(kTilt);
  result.curvature = p.segment<2>(kCurvature);
  const auto relative = [&](Index i) -> Trait {
    return {p[i] / p[kRadius], std::sqrt(covariance(i, i)) / p[kRadius]};
  };
  result.taper = relative(kTaper);
  result.taper_change = relative(kTaperChange);
  result.noise = noise;
  result.log_noise = {p[kNoise], std::sqrt(covariance(kNoise, kNoise))};
  result.ellipticity = p.segment<2>(kEllipse) / p[kRadius];
  result.ellipticity_stddev =
      std::sqrt(0.5 * covariance.diagonal().segment<2>(kEllipse).sum()) / p[kRadius];
  result.outlier_share = solver.outlierShare();
  result.points = solver.surfacePoints();
  setDiameters(p, covariance, result);
  setPriorShares(1.0 / solver.priorWeight()[kRadius], ellipse_variance, covariance, result);
  return result;
}

}  // namespace field_phenotyping
