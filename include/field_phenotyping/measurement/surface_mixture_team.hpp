#pragma once

#include <cstddef>

#include "field_phenotyping/common/team_cholesky.hpp"
#include "field_phenotyping/measurement/cross_section_model.hpp"
#include "field_phenotyping/measurement/cross_section_start_team.hpp"

// What fitSurfaceMixture() does, for a team of threads (see team.hpp), on the CPU and on the GPU.
// Every sum over the points is one member's, who adds them in their order: it has the same bits
// whatever the team.

namespace field_phenotyping {

/// What a fit of a piece of stem comes to.
struct SurfaceMixtureFit {
  bool converged = false;
  bool has_covariance = false;  ///< false where nothing finite was found
  CrossSectionVector parameters;
  double radius_prior_variance = 0.0;
  double outlier_share = 0.0;
  double surface_points = 0.0;  ///< expected number of points that are no outliers
  double freedom = 0.0;       ///< points that the noise is known from, beyond those that the shape
                              ///< takes; its prior counts too
  double arc_coverage = 0.0;  ///< share of the circumference at which points are
  // Covariances of the parameters, row by row, the shares integrated out.
  double posterior[kCrossSectionSize * kCrossSectionSize];  ///< inverse of the observed information
  double patches[kCrossSectionSize * kCrossSectionSize];    ///< by how much patches of the surface
                                                            ///< disagree ("sandwich"): errors that
                                                            ///< neighbours share show in it
  double bound[kCrossSectionSize * kCrossSectionSize];  ///< of Kanatani, Cramer and Rao, with the
                                                        ///< same priors: what is known at best
                                                        ///< where the points' angles are not
};

namespace mixture {

constexpr double kFinest = 0.02;   // noise over radius
constexpr double kBinWidth = 1.0;  // [standard deviations of the noise] bins as far apart make a
                                   // density even to two parts in a thousand
constexpr int kLeastBins = 30;
constexpr double kTwoPi = 6.283185307179586;
constexpr int kSectors = 12;  // patches that the covariance is checked on
constexpr int kSlabs = 3;
constexpr int kPatches = kSectors * kSlabs;
constexpr int kShapePairs = pairOf(kLocalShapeSize, 0);

FIELD_PHENOTYPING_HD inline double blurOf(const CrossSectionVector& start) {
  return largerOf(exponential(start[kNoise]) / start[kRadius], kFinest);
}
/// Bins round a stem.
FIELD_PHENOTYPING_HD inline int binsOf(const CrossSectionVector& start) {
  const double wished = std::ceil(kTwoPi / (kBinWidth * blurOf(start)));
  return wished > kLeastBins ? static_cast<int>(wished) : kLeastBins;
}

/// What one point says; its candidate bins lie beside it.
struct Record {
  double powers[kHeightPowers];
  double log_density;
  double member;             // that it is no outlier
  double score[kLocalSize];  // the mean over the bins
  double known[kPairs];      // information if its bin were known
  double missing[kPairs];    // how much of that is missing, for it is not
  double patch;              // number of the patch of surface that it is of
  double candidates;         // bins that count
};
constexpr int kRecordSize = static_cast<int>(sizeof(Record) / sizeof(double));

/// What all points say, but for the bins.
struct Sums {
  double log_density;
  double members;
  double doubt;
  double score[kCrossSectionSize];
  double cross_outliers[kCrossSectionSize];
  double known[kInformationSums];
  double missing[kInformationSums];
};
constexpr int kSumsSize = static_cast<int>(sizeof(Sums) / sizeof(double));

/// Memory of one point: what one member of the team works on.
struct PointScratch {
  Record* record;
  double* weights;  // of the candidate bins
  double* scores;   // kLocalSize for each of them
  double* bins;     // their numbers
  double*
      places;  // for each bin: where it is among the candidates, or -1; not where a team is alone
};
FIELD_PHENOTYPING_HD constexpr std::size_t pointScratchSize(int bins) {
  return static_cast<std::size_t>(kRecordSize + bins * (kLocalSize + 3));
}
FIELD_PHENOTYPING_HD inline PointScratch pointScratchAt(double* memory, int bins) {
  double* weights = memory + kRecordSize;
  double* scores = weights + bins;
  double* numbers = scores + bins * kLocalSize;
  return {reinterpret_cast<Record*>(memory), weights, scores, numbers, numbers + bins};
}

/// Memory that all members of the team see.
struct SharedScratch {
  Sums* sums;
  double* moved;  // kCrossSectionSize x kPatches
  // For each bin.
  double* x;  // of its direction
  double* y;
  double* stretched_x;  // of that, by the ellipticity
  double* stretched_y;
  double* log_shares;  // up to a constant
  double* trial;       // the same where the sums are taken
  double* shares;      // exponentials of those, relative to the largest
  double* occupancy;
  double* outlying;
  double* stiffness;  // kShapePairs: information of a point that is known to be of it
  double* cross;      // kCrossSectionSize: what a parameter and its share have in common
  // For each unknown: the parameters, then the bins.
  double* right;
  double* wished;
  double* together;  // bins x bins: of points that may be of both
  double* matrix;    // unknowns x unknowns
};
FIELD_PHENOTYPING_HD constexpr std::size_t sharedScratchSize(int bins) {
  const auto n = static_cast<std::size_t>(bins);
  const std::size_t unknowns = n + kCrossSectionSize;
  return kSumsSize + kCrossSectionSize * kPatches + n * (9U + kShapePairs + kCrossSectionSize) +
         2U * unknowns + n * n + unknowns * unknowns;
}
FIELD_PHENOTYPING_HD inline SharedScratch sharedScratchAt(double* memory, int bins) {
  double* at = memory;
  const auto take = [&](int count) {
    double* taken = at;
    at += count;
    return taken;
  };
  const int unknowns = bins + kCrossSectionSize;
  SharedScratch s;
  s.sums = reinterpret_cast<Sums*>(take(kSumsSize));
  s.moved = take(kCrossSectionSize * kPatches);
  s.x = take(bins);
  s.y = take(bins);
  s.stretched_x = take(bins);
  s.stretched_y = take(bins);
  s.log_shares = take(bins);
  s.trial = take(bins);
  s.shares = take(bins);
  s.occupancy = take(bins);
  s.outlying = take(bins);
  s.stiffness = take(bins * kShapePairs);
  s.cross = take(bins * kCrossSectionSize);
  s.right = take(unknowns);
  s.wished = take(unknowns);
  s.together = take(bins * bins);
  s.matrix = take(unknowns * unknowns);
  return s;
}

template <int kRow = 0>
FIELD_PHENOTYPING_HD inline void addSquare(const double* score, double weight, double* sum) {
  if constexpr (kRow < kLocalSize) {
    const double scaled = weight * score[kRow];
    for (int b = 0; b <= kRow; ++b) sum[pairOf(kRow, b)] += scaled * score[b];
    addSquare<kRow + 1>(score, weight, sum);
  }
}

/// The part of a circle that the direction (x, y) lies in, from that of -x on, towards -y.
FIELD_PHENOTYPING_HD inline int sectorOf(double x, double y) {
  static_assert(kSectors == 12, "each quarter is cut in three");
  constexpr double kRootThree = 1.7320508075688772;
  // Turned back by quarters until it lies in the first one.
  int quarter = 0;
  double a = -x;
  double b = -y;
  while (!(a > 0.0 && b >= 0.0) && quarter < 3) {
    const double turned = -a;
    a = b;
    b = turned;
    ++quarter;
  }
  return 3 * quarter + (b * kRootThree < a ? 0 : b < a * kRootThree ? 1 : 2);
}

}  // namespace mixture

/// The fit of one piece of stem; see fitSurfaceMixture(). All members of the team make one, call
/// everything, and have the same values.
template <class Team>
class SurfaceMixtureSolver {
 public:
  /// @param shared sharedScratchSize() numbers, which all members see
  /// @param of_points pointScratchSize() numbers for each member, which all members see
  FIELD_PHENOTYPING_HD SurfaceMixtureSolver(const Team& team, const CrossSectionPoints& points,
                                            const KnownOfStem& known, const StemExtent& extent,
                                            const CrossSectionStart& start, int bins,
                                            double* shared, double* of_points)
      : team_(team),
        points_(points),
        known_(known),
        extent_(extent),
        bins_(bins),
        unknowns_(kCrossSectionSize + bins),
        shared_(mixture::sharedScratchAt(shared, bins)),
        of_points_(of_points),
        information_(team),
        parameters_(start.parameters),
        outlier_share_(start.outlier_share) {
    // Logarithms of the shares change by this much over as much of the surface as the noise blurs:
    // the end of an arc may be sharp, noise in how many points there are may not.
    constexpr double kJump = 2.5;
    smoothness_ = bins_ * mixture::blurOf(parameters_) / (mixture::kTwoPi * kJump * kJump);
    for (int k = rank(); k < bins_; k += size()) {
      const Direction u = directionOf(k, bins_);
      shared_.x[k] = u.x;
      shared_.y[k] = u.y;
      shared_.log_shares[k] = 0.0;
      shared_.wished[kCrossSectionSize + k] = 0.0;
    }
    team_.sync();
    prior_ = ParameterPrior(known_, extent_, parameters_);
    evaluate(parameters_, 0.0);
    constexpr double kLeastShare = 0.05;  // of an even one
    const double even = shared_.sums->members / bins_;
    for (int k = rank(); k < bins_; k += size()) {
      shared_.log_shares[k] = logarithm(largerOf(shared_.occupancy[k] / even, kLeastShare));
    }
    team_.sync();
    update();
    evaluate(parameters_, 0.0);
  }

  /// Up to `steps` steps; true once nothing moves.
  FIELD_PHENOTYPING_HD bool run(int steps) {
    constexpr double kConverged = 1e-5;       // step, relative to the radius
    constexpr double kConvergedNoise = 1e-4;  // of its logarithm
    constexpr int kHalvings = 8;
    constexpr double kMostLogStep = 3.0;  // of a share
    // What depends on the parameters but is taken as given, as the share of the outliers, follows
    // them in the first steps only, and moves the log-posterior by up to so much.
    constexpr int kSettling = 6;
    constexpr double kSlack = 1.0;
    constexpr double kRounding = 1e-3;  // of the log-posterior: bins that hardly count are left out
    for (int step = 1; step <= steps; ++step) {
      if (!factorInformation()) return false;
      fillScore();
      teamSolve(team_, shared_.matrix, unknowns_, shared_.right, shared_.wished);
      CrossSectionVector move;
      for (int i = 0; i < kCrossSectionSize; ++i) move[i] = shared_.wished[i];
      double most = 0.0;
      for (int k = kCrossSectionSize; k < unknowns_; ++k) {
        const double wished = shared_.wished[k];
        if (!(wished - wished == 0.0)) return false;
        most = largerOf(most, magnitudeOf(wished));
      }
      if (!isFinite(move)) return false;
      const double length = largerOf(normOf(move), 1e-300);
      limitStep(parameters_, move);
      double share_of_step = smallerOf(1.0, normOf(move) / length);
      share_of_step *= smallerOf(1.0, kMostLogStep / largerOf(share_of_step * most, 1e-300));
      const bool settled = step > kSettling;
      const double least = value_ - (settled ? kRounding : kSlack);
      CrossSectionVector next = sumOf(parameters_, move);
      evaluate(next, share_of_step);
      for (int halving = 0; !(value_ >= least) && halving < kHalvings; ++halving) {
        for (double& value : move.values) value *= 0.5;
        share_of_step *= 0.5;
        next = sumOf(parameters_, move);
        evaluate(next, share_of_step);
      }
      parameters_ = next;
      for (int k = rank(); k < bins_; k += size()) shared_.log_shares[k] = shared_.trial[k];
      team_.sync();
      if (!settled) update();
      if (step == kSettling) evaluate(parameters_, 0.0);
      if (movedBy(move) < kConverged * parameters_[kRadius] &&
          magnitudeOf(move[kNoise]) < kConvergedNoise) {
        return true;
      }
    }
    return false;
  }

  /// @param fit the same memory for all members, who may read it afterwards
  FIELD_PHENOTYPING_HD void describe(bool converged, SurfaceMixtureFit& fit) {
    const double members = shared_.sums->members;
    const double arc_coverage = arcCoverage();
    const bool has_covariance = isFinite(parameters_) && factorInformation();
    if (has_covariance) addCovariance(fit);
    if (rank() == 0) {
      fit.converged = converged;
      fit.has_covariance = has_covariance;
      fit.parameters = parameters_;
      fit.radius_prior_variance = 1.0 / prior_.weight[kRadius];
      fit.outlier_share = outlier_share_;
      fit.surface_points = members;
      fit.freedom = members - fitted_ + 0.5 * prior_.weight[kNoise];
      fit.arc_coverage = arc_coverage;
    }
    team_.sync();
  }

 private:
  static constexpr double kRidge = 1e-2;  // inverse variance of a share's logarithm: none is
                                          // exactly zero

  /// What is the same for all points.
  struct Constants {
    CrossSectionVector parameters;
    // Inverse variances of the noise along and across the direction of a place.
    double along;
    double across;
    double log_scale;    // of the density of a place, with its share's logarithm
    double log_outlier;  // density of outliers, in its logarithm
    double lowest;       // of the points' heights
    double slab;         // [m]
  };

  FIELD_PHENOTYPING_HD int rank() const { return static_cast<int>(team_.rank()); }
  FIELD_PHENOTYPING_HD int size() const { return static_cast<int>(team_.size()); }
  FIELD_PHENOTYPING_HD int group() const { return static_cast<int>(team_.group()); }
  FIELD_PHENOTYPING_HD int groups() const { return static_cast<int>(team_.groups()); }
  FIELD_PHENOTYPING_HD int lanes() const { return size() / groups(); }
  FIELD_PHENOTYPING_HD int lane() const { return rank() - group() * lanes(); }

  FIELD_PHENOTYPING_HD static double normOf(const CrossSectionVector& vector) {
    double sum = 0.0;
    for (const double value : vector.values) sum += value * value;
    return std::sqrt(sum);
  }
  FIELD_PHENOTYPING_HD static CrossSectionVector sumOf(const CrossSectionVector& a,
                                                       const CrossSectionVector& b) {
    CrossSectionVector sum;
    for (int i = 0; i < kCrossSectionSize; ++i) sum[i] = a[i] + b[i];
    return sum;
  }

  /// Prepares the bins for visits to the points at some parameters and at shared_.trial.
  FIELD_PHENOTYPING_HD Constants prepare(const CrossSectionVector& p) {
    double top = shared_.trial[0];
    for (int k = 1; k < bins_; ++k) top = largerOf(top, shared_.trial[k]);
    for (int k = rank(); k < bins_; k += size()) {
      const double x = shared_.x[k];
      const double y = shared_.y[k];
      shared_.shares[k] = exponential(shared_.trial[k] - top);
      shared_.stretched_x[k] = p[kEllipse] * x + p[kEllipse + 1] * y;
      shared_.stretched_y[k] = p[kEllipse + 1] * x - p[kEllipse] * y;
    }
    team_.sync();
    double sum = 0.0;
    for (int k = 0; k < bins_; ++k) sum += shared_.shares[k];
    share_scale_ = 1.0 / sum;
    Constants c;
    c.parameters = p;
    c.along = exponential(-2.0 * (p[kNoise] + p[kElongation]));
    c.across = exponential(-2.0 * (p[kNoise] - p[kElongation]));
    constexpr double kPi = 0.5 * mixture::kTwoPi;
    c.log_scale = logarithm(1.0 - outlier_share_) - logarithm(mixture::kTwoPi) - 2.0 * p[kNoise] -
                  (top + logarithm(sum));
    c.log_outlier =
        logarithm(outlier_share_ / kPi) - 2.0 * logarithm(largerOf(extent_.reach, 1e-9));
    return c;
  }

  FIELD_PHENOTYPING_HD double shareOf(int k) const { return shared_.shares[k] * share_scale_; }

  /// Finds the bins that a point may be of, and what it says of the surface.
  /// @tparam kAll or only what the covariance needs
  template <bool kAll>
  FIELD_PHENOTYPING_HD void visit(const double* point, const Constants& c,
                                  const mixture::PointScratch& scratch) const {
    constexpr double kNegligible = 12.0;  // of a log-likelihood
    mixture::Record& record = *scratch.record;
    const double height = point[2];
    const Direction center = centerAt(c.parameters, height);
    const double radius = radiusAt(c.parameters, height);
    const double offset_x = point[0] - center.x;
    const double offset_y = point[1] - center.y;
    const double half_across = 0.5 * c.across;
    const double half_difference = 0.5 * (c.across - c.along);
    const double* const x = shared_.x;
    const double* const y = shared_.y;
    const double* const stretched_x = shared_.stretched_x;
    const double* const stretched_y = shared_.stretched_y;
    const double* const trial = shared_.trial;
    double* const weights = scratch.weights;
    for (int k = 0; k < bins_; ++k) {
      const double rx = offset_x - radius * x[k] - stretched_x[k];
      const double ry = offset_y - radius * y[k] - stretched_y[k];
      const double along = rx * x[k] + ry * y[k];
      weights[k] = trial[k] - half_across * (rx * rx + ry * ry) +
                   half_difference * (along * along) + c.log_scale;
    }
    double top = c.log_outlier;
    for (int k = 0; k < bins_; ++k) top = largerOf(top, weights[k]);
    double sum = exponential(c.log_outlier - top);
    int candidates = 0;
    for (int k = 0; k < bins_; ++k) {
      const bool counts = !(weights[k] < top - kNegligible);
      if constexpr (!Team::kAlone) scratch.places[k] = counts ? candidates : -1;
      if (!counts) continue;
      const double weight = exponential(weights[k] - top);
      scratch.bins[candidates] = k;
      weights[candidates] = weight;
      sum += weight;
      ++candidates;
    }
    const double scale = 1.0 / sum;
    double member = 0.0;
    double squares = 0.0;
    double difference = 0.0;
    double mean[kLocalSize] = {};
    double known[kPairs] = {};
    double missing[kPairs] = {};
    for (int j = 0; j < candidates; ++j) {
      const double weight = weights[j] * scale;
      weights[j] = weight;
      member += weight;
      const auto k = static_cast<int>(scratch.bins[j]);
      const Direction u{x[k], y[k]};
      const double rx = offset_x - radius * u.x - stretched_x[k];
      const double ry = offset_y - radius * u.y - stretched_y[k];
      const double along = rx * u.x + ry * u.y;
      const double across = ry * u.x - rx * u.y;
      const double along_pull = c.along * along;
      const double across_pull = c.across * across;
      const double along_square = along_pull * along;
      const double across_square = across_pull * across;
      const double pull_x = along_pull * u.x - across_pull * u.y;
      const double pull_y = along_pull * u.y + across_pull * u.x;
      double score[kLocalSize];
      surfaceMotion(u, pull_x, pull_y, score);
      score[kLocalNoise] = along_square + across_square - 2.0;
      score[kLocalElongation] = along_square - across_square;
      for (int a = 0; a < kLocalSize; ++a) mean[a] += weight * score[a];
      const double* const stiffness = shared_.stiffness + k * mixture::kShapePairs;
      for (int a = 0; a < mixture::kShapePairs; ++a) known[a] += weight * stiffness[a];
      if constexpr (kAll) {
        double* const kept = scratch.scores + j * kLocalSize;
        for (int a = 0; a < kLocalSize; ++a) kept[a] = score[a];
        // The pull, mirrored at the direction of the place.
        double motion[kLocalShapeSize];
        surfaceMotion(u, 2.0 * along_pull * u.x - pull_x, 2.0 * along_pull * u.y - pull_y, motion);
        for (int a = 0; a < kLocalShapeSize; ++a) {
          known[pairOf(kLocalElongation, a)] += 2.0 * weight * motion[a];
        }
        squares += weight * (along_square + across_square);
        difference += weight * (along_square - across_square);
        mixture::addSquare(score, weight, missing);
      }
    }
    powersOf(height, record.powers);
    record.log_density = top + logarithm(sum);
    record.member = member;
    record.candidates = candidates;
    if constexpr (kAll) {
      for (int a = 0; a < kLocalShapeSize; ++a) known[pairOf(kLocalNoise, a)] = 2.0 * mean[a];
      known[pairOf(kLocalNoise, kLocalNoise)] = 2.0 * squares;
      known[pairOf(kLocalElongation, kLocalNoise)] = 2.0 * difference;
      known[pairOf(kLocalElongation, kLocalElongation)] = 2.0 * squares;
      mixture::addSquare(mean, -1.0, missing);
      for (int a = 0; a < kPairs; ++a) record.missing[a] = missing[a];
    } else {
      known[pairOf(kLocalNoise, kLocalNoise)] = 2.0 * member;
      const auto level = static_cast<int>((height - c.lowest) / c.slab);
      record.patch = (level < mixture::kSlabs ? level : mixture::kSlabs - 1) * mixture::kSectors +
                     mixture::sectorOf(offset_x, offset_y);
    }
    for (int a = 0; a < kLocalSize; ++a) record.score[a] = mean[a];
    for (int a = 0; a < kPairs; ++a) record.known[a] = known[a];
  }

  /// visit() for all points; add(what it found) in their order, by all members. These may read what
  /// they have added up afterwards.
  template <bool kAll, class Add>
  FIELD_PHENOTYPING_HD void visitPoints(const Constants& c, const Add& add) const {
    const std::size_t one = mixture::pointScratchSize(bins_);
    for (int first = 0; first < points_.count; first += size()) {
      if (first + rank() < points_.count) {
        const double* point = points_.places + 3 * static_cast<std::ptrdiff_t>(first + rank());
        visit<kAll>(point, c, mixture::pointScratchAt(of_points_ + team_.rank() * one, bins_));
      }
      team_.sync();
      const int there = points_.count - first < size() ? points_.count - first : size();
      for (int k = 0; k < there; ++k) {
        add(mixture::pointScratchAt(of_points_ + static_cast<std::size_t>(k) * one, bins_));
      }
      team_.sync();
    }
  }

  /// Takes the sums at some parameters, and at the shares' logarithms moved by `share_of_step` of
  /// shared_.wished; sets what is evaluated_.
  FIELD_PHENOTYPING_HD void evaluate(const CrossSectionVector& p, double share_of_step) {
    team_.sync();  // all is still being read
    for (int k = rank(); k < bins_; k += size()) {
      shared_.trial[k] =
          shared_.log_shares[k] + share_of_step * shared_.wished[kCrossSectionSize + k];
    }
    team_.sync();
    const Constants c = prepare(p);
    evaluated_ = p;
    evaluated_prior_ = prior_;
    evaluated_fitted_ = fitted_;
    mixture::Sums& sums = *shared_.sums;
    clear(reinterpret_cast<double*>(&sums), mixture::kSumsSize);
    for (int k = group(); k < bins_; k += groups()) {
      // How a place moves, twice.
      if (lane() == 0) {
        const Direction u{shared_.x[k], shared_.y[k]};
        double outward[kLocalShapeSize];
        double sideward[kLocalShapeSize];
        surfaceMotion(u, u.x, u.y, outward);
        surfaceMotion(u, -u.y, u.x, sideward);
        double* const stiffness = shared_.stiffness + k * mixture::kShapePairs;
        for (int a = 0; a < kLocalShapeSize; ++a) {
          for (int b = 0; b <= a; ++b) {
            stiffness[pairOf(a, b)] =
                c.along * outward[a] * outward[b] + c.across * sideward[a] * sideward[b];
          }
        }
        shared_.occupancy[k] = 0.0;
        shared_.outlying[k] = 0.0;
      }
      for (int i = lane(); i < kCrossSectionSize; i += lanes()) {
        shared_.cross[k * kCrossSectionSize + i] = 0.0;
      }
      for (int i = lane(); i < bins_; i += lanes()) shared_.together[k * bins_ + i] = 0.0;
    }
    team_.sync();
    visitPoints<true>(c, [&](const mixture::PointScratch& point) { add(point, sums); });

    double jumps = 0.0;
    double squares = 0.0;
    for (int k = 0; k < bins_; ++k) {
      const double jump = shared_.trial[k + 1 < bins_ ? k + 1 : 0] - shared_.trial[k];
      jumps += jump * jump;
      squares += shared_.trial[k] * shared_.trial[k];
    }
    value_ = sums.log_density + prior_.valueAt(p) + fitted_ * p[kNoise] -  // residual likelihood
             (0.5 * smoothness_ * jumps + 0.5 * kRidge * squares);
  }

  FIELD_PHENOTYPING_HD void clear(double* values, int count) const {
    for (int i = rank(); i < count; i += size()) values[i] = 0.0;
  }

  /// visit(number among the candidates, number among the bins) for the candidates of a point that
  /// are of this member's group.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forEachOwnCandidate(const mixture::PointScratch& point,
                                                const Visit& visit) const {
    if constexpr (Team::kAlone) {
      const auto candidates = static_cast<int>(point.record->candidates);
      for (int j = 0; j < candidates; ++j) visit(j, static_cast<int>(point.bins[j]));
    } else {
      for (int k = group(); k < bins_; k += groups()) {
        const auto j = static_cast<int>(point.places[k]);
        if (j >= 0) visit(j, k);
      }
    }
  }

  /// Adds what one point says; each member what is its own.
  FIELD_PHENOTYPING_HD void add(const mixture::PointScratch& point, mixture::Sums& sums) const {
    const mixture::Record& record = *point.record;
    const double outside = 1.0 - record.member;
    if (rank() == 0) {
      sums.log_density += record.log_density;
      sums.members += record.member;
      sums.doubt += record.member * outside;
    }
    for (int i = rank(); i < kCrossSectionSize; i += size()) {
      const double score = record.powers[powerOf(i)] * record.score[localOf(i)];
      sums.score[i] += score;
      sums.cross_outliers[i] += outside * score;
    }
    information_.add(record.known, record.powers, sums.known);
    information_.add(record.missing, record.powers, sums.missing);
    forEachOwnCandidate(point, [&](int j, int k) {
      const double weight = point.weights[j];
      const double* const score = point.scores + j * kLocalSize;
      double* const cross = shared_.cross + k * kCrossSectionSize;
      for (int i = lane(); i < kCrossSectionSize; i += lanes()) {
        const int local = localOf(i);
        cross[i] += weight * record.powers[powerOf(i)] * (score[local] - record.score[local]);
      }
      if (lane() == 0) {
        shared_.occupancy[k] += weight;
        shared_.outlying[k] += outside * weight;
      }
      double* const together = shared_.together + k * bins_;
      if constexpr (Team::kAlone) {
        for (int i = 0; i <= j; ++i) {
          together[static_cast<int>(point.bins[i])] += weight * point.weights[i];
        }
      } else {
        for (int bin = lane(); bin <= k; bin += lanes()) {
          const auto i = static_cast<int>(point.places[bin]);
          if (i >= 0) together[bin] += weight * point.weights[i];
        }
      }
    });
  }

  /// What is taken as given in the next evaluation: priors, share of outliers, freedom.
  FIELD_PHENOTYPING_HD void update() {
    prior_ = ParameterPrior(known_, extent_, parameters_);
    constexpr double kPseudoOutliers = 0.5, kPseudoPoints = 5.0;  // keep the share off 0 and 1
    outlier_share_ =
        (points_.count - shared_.sums->members + kPseudoOutliers) / (points_.count + kPseudoPoints);
    fillParameters(shared_.sums->known, evaluated_prior_);
    teamFactor(team_, shared_.matrix, kCrossSectionSize);
    fitted_ = fittedParameters(team_, shared_.matrix, prior_, shared_.right);
  }

  /// Information of the parameters alone, with that of their priors, to the matrix.
  FIELD_PHENOTYPING_HD void fillParameters(const double* sums, const ParameterPrior& prior) const {
    team_.sync();
    if (rank() == 0) {
      forEachInformation([&](int i, int j, int sum) {
        shared_.matrix[i * kCrossSectionSize + j] = sums[sum] + (i == j ? prior.weight[i] : 0.0);
      });
    }
    team_.sync();
  }

  /// The observed information, or as much of the complete one with it as makes it positive,
  /// factored. @return whether it is
  FIELD_PHENOTYPING_HD bool factorInformation() const {
    constexpr double kSharesOfComplete[] = {0.0, 0.1, 0.25, 0.5, 1.0};
    for (const double share : kSharesOfComplete) {
      fillInformation(1.0 - share);
      if (teamFactor(team_, shared_.matrix, unknowns_)) return true;
    }
    return false;
  }

  /// The complete information less `observed` times what is missing of it (Louis 1982).
  FIELD_PHENOTYPING_HD void fillInformation(double observed) const {
    team_.sync();
    const mixture::Sums& sums = *shared_.sums;
    if (rank() == 0) {
      forEachInformation([&](int i, int j, int sum) {
        shared_.matrix[i * unknowns_ + j] = sums.known[sum] - observed * sums.missing[sum] +
                                            (i == j ? evaluated_prior_.weight[i] : 0.0);
      });
    }
    for (int i = group(); i < kCrossSectionSize; i += groups()) {
      double* const row = shared_.matrix + i * unknowns_ + kCrossSectionSize;
      for (int k = lane(); k < bins_; k += lanes()) {
        row[k] = -observed *
                 (shared_.cross[k * kCrossSectionSize + i] - sums.cross_outliers[i] * shareOf(k));
      }
    }
    for (int k = group(); k < bins_; k += groups()) {
      double* const row = shared_.matrix + (kCrossSectionSize + k) * unknowns_ + kCrossSectionSize;
      const double share = shareOf(k);
      for (int l = k + lane(); l < bins_; l += lanes()) {
        const double other = shareOf(l);
        double complete = -sums.members * share * other;
        double missing = -shared_.together[l * bins_ + k] - shared_.outlying[k] * other -
                         share * shared_.outlying[l] + sums.doubt * share * other;
        if (k == l) {
          complete += kRidge + 2.0 * smoothness_ + sums.members * share;
          missing += shared_.occupancy[k];
        }
        if (l == k + 1 || l == k + bins_ - 1) complete -= smoothness_;
        row[l] = complete - observed * missing;
      }
    }
    team_.sync();
  }

  /// The score of all unknowns, where the sums were taken.
  FIELD_PHENOTYPING_HD void fillScore() const {
    const mixture::Sums& sums = *shared_.sums;
    for (int i = rank(); i < kCrossSectionSize; i += size()) {
      shared_.right[i] = sums.score[i] + evaluated_prior_.scoreOf(evaluated_, i) +
                         (i == kNoise ? evaluated_fitted_ : 0.0);
    }
    const double* const log_shares = shared_.trial;
    for (int k = rank(); k < bins_; k += size()) {
      const double next = log_shares[k + 1 < bins_ ? k + 1 : 0];
      const double before = log_shares[k > 0 ? k - 1 : bins_ - 1];
      shared_.right[kCrossSectionSize + k] =
          shared_.occupancy[k] - sums.members * shareOf(k) - kRidge * log_shares[k] +
          smoothness_ * ((next - log_shares[k]) - (log_shares[k] - before));
    }
    team_.sync();
  }

  FIELD_PHENOTYPING_HD double arcCoverage() const {
    constexpr double kStray = 0.2;         // of the usual density, below which a bin is not seen
    constexpr double kGap = 40.0 / 360.0;  // shorter ones are chance
    const double scale = 1.0 / shared_.sums->members;
    double usual = 0.0;
    int first = 0;  // where to begin: at a bin that is seen
    for (int k = 0; k < bins_; ++k) {
      const double share = shared_.occupancy[k] * scale;
      usual += share * share;
      if (shared_.occupancy[k] > shared_.occupancy[first]) first = k;
    }
    const auto longest = static_cast<int>(kGap * bins_);
    int unseen = 0;
    int gap = 0;
    for (int k = 1; k <= bins_; ++k) {
      if (shared_.occupancy[(first + k) % bins_] * scale < kStray * usual) {
        ++gap;
        continue;
      }
      if (gap > longest) unseen += gap;
      gap = 0;
    }
    return 1.0 - static_cast<double>(unseen) / bins_;
  }

  /// Covariances, of the information that is factored in the matrix.
  FIELD_PHENOTYPING_HD void addCovariance(SurfaceMixtureFit& fit) {
    // What was summed over pairs of bins is in the matrix: there is room for columns of the
    // inverse.
    double* const columns = shared_.together;
    static_assert(kCrossSectionSize * (kCrossSectionSize + mixture::kLeastBins) <=
                      mixture::kLeastBins * mixture::kLeastBins,
                  "columns of the inverse fit in");
    for (int r = rank(); r < kCrossSectionSize; r += size()) {
      double* const column = columns + r * unknowns_;
      columnOfInverse(shared_.matrix, unknowns_, r, column);
      for (int i = 0; i < kCrossSectionSize; ++i) {
        fit.posterior[i * kCrossSectionSize + r] = column[i];
      }
    }
    // What is taken as given may have followed the parameters since.
    for (int k = rank(); k < bins_; k += size()) shared_.trial[k] = shared_.log_shares[k];
    team_.sync();
    Constants c = prepare(parameters_);
    c.lowest = points_.places[2];
    double highest = c.lowest;
    for (int i = 1; i < points_.count; ++i) {
      const double height = points_.places[3 * static_cast<std::ptrdiff_t>(i) + 2];
      c.lowest = smallerOf(c.lowest, height);
      highest = largerOf(highest, height);
    }
    c.slab = largerOf(highest - c.lowest, 1e-9) / mixture::kSlabs;

    // What a point says of the surface at best: how far off it is along the normal (Kanatani 1998).
    for (int k = rank(); k < bins_; k += size()) {
      const Direction u{shared_.x[k], shared_.y[k]};
      const double ellipse_c = parameters_[kEllipse];
      const double ellipse_s = parameters_[kEllipse + 1];
      const double radius = parameters_[kRadius];
      // The inverse of S, up to its determinant.
      const double nx = (radius - ellipse_c) * u.x - ellipse_s * u.y;
      const double ny = (radius + ellipse_c) * u.y - ellipse_s * u.x;
      const double scale = 1.0 / lengthOf(nx, ny);
      double motion[kLocalShapeSize];
      surfaceMotion(u, scale * nx, scale * ny, motion);
      double* const stiffness = shared_.stiffness + k * mixture::kShapePairs;
      for (int a = 0; a < kLocalShapeSize; ++a) {
        for (int b = 0; b <= a; ++b) stiffness[pairOf(a, b)] = c.along * motion[a] * motion[b];
      }
    }
    mixture::Sums& sums = *shared_.sums;
    clear(reinterpret_cast<double*>(&sums), mixture::kSumsSize);
    // Patch by patch the unknowns.
    double* const patches = shared_.matrix;
    static_assert(mixture::kPatches <= kCrossSectionSize + mixture::kLeastBins, "patches fit in");
    clear(patches, mixture::kPatches * unknowns_);
    double* const members = shared_.moved;  // of each patch
    clear(members, mixture::kPatches);
    team_.sync();
    visitPoints<false>(c, [&](const mixture::PointScratch& point) {
      const mixture::Record& record = *point.record;
      const auto at = static_cast<int>(record.patch);
      double* const patch = patches + at * unknowns_;
      if (rank() == 0) members[at] += record.member;
      for (int i = rank(); i < kCrossSectionSize; i += size()) {
        patch[i] += record.powers[powerOf(i)] * record.score[localOf(i)];
      }
      forEachOwnCandidate(point, [&](int j, int k) {
        if (lane() == 0) patch[kCrossSectionSize + k] += point.weights[j];
      });
      information_.add(record.known, record.powers, sums.known);
    });
    for (int at = group(); at < mixture::kPatches; at += groups()) {
      double* const patch = patches + at * unknowns_ + kCrossSectionSize;
      for (int k = lane(); k < bins_; k += lanes()) patch[k] -= members[at] * shareOf(k);
    }
    team_.sync();
    for (int at = rank(); at < kCrossSectionSize * mixture::kPatches; at += size()) {
      const double* const column = columns + at / mixture::kPatches * unknowns_;
      const double* const patch = patches + at % mixture::kPatches * unknowns_;
      double sum = 0.0;
      for (int i = 0; i < unknowns_; ++i) sum += column[i] * patch[i];
      shared_.moved[at] = sum;
    }
    team_.sync();
    for (int at = rank(); at < kCrossSectionSize * kCrossSectionSize; at += size()) {
      const double* const a = shared_.moved + at / kCrossSectionSize * mixture::kPatches;
      const double* const b = shared_.moved + at % kCrossSectionSize * mixture::kPatches;
      double sum = 0.0;
      for (int i = 0; i < mixture::kPatches; ++i) sum += a[i] * b[i];
      fit.patches[at] = sum;
    }
    fillParameters(sums.known, prior_);
    teamFactor(team_, shared_.matrix, kCrossSectionSize);
    for (int r = rank(); r < kCrossSectionSize; r += size()) {
      columnOfInverse(shared_.matrix, kCrossSectionSize, r, fit.bound + r * kCrossSectionSize);
    }
    team_.sync();
  }

  const Team& team_;
  CrossSectionPoints points_;
  KnownOfStem known_;
  StemExtent extent_;
  int bins_;
  int unknowns_;
  mixture::SharedScratch shared_;
  double* of_points_;
  InformationAdder<kLocalSize, Team> information_;
  ParameterPrior prior_;
  CrossSectionVector parameters_;
  double smoothness_ = 0.0;  // inverse variance of the difference of neighbours
  double share_scale_ = 1.0;
  double outlier_share_;
  double fitted_ = 0.0;  // parameters that the points, not the priors, decide
  // Where the sums were taken, and with what.
  double value_ = 0.0;  // logarithm of the posterior
  CrossSectionVector evaluated_;
  ParameterPrior evaluated_prior_;
  double evaluated_fitted_ = 0.0;
};

/// @param bins binsOf() the start; the memory is as for SurfaceMixtureSolver
/// @param fit the same memory for all members, who may read it afterwards
template <class Team>
FIELD_PHENOTYPING_HD void fitSurfaceMixture(const Team& team, const CrossSectionPoints& points,
                                            const CrossSectionTask& task,
                                            const CrossSectionStart& start, int bins,
                                            double* shared, double* of_points,
                                            SurfaceMixtureFit& fit) {
  constexpr int kMaxSteps = 120;
  SurfaceMixtureSolver<Team> solver(team, points,
                                    start.shapeless ? ofCircle(task.known) : task.known,
                                    task.extent, start, bins, shared, of_points);
  const bool converged = solver.run(kMaxSteps);
  solver.describe(converged, fit);
}

}  // namespace field_phenotyping
