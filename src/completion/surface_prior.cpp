#include "field_phenotyping/completion/surface_prior.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <tuple>
#include <utility>

#include "field_phenotyping/completion/envelope_cholesky.hpp"

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

constexpr double kNodeSpacing = 0.01;  // [m] of the frame
constexpr double kMaxLength = 5.0;     // [m]
constexpr double kKnotSpacing = 0.06;  // [m] of the splines; doubled until they are few enough
constexpr int kMaxIntervals = 36;
constexpr std::size_t kFewestPoints = 4;
constexpr std::size_t kMaxFitPoints = 1500;
constexpr std::size_t kMaxScoredPoints = 250;
constexpr int kHypotheses = 128;
constexpr int kMaxIterations = 10;
constexpr double kConverged = 2e-5;  // [m] so that a few more points move little
constexpr double kTukey = 3.5;       // cuts off leaf bases; and at this value the inverse of
                                     // the normal matrix is the covariance of the fit
constexpr double kMadToSigma = 1.4826;
constexpr double kMinNoise = 2e-4;    // [m]
constexpr double kAngleWindow = 0.2;  // [m] along which a stem is seen from about the same sides
constexpr double kTwoPi = 6.28318530717958647692;

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
constexpr double kMaxNoiseRatio = 0.6;  // noise over radius: beyond it the fit drifts outwards
constexpr double kMinInlierShare = 0.4;

double quantile(std::vector<double> values, double share) {
  const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)];
}

/// Tukey's biweight of a residual in standard deviations.
double tukeyWeight(double residual) {
  const double u = residual / kTukey;
  return std::abs(u) < 1.0 ? (1.0 - u * u) * (1.0 - u * u) : 0.0;
}

/// What noise in x and y does to the distance and the angle of points of a circle as seen from its
/// centre, with the weights of the fit: all in standard deviations of the noise. Of order sigma /
/// R, but where half of the circumference is hidden nothing else tells a shift from a smaller
/// radius.
struct NoiseEffect {
  double radius_bias = 0.0;      ///< mean distance beyond the circle
  double shift_bias = 0.0;       ///< the same, weighted by the cosine of the angle's error
  double ellipse_bias = 0.0;     ///< the same, by the cosine of twice that
  double median_residual = 1.0;  ///< median of |distance beyond the circle - radius_bias|

  /// @param ratio radius over noise; what is beyond the table is taken as its end
  static NoiseEffect at(double ratio) {
    static const std::array<NoiseEffect, kSteps + 1> kTable = makeTable();
    const double place = std::clamp(kSteps * kLeastRatio / std::max(ratio, kLeastRatio), 0.0,
                                    static_cast<double>(kSteps));
    const auto low = std::min(static_cast<std::size_t>(place), kSteps - 1U);
    const double share = place - static_cast<double>(low);
    const NoiseEffect& a = kTable[low];
    const NoiseEffect& b = kTable[low + 1U];
    const auto mix = [&](double x, double y) { return x + share * (y - x); };
    return {mix(a.radius_bias, b.radius_bias), mix(a.shift_bias, b.shift_bias),
            mix(a.ellipse_bias, b.ellipse_bias), mix(a.median_residual, b.median_residual)};
  }

 private:
  static constexpr std::size_t kSteps = 32;  // of noise over radius, from 0
  static constexpr double kLeastRatio = 1.25;

  static std::array<NoiseEffect, kSteps + 1> makeTable() {
    std::array<NoiseEffect, kSteps + 1> table;
    for (std::size_t k = 0; k < table.size(); ++k) {
      table[k] = integrate(static_cast<double>(k) / kSteps / kLeastRatio);
    }
    return table;
  }

  /// Sums over a grid of noise. @param noise over the radius
  static NoiseEffect integrate(double noise) {
    constexpr int kHalf = 40;
    constexpr double kReach = 5.0;  // standard deviations
    struct Sample {
      double beyond, cosine, probability;
    };
    std::vector<Sample> samples;
    double total = 0.0;
    for (int i = -kHalf; i <= kHalf; ++i) {
      for (int j = 0; j <= kHalf; ++j) {
        const double x = kReach * i / kHalf;
        const double y = kReach * j / kHalf;
        const double along = 1.0 + noise * x;
        const double distance = std::hypot(along, noise * y);
        const double beyond = noise > 0.0 ? (distance - 1.0) / noise : x;
        const double probability = (j == 0 ? 0.5 : 1.0) * std::exp(-0.5 * (x * x + y * y));
        samples.push_back({beyond, along / std::max(distance, 1e-12), probability});
        total += probability;
      }
    }
    NoiseEffect effect;
    constexpr int kIterations = 20;
    for (int iteration = 0; iteration < kIterations; ++iteration) {
      std::array<double, 3> sums{};
      std::array<double, 3> weights{};
      for (const Sample& sample : samples) {
        const double weight = sample.probability * tukeyWeight(sample.beyond - effect.radius_bias);
        const std::array<double, 3> factor{1.0, sample.cosine,
                                           2.0 * sample.cosine * sample.cosine - 1.0};
        for (std::size_t k = 0; k < 3; ++k) {
          sums[k] += weight * factor[k] * sample.beyond;
          weights[k] += weight * factor[k];
        }
      }
      effect.radius_bias = sums[0] / weights[0];
      effect.shift_bias = sums[1] / weights[1];
      effect.ellipse_bias = sums[2] / weights[2];
    }
    for (Sample& sample : samples) sample.beyond = std::abs(sample.beyond - effect.radius_bias);
    std::sort(samples.begin(), samples.end(),
              [](const Sample& a, const Sample& b) { return a.beyond < b.beyond; });
    double below = 0.0;
    for (const Sample& sample : samples) {
      below += sample.probability;
      effect.median_residual = sample.beyond;
      if (below >= 0.5 * total) break;
    }
    return effect;
  }
};

/// The four uniform cubic B-splines that are not 0 in one interval.
std::array<double, 4> cubicBasis(double t) {
  const double t2 = t * t;
  const double t3 = t2 * t;
  return {(1.0 - 3.0 * t + 3.0 * t2 - t3) / 6.0, (4.0 - 6.0 * t2 + 3.0 * t3) / 6.0,
          (1.0 + 3.0 * t + 3.0 * t2 - 3.0 * t3) / 6.0, t3 / 6.0};
}

/// One row of the design: the radius at a place as a linear function of the coefficients. Shift u,
/// shift v and radius of four control points, then the ellipse.
constexpr std::size_t kDesignSize = 14;
using DesignRow = std::array<double, kDesignSize>;

/// A place of the unrolled stem, as the splines see it.
struct Place {
  int interval = 0;
  std::array<double, 4> basis{};
  double cosine = 1.0;  // of theta
  double sine = 0.0;

  double cosineOfTwice() const { return cosine * cosine - sine * sine; }
  double sineOfTwice() const { return 2.0 * cosine * sine; }
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

  Place place(double theta, double s) const {
    const auto [interval, basis] = splines(s);
    return {interval, basis, std::cos(theta), std::sin(theta)};
  }

  /// @param mean_radius R(s) [m], which the ellipse is relative to
  static DesignRow row(const Place& place, double mean_radius) {
    DesignRow row;
    std::size_t k = 0;
    for (const double b : place.basis) {
      row[k++] = b * place.cosine;
      row[k++] = b * place.sine;
      row[k++] = b;
    }
    row[k++] = mean_radius * place.cosineOfTwice();
    row[k] = mean_radius * place.sineOfTwice();
    return row;
  }

  /// Which coefficient a number of the design row belongs to.
  Eigen::Index column(int interval, std::size_t k) const {
    constexpr std::size_t kOfSplines = kDesignSize - 2U;
    const auto index = static_cast<Eigen::Index>(k);
    return k < kOfSplines ? 3 * interval + index : ellipse(static_cast<int>(k - kOfSplines));
  }

  double evaluate(const Eigen::VectorXd& coefficients, Eigen::Index offset, double s) const {
    const auto [first, basis] = splines(s);
    return evaluate(coefficients, offset, first, basis);
  }

  static double evaluate(const Eigen::VectorXd& coefficients, Eigen::Index offset, int interval,
                         const std::array<double, 4>& basis) {
    double value = 0.0;
    for (int i = 0; i < 4; ++i) {
      value += basis[static_cast<std::size_t>(i)] * coefficients[3 * (interval + i) + offset];
    }
    return value;
  }

  static double meanRadius(const Eigen::VectorXd& coefficients, const Place& place) {
    return evaluate(coefficients, 2, place.interval, place.basis);
  }

  /// Radius of the surface: the shifts of the axis are 0 once it has been moved.
  double surfaceRadius(const Eigen::VectorXd& coefficients, const Place& place) const {
    return meanRadius(coefficients, place) *
           (1.0 + coefficients[ellipse(0)] * place.cosineOfTwice() +
            coefficients[ellipse(1)] * place.sineOfTwice());
  }
};

/// Normal equations, built row by row; the lower triangle is kept.
class NormalEquations {
 public:
  using Matrix = EnvelopeCholesky::RowMatrix;

  explicit NormalEquations(const Layout& layout)
      : layout_(layout),
        matrix_(Matrix::Zero(layout.size(), layout.size())),
        right_side_(Matrix::Zero(layout.size(), 1)),
        blocks_(static_cast<std::size_t>(layout.intervals)) {}

  /// Adds weight * (sum_k factor_k x_column_k - target)^2; columns ascend.
  template <std::size_t N>
  void add(const std::array<Eigen::Index, N>& column, const std::array<double, N>& factor,
           double target, double weight) {
    for (std::size_t a = 0; a < N; ++a) {
      right_side_(column[a], 0) += weight * factor[a] * target;
      for (std::size_t b = 0; b <= a; ++b) {
        matrix_(column[a], column[b]) += weight * factor[a] * factor[b];
      }
    }
  }

  /// The same for a design row in an interval, with a target of its own for each coefficient.
  void add(int interval, const DesignRow& row, const DesignRow& target, double weight) {
    Block& block = blocks_[static_cast<std::size_t>(interval)];
    for (std::size_t a = 0; a < kDesignSize; ++a) {
      const double factor = weight * row[a];
      block.right_side[a] += factor * target[a];
      for (std::size_t b = 0; b < kDesignSize; ++b) block.matrix[a][b] += factor * row[b];
    }
  }

  /// Brings what was added by intervals into the whole; before matrix() and rightSide().
  void assemble() {
    for (int interval = 0; interval < layout_.intervals; ++interval) {
      const Block& block = blocks_[static_cast<std::size_t>(interval)];
      for (std::size_t a = 0; a < kDesignSize; ++a) {
        const Eigen::Index row = layout_.column(interval, a);
        right_side_(row, 0) += block.right_side[a];
        for (std::size_t b = 0; b <= a; ++b) {
          matrix_(row, layout_.column(interval, b)) += block.matrix[a][b];
        }
      }
    }
  }

  const Matrix& matrix() const { return matrix_; }
  const Matrix& rightSide() const { return right_side_; }

  /// Rows of splines reach to the first of their interval, those of the ellipse all the way.
  static bool decompose(const Matrix& matrix, EnvelopeCholesky& solver) {
    return solver.compute(matrix, static_cast<Eigen::Index>(kDesignSize) - 3, 2);
  }

 private:
  /// Of one interval, in the order of the design row.
  struct Block {
    std::array<DesignRow, kDesignSize> matrix{};
    DesignRow right_side{};
  };

  const Layout& layout_;
  Matrix matrix_;
  Matrix right_side_;
  std::vector<Block> blocks_;
};

/// Variance of the radius at a place from the covariance of the coefficients, which is symmetric.
double quadraticForm(const Layout& layout, int interval, const DesignRow& row,
                     const NormalEquations::Matrix& covariance) {
  double form = 0.0;
  for (std::size_t a = 0; a < kDesignSize; ++a) {
    const Eigen::Index i = layout.column(interval, a);
    double sum = 0.5 * row[a] * covariance(i, i);
    for (std::size_t b = 0; b < a; ++b) sum += row[b] * covariance(i, layout.column(interval, b));
    form += 2.0 * row[a] * sum;
  }
  return form;
}

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

/// Bits that scatter with a point's coordinates.
std::uint64_t hashOf(const Vector3d& point) {
  std::uint64_t hash = 0U;
  for (int axis = 0; axis < 3; ++axis) {
    std::uint64_t bits = 0U;
    std::memcpy(&bits, &point[axis], sizeof(bits));
    hash = (hash ^ bits) * 0x9E3779B97F4A7C15U;
    hash ^= hash >> 29U;
  }
  return hash >> 8U;
}

}  // namespace

/// The steps of SurfacePrior::fit().
class SurfacePriorFitter {
 public:
  SurfacePriorFitter(const std::vector<Vector3d>& points, const StemAxis& axis) : axis_(axis) {
    // Which points are left out depends on each alone, and how many on their number in steps: a few
    // more points leave the fit about as it was.
    std::uint64_t of_16 = 16U;
    while (of_16 > 1U && of_16 * points.size() > 16U * kMaxFitPoints) --of_16;
    while (of_16 == 1U && points.size() > 16U * stride_ * kMaxFitPoints) stride_ *= 2U;
    for (const Vector3d& point : points) {
      const std::uint64_t hash = hashOf(point);
      if (hash % 16U < of_16 && hash / 16U % stride_ == 0U) points_.push_back(point);
    }
    if (points_.size() < kFewestPoints) points_ = points;
  }

  std::optional<SurfacePrior> run(double extend) {
    if (!layOutCurve(extend)) return std::nullopt;
    fitConeByRansac();
    if (!iterate(kMaxIterations)) return std::nullopt;
    // Residuals understate the noise by the freedom that the fit has used up.
    inflation_ = noiseInflation();
    if (!iterate(1)) return std::nullopt;
    return finish();
  }

 private:
  bool iterate(int most) {
    for (int iteration = 0; iteration < most; ++iteration) {
      if (!solve()) return false;
      if (moveAxis() < kConverged) break;
    }
    return true;
  }

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
    // Knots lie at fixed places of the axis, so that points added at its end leave the others.
    spacing_ = kKnotSpacing;
    while (high - low + extend > (kMaxIntervals - 2) * spacing_) spacing_ *= 2.0;
    low = spacing_ * std::floor((low - std::max(extend, kNodeSpacing)) / spacing_);
    high = spacing_ * std::ceil((high + kNodeSpacing) / spacing_);
    given_begin_ = low;
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
        std::clamp(static_cast<int>(std::lround(frame_.length() / spacing_)), 1, kMaxIntervals);
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
    if (!isPossibleRadius(low, givenRadius(0.0)) || !isPossibleRadius(high, givenRadius(length))) {
      return std::nullopt;
    }
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
    placePoints();
    std::vector<double> residuals, distances;
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      residuals.push_back(residualOf(i));
      distances.push_back(std::abs(residuals.back()));
    }
    const double mean_radius = layout_.evaluate(coefficients_, 2, 0.5 * frame_.length());
    noise_ = std::max(kMinNoise, std::sqrt(inflation_) * quantile(distances, 0.5) /
                                     NoiseEffect::at(mean_radius / noise_).median_residual);

    NormalEquations equations(layout_);
    addShapePrior(equations);
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      const double weight = tukeyWeight(residuals[i] / noise_);
      if (weight > 0.0) addPoint(i, weight / (noise_ * noise_), equations);
    }
    equations.assemble();
    normal_matrix_ = equations.matrix();
    if (!NormalEquations::decompose(normal_matrix_, solver_)) return false;
    NormalEquations::Matrix solution = equations.rightSide();
    solver_.solveInPlace(solution);
    coefficients_ = solution.col(0);
    return coefficients_.allFinite();
  }

  /// Noise moves a point outwards on average, and its angle at the same time: each row's target
  /// has a bias of its own.
  void addPoint(std::size_t i, double weight, NormalEquations& equations) const {
    const double r = unrolled_[i].r;
    const double radius = Layout::meanRadius(coefficients_, places_[i]);
    const NoiseEffect effect = NoiseEffect::at(radius / noise_);
    const double shift = r - noise_ * effect.shift_bias;
    const double mean = r - noise_ * effect.radius_bias;
    const double ellipse = r - noise_ * effect.ellipse_bias;
    const DesignRow target{shift, shift, mean,  shift, shift, mean,    shift,
                           shift, mean,  shift, shift, mean,  ellipse, ellipse};
    equations.add(places_[i].interval, Layout::row(places_[i], radius), target, weight);
  }

  void placePoints() {
    places_.clear();
    for (const UnrolledPoint& p : unrolled_) places_.push_back(layout_.place(p.theta, p.s));
  }

  /// How far a point lies beyond the surface, noise bias taken off [m].
  double residualOf(std::size_t i) const {
    const double radius = Layout::meanRadius(coefficients_, places_[i]);
    return unrolled_[i].r - layout_.surfaceRadius(coefficients_, places_[i]) -
           noise_ * NoiseEffect::at(radius / noise_).radius_bias;
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
    for (int k = 0; k < 2; ++k) {
      equations.add<1>({layout_.ellipse(k)}, {1.0}, 0.0, 1.0 / (kEllipticity * kEllipticity));
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

  double noiseInflation() {
    placePoints();
    NormalEquations::Matrix inverse =
        NormalEquations::Matrix::Identity(layout_.size(), layout_.size());
    solver_.solveInPlace(inverse);
    double inliers = 0.0;
    double used_freedom = 0.0;
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      const double weight = tukeyWeight(residualOf(i) / noise_);
      if (!(weight > 0.0)) continue;
      const double mean_radius = Layout::meanRadius(coefficients_, places_[i]);
      inliers += weight;
      used_freedom += weight *
                      quadraticForm(layout_, places_[i].interval,
                                    Layout::row(places_[i], mean_radius), inverse) /
                      (noise_ * noise_);
    }
    return inliers / std::max(inliers - used_freedom, 1.0);
  }

  /// Of the coefficients. Noise spreads the angles of the points, so that their normal matrix
  /// believes in more of the circumference than was seen: the information is that of the angles
  /// before the noise, while the score varies as the points do.
  NormalEquations::Matrix covariance() const {
    NormalEquations information(layout_);
    addShapePrior(information);
    const std::vector<double> angles = anglesBeforeNoise();
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      const double weight = tukeyWeight(residualOf(i) / noise_);
      if (!(weight > 0.0)) continue;
      Place place = places_[i];
      place.cosine = std::cos(angles[i]);
      place.sine = std::sin(angles[i]);
      information.add(place.interval, Layout::row(place, Layout::meanRadius(coefficients_, place)),
                      {}, weight / (noise_ * noise_));
    }
    information.assemble();
    NormalEquations::Matrix half = normal_matrix_;
    half.triangularView<Eigen::StrictlyUpper>() = normal_matrix_.transpose();
    EnvelopeCholesky solver;
    if (!NormalEquations::decompose(information.matrix(), solver)) {
      half.setIdentity();
      solver_.solveInPlace(half);
      return half;
    }
    solver.solveInPlace(half);
    half.transposeInPlace();
    solver.solveInPlace(half);
    return half;
  }

  /// How much more the sum of the residuals of neighbouring points varies than if each had one of
  /// its own: about 1 for noise. What is no cylinder departs from one with its neighbours, and many
  /// points say little more than one of them; those that are left out count, too, for where there
  /// are such the fit has less to go by than it believes. At least 1.
  double clustering() const {
    constexpr double kLength = 0.06;  // [m] of a cluster
    constexpr std::size_t kAround = 6U;
    constexpr double kOfNoise = 0.7;  // what noise alone gives, for the fit follows it
    std::vector<double> sums(kAround * (1U + static_cast<std::size_t>(frame_.length() / kLength)));
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      const UnrolledPoint& p = unrolled_[i];
      const double turn = std::clamp(p.theta / kTwoPi + 0.5, 0.0, 1.0);
      const auto row = static_cast<std::size_t>(std::clamp(p.s, 0.0, frame_.length()) / kLength);
      const auto column = static_cast<std::size_t>(turn * static_cast<double>(kAround));
      const double most = Layout::meanRadius(coefficients_, places_[i]);
      sums[kAround * row + std::min(column, kAround - 1U)] +=
          std::clamp(residualOf(i), -most, most);
    }
    double squares = 0.0;
    for (const double sum : sums) squares += sum * sum;
    const double alone = kOfNoise * static_cast<double>(unrolled_.size()) * noise_ * noise_;
    return std::max(squares / alone, 1.0);
  }

  /// The angles of the points, drawn together round their mean in each window along the stem by as
  /// much as noise has spread them.
  std::vector<double> anglesBeforeNoise() const {
    struct Window {
      double cosine = 0.0, sine = 0.0, squares = 0.0, noise = 0.0, count = 0.0;
      double mean() const { return std::atan2(sine, cosine); }
    };
    const auto windowOf = [&](const UnrolledPoint& p) {
      return static_cast<std::size_t>(std::clamp(p.s, 0.0, frame_.length()) / kAngleWindow);
    };
    const auto offset = [](const UnrolledPoint& p, const Window& window) {
      return std::remainder(p.theta - window.mean(), kTwoPi);
    };
    std::vector<Window> windows(1U + static_cast<std::size_t>(frame_.length() / kAngleWindow));
    for (const UnrolledPoint& p : unrolled_) {
      Window& window = windows[windowOf(p)];
      window.cosine += std::cos(p.theta);
      window.sine += std::sin(p.theta);
      window.noise +=
          std::pow(noise_ / std::max(layout_.evaluate(coefficients_, 2, p.s), noise_), 2);
      window.count += 1.0;
    }
    for (const UnrolledPoint& p : unrolled_) {
      Window& window = windows[windowOf(p)];
      window.squares += std::pow(offset(p, window), 2);
    }
    std::vector<double> angles;
    for (const UnrolledPoint& p : unrolled_) {
      const Window& window = windows[windowOf(p)];
      const double left = 1.0 - window.noise / std::max(window.squares, 1e-9);
      angles.push_back(window.mean() + std::sqrt(std::max(left, 0.0)) * offset(p, window));
    }
    return angles;
  }

  std::optional<SurfacePrior> finish() {
    placePoints();
    SurfacePrior prior(frame_, layout_.intervals);
    prior.coefficients_ = coefficients_;
    prior.covariance_ = covariance();
    prior.clustering_ = clustering();
    prior.noise_ = noise_;
    prior.begin_ = given_begin_;
    double inliers = 0.0;
    for (std::size_t i = 0; i < unrolled_.size(); ++i) {
      inliers += tukeyWeight(residualOf(i) / noise_);
    }
    if (inliers < kMinInlierShare * static_cast<double>(unrolled_.size())) return std::nullopt;

    double sum = 0.0;
    for (const StemFrame::Frame& node : frame_.nodes()) {
      const double r = layout_.evaluate(coefficients_, 2, node.s);
      if (!isPossibleRadius(r, givenRadius(node.s))) return std::nullopt;
      sum += r;
    }
    prior.mean_radius_ = sum / static_cast<double>(frame_.nodes().size());
    if (noise_ > kMaxNoiseRatio * prior.mean_radius_) return std::nullopt;
    return prior;
  }

  /// Of the stem as segmented, at an arc length of the frame; a stem tapers.
  double givenRadius(double s) const {
    const double r = static_cast<double>(axis_.radiusAt(static_cast<float>(given_begin_ + s)));
    return r > 0.0 ? r : given_radius_;
  }

  /// False for NaN too.
  static bool isPossibleRadius(double r, double given) {
    return r > kMinRadiusRatio * given && r < kMaxRadiusRatio * given;
  }

  const StemAxis& axis_;
  std::vector<Vector3d> points_;
  std::uint64_t stride_ = 1U;
  double given_radius_ = 0.0;      // median over the points [m]
  double spacing_ = kKnotSpacing;  // of the knots [m]
  double given_begin_ = 0.0;       // arc length on the segmented axis where the frame begins [m]
  std::vector<Vector3d> given_curve_;
  std::vector<Vector3d> curve_;
  StemFrame frame_{{Vector3d::Zero(), Vector3d::UnitZ()}};
  Layout layout_;
  std::vector<UnrolledPoint> unrolled_;
  Eigen::VectorXd coefficients_;
  double noise_ = kMinNoise;
  double inflation_ = 1.0;     // of its square
  std::vector<Place> places_;  // of unrolled_
  NormalEquations::Matrix normal_matrix_;
  EnvelopeCholesky solver_;
};

SurfacePrior::SurfacePrior(StemFrame frame, int intervals)
    : frame_(std::move(frame)),
      intervals_(intervals),
      interval_length_(frame_.length() / intervals) {}

std::optional<SurfacePrior> SurfacePrior::fit(const std::vector<Vector3d>& points,
                                              const StemAxis& axis, double extend) {
  if (points.size() < kFewestPoints || axis.empty()) return std::nullopt;
  return SurfacePriorFitter(points, axis).run(extend);
}

double SurfacePrior::radius(double theta, double s) const {
  const Layout layout{intervals_, interval_length_};
  return layout.surfaceRadius(coefficients_, layout.place(theta, s));
}

double SurfacePrior::meanRadiusAt(double s) const {
  return Layout{intervals_, interval_length_}.evaluate(coefficients_, 2, s);
}

std::array<double, 2> SurfacePrior::ellipse() const {
  const Eigen::Index first = Layout{intervals_, interval_length_}.ellipse(0);
  return {coefficients_[first], coefficients_[first + 1]};
}

double SurfacePrior::noiseBias(double s) const {
  const double radius = Layout{intervals_, interval_length_}.evaluate(coefficients_, 2, s);
  return noise_ * NoiseEffect::at(radius / noise_).radius_bias;
}

SurfacePrior::Residual SurfacePrior::residual(const UnrolledPoint& point) const {
  const Layout layout{intervals_, interval_length_};
  const Place place = layout.place(point.theta, point.s);
  const double radius = Layout::meanRadius(coefficients_, place);
  const double bias = noise_ * NoiseEffect::at(radius / noise_).radius_bias;
  return {point.r - layout.surfaceRadius(coefficients_, place) - bias, bias};
}

double SurfacePrior::variance(double theta, double s) const {
  const Layout layout{intervals_, interval_length_};
  const Place place = layout.place(theta, s);
  return quadraticForm(layout, place.interval,
                       Layout::row(place, Layout::meanRadius(coefficients_, place)), covariance_);
}

double SurfacePrior::misfitVariance(double theta, double s) const {
  return clustering_ > 1.0 ? (clustering_ - 1.0) * variance(theta, s) : 0.0;
}

double SurfacePrior::robustWeight(double residual) const {
  return tukeyWeight(residual / noise_);
}

}  // namespace field_phenotyping
