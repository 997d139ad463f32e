#pragma once

#include "field_phenotyping/common/team_cholesky.hpp"
#include "field_phenotyping/measurement/cross_section_model.hpp"
#include "field_phenotyping/measurement/rice_distribution.hpp"

// What startCrossSection() does, for a team of threads (see team.hpp), on the CPU and on the GPU.

namespace field_phenotyping {

/// Where the fit of a piece of stem begins.
struct CrossSectionStart {
  CrossSectionVector parameters;
  double outlier_share = 0.0;
  bool shapeless = false;  ///< a circle is to be fitted
};

/// One piece of stem to be fitted, before anything is.
struct CrossSectionTask {
  KnownOfStem known;
  StemExtent extent;
  CrossSectionVector of_axis;    ///< a circle round the reference axis
  CrossSectionVector of_circle;  ///< one through all points
  bool has_circle = false;
  CrossSectionStart near;  ///< where to begin instead
  bool has_near = false;
  bool shapeless = false;  ///< a circle is to be fitted
};

namespace start {

/// Whether noise leaves no shape to be seen but the size.
FIELD_PHENOTYPING_HD inline bool isShapeless(const CrossSectionVector& parameters) {
  constexpr double kMaxBlur = 0.6;  // noise over radius
  return !(exponential(parameters[kNoise]) < kMaxBlur * parameters[kRadius]);
}

/// A symmetric matrix.
struct Symmetric2 {
  double xx, xy, yy;

  FIELD_PHENOTYPING_HD Direction times(double x, double y) const {
    return {xx * x + xy * y, xy * x + yy * y};
  }
  /// @param least of its determinant
  FIELD_PHENOTYPING_HD Symmetric2 inverse(double least) const {
    const double scale = 1.0 / largerOf(xx * yy - xy * xy, least);
    return {yy * scale, -xy * scale, xx * scale};
  }
};

/// The ellipse at one height.
struct Ellipse {
  Symmetric2 shape;    // S
  Symmetric2 inverse;  // of S
};

FIELD_PHENOTYPING_HD inline Ellipse ellipseAt(const CrossSectionVector& p, double height) {
  const double radius = radiusAt(p, height);
  const double c = p[kEllipse];
  const double s = p[kEllipse + 1];
  const Symmetric2 shape{radius + c, s, radius - c};
  return {shape, shape.inverse(1e-6 * radius * radius)};
}

/// A place on the ellipse, given by the unit vector u(t) of its parameter.
struct Foot {
  Direction direction;  // u(t)
  Direction normal;     // outwards
  double radius;        // distance of the tangent from the center
};

FIELD_PHENOTYPING_HD inline Foot footAt(const Ellipse& ellipse, double x, double y) {
  const double scale = 1.0 / lengthOf(x, y);
  const Direction u{x * scale, y * scale};
  const Direction across = ellipse.inverse.times(u.x, u.y);
  const double radius = 1.0 / lengthOf(across.x, across.y);
  return {u, {across.x * radius, across.y * radius}, radius};
}

/// The distance of the tangent from the center over the radius of curvature.
FIELD_PHENOTYPING_HD inline double flatnessAt(const Ellipse& ellipse, const Foot& foot) {
  const Direction turned = ellipse.inverse.times(-foot.normal.y, foot.normal.x);
  return foot.radius * foot.radius * (turned.x * turned.x + turned.y * turned.y);
}

/// Place of the ellipse whose normal passes through the point (x, y) from the center.
FIELD_PHENOTYPING_HD inline Foot footOf(const Ellipse& ellipse, double x, double y) {
  constexpr int kIterations = 3;
  // offset = S u + l S^-1 u; starts from the ray through the center.
  const Symmetric2& inverse = ellipse.inverse;
  const Direction ray = inverse.times(x, y);
  const bool has_ray = lengthOf(ray.x, ray.y) > 0.0;
  Foot foot = footAt(ellipse, has_ray ? ray.x : 1.0, has_ray ? ray.y : 0.0);
  // Keeps clear of the evolute.
  const double least =
      -0.8 / (inverse.xx * inverse.xx + 2.0 * inverse.xy * inverse.xy + inverse.yy * inverse.yy);
  for (int i = 0; i < kIterations; ++i) {
    const Direction place = ellipse.shape.times(foot.direction.x, foot.direction.y);
    const double distance = foot.normal.x * (x - place.x) + foot.normal.y * (y - place.y);
    const double l = largerOf(distance * foot.radius, least);
    const Symmetric2 sum{ellipse.shape.xx + l * inverse.xx, ellipse.shape.xy + l * inverse.xy,
                         ellipse.shape.yy + l * inverse.yy};
    // Its determinant's size does not matter, and it is positive.
    const Direction wished{sum.yy * x - sum.xy * y, sum.xx * y - sum.xy * x};
    if (lengthOf(wished.x, wished.y) > 0.0) foot = footAt(ellipse, wished.x, wished.y);
  }
  return foot;
}

/// Second derivative along the ellipse of how far the surface moves along its normal.
/// @param motion at `foot`
FIELD_PHENOTYPING_HD inline void secondDerivative(const Ellipse& ellipse, const Foot& foot,
                                                  const double* motion, double* derivative) {
  constexpr double kStep = 0.1;                     // [rad]
  constexpr double kCosine = 0.995004165278025766;  // of the step
  constexpr double kSine = 0.0998334166468281523;
  const auto speedAt = [&](const Direction& u) {  // length of ellipse per angle
    const Direction along = ellipse.shape.times(-u.y, u.x);
    return lengthOf(along.x, along.y);
  };
  const Direction& u = foot.direction;
  const Direction before{kCosine * u.x + kSine * u.y, kCosine * u.y - kSine * u.x};
  const Direction after{kCosine * u.x - kSine * u.y, kCosine * u.y + kSine * u.x};
  const Foot foot_before = footAt(ellipse, before.x, before.y);
  const Foot foot_after = footAt(ellipse, after.x, after.y);
  double motion_before[kLocalShapeSize];
  double motion_after[kLocalShapeSize];
  surfaceMotion(before, foot_before.normal.x, foot_before.normal.y, motion_before);
  surfaceMotion(after, foot_after.normal.x, foot_after.normal.y, motion_after);
  const double speed = speedAt(u);
  const double to_after = 1.0 / (0.5 * (speedAt(after) + speed));
  const double to_before = 1.0 / (0.5 * (speed + speedAt(before)));
  const double scale = 1.0 / (kStep * kStep * speed);
  for (int i = 0; i < kLocalShapeSize; ++i) {
    derivative[i] =
        ((motion_after[i] - motion[i]) * to_after - (motion[i] - motion_before[i]) * to_before) *
        scale;
  }
}

constexpr int kLocals = kLocalNoise + 1;  // the elongation of the noise is left to its prior
constexpr int kLocalPairs = pairOf(kLocals, 0);
constexpr int kShapePairs = pairOf(kLocalShapeSize, 0);

/// What one point says.
struct Record {
  double powers[kHeightPowers];
  double value;  // logarithm of its density
  double member;
  double score[kLocals];
  double observed[kLocalPairs];
  double expected[kShapePairs];
};

/// What all points say.
struct Sums {
  double value;
  double outliers;
  double score[kCrossSectionSize];
  double observed[kInformationSums];
  double expected[kInformationSums];
};

}  // namespace start

/// What a team works with; all members see the same memory.
struct StartScratch {
  start::Record* records;  ///< one for each member
  start::Sums* sums;
  double* matrix;    ///< kCrossSectionSize x kCrossSectionSize
  double* vector;    ///< kCrossSectionSize
  double* solution;  ///< kCrossSectionSize
};

/// Solves the estimating equations from one starting point after the other. All members of the team
/// call everything, and have the same values.
template <class Team>
class CrossSectionSolver {
 public:
  FIELD_PHENOTYPING_HD CrossSectionSolver(const Team& team, const CrossSectionPoints& points,
                                          const KnownOfStem& known, const StemExtent& extent,
                                          const StartScratch& scratch)
      : team_(team),
        points_(points),
        known_(known),
        extent_(extent),
        scratch_(scratch),
        observed_(team),
        expected_(team) {}

  /// Up to kSteps steps, fewer once little moves. Returns the logarithm of the posterior.
  FIELD_PHENOTYPING_HD_ONCE double run(CrossSectionStart& at) const {
    constexpr int kSteps = 15;
    constexpr double kNearEnough = 0.01;  // step, relative to the radius; of the noise's logarithm
    constexpr double kOutlierShare = 0.1;
    at.outlier_share = kOutlierShare;
    ParameterPrior prior;
    double value = evaluate(at, prior);
    for (int i = 0; i < kSteps; ++i) {
      CrossSectionVector step;
      if (!newtonStep(at.parameters, prior, step)) return value;
      limitStep(at.parameters, step);
      for (int k = 0; k < kCrossSectionSize; ++k) at.parameters[k] += step[k];
      value = evaluate(at, prior);
      if (movedBy(step) < kNearEnough * at.parameters[kRadius] &&
          magnitudeOf(step[kNoise]) < kNearEnough) {
        return value;
      }
    }
    return value;
  }

 private:
  /// What is the same for all points.
  struct Constants {
    CrossSectionVector parameters;
    double noise;
    double log_member;   // of the share of points that are no outliers
    double log_outlier;  // density of outliers at distance 1, in its logarithm
  };

  /// Takes the sums at a place of the parameters; finds the share of outliers anew.
  FIELD_PHENOTYPING_HD_ONCE double evaluate(CrossSectionStart& at, ParameterPrior& prior) const {
    prior = ParameterPrior(known_, extent_, at.parameters);
    const Constants constants{at.parameters, exponential(at.parameters[kNoise]),
                              logarithm(1.0 - at.outlier_share),
                              logarithm(2.0 * at.outlier_share) - 2.0 * logarithm(extent_.reach)};
    start::Sums& sums = *scratch_.sums;
    auto* all = reinterpret_cast<double*>(&sums);
    team_.sync();  // the sums are still being read
    constexpr int kAll = static_cast<int>(sizeof(start::Sums) / sizeof(double));
    const int rank = static_cast<int>(team_.rank());
    const int size = static_cast<int>(team_.size());
    for (int i = rank; i < kAll; i += size) all[i] = 0.0;
    for (int first = 0; first < points_.count; first += size) {
      if (first + rank < points_.count) {
        describe(points_.places + 3 * static_cast<std::ptrdiff_t>(first + rank), constants,
                 scratch_.records[rank]);
      }
      team_.sync();
      const int there = points_.count - first < size ? points_.count - first : size;
      for (int k = 0; k < there; ++k) add(scratch_.records[k], sums);
      team_.sync();
    }
    constexpr double kPseudoOutliers = 0.5, kPseudoPoints = 5.0;  // keep the share off 0 and 1
    at.outlier_share = (sums.outliers + kPseudoOutliers) / (points_.count + kPseudoPoints);
    return sums.value + prior.valueAt(at.parameters);
  }

  /// A point's log-likelihood depends on the parameters through three things: how far the surface
  /// is shifted along its normal, how far it has grown along its normal, and the noise.
  FIELD_PHENOTYPING_HD void describe(const double* point, const Constants& constants,
                                     start::Record& record) const {
    const CrossSectionVector& p = constants.parameters;
    const double height = point[2];
    const start::Ellipse ellipse = start::ellipseAt(p, height);
    const Direction center = centerAt(p, height);
    const double x = point[0] - center.x;
    const double y = point[1] - center.y;
    const start::Foot foot = start::footOf(ellipse, x, y);
    const double distance = largerOf(foot.normal.x * x + foot.normal.y * y, 1e-3 * foot.radius);
    const double noise = constants.noise;
    const RiceTerms rice = riceTerms(distance, foot.radius, noise);

    // Where the surface curves more or less than a circle would, the noise along it moves points
    // outwards more or less.
    const double flatness = start::flatnessAt(ellipse, foot);
    const double excess = 0.5 * (flatness - 1.0);
    const double log_surface =
        rice.value + excess * logarithm(distance / foot.radius) + constants.log_member;
    const double log_outlier = logarithm(distance) + constants.log_outlier;
    const double top = largerOf(log_surface, log_outlier);
    const double of_surface = exponential(log_surface - top);
    const double density = of_surface + exponential(log_outlier - top);
    const double member = of_surface / density;

    const double shift = -rice.by_distance - excess / distance;
    const double growth = rice.by_radius - excess / foot.radius;
    const double louder = rice.by_log_noise;
    // Second derivatives by these, with the minus of an information.
    const double doubt = member * (1.0 - member);
    const double shift2 =
        member * (-rice.by_distance2 + excess / (distance * distance)) - doubt * shift * shift;
    const double shift_growth = member * rice.by_distance_radius - doubt * shift * growth;
    const double shift_noise = member * rice.by_distance_noise - doubt * shift * louder;
    const double growth2 = member * (-rice.by_radius2 - excess / (foot.radius * foot.radius)) -
                           doubt * growth * growth;
    const double growth_noise = -member * rice.by_radius_noise - doubt * growth * louder;
    const double noise2 = -member * rice.by_log_noise2 - doubt * louder * louder;

    powersOf(height, record.powers);
    record.value = top + logarithm(density);
    record.member = member;
    double motion[kLocalShapeSize];
    surfaceMotion(foot.direction, foot.normal.x, foot.normal.y, motion);
    // Noise along the surface moves a point away from where its motion was taken. Without this term
    // the ends of a half-seen arc pull on the fit: E[score] = -s^2/2 k J'' for motion J and
    // curvature k, the damping being a stand-in for higher orders.
    double bend[kLocalShapeSize];
    start::secondDerivative(ellipse, foot, motion, bend);
    const double blur = noise / foot.radius;
    const double bending =
        0.5 * blur * blur / (1.0 + blur * blur) * member * flatness * foot.radius;
    const double precision = member / (noise * noise);
    for (int a = 0; a < kLocalShapeSize; ++a) {
      const bool shifts = a < 2;
      record.score[a] = member * (shifts ? shift : growth) * motion[a] + bending * bend[a];
      const double by_shift = (shifts ? shift2 : shift_growth) * motion[a];
      const double by_growth = (shifts ? shift_growth : growth2) * motion[a];
      for (int b = 0; b <= a; ++b) {
        record.observed[pairOf(a, b)] = (b < 2 ? by_shift : by_growth) * motion[b];
        record.expected[pairOf(a, b)] = precision * motion[a] * motion[b];
      }
      record.observed[pairOf(kLocalNoise, a)] = (shifts ? shift_noise : growth_noise) * motion[a];
    }
    record.score[kLocalNoise] = member * louder;
    record.observed[pairOf(kLocalNoise, kLocalNoise)] = noise2;
  }

  FIELD_PHENOTYPING_HD void add(const start::Record& record, start::Sums& sums) const {
    if (team_.rank() == 0U) {
      sums.value += record.value;
      sums.outliers += 1.0 - record.member;
      sums.expected[sumsOf(kLocalNoise, kLocalNoise)] += 2.0 * record.member;
    }
    for (int i = static_cast<int>(team_.rank()); i < kElongation;
         i += static_cast<int>(team_.size())) {
      sums.score[i] += record.powers[powerOf(i)] * record.score[localOf(i)];
    }
    observed_.add(record.observed, record.powers, sums.observed);
    expected_.add(record.expected, record.powers, sums.expected);
  }

  /// The matrix of information with that of the priors; the members may read it.
  FIELD_PHENOTYPING_HD void fill(const double* sums, const ParameterPrior& prior) const {
    team_.sync();
    if (team_.rank() == 0U) {
      forEachInformation([&](int i, int j, int sum) {
        scratch_.matrix[i * kCrossSectionSize + j] = sums[sum] + (i == j ? prior.weight[i] : 0.0);
      });
    }
    team_.sync();
  }

  /// @return whether it is a step
  FIELD_PHENOTYPING_HD bool newtonStep(const CrossSectionVector& at, const ParameterPrior& prior,
                                       CrossSectionVector& step) const {
    // Residual maximum likelihood: the shape was fitted to the same points as the noise.
    fill(scratch_.sums->expected, prior);
    if (!teamFactor(team_, scratch_.matrix, kCrossSectionSize)) return false;
    const double fitted = fittedParameters(team_, scratch_.matrix, prior, scratch_.vector);
    fill(scratch_.sums->observed, prior);
    if (!teamFactor(team_, scratch_.matrix, kCrossSectionSize)) {  // far from the solution
      fill(scratch_.sums->expected, prior);
      teamFactor(team_, scratch_.matrix, kCrossSectionSize);
    }
    if (team_.rank() == 0U) {
      for (int i = 0; i < kCrossSectionSize; ++i) {
        scratch_.vector[i] = scratch_.sums->score[i] + prior.scoreOf(at, i);
      }
      scratch_.vector[kNoise] += fitted;
    }
    team_.sync();
    teamSolve(team_, scratch_.matrix, kCrossSectionSize, scratch_.vector, scratch_.solution);
    for (int i = 0; i < kCrossSectionSize; ++i) step[i] = scratch_.solution[i];
    return isFinite(step);
  }

  const Team& team_;
  CrossSectionPoints points_;
  KnownOfStem known_;
  StemExtent extent_;
  StartScratch scratch_;
  InformationAdder<start::kLocals, Team> observed_;
  InformationAdder<kLocalShapeSize, Team> expected_;
};

/// A rough fit from the likelier of two starting points.
template <class Team>
FIELD_PHENOTYPING_HD CrossSectionStart roughFit(const Team& team, const CrossSectionPoints& points,
                                                const CrossSectionTask& task,
                                                const KnownOfStem& known,
                                                const StartScratch& scratch) {
  const CrossSectionSolver<Team> solver(team, points, known, task.extent, scratch);
  CrossSectionStart best{task.of_axis};
  const double value = solver.run(best);
  if (task.has_circle) {
    CrossSectionStart other{task.of_circle};
    if (!(solver.run(other) <= value)) best = other;
  }
  return best;
}

/// What is known of a stem of which a circle is to be fitted.
FIELD_PHENOTYPING_HD inline KnownOfStem ofCircle(KnownOfStem known) {
  known.ellipticity_stddev = 0.0;
  return known;
}

/// See cross_section_start.hpp. All members of the team get it.
template <class Team>
FIELD_PHENOTYPING_HD CrossSectionStart startCrossSection(const Team& team,
                                                         const CrossSectionPoints& points,
                                                         const CrossSectionTask& task,
                                                         const StartScratch& scratch) {
  if (task.has_near) return task.near;
  if (!task.shapeless) {
    const CrossSectionStart ellipse = roughFit(team, points, task, task.known, scratch);
    if (!start::isShapeless(ellipse.parameters)) return ellipse;
  }
  CrossSectionStart circle = roughFit(team, points, task, ofCircle(task.known), scratch);
  circle.shapeless = true;
  return circle;
}

}  // namespace field_phenotyping
