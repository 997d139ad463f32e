#pragma once

#include <cstddef>
#include <cstdint>

#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/team_envelope.hpp"
#include "field_phenotyping/common/team_order.hpp"
#include "field_phenotyping/common/vector3.hpp"
#include "field_phenotyping/completion/curve_frame.hpp"
#include "field_phenotyping/completion/surface_prior_model.hpp"

// The fit of SurfacePrior, for a team of threads (see team.hpp), on the CPU and on the GPU. Every
// sum over the points is one member's, who adds them in their order: it has the same bits whatever
// the team.

namespace field_phenotyping {

/// What the coarse model of one stem is fitted to. All members of a team see the same memory.
struct SurfacePriorTask {
  const double* points = nullptr;        ///< x, y, z; x, y, z; ...
  const double* curve = nullptr;         ///< the axis as segmented, likewise, from below
  const NoiseEffect* effects = nullptr;  ///< the table
  const std::uint32_t* draws = nullptr;  ///< random numbers, kDraws
  int count = 0;                         ///< of the points, kFewestPoints or more
  int nodes = 0;                         ///< of the curve, two or more
  double spacing = 0.0;                  ///< of the knots [m]
  double radius = 0.0;                   ///< as segmented [m]
  double first_radius = 0.0;             ///< the same at the curve's first node
  double last_radius = 0.0;              ///< and at its last
};

/// The rest of the fit is in arrays.
struct SurfacePriorFit {
  bool valid;  ///< false: the points do not lie on anything like a stem
  coarse::Layout layout;
  double noise;       ///< [m]
  double inliers;     ///< sum of the weights
  double clustering;  ///< of the residuals, see SurfacePrior
};

namespace coarse {

constexpr int kFewestPoints = 4;
constexpr int kMostScored = 250;
constexpr int kHypotheses = 128;
constexpr int kSample = 6;
constexpr int kDraws = kHypotheses * kSample;
constexpr int kMaxIterations = 10;
constexpr double kConverged = 2e-5;   // [m] so that a few more points move little
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

/// False for NaN too.
FIELD_PHENOTYPING_HD inline bool isPossibleRadius(double r, double given) {
  return r > kMinRadiusRatio * given && r < kMaxRadiusRatio * given;
}

FIELD_PHENOTYPING_HD inline bool isFinite(double value) {
  return value - value == 0.0;
}

constexpr int kBand = kDesignSize - 3;  // rows of splines reach to the first of their interval

/// Sums over the points of one interval, in the order of the design row: the lower triangle by
/// pairOf(), then the right side.
constexpr int kBlockPairs = pairOf(kDesignSize, 0);
constexpr int kBlockSize = kBlockPairs + kDesignSize;

/// A point on the unrolled stem.
struct OnStem {
  Direction around;
  double s;
  double r;
};

/// A point in the plane across the axis.
struct AcrossPoint {
  double x;
  double y;
  double s;
};

/// A straight correction of the axis and a linear taper: centre and radius at s.
struct Cone {
  double x, y, x_slope, y_slope, radius, radius_slope;

  FIELD_PHENOTYPING_HD double residual(const AcrossPoint& p) const {
    return lengthOf(p.x - x - p.s * x_slope, p.y - y - p.s * y_slope) - radius - p.s * radius_slope;
  }
};

/// A cone of RANSAC with what it is judged by.
struct Candidate {
  double score;
  int number;  // of the hypothesis
  Cone cone;
};

/// What a point adds to the sums of its interval.
struct Record {
  double row[kDesignSize];
  double target[3];  // of shifts, radius and ellipse
  double weight;
  int interval;  // below 0: nothing
};

/// Points in a stretch of the stem that is seen from about the same sides.
struct Window {
  double cosine, sine, squares, noise;
};

/// Points that are worked on before their sums are added.
FIELD_PHENOTYPING_HD constexpr int recordsOf(int members) {
  constexpr int kMost = 64;  // so that shared memory of 64 KiB is enough
  return members < kMost ? members : kMost;
}

/// What the members use again and again: on the GPU, shared memory.
struct NearMemory {
  double* matrix;  // an Envelope: the normal matrix, then its factor
  double* right;
  double* coefficients;
  double* blocks;         // kBlockSize for each interval
  Direction* bends;       // u and v of the axis' second derivative at each knot
  Direction* ties;        // how far the segmented axis is off at each control point
  double* results;        // what one member tells all
  Record* records;        // recordsOf(members)
  Candidate* candidates;  // one for each member, in the records' place
  int* counts;            // likewise
};
constexpr int kResults = 2;
constexpr int kMatrixSize = Envelope::valuesOf(kMostCoefficients, kBand, kEllipseSize);
constexpr std::size_t nearSize(int members) {
  const std::size_t of_records = static_cast<std::size_t>(recordsOf(members)) * sizeof(Record);
  const std::size_t of_candidates = static_cast<std::size_t>(members) * sizeof(Candidate);
  return kMatrixSize + 2 * kMostCoefficients + kBlockSize * kMostIntervals +
         2 * (kMostIntervals + 1) + 2 * (kMostIntervals + 3) + kResults +
         (of_records > of_candidates ? of_records : of_candidates) / sizeof(double);
}
FIELD_PHENOTYPING_HD inline NearMemory nearMemoryAt(double* at) {
  NearMemory m;
  m.matrix = takeFrom(at, kMatrixSize);
  m.right = takeFrom(at, kMostCoefficients);
  m.coefficients = takeFrom(at, kMostCoefficients);
  m.blocks = takeFrom(at, kBlockSize * kMostIntervals);
  m.bends = reinterpret_cast<Direction*>(takeFrom(at, 2 * (kMostIntervals + 1)));
  m.ties = reinterpret_cast<Direction*>(takeFrom(at, 2 * (kMostIntervals + 3)));
  m.results = takeFrom(at, kResults);
  m.records = reinterpret_cast<Record*>(at);
  m.candidates = reinterpret_cast<Candidate*>(at);
  m.counts = reinterpret_cast<int*>(at);
  return m;
}

/// The rest.
struct FarMemory {
  CurveFrame<Vector3>* frames;  // of the nodes
  double* shifts;               // how far each node moves
  OnStem* on_stem;
  SplinePlace* places;
  double* residuals;
  double* values;  // of each point, for a while
  double* angles;
  double* normal;   // the last step's matrix, as an Envelope
  double* scratch;  // what is needed for a while, the most of it for matrices and RANSAC
};
constexpr int kFrameSize = static_cast<int>(sizeof(CurveFrame<Vector3>) / sizeof(double));
constexpr int kOnStemSize = static_cast<int>(sizeof(OnStem) / sizeof(double));
constexpr int kPlaceSize = static_cast<int>(sizeof(SplinePlace) / sizeof(double));
constexpr int kAcrossSize = static_cast<int>(sizeof(AcrossPoint) / sizeof(double));
FIELD_PHENOTYPING_HD constexpr int pointSize() {
  return kOnStemSize + kPlaceSize + 3;
}
/// @param members of the team
constexpr std::size_t farSize(int points, int nodes, int members) {
  const auto n = static_cast<std::size_t>(points);
  constexpr std::size_t kOfMatrices =
      static_cast<std::size_t>(kMostCoefficients) * kMostCoefficients;
  const std::size_t of_ransac =
      2U * kAcrossSize * n + static_cast<std::size_t>(members + kAcrossSize) * kMostScored;
  return static_cast<std::size_t>(nodes) * (kFrameSize + 1U) +
         n * static_cast<std::size_t>(pointSize()) + kMatrixSize +
         (of_ransac > kOfMatrices ? of_ransac : kOfMatrices);
}
FIELD_PHENOTYPING_HD inline FarMemory farMemoryAt(double* at, int points, int nodes) {
  FarMemory m;
  m.frames = reinterpret_cast<CurveFrame<Vector3>*>(takeFrom(at, nodes * kFrameSize));
  m.shifts = takeFrom(at, nodes);
  m.on_stem = reinterpret_cast<OnStem*>(takeFrom(at, points * kOnStemSize));
  m.places = reinterpret_cast<SplinePlace*>(takeFrom(at, points * kPlaceSize));
  m.residuals = takeFrom(at, points);
  m.values = takeFrom(at, points);
  m.angles = takeFrom(at, points);
  m.normal = takeFrom(at, kMatrixSize);
  m.scratch = at;
  return m;
}

/// Adds a point to the sums of its interval, by one thread: the loops are unrolled.
template <int kRow = 0>
FIELD_PHENOTYPING_HD inline void addRows(const Record& record, double* block) {
  if constexpr (kRow < kDesignSize) {
    const double factor = record.weight * record.row[kRow];
    for (int b = 0; b <= kRow; ++b) block[pairOf(kRow, b)] += factor * record.row[b];
    constexpr int kTarget = kRow >= kSplineSize ? 2 : kRow % 3 == 2 ? 1 : 0;
    block[kBlockPairs + kRow] += factor * record.target[kTarget];
    addRows<kRow + 1>(record, block);
  }
}

/// Adds records to one of the sums of their intervals.
/// @param element of a block
FIELD_PHENOTYPING_HD inline void addElement(const Record* records, int count, int element,
                                            double* blocks) {
  int a = element - kBlockPairs;
  int b = 0;
  if (a < 0) {
    a = 0;
    while (pairOf(a + 1, 0) <= element) ++a;
    b = element - pairOf(a, 0);
  }
  const int target = a >= kSplineSize ? 2 : a % 3 == 2 ? 1 : 0;
  for (int i = 0; i < count; ++i) {
    const Record& record = records[i];
    if (record.interval < 0) continue;
    const double with = element < kBlockPairs ? record.row[b] : record.target[target];
    blocks[record.interval * kBlockSize + element] += record.weight * record.row[a] * with;
  }
}

}  // namespace coarse

/// The steps of SurfacePrior::fit(). All members of the team make one, call everything, and have
/// the same values.
template <class Team>
class SurfacePriorFitter {
 public:
  /// @param curve of the fitted axis: 3 numbers for each node
  /// @param coefficients, covariance of the fit: kMostCoefficients, and its square
  /// @param near, far nearSize() and farSize() numbers
  FIELD_PHENOTYPING_HD SurfacePriorFitter(const Team& team, const SurfacePriorTask& task,
                                          double* curve, double* coefficients, double* covariance,
                                          double* near, double* far)
      : team_(team),
        task_(task),
        curve_(reinterpret_cast<Vector3*>(curve)),
        out_coefficients_(coefficients),
        covariance_(covariance),
        near_(coarse::nearMemoryAt(near)),
        far_(coarse::farMemoryAt(far, task.count, task.nodes)) {}

  FIELD_PHENOTYPING_HD SurfacePriorFit run() {
    forNodes([&](int i) { curve_[i] = pointAt(task_.curve, i); });
    team_.sync();
    if (!unroll()) return failed();
    fitConeByRansac();
    if (!unroll()) return failed();
    startRadius();
    if (!iterate(coarse::kMaxIterations)) return failed();
    // Residuals understate the noise by the freedom that the fit has used up.
    inflation_ = noiseInflation();
    if (!iterate(1)) return failed();
    return finish();
  }

 private:
  using Layout = coarse::Layout;
  using Place = coarse::Place;

  FIELD_PHENOTYPING_HD int rank() const { return static_cast<int>(team_.rank()); }
  FIELD_PHENOTYPING_HD int size() const { return static_cast<int>(team_.size()); }
  /// visit(i) for those of 0 ... count - 1 that are this member's.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forOwn(int count, const Visit& visit) const {
    for (int i = rank(); i < count; i += size()) visit(i);
  }
  template <class Visit>
  FIELD_PHENOTYPING_HD void forPoints(const Visit& visit) const {
    forOwn(task_.count, visit);
  }
  template <class Visit>
  FIELD_PHENOTYPING_HD void forNodes(const Visit& visit) const {
    forOwn(task_.nodes, visit);
  }
  /// visit(row, column) for those elements of a matrix over the coefficients that are this
  /// member's.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forMatrix(const Visit& visit) const {
    const int n = layout_.size();
    const int groups = static_cast<int>(team_.groups());
    const int lanes = size() / groups;
    const int group = static_cast<int>(team_.group());
    for (int i = group; i < n; i += groups) {
      for (int j = rank() - group * lanes; j < n; j += lanes) visit(i, j);
    }
  }
  FIELD_PHENOTYPING_HD static Vector3 pointAt(const double* points, int i) {
    return {points[3 * i], points[3 * i + 1], points[3 * i + 2]};
  }
  /// What one member finds out, told to all.
  template <class Find>
  FIELD_PHENOTYPING_HD double byOne(const Find& find) const {
    if (rank() == 0) near_.results[0] = find();
    team_.sync();
    const double result = near_.results[0];
    team_.sync();
    return result;
  }
  FIELD_PHENOTYPING_HD double sumInOrder(const double* values) const {
    return byOne([&] {
      double sum = 0.0;
      for (int i = 0; i < task_.count; ++i) sum += values[i];
      return sum;
    });
  }

  FIELD_PHENOTYPING_HD SurfacePriorFit failed() const { return {false, layout_, noise_, 0.0, 1.0}; }

  FIELD_PHENOTYPING_HD double length() const { return far_.frames[task_.nodes - 1].s; }
  FIELD_PHENOTYPING_HD CurveFrame<Vector3> frameOf(double s) const {
    return frameAt(far_.frames, task_.nodes, s);
  }
  FIELD_PHENOTYPING_HD NoiseEffect effectAt(double radius) const {
    return NoiseEffect::at(task_.effects, radius / noise_);
  }
  FIELD_PHENOTYPING_HD Envelope matrix() const {
    return {near_.matrix, layout_.size(), coarse::kBand, coarse::kEllipseSize};
  }
  FIELD_PHENOTYPING_HD Place placeOf(int i) const {
    return {far_.places[i], far_.on_stem[i].around};
  }

  /// Frames of the curve, which all members have written, and the points round it. False where two
  /// of its nodes are in one place.
  FIELD_PHENOTYPING_HD bool unroll() {
    forNodes([&](int i) { placeNode(curve_, task_.nodes, i, far_.frames[i]); });
    team_.sync();
    const double is_curve = byOne([&] {
      for (int i = 1; i < task_.nodes; ++i) {
        if (!(far_.frames[i].s > 0.0)) return 0.0;
      }
      startFrame(far_.frames[0]);
      for (int i = 1; i < task_.nodes; ++i) carryOn(far_.frames[i - 1], far_.frames[i]);
      return 1.0;
    });
    if (!(is_curve > 0.0)) return false;
    const double intervals = std::floor(length() / task_.spacing + 0.5);
    constexpr double kMost = coarse::kMostIntervals;
    layout_.intervals = static_cast<int>(smallerOf(largerOf(intervals, 1.0), kMost));
    layout_.interval_length = length() / layout_.intervals;
    forPoints([&](int i) {
      const BesideCurve<Vector3> beside =
          besideCurve(far_.frames, task_.nodes, pointAt(task_.points, i));
      const double x = beside.cosine();
      const double y = beside.sine();
      const double wide = lengthOf(x, y);
      const Direction around = wide > 0.0 ? Direction{x / wide, y / wide} : Direction{1.0, 0.0};
      far_.on_stem[i] = {around, beside.s, beside.r};
    });
    team_.sync();
    return true;
  }

  /// Least median of squares over hypotheses through six points each, three from either half of the
  /// stem: needs no noise level and stands up to nearly half the points being leaf. Moves the
  /// curve.
  FIELD_PHENOTYPING_HD void fitConeByRansac() {
    using coarse::AcrossPoint;
    using coarse::Candidate;
    const int count = task_.count;
    auto* across = reinterpret_cast<AcrossPoint*>(far_.scratch);
    forPoints([&](int i) {
      const coarse::OnStem& p = far_.on_stem[i];
      across[i] = {p.r * p.around.x, p.r * p.around.y, p.s};
    });
    team_.sync();
    const AcrossPoint* sorted = teamSort(
        team_, across, across + count, count, [](const AcrossPoint& a, const AcrossPoint& b) {
          return a.s != b.s ? a.s < b.s : a.x != b.x ? a.x < b.x : a.y < b.y;
        });
    const int stride = 1 + (count - 1) / coarse::kMostScored;
    const int scored_count = (count + stride - 1) / stride;
    AcrossPoint* scored = across + 2 * count;
    forOwn(scored_count, [&](int i) { scored[i] = sorted[i * stride]; });
    team_.sync();

    double* distances = reinterpret_cast<double*>(scored + coarse::kMostScored) +
                        static_cast<std::ptrdiff_t>(rank()) * coarse::kMostScored;
    constexpr double kNone = 1e300;
    Candidate best{kNone, -1, {0.0, 0.0, 0.0, 0.0, task_.radius, 0.0}};
    if (rank() == 0) best.score = scoreOf(best.cone, scored, scored_count, kNone, distances);
    forOwn(coarse::kHypotheses, [&](int number) {
      AcrossPoint sample[coarse::kSample];
      const int half = count / 2;
      for (int k = 0; k < coarse::kSample; ++k) {
        const std::uint32_t draw = task_.draws[number * coarse::kSample + k];
        const int begin = 2 * k < coarse::kSample ? 0 : half;
        const int of = begin == 0 ? half : count - half;
        sample[k] = sorted[begin + static_cast<int>(draw % static_cast<std::uint32_t>(of))];
      }
      Candidate next{kNone, number, {}};
      if (!coneThrough(sample, next.cone)) return;
      next.score = scoreOf(next.cone, scored, scored_count, best.score, distances);
      if (next.score < best.score) best = next;
    });
    near_.candidates[rank()] = best;
    team_.sync();
    for (int k = 0; k < size(); ++k) {
      const Candidate& other = near_.candidates[k];
      if (other.score < best.score || (other.score == best.score && other.number < best.number)) {
        best = other;
      }
    }
    team_.sync();
    cone_ = best.cone;
    const double freedom = largerOf(1.0, scored_count - 6.0);
    noise_ = largerOf(coarse::kMinNoise, kMadToSigma * (1.0 + 5.0 / freedom) * best.score);
    forNodes([&](int i) {
      const CurveFrame<Vector3>& node = far_.frames[i];
      curve_[i] +=
          (cone_.x + node.s * cone_.x_slope) * node.u + (cone_.y + node.s * cone_.y_slope) * node.v;
    });
    team_.sync();
  }

  /// x^2 + y^2 = 2 c.(x, y) + (R^2 - c^2), with c and the last term linear in s.
  FIELD_PHENOTYPING_HD bool coneThrough(const coarse::AcrossPoint* sample,
                                        coarse::Cone& cone) const {
    constexpr int n = coarse::kSample;
    double m[n][n + 1];  // the right side behind the matrix
    for (int k = 0; k < n; ++k) {
      const coarse::AcrossPoint& p = sample[k];
      const double row[n + 1] = {
          2.0 * p.x, 2.0 * p.y, 1.0, p.s * 2.0 * p.x, p.s * 2.0 * p.y, p.s, p.x * p.x + p.y * p.y};
      for (int j = 0; j <= n; ++j) m[k][j] = row[j];
    }
    for (int k = 0; k < n; ++k) {
      int largest = k;
      for (int i = k + 1; i < n; ++i) {
        if (magnitudeOf(m[i][k]) > magnitudeOf(m[largest][k])) largest = i;
      }
      for (int j = k; j <= n; ++j) {
        const double value = m[k][j];
        m[k][j] = m[largest][j];
        m[largest][j] = value;
      }
      for (int i = k + 1; i < n; ++i) {
        const double factor = m[i][k] / m[k][k];
        for (int j = k + 1; j <= n; ++j) m[i][j] -= factor * m[k][j];
      }
    }
    double x[n];
    for (int k = n - 1; k >= 0; --k) {
      double value = m[k][n];
      for (int j = k + 1; j < n; ++j) value -= m[k][j] * x[j];
      x[k] = value / m[k][k];
      if (!coarse::isFinite(x[k])) return false;
    }
    const auto squareAt = [&](double s) {  // of the centre's distance
      const double along = x[0] + s * x[3];
      const double across = x[1] + s * x[4];
      return along * along + across * across;
    };
    const auto radiusAt = [&](double s) { return std::sqrt(x[2] + s * x[5] + squareAt(s)); };
    const double low = radiusAt(0.0);
    const double high = radiusAt(length());
    if (!coarse::isPossibleRadius(low, task_.first_radius) ||
        !coarse::isPossibleRadius(high, task_.last_radius)) {
      return false;
    }
    const double reach = coarse::kMaxRadiusRatio * task_.radius + coarse::kAxisError;
    if (squareAt(0.0) > reach * reach || squareAt(length()) > reach * reach) return false;
    cone = {x[0], x[1], x[3], x[4], low, (high - low) / length()};
    return true;
  }

  /// Median distance of the points; `limit` once it cannot be below that. By one member alone.
  FIELD_PHENOTYPING_HD static double scoreOf(const coarse::Cone& cone,
                                             const coarse::AcrossPoint* points, int count,
                                             double limit, double* distances) {
    int beyond = 0;
    for (int i = 0; i < count; ++i) {
      distances[i] = magnitudeOf(cone.residual(points[i]));
      if (distances[i] > limit && 2 * ++beyond > count + 1) return limit;
    }
    return selectAlone(distances, count, (count - 1) / 2);
  }

  FIELD_PHENOTYPING_HD void startRadius() {
    forOwn(layout_.size(), [&](int i) { near_.coefficients[i] = 0.0; });
    team_.sync();
    forOwn(layout_.controls(), [&](int k) {
      near_.coefficients[3 * k + 2] =
          cone_.radius + cone_.radius_slope * (k - 1) * layout_.interval_length;
    });
    team_.sync();
  }

  FIELD_PHENOTYPING_HD bool iterate(int most) {
    for (int iteration = 0; iteration < most; ++iteration) {
      if (!solve()) return false;
      const double moved = moveAxis();
      if (moved < 0.0) return false;
      if (moved < coarse::kConverged) break;
    }
    return true;
  }

  FIELD_PHENOTYPING_HD void placePoints() const {
    forPoints([&](int i) { far_.places[i] = layout_.splines(far_.on_stem[i].s); });
  }

  /// How far a point lies beyond the surface, noise bias taken off [m].
  FIELD_PHENOTYPING_HD double residualOf(int i) const {
    const double radius = coarse::meanRadius(near_.coefficients, far_.places[i]);
    return far_.on_stem[i].r - coarse::surfaceRadius(layout_, near_.coefficients, placeOf(i)) -
           noise_ * effectAt(radius).radius_bias;
  }

  /// One re-weighted least-squares step: all coefficients, the axis shifts relative to the current
  /// axis. False when the equations cannot be solved.
  FIELD_PHENOTYPING_HD bool solve() {
    placePoints();
    forPoints([&](int i) {
      far_.residuals[i] = residualOf(i);
      far_.values[i] = magnitudeOf(far_.residuals[i]);
    });
    team_.sync();
    const double median =
        teamSelect(team_, far_.values, task_.count, (task_.count - 1) / 2, near_.counts);
    const double mean_radius =
        coarse::meanRadius(near_.coefficients, layout_.splines(0.5 * length()));
    noise_ = largerOf(coarse::kMinNoise,
                      std::sqrt(inflation_) * median / effectAt(mean_radius).median_residual);
    fillEquations([&](int i, coarse::Record& record) { describe(i, record); });
    const int values = Envelope::valuesOf(layout_.size(), coarse::kBand, coarse::kEllipseSize);
    forOwn(values, [&](int i) { far_.normal[i] = near_.matrix[i]; });
    team_.sync();
    if (!teamFactor(team_, matrix())) return false;
    teamSolve(team_, matrix(), near_.right, 1);
    team_.sync();
    bool is_finite = true;
    for (int i = 0; i < layout_.size(); ++i) is_finite &= coarse::isFinite(near_.right[i]);
    forOwn(layout_.size(), [&](int i) { near_.coefficients[i] = near_.right[i]; });
    team_.sync();
    return is_finite;
  }

  /// What a point adds to the normal equations. Noise moves it outwards on average, and its angle
  /// at the same time: each row's target has a bias of its own.
  FIELD_PHENOTYPING_HD void describe(int i, coarse::Record& record) const {
    const double weight = tukeyWeight(far_.residuals[i] / noise_);
    record.interval = weight > 0.0 ? far_.places[i].interval : -1;
    if (record.interval < 0) return;
    record.weight = weight / (noise_ * noise_);
    const double radius = coarse::meanRadius(near_.coefficients, far_.places[i]);
    const NoiseEffect effect = effectAt(radius);
    const double r = far_.on_stem[i].r;
    record.target[0] = r - noise_ * effect.shift_bias;
    record.target[1] = r - noise_ * effect.radius_bias;
    record.target[2] = r - noise_ * effect.ellipse_bias;
    coarse::fillDesignRow(placeOf(i), radius, record.row);
  }

  /// Normal equations of the points, of which each makes a record, and of how stems are shaped.
  /// All members may read them afterwards.
  template <class Describe>
  FIELD_PHENOTYPING_HD void fillEquations(const Describe& describePoint) const {
    forOwn(layout_.intervals * coarse::kBlockSize, [&](int i) { near_.blocks[i] = 0.0; });
    describeShape();
    team_.sync();
    const int at_once = coarse::recordsOf(size());
    for (int begin = 0; begin < task_.count; begin += at_once) {
      const int count = task_.count - begin < at_once ? task_.count - begin : at_once;
      forOwn(count, [&](int i) { describePoint(begin + i, near_.records[i]); });
      team_.sync();
      if constexpr (Team::kAlone) {
        const coarse::Record& record = near_.records[0];
        if (record.interval >= 0) {
          coarse::addRows(record, near_.blocks + record.interval * coarse::kBlockSize);
        }
      } else {
        forOwn(coarse::kBlockSize,
               [&](int e) { coarse::addElement(near_.records, count, e, near_.blocks); });
      }
      team_.sync();
    }
    forOwn(layout_.size(), [&](int row) { assembleRow(row); });
    team_.sync();
  }

  /// Second derivatives of the axis, and how far it is off the one as segmented, in its frame.
  FIELD_PHENOTYPING_HD void describeShape() const {
    const double h = layout_.interval_length;
    forOwn(layout_.intervals + 1, [&](int knot) {
      const CurveFrame<Vector3> here = frameOf(knot * h);
      const Vector3 curvature = axisCurvature(knot);
      near_.bends[knot] = {curvature.dot(here.u), curvature.dot(here.v)};
    });
    forOwn(layout_.controls(), [&](int k) {
      const CurveFrame<Vector3> here = frameOf(smallerOf(largerOf((k - 1) * h, 0.0), length()));
      const Vector3 back = givenPoint(here.s) - here.position;
      near_.ties[k] = {back.dot(here.u), back.dot(here.v)};
    });
  }

  /// Second derivative of the current axis at a knot; at the ends that of the next knot.
  FIELD_PHENOTYPING_HD Vector3 axisCurvature(int knot) const {
    if (layout_.intervals < 2) return {0.0, 0.0, 0.0};
    const double h = layout_.interval_length;
    const int inner = knot < 1 ? 1 : knot > layout_.intervals - 1 ? layout_.intervals - 1 : knot;
    const double s = inner * h;
    return (frameOf(s - h).position - 2.0 * frameOf(s).position + frameOf(s + h).position) /
           (h * h);
  }

  /// The point of the segmented axis that has since moved to arc length `s`.
  FIELD_PHENOTYPING_HD Vector3 givenPoint(double s) const {
    const int i = nodeBefore(far_.frames, task_.nodes, s);
    const double low = far_.frames[i].s;
    const double share = (s - low) / (far_.frames[i + 1].s - low);
    return (1.0 - share) * pointAt(task_.curve, i) + share * pointAt(task_.curve, i + 1);
  }

  /// One row of the normal equations: small second derivatives, weak ties to the axis and the
  /// radius as segmented, and the sums over the points of all intervals that it takes part in.
  FIELD_PHENOTYPING_HD void assembleRow(int row) const {
    const double h = layout_.interval_length;
    // Errors of the segmented stem are shared by all its nodes: as much weight as one has.
    const double share = 1.0 / layout_.controls();
    const double radius_error = coarse::kRadiusError * task_.radius;
    const bool is_ellipse = row >= 3 * layout_.controls();
    const int kind = is_ellipse ? -1 : row % 3;
    const double bending = kind == 2 ? h / (coarse::kTaperChange * coarse::kTaperChange)
                                     : h / (coarse::kBending * coarse::kBending);
    const double tie = is_ellipse  ? 1.0 / (coarse::kEllipticity * coarse::kEllipticity)
                       : kind == 2 ? share / (radius_error * radius_error)
                                   : share / (coarse::kAxisError * coarse::kAxisError);
    const double second[3] = {1.0 / (h * h), -2.0 / (h * h), 1.0 / (h * h)};
    // A control point takes part in three second derivatives and in four intervals.
    const int control = row / 3;
    const int first_knot = control > 2 ? control - 2 : 0;
    const int first_interval = is_ellipse || control < 3 ? 0 : control - 3;
    const int number = is_ellipse ? coarse::kSplineSize + row - 3 * layout_.controls() : row;

    const Envelope to = matrix();
    double* values = to.row(row);
    for (int column = to.first(row); column <= row; ++column) {
      const bool with_ellipse = column >= 3 * layout_.controls();
      const int other = column / 3;
      double sum = 0.0;
      if (!is_ellipse && column % 3 == kind) {
        const int last = other < layout_.intervals ? other : layout_.intervals;
        for (int knot = first_knot; knot <= last; ++knot) {
          sum += bending * second[control - knot] * second[other - knot];
        }
      }
      if (column == row) sum += tie;
      const int last = with_ellipse || other >= layout_.intervals ? layout_.intervals - 1 : other;
      const int from = with_ellipse || other < 3 ? 0 : other - 3;
      for (int k = from > first_interval ? from : first_interval; k <= last; ++k) {
        const int a = is_ellipse ? number : number - 3 * k;
        const int b =
            with_ellipse ? coarse::kSplineSize + column - 3 * layout_.controls() : column - 3 * k;
        sum += near_.blocks[k * coarse::kBlockSize + pairOf(a, b)];
      }
      values[column] = sum;
    }

    double right = 0.0;
    if (!is_ellipse) {
      const int last = control < layout_.intervals ? control : layout_.intervals;
      for (int knot = first_knot; kind < 2 && knot <= last; ++knot) {
        const double bend = kind == 0 ? near_.bends[knot].x : near_.bends[knot].y;
        right += bending * second[control - knot] * -bend;
      }
      right += tie * (kind == 0   ? near_.ties[control].x
                      : kind == 1 ? near_.ties[control].y
                                  : task_.radius);
    }
    const int last = is_ellipse || control >= layout_.intervals ? layout_.intervals - 1 : control;
    for (int k = first_interval; k <= last; ++k) {
      const int a = is_ellipse ? number : number - 3 * k;
      right += near_.blocks[k * coarse::kBlockSize + coarse::kBlockPairs + a];
    }
    near_.right[row] = right;
  }

  /// Moves the axis by the solved shifts; returns the longest of them [m], or below 0 when that is
  /// no curve any more.
  FIELD_PHENOTYPING_HD double moveAxis() {
    forNodes([&](int i) {
      const CurveFrame<Vector3>& node = far_.frames[i];
      const coarse::SplinePlace place = layout_.splines(node.s);
      const double du = coarse::splineValue(near_.coefficients, 0, place);
      const double dv = coarse::splineValue(near_.coefficients, 1, place);
      far_.shifts[i] = lengthOf(du, dv);
      curve_[i] += du * node.u + dv * node.v;
    });
    team_.sync();
    const double longest = byOne([&] {
      double most = 0.0;
      for (int i = 0; i < task_.nodes; ++i) most = largerOf(most, far_.shifts[i]);
      return most;
    });
    const int intervals = layout_.intervals;
    if (!unroll()) return -1.0;
    if (layout_.intervals != intervals) {
      layout_.intervals = intervals;
      layout_.interval_length = length() / intervals;
    }
    forOwn(layout_.controls(), [&](int k) {
      near_.coefficients[3 * k] = 0.0;
      near_.coefficients[3 * k + 1] = 0.0;
    });
    team_.sync();
    return longest;
  }

  FIELD_PHENOTYPING_HD void setIdentity(double* values) const {
    const int n = layout_.size();
    forMatrix([&](int i, int j) { values[i * n + j] = i == j ? 1.0 : 0.0; });
    team_.sync();
  }

  FIELD_PHENOTYPING_HD double noiseInflation() const {
    placePoints();
    setIdentity(far_.scratch);
    teamSolve(team_, matrix(), far_.scratch, layout_.size());
    team_.sync();
    forPoints([&](int i) {
      const double weight = tukeyWeight(residualOf(i) / noise_);
      far_.residuals[i] = weight;
      far_.values[i] =
          weight > 0.0
              ? weight * coarse::varianceAt(layout_, near_.coefficients, placeOf(i), far_.scratch) /
                    (noise_ * noise_)
              : 0.0;
    });
    team_.sync();
    const double inliers = sumInOrder(far_.residuals);
    const double used_freedom = sumInOrder(far_.values);
    return inliers / largerOf(inliers - used_freedom, 1.0);
  }

  FIELD_PHENOTYPING_HD SurfacePriorFit finish() {
    placePoints();
    forPoints([&](int i) {
      const Direction& around = far_.on_stem[i].around;
      far_.residuals[i] = residualOf(i);
      far_.values[i] = tukeyWeight(far_.residuals[i] / noise_);
      far_.angles[i] = angleOf(around.x, around.y);
    });
    team_.sync();
    const double inliers = sumInOrder(far_.values);
    const double clusters = clustering();
    drawAnglesTogether();
    findCovariance();
    forOwn(layout_.size(), [&](int i) { out_coefficients_[i] = near_.coefficients[i]; });
    team_.sync();
    return {true, layout_, noise_, inliers, clusters};
  }

  /// How much more the sum of the residuals of neighbouring points varies than if each had one of
  /// its own: about 1 for noise. What is no cylinder departs from one with its neighbours, and many
  /// points say little more than one of them; those that are left out count, too, for where there
  /// are such the fit has less to go by than it believes. At least 1.
  FIELD_PHENOTYPING_HD double clustering() const {
    constexpr double kLength = 0.06;  // [m] of a cluster
    constexpr int kAround = 6;
    constexpr double kOfNoise = 0.7;  // what noise alone gives, for the fit follows it
    double* sums = far_.scratch;
    const int cells = kAround * (1 + static_cast<int>(length() / kLength));
    forOwn(cells, [&](int i) { sums[i] = 0.0; });
    forPoints([&](int i) {
      const double most = coarse::meanRadius(near_.coefficients, far_.places[i]);
      far_.values[i] = smallerOf(largerOf(far_.residuals[i], -most), most);
    });
    team_.sync();
    const double squares = byOne([&] {
      for (int i = 0; i < task_.count; ++i) {
        const double turn = smallerOf(largerOf(far_.angles[i] / coarse::kTwoPi + 0.5, 0.0), 1.0);
        const int row = static_cast<int>(along(i) / kLength);
        const int column = static_cast<int>(turn * kAround);
        sums[kAround * row + (column < kAround ? column : kAround - 1)] += far_.values[i];
      }
      double sum = 0.0;
      for (int i = 0; i < cells; ++i) sum += sums[i] * sums[i];
      return sum;
    });
    const double alone = kOfNoise * task_.count * noise_ * noise_;
    return largerOf(squares / alone, 1.0);
  }

  /// Where along the stem a point is, but for what lies beyond its ends.
  FIELD_PHENOTYPING_HD double along(int i) const {
    return smallerOf(largerOf(far_.on_stem[i].s, 0.0), length());
  }

  /// Draws the angles of the points together round their mean in each window along the stem, by as
  /// much as noise has spread them.
  FIELD_PHENOTYPING_HD void drawAnglesTogether() const {
    auto* windows = reinterpret_cast<coarse::Window*>(far_.scratch);
    const int count = 1 + static_cast<int>(length() / coarse::kAngleWindow);
    const auto windowOf = [&](int i) -> coarse::Window& {
      return windows[static_cast<int>(along(i) / coarse::kAngleWindow)];
    };
    const auto offset = [&](int i) {
      const coarse::Window& window = windowOf(i);
      const double apart = far_.angles[i] - angleOf(window.cosine, window.sine);
      return apart - coarse::kTwoPi * std::floor(apart / coarse::kTwoPi + 0.5);
    };
    forPoints([&](int i) {
      const double radius = coarse::meanRadius(near_.coefficients, far_.places[i]);
      const double ratio = noise_ / largerOf(radius, noise_);
      far_.values[i] = ratio * ratio;
    });
    forOwn(count, [&](int k) { windows[k] = {0.0, 0.0, 0.0, 0.0}; });
    team_.sync();
    byOne([&] {
      for (int i = 0; i < task_.count; ++i) {
        coarse::Window& window = windowOf(i);
        window.cosine += far_.on_stem[i].around.x;
        window.sine += far_.on_stem[i].around.y;
        window.noise += far_.values[i];
      }
      return 0.0;
    });
    forPoints([&](int i) { far_.values[i] = offset(i); });
    team_.sync();
    byOne([&] {
      for (int i = 0; i < task_.count; ++i) {
        windowOf(i).squares += far_.values[i] * far_.values[i];
      }
      return 0.0;
    });
    forPoints([&](int i) {
      const coarse::Window& window = windowOf(i);
      const double left = 1.0 - window.noise / largerOf(window.squares, 1e-9);
      far_.angles[i] =
          angleOf(window.cosine, window.sine) + std::sqrt(largerOf(left, 0.0)) * far_.values[i];
    });
    team_.sync();
  }

  /// Of the coefficients. Noise spreads the angles of the points, so that their normal matrix
  /// believes in more of the circumference than was seen: the information is that of the angles
  /// before the noise, while the score varies as the points do.
  FIELD_PHENOTYPING_HD void findCovariance() const {
    fillEquations([&](int i, coarse::Record& record) {
      const double weight = tukeyWeight(far_.residuals[i] / noise_);
      record.interval = weight > 0.0 ? far_.places[i].interval : -1;
      if (record.interval < 0) return;
      record.weight = weight / (noise_ * noise_);
      for (double& target : record.target) target = 0.0;
      const Place place{far_.places[i], directionAt(far_.angles[i])};
      coarse::fillDesignRow(place, coarse::meanRadius(near_.coefficients, place.along), record.row);
    });
    const int n = layout_.size();
    const Envelope normal{far_.normal, n, coarse::kBand, coarse::kEllipseSize};
    if (teamFactor(team_, matrix())) {
      // I^-1 N I^-1, of which the first product is turned for the second.
      double* half = far_.scratch;
      forMatrix([&](int i, int j) {
        const int row = i > j ? i : j;
        const int column = i > j ? j : i;
        half[i * n + j] = column < normal.first(row) ? 0.0 : normal.row(row)[column];
      });
      team_.sync();
      teamSolve(team_, matrix(), half, n);
      team_.sync();
      forMatrix([&](int i, int j) { covariance_[i * n + j] = half[j * n + i]; });
    } else {
      const int values = Envelope::valuesOf(n, coarse::kBand, coarse::kEllipseSize);
      team_.sync();
      forOwn(values, [&](int i) { near_.matrix[i] = far_.normal[i]; });
      team_.sync();
      teamFactor(team_, matrix());
      setIdentity(covariance_);
    }
    team_.sync();
    teamSolve(team_, matrix(), covariance_, n);
    team_.sync();
  }

  Team team_;
  SurfacePriorTask task_;
  Vector3* curve_;
  double* out_coefficients_;
  double* covariance_;
  coarse::NearMemory near_;
  coarse::FarMemory far_;
  Layout layout_;
  coarse::Cone cone_ = {};
  double noise_ = coarse::kMinNoise;
  double inflation_ = 1.0;  // of its square
};

}  // namespace field_phenotyping
