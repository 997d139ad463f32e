#include "field_phenotyping/measurement/cross_section_start.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/rice_distribution.hpp"

namespace field_phenotyping {
namespace {

using Parameters = CrossSectionVector;
using Information = CrossSectionMatrix;

constexpr int kSteps = 15;
constexpr double kNearEnough = 0.01;  // step, relative to the radius; of the noise's logarithm too

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

/// How far the surface moves along its normal.
SurfaceMotion motionAt(const Foot& foot) {
  return surfaceMotion(foot.direction, foot.normal);
}

/// Second derivative of the motion along the ellipse.
SurfaceMotion secondDerivative(const Ellipse& ellipse, const Eigen::Vector2d& direction) {
  constexpr double kStep = 0.1;  // [rad]
  SurfaceMotion value[3];
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

/// How the local quantities move them: two shift the surface, the next three let it grow.
using LocalJacobian = Eigen::Matrix<double, kLocalSize, 3>;
LocalJacobian jacobianOf(const SurfaceMotion& motion) {
  LocalJacobian jacobian = LocalJacobian::Zero();
  jacobian.block<2, 1>(0, 0) = motion.head<2>();
  jacobian.block<3, 1>(2, 1) = motion.tail<3>();
  jacobian(kLocalNoise, 2) = 1.0;
  return jacobian;
}

LocalPairs pairsOf(const LocalJacobian& jacobian, const LocalInformation& information) {
  const LocalJacobian half = jacobian.lazyProduct(information);
  LocalPairs pairs;
  for (int i = 0; i < kLocalSize; ++i) {
    for (int j = 0; j <= i; ++j) pairs[localPair(i, j)] = half.row(i).dot(jacobian.row(j));
  }
  return pairs;
}

/// What the points say at one place of the parameters.
struct Evaluation {
  double value = 0.0;
  Parameters score = Parameters::Zero();
  Information observed = Information::Zero();  // may be indefinite far from the solution
  Information expected = Information::Zero();  // never is
  double outliers = 0.0;
};

/// Solves the estimating equations from one starting point.
class CrossSectionSolver {
 public:
  CrossSectionSolver(const std::vector<Eigen::Vector3d>& points, const CrossSectionPrior& prior,
                     const StemExtent& extent, const Parameters& start)
      : points_(&points), given_(prior), extent_(extent), parameters_(start) {
    evaluate();
  }

  /// Up to kSteps steps, fewer once little moves.
  void run() {
    for (int i = 0; i < kSteps; ++i) {
      Parameters step = newtonStep();
      if (!step.allFinite()) return;
      limitStep(parameters_, step);
      parameters_ += step;
      evaluate();
      const double moved = step.segment<2>(kCenter).norm() + std::abs(step[kRadius]) +
                           step.segment<2>(kEllipse).norm();
      if (moved < kNearEnough * parameters_[kRadius] && std::abs(step[kNoise]) < kNearEnough)
        return;
    }
  }

  double value() const { return evaluation_.value; }
  const Parameters& parameters() const { return parameters_; }
  double outlierShare() const { return outlier_share_; }

 private:
  double count() const { return static_cast<double>(points_->size()); }

  void evaluate() {
    prior_ = ParameterPrior(given_, extent_, parameters_);
    evaluation_ = Evaluation();
    HeightSums observed;
    HeightSums expected;
    for (const Eigen::Vector3d& point : *points_) addPoint(point, evaluation_, observed, expected);
    evaluation_.observed = observed.total();
    evaluation_.expected = expected.total();
    constexpr double kPseudoOutliers = 0.5, kPseudoPoints = 5.0;  // keep the share off 0 and 1
    outlier_share_ = (evaluation_.outliers + kPseudoOutliers) / (count() + kPseudoPoints);
    addPriors();
  }

  void addPoint(const Eigen::Vector3d& point, Evaluation& evaluation, HeightSums& observed_sums,
                HeightSums& expected_sums) const {
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
        std::log(2.0 * distance * outlier_share_) - 2.0 * std::log(extent_.reach);
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

    const SurfaceMotion motion = motionAt(foot);
    const LocalJacobian jacobian = jacobianOf(motion);
    const HeightPowers powers = heightPowers(point.z());
    evaluation.value += log_density;
    evaluation.outliers += 1.0 - member;
    LocalVector local_score = jacobian.lazyProduct(score);
    local_score.head<kLocalShapeSize>() += bendAt(ellipse, foot, member);
    evaluation.score += spread(local_score, powers);
    observed_sums.add(pairsOf(jacobian, second), powers);
    expected_sums.add(pairsOf(jacobian, expected), powers);
  }

  /// Noise along the surface moves a point away from where its motion was taken. Without this term
  /// the ends of a half-seen arc pull on the fit: E[score] = -s^2/2 k J'' for motion J and
  /// curvature k, the damping being a stand-in for higher orders.
  SurfaceMotion bendAt(const Ellipse& ellipse, const Foot& foot, double member) const {
    const double noise = std::exp(parameters_[kNoise]) / foot.radius;
    const double weight = 0.5 * noise * noise / (1.0 + noise * noise) * member;
    return weight * foot.flatness * foot.radius * secondDerivative(ellipse, foot.direction);
  }

  void addPriors() {
    const Parameters deviation = parameters_ - prior_.mean;
    evaluation_.value -= 0.5 * deviation.dot(prior_.weight.cwiseProduct(deviation));
    evaluation_.score -= prior_.weight.cwiseProduct(deviation);
    evaluation_.observed.diagonal() += prior_.weight;
    evaluation_.expected.diagonal() += prior_.weight;

    // Residual maximum likelihood: the shape was fitted to the same points as the noise.
    const Information inverse = evaluation_.expected.llt().solve(Information::Identity());
    const double fitted =
        kNoise - prior_.weight.head<kNoise>().dot(inverse.diagonal().head<kNoise>());
    evaluation_.score[kNoise] += fitted;
  }

  Parameters newtonStep() const {
    const Eigen::LLT<Information> newton(evaluation_.observed);
    if (newton.info() == Eigen::Success) return newton.solve(evaluation_.score);
    return evaluation_.expected.llt().solve(evaluation_.score);
  }

  const std::vector<Eigen::Vector3d>* points_;
  CrossSectionPrior given_;
  StemExtent extent_;
  ParameterPrior prior_;
  Parameters parameters_;
  Evaluation evaluation_;
  double outlier_share_ = 0.1;
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

}  // namespace

CrossSectionStart startCrossSection(const std::vector<Eigen::Vector3d>& points,
                                    const CrossSectionPrior& prior, const StemExtent& extent) {
  CrossSectionSolver best(points, prior, extent,
                          circleStart(points, Eigen::Vector2d::Zero(), prior));
  best.run();
  std::vector<Eigen::Vector2d> flat;
  flat.reserve(points.size());
  for (const Eigen::Vector3d& point : points) flat.push_back(point.head<2>());
  const CircleFit guess = fitCircle(flat);
  if (guess.valid && guess.radius < 2.0 * extent.reach) {
    CrossSectionSolver other(points, prior, extent, circleStart(points, guess.center, prior));
    other.run();
    if (!(other.value() <= best.value())) best = other;
  }
  return {best.parameters(), best.outlierShare()};
}

}  // namespace field_phenotyping
