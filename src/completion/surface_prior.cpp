#include "field_phenotyping/completion/surface_prior.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <tuple>
#include <utility>

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

constexpr double kNodeSpacing = 0.01;  // [m] of the frame
constexpr double kMaxLength = 5.0;     // [m]
constexpr double kKnotSpacing = 0.05;  // [m] of the splines
constexpr int kMaxIntervals = 30;
constexpr std::size_t kMaxFitPoints = 1500;
constexpr std::size_t kMaxScoredPoints = 250;
constexpr int kHypotheses = 128;
constexpr int kMaxIterations = 8;
constexpr double kConverged = 1e-4;  // [m]
constexpr double kTukey = 3.5;       // cuts off leaf bases; and at this value the inverse of
                                     // the normal matrix is the covariance of the fit
constexpr double kMadToSigma = 1.4826;
constexpr double kMinNoise = 2e-4;  // [m]

// How stems are shaped, as standard deviations. The first two are rates of random walks in slope
// along the stem: a lean that wanders by 6 degrees and a taper that changes by 5 mm/m over 1 m.
constexpr double kBending = 0.11;       // [1/sqrt(m)]
constexpr double kTaperChange = 0.005;  // [1/sqrt(m)]
constexpr double kAxisError = 0.01;     // [m] of the axis as segmented
constexpr double kRadiusError = 0.3;    // share of the radius as segmented
constexpr double kEllipticity = 0.05;   // amplitude of cos 2 theta, share of the radius

// What still passes as a stem.
constexpr double kMinRadiusRatio = 0.4;  // of the radius as segmented
constexpr double kMaxRadiusRatio = 2.5;
constexpr double kMaxNoiseRatio = 0.7;  // noise over radius
constexpr double kMinInlierShare = 0.4;

double quantile(std::vector<double> values, double share) {
  const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)];
}

/// The four uniform cubic B-splines that are not 0 in one interval.
std::array<double, 4> cubicBasis(double t) {
  const double t2 = t * t;
  const double t3 = t2 * t;
  return {(1.0 - 3.0 * t + 3.0 * t2 - t3) / 6.0, (4.0 - 6.0 * t2 + 3.0 * t3) / 6.0,
          (1.0 + 3.0 * t + 3.0 * t2 - 3.0 * t3) / 6.0, t3 / 6.0};
}

/// One row of the design: the radius at (theta, s) as a linear function of the coefficients. Shift
/// u, shift v and radius of four control points, then the ellipse.
struct DesignRow {
  static constexpr int kSize = 14;
  std::array<Eigen::Index, kSize> column{};
  std::array<double, kSize> factor{};
};

/// Where the coefficients of the splines are found: (shift u, shift v, radius) of each control
/// point, then the two of the ellipse.
struct Layout {
  int intervals = 1;
  double interval_length = kKnotSpacing;

  int controls() const { return intervals + 3; }
  Eigen::Index size() const { return 3 * controls() + 2; }
  Eigen::Index shiftU(int control) const { return 3 * control; }
  Eigen::Index shiftV(int control) const { return 3 * control + 1; }
  Eigen::Index radius(int control) const { return 3 * control + 2; }
  Eigen::Index ellipse(int k) const { return 3 * controls() + k; }

  /// Interval of `s` and the splines' values there.
  std::pair<int, std::array<double, 4>> splines(double s) const {
    const double place = std::clamp(s / interval_length, 0.0, static_cast<double>(intervals));
    const int interval = std::min(static_cast<int>(place), intervals - 1);
    return {interval, cubicBasis(place - interval)};
  }

  DesignRow row(double theta, double s) const {
    DesignRow row;
    const auto [first, basis] = splines(s);
    const double cosine = std::cos(theta);
    const double sine = std::sin(theta);
    std::size_t k = 0;
    for (int i = 0; i < 4; ++i) {
      const double b = basis[static_cast<std::size_t>(i)];
      row.column[k] = shiftU(first + i);
      row.factor[k++] = b * cosine;
      row.column[k] = shiftV(first + i);
      row.factor[k++] = b * sine;
      row.column[k] = radius(first + i);
      row.factor[k++] = b;
    }
    row.column[k] = ellipse(0);
    row.factor[k++] = cosine * cosine - sine * sine;
    row.column[k] = ellipse(1);
    row.factor[k] = 2.0 * cosine * sine;
    return row;
  }

  double evaluate(const Eigen::VectorXd& coefficients, Eigen::Index offset, double s) const {
    const auto [first, basis] = splines(s);
    double value = 0.0;
    for (int i = 0; i < 4; ++i) {
      value += basis[static_cast<std::size_t>(i)] * coefficients[3 * (first + i) + offset];
    }
    return value;
  }
};

double dot(const DesignRow& row, const Eigen::VectorXd& coefficients) {
  double value = 0.0;
  for (std::size_t k = 0; k < DesignRow::kSize; ++k) {
    value += row.factor[k] * coefficients[row.column[k]];
  }
  return value;
}

/// Normal equations, built row by row; the lower triangle is kept.
struct NormalEquations {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd right_side;

  explicit NormalEquations(Eigen::Index size)
      : matrix(Eigen::MatrixXd::Zero(size, size)), right_side(Eigen::VectorXd::Zero(size)) {}

  /// Adds weight * (sum_k factor_k x_column_k - target)^2.
  template <std::size_t N>
  void add(const std::array<Eigen::Index, N>& column, const std::array<double, N>& factor,
           double target, double weight) {
    std::array<double, N> targets;
    targets.fill(target);
    add(column, factor, targets, weight);
  }

  /// The same with a target of its own for each row.
  template <std::size_t N>
  void add(const std::array<Eigen::Index, N>& column, const std::array<double, N>& factor,
           const std::array<double, N>& target, double weight) {
    for (std::size_t a = 0; a < N; ++a) {
      right_side[column[a]] += weight * factor[a] * target[a];
      for (std::size_t b = 0; b < N; ++b) {
        if (column[b] <= column[a]) matrix(column[a], column[b]) += weight * factor[a] * factor[b];
      }
    }
  }
};

/// Evens out the corners of a polyline; the ends stay.
std::vector<Vector3d> smoothed(const std::vector<Vector3d>& curve) {
  constexpr std::size_t kHalfWindow = 4;
  std::vector<Vector3d> result(curve.size());
  for (std::size_t i = 0; i < curve.size(); ++i) {
    const std::size_t half = std::min({kHalfWindow, i, curve.size() - 1 - i});
    Vector3d sum = Vector3d::Zero();
    for (std::size_t k = i - half; k <= i + half; ++k) sum += curve[k];
    result[i] = sum / static_cast<double>(2 * half + 1);
  }
  return result;
}

/// A point in the plane across the axis.
struct AcrossPoint {
  Eigen::Vector2d xy;
  double s;
};

/// A straight correction of the axis and a linear taper: centre and radius at s.
struct Cone {
  Eigen::Vector2d center = Eigen::Vector2d::Zero(), center_slope = Eigen::Vector2d::Zero();
  double radius = 0.0, radius_slope = 0.0;

  double residual(const AcrossPoint& p) const {
    return (p.xy - center - p.s * center_slope).norm() - radius - p.s * radius_slope;
  }
};

}  // namespace

/// The steps of SurfacePrior::fit().
class SurfacePriorFitter {
 public:
  SurfacePriorFitter(const std::vector<Vector3d>& points, const StemAxis& axis) : axis_(axis) {
    const std::size_t stride = 1 + (points.size() - 1) / kMaxFitPoints;
    for (std::size_t i = 0; i < points.size(); i += stride) points_.push_back(points[i]);
  }

  std::optional<SurfacePrior> run(double extend) {
    if (!layOutCurve(extend)) return std::nullopt;
    fitConeByRansac();
    for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
      if (!solve()) return std::nullopt;
      if (moveAxis() < kConverged) break;
    }
    return finish();
  }

 private:
  /// The axis as segmented, resampled over the range of the points.
  bool layOutCurve(double extend) {
    double low = std::numeric_limits<double>::max();
    double high = std::numeric_limits<double>::lowest();
    std::vector<double> radii;
    for (const Vector3d& point : points_) {
      const StemAxis::Projection p = axis_.project(point.cast<float>());
      low = std::min<double>(low, p.arc_length);
      high = std::max<double>(high, p.arc_length);
      radii.push_back(p.radius);
    }
    if (!(high - low < kMaxLength)) return false;
    given_radius_ = quantile(radii, 0.5);
    low -= std::max(extend, kNodeSpacing);
    high += kNodeSpacing;
    const auto steps = static_cast<int>(std::ceil((high - low) / kNodeSpacing));
    for (int i = 0; i <= steps; ++i) {
      const double s = low + (high - low) * i / steps;
      curve_.push_back(axis_.pointAt(static_cast<float>(s)).cast<double>());
    }
    curve_ = smoothed(curve_);
    given_curve_ = curve_;
    unroll();
    if (!(given_radius_ > 0.0)) {
      std::vector<double> distances;
      for (const UnrolledPoint& p : unrolled_) distances.push_back(p.r);
      given_radius_ = quantile(distances, 0.5);
    }
    return given_radius_ > 0.0;
  }

  void unroll() {
    frame_ = StemFrame(curve_);
    layout_.intervals =
        std::clamp(static_cast<int>(std::lround(frame_.length() / kKnotSpacing)), 1, kMaxIntervals);
    layout_.interval_length = frame_.length() / layout_.intervals;
    unrolled_.clear();
    for (const Vector3d& point : points_) unrolled_.push_back(frame_.unroll(point));
  }

  /// Least median of squares over hypotheses through six points each, three from either half of the
  /// stem: needs no noise level and stands up to nearly half the points being leaf.
  void fitConeByRansac() {
    std::vector<AcrossPoint> sorted;
    for (const UnrolledPoint& p : unrolled_) {
      sorted.push_back({{p.r * std::cos(p.theta), p.r * std::sin(p.theta)}, p.s});
    }
    std::sort(sorted.begin(), sorted.end(), [](const AcrossPoint& a, const AcrossPoint& b) {
      return std::make_tuple(a.s, a.xy.x(), a.xy.y()) < std::make_tuple(b.s, b.xy.x(), b.xy.y());
    });
    const std::size_t stride = 1 + (sorted.size() - 1) / kMaxScoredPoints;
    std::vector<AcrossPoint> scored;
    for (std::size_t i = 0; i < sorted.size(); i += stride) scored.push_back(sorted[i]);

    Cone best;
    best.radius = given_radius_;
    double best_score = score(best, scored, std::numeric_limits<double>::max());
    std::mt19937 random(1);  // NOLINT: the same hypotheses for every stem and every run
    for (int i = 0; i < kHypotheses; ++i) {
      const std::optional<Cone> cone = coneThrough(drawSample(sorted, random));
      if (!cone) continue;
      const double cone_score = score(*cone, scored, best_score);
      if (cone_score >= best_score) continue;
      best = *cone;
      best_score = cone_score;
    }
    const double freedom = std::max(1.0, static_cast<double>(scored.size()) - 6.0);
    noise_ = std::max(kMinNoise, kMadToSigma * (1.0 + 5.0 / freedom) * best_score);
    startFrom(best);
  }

  static std::array<AcrossPoint, 6> drawSample(const std::vector<AcrossPoint>& sorted,
                                               std::mt19937& random) {
    const std::size_t half = sorted.size() / 2;
    std::array<AcrossPoint, 6> sample;
    for (std::size_t k = 0; k < sample.size(); ++k) {
      sample[k] =
          k < 3 ? sorted[random() % half] : sorted[half + random() % (sorted.size() - half)];
    }
    return sample;
  }

  /// x^2 + y^2 = 2 c.(x, y) + (R^2 - c^2), with c and the last term linear in s.
  std::optional<Cone> coneThrough(const std::array<AcrossPoint, 6>& sample) const {
    Eigen::Matrix<double, 6, 6> design;
    Eigen::Matrix<double, 6, 1> squares;
    for (int k = 0; k < 6; ++k) {
      const AcrossPoint& p = sample[static_cast<std::size_t>(k)];
      const Eigen::Vector2d twice = 2.0 * p.xy;
      design.row(k) << twice.x(), twice.y(), 1.0, p.s * twice.x(), p.s * twice.y(), p.s;
      squares[k] = p.xy.squaredNorm();
    }
    const Eigen::Matrix<double, 6, 1> x = design.partialPivLu().solve(squares);
    if (!x.allFinite()) return std::nullopt;
    const auto radiusAt = [&](double s) {
      return std::sqrt(x[2] + s * x[5] + (x.segment<2>(0) + s * x.segment<2>(3)).squaredNorm());
    };
    const double length = frame_.length();
    const double low = radiusAt(0.0);
    const double high = radiusAt(length);
    if (!isPossibleRadius(low) || !isPossibleRadius(high)) return std::nullopt;
    Cone cone;
    cone.center = x.segment<2>(0);
    cone.center_slope = x.segment<2>(3);
    cone.radius = low;
    cone.radius_slope = (high - low) / length;
    const double reach = kMaxRadiusRatio * given_radius_ + kAxisError;
    if (cone.center.norm() > reach || (cone.center + length * cone.center_slope).norm() > reach) {
      return std::nullopt;
    }
    return cone;
  }

  /// Median distance of the points; stops early once it cannot be below `limit`.
  static double score(const Cone& cone, const std::vector<AcrossPoint>& points, double limit) {
    std::vector<double> distances;
    distances.reserve(points.size());
    std::size_t beyond = 0;
    for (const AcrossPoint& p : points) {
      distances.push_back(std::abs(cone.residual(p)));
      if (distances.back() > limit && 2 * ++beyond > points.size() + 1) return limit;
    }
    return quantile(std::move(distances), 0.5);
  }

  void startFrom(const Cone& cone) {
    for (std::size_t i = 0; i < curve_.size(); ++i) {
      const StemFrame::Frame& node = frame_.nodes()[i];
      const Eigen::Vector2d shift = cone.center + node.s * cone.center_slope;
      curve_[i] += shift.x() * node.u + shift.y() * node.v;
    }
    unroll();
    coefficients_ = Eigen::VectorXd::Zero(layout_.size());
    for (int k = 0; k < layout_.controls(); ++k) {
      coefficients_[layout_.radius(k)] =
          cone.radius + cone.radius_slope * (k - 1) * layout_.interval_length;
    }
  }

  /// One re-weighted least-squares step: all coefficients, the axis shifts relative to the current
  /// axis. False when the equations cannot be solved.
  bool solve() {
    std::vector<double> residuals, distances;
    for (const UnrolledPoint& p : unrolled_) {
      residuals.push_back(p.r - radiusAt(p));
      distances.push_back(std::abs(residuals.back()));
    }
    noise_ = std::max(kMinNoise, kMadToSigma * quantile(distances, 0.5));

    NormalEquations equations(layout_.size());
    addShapePrior(equations);
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      addPoint(unrolled_[i], tukey(residuals[i], noise_) / (noise_ * noise_), equations);
    }
    solver_.compute(equations.matrix);
    if (solver_.info() != Eigen::Success) return false;
    coefficients_ = solver_.solve(equations.right_side);
    return coefficients_.allFinite();
  }

  /// Noise moves a point outwards by sigma^2 / 2R on average, and its angle at the same time, so
  /// that the rows of cos k theta see a bias that differs from k to k at order sigma^4 / R^3.
  /// Small, but where half the circumference is hidden nothing else tells a shift from a smaller
  /// radius.
  void addPoint(const UnrolledPoint& p, double weight, NormalEquations& equations) const {
    const double radius = std::max(layout_.evaluate(coefficients_, 2, p.s), noise_);
    const double square = noise_ * noise_ / (radius * radius);
    const double bias = 0.5 * square * radius;
    const double fourth = square * square * radius;
    const double shift = p.r - bias - 0.5 * fourth;
    const double mean = p.r - bias - 0.125 * fourth;
    const double ellipse = p.r - bias - 2.0 * fourth;
    const std::array<double, DesignRow::kSize> target{shift, shift, mean,    shift,  shift,
                                                      mean,  shift, shift,   mean,   shift,
                                                      shift, mean,  ellipse, ellipse};
    const DesignRow row = layout_.row(p.theta, p.s);
    equations.add(row.column, row.factor, target, weight);
  }

  double radiusAt(const UnrolledPoint& p) const {
    return dot(layout_.row(p.theta, p.s), coefficients_) + noiseBias(p.s);
  }

  double noiseBias(double s) const {
    const double radius = std::max(layout_.evaluate(coefficients_, 2, s), noise_);
    return 0.5 * noise_ * noise_ / radius;
  }

  static double tukey(double residual, double noise) {
    const double u = residual / (kTukey * noise);
    return std::abs(u) < 1.0 ? (1.0 - u * u) * (1.0 - u * u) : 0.0;
  }

  /// Small second derivatives, weak ties to the axis and the radius as segmented.
  void addShapePrior(NormalEquations& equations) const {
    const double h = layout_.interval_length;
    const double bending_weight = h / (kBending * kBending);
    const double taper_weight = h / (kTaperChange * kTaperChange);
    const std::array<double, 3> second{1.0 / (h * h), -2.0 / (h * h), 1.0 / (h * h)};
    for (int knot = 0; knot <= layout_.intervals; ++knot) {
      const StemFrame::Frame here = frame_.at(knot * h);
      const Vector3d curvature = axisCurvature(knot);
      equations.add<3>({layout_.shiftU(knot), layout_.shiftU(knot + 1), layout_.shiftU(knot + 2)},
                       second, -curvature.dot(here.u), bending_weight);
      equations.add<3>({layout_.shiftV(knot), layout_.shiftV(knot + 1), layout_.shiftV(knot + 2)},
                       second, -curvature.dot(here.v), bending_weight);
      equations.add<3>({layout_.radius(knot), layout_.radius(knot + 1), layout_.radius(knot + 2)},
                       second, 0.0, taper_weight);
    }
    // Errors of the segmented stem are shared by all its nodes: as much weight as one has.
    const double share = 1.0 / layout_.controls();
    const double radius_error = kRadiusError * given_radius_;
    for (int k = 0; k < layout_.controls(); ++k) {
      const StemFrame::Frame here = frame_.at(std::clamp((k - 1) * h, 0.0, frame_.length()));
      const Vector3d back = givenPoint(here.s) - here.position;
      equations.add<1>({layout_.shiftU(k)}, {1.0}, back.dot(here.u),
                       share / (kAxisError * kAxisError));
      equations.add<1>({layout_.shiftV(k)}, {1.0}, back.dot(here.v),
                       share / (kAxisError * kAxisError));
      equations.add<1>({layout_.radius(k)}, {1.0}, given_radius_,
                       share / (radius_error * radius_error));
    }
    const double ellipticity = kEllipticity * given_radius_;
    for (int k = 0; k < 2; ++k) {
      equations.add<1>({layout_.ellipse(k)}, {1.0}, 0.0, 1.0 / (ellipticity * ellipticity));
    }
  }

  /// Second derivative of the current axis at a knot; at the ends that of the next knot.
  Vector3d axisCurvature(int knot) const {
    if (layout_.intervals < 2) return Vector3d::Zero();
    const double h = layout_.interval_length;
    const double s = std::clamp(knot, 1, layout_.intervals - 1) * h;
    return (frame_.at(s - h).position - 2.0 * frame_.at(s).position + frame_.at(s + h).position) /
           (h * h);
  }

  /// The point of the segmented axis that has since moved to arc length `s`.
  Vector3d givenPoint(double s) const {
    const auto& nodes = frame_.nodes();
    const auto above =
        std::upper_bound(nodes.begin() + 1, nodes.end() - 1, s,
                         [](double value, const StemFrame::Frame& node) { return value < node.s; });
    const auto i = static_cast<std::size_t>(above - nodes.begin());
    const double share = (s - nodes[i - 1].s) / (nodes[i].s - nodes[i - 1].s);
    return (1.0 - share) * given_curve_[i - 1] + share * given_curve_[i];
  }

  /// Moves the axis by the solved shifts; returns the longest of them [m].
  double moveAxis() {
    double longest = 0.0;
    for (std::size_t i = 0; i < curve_.size(); ++i) {
      const StemFrame::Frame& node = frame_.nodes()[i];
      const double du = layout_.evaluate(coefficients_, 0, node.s);
      const double dv = layout_.evaluate(coefficients_, 1, node.s);
      longest = std::max(longest, std::hypot(du, dv));
      curve_[i] += du * node.u + dv * node.v;
    }
    const int intervals = layout_.intervals;
    unroll();
    if (layout_.intervals != intervals) {
      layout_.intervals = intervals;
      layout_.interval_length = frame_.length() / intervals;
    }
    for (int k = 0; k < layout_.controls(); ++k) {
      coefficients_[layout_.shiftU(k)] = 0.0;
      coefficients_[layout_.shiftV(k)] = 0.0;
    }
    return longest;
  }

  std::optional<SurfacePrior> finish() {
    SurfacePrior prior(frame_, layout_.intervals);
    prior.coefficients_ = coefficients_;
    prior.covariance_ = solver_.solve(Eigen::MatrixXd::Identity(layout_.size(), layout_.size()));

    // Residuals understate the noise by the freedom that the fit has used up.
    double inliers = 0.0;
    double used_freedom = 0.0;
    for (const UnrolledPoint& p : unrolled_) {
      const double weight = tukey(p.r - radiusAt(p), noise_);
      inliers += weight;
      used_freedom += weight * prior.variance(p.theta, p.s) / (noise_ * noise_);
    }
    if (inliers < kMinInlierShare * static_cast<double>(unrolled_.size())) return std::nullopt;
    const double inflation = inliers / std::max(inliers - used_freedom, 1.0);
    prior.noise_ = noise_ * std::sqrt(inflation);
    prior.covariance_ *= inflation;

    double sum = 0.0;
    for (const StemFrame::Frame& node : frame_.nodes()) {
      const double r = layout_.evaluate(coefficients_, 2, node.s);
      if (!isPossibleRadius(r)) return std::nullopt;
      sum += r;
    }
    prior.mean_radius_ = sum / static_cast<double>(frame_.nodes().size());
    if (noise_ > kMaxNoiseRatio * prior.mean_radius_) return std::nullopt;
    return prior;
  }

  /// False for NaN too.
  bool isPossibleRadius(double r) const {
    return r > kMinRadiusRatio * given_radius_ && r < kMaxRadiusRatio * given_radius_;
  }

  const StemAxis& axis_;
  std::vector<Vector3d> points_;
  double given_radius_ = 0.0;
  std::vector<Vector3d> given_curve_;
  std::vector<Vector3d> curve_;
  StemFrame frame_{{Vector3d::Zero(), Vector3d::UnitZ()}};
  Layout layout_;
  std::vector<UnrolledPoint> unrolled_;
  Eigen::VectorXd coefficients_;
  double noise_ = kMinNoise;
  Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> solver_;
};

SurfacePrior::SurfacePrior(StemFrame frame, int intervals)
    : frame_(std::move(frame)),
      intervals_(intervals),
      interval_length_(frame_.length() / intervals) {}

std::optional<SurfacePrior> SurfacePrior::fit(const std::vector<Vector3d>& points,
                                              const StemAxis& axis, double extend) {
  constexpr std::size_t kFewestPoints = 4;
  if (points.size() < kFewestPoints || axis.empty()) return std::nullopt;
  return SurfacePriorFitter(points, axis).run(extend);
}

double SurfacePrior::radius(double theta, double s) const {
  return dot(Layout{intervals_, interval_length_}.row(theta, s), coefficients_);
}

double SurfacePrior::noiseBias(double s) const {
  const double radius = Layout{intervals_, interval_length_}.evaluate(coefficients_, 2, s);
  return 0.5 * noise_ * noise_ / std::max(radius, noise_);
}

double SurfacePrior::variance(double theta, double s) const {
  const DesignRow row = Layout{intervals_, interval_length_}.row(theta, s);
  double variance = 0.0;
  for (std::size_t a = 0; a < DesignRow::kSize; ++a) {
    for (std::size_t b = 0; b < DesignRow::kSize; ++b) {
      variance += row.factor[a] * row.factor[b] * covariance_(row.column[a], row.column[b]);
    }
  }
  return variance;
}

double SurfacePrior::robustWeight(double residual) const {
  const double u = residual / (kTukey * noise_);
  return std::abs(u) < 1.0 ? (1.0 - u * u) * (1.0 - u * u) : 0.0;
}

}  // namespace field_phenotyping
