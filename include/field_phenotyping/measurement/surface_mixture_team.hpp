#pragma once

#include <cstddef>
#include <type_traits>

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

/// What is solved for: the parameters, the logarithms of the bins' shares, that of the odds of
/// being an outlier.
FIELD_PHENOTYPING_HD constexpr int unknownsOf(int bins) {
  return kCrossSectionSize + bins + 1;
}

FIELD_PHENOTYPING_HD inline double blurOf(const CrossSectionVector& start) {
  return largerOf(exponential(start[kNoise]) / start[kRadius], kFinest);
}
/// Bins round a stem.
FIELD_PHENOTYPING_HD inline int binsOf(const CrossSectionVector& start) {
  const double wished = std::ceil(kTwoPi / (kBinWidth * blurOf(start)));
  return wished > kLeastBins ? static_cast<int>(wished) : kLeastBins;
}

/// Bins, filled up to whole lanes.
FIELD_PHENOTYPING_HD constexpr int paddedBins(int bins) {
  constexpr auto kWidth = static_cast<int>(kLanes);
  return (bins + kWidth - 1) / kWidth * kWidth;
}

/// What one point says; what its candidate bins do lies beside it.
struct Record {
  double powers[kHeightPowers];
  double log_density;
  double member;             // that it is no outlier; the sum of the weights
  double score[kLocalSize];  // the mean over the bins, times `member`
  double known[kPairs];      // information if its bin were known; not of the shape alone
  double missing[kPairs];    // how much of that is missing, for it is not
  double patch;              // number of the patch of surface that it is of
  double candidates;         // packs of kLanes bins side by side that it may be of
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

/// Memory of one point: what one group of the team works on.
struct PointScratch {
  Record* record;
  // For each bin.
  float* along;    // how far off its place the point is, along its direction
  float* across;   // and across it
  float* weights;  // that the point is of it, of packs that count
  float* scores;   // of packs that count: kLocalSize times kLanes each
  // For each pack.
  float* candidates;  // numbers of those that count, in their order
  float* counts;      // whether it does
};

/// Points that have been visited at once, one by each group of the team.
struct Visited {
  double* memory;   ///< pointScratchSize() numbers of each
  std::size_t one;  ///< that
  int bins;
  int count;

  FIELD_PHENOTYPING_HD PointScratch operator[](int k) const;
};

FIELD_PHENOTYPING_HD constexpr std::size_t pointScratchSize(int bins) {
  const auto n = static_cast<std::size_t>(paddedBins(bins));
  return kRecordSize + (n * (3U + kLocalSize) + 2U * n / kLanes + 1U) / 2U;
}
FIELD_PHENOTYPING_HD inline PointScratch pointScratchAt(double* memory, int bins) {
  const int n = paddedBins(bins);
  auto* at = reinterpret_cast<float*>(memory + kRecordSize);
  PointScratch s;
  s.record = reinterpret_cast<Record*>(memory);
  s.along = takeFrom(at, n);
  s.across = takeFrom(at, n);
  s.weights = takeFrom(at, n);
  s.scores = takeFrom(at, n * kLocalSize);
  s.candidates = takeFrom(at, n / static_cast<int>(kLanes));
  s.counts = takeFrom(at, n / static_cast<int>(kLanes));
  return s;
}

FIELD_PHENOTYPING_HD inline PointScratch Visited::operator[](int k) const {
  return pointScratchAt(memory + static_cast<std::size_t>(k) * one, bins);
}

/// Memory that all members of the team see.
struct SharedScratch {
  Sums* sums;
  double* moved;  // kCrossSectionSize x kPatches
  // For each bin.
  double* x;  // of its direction
  double* y;
  double* log_shares;  // up to a constant
  double* trial;       // the same where the sums are taken
  double* shares;      // exponentials of those, relative to the largest
  double* stiffness;   // kShapePairs: information of a point that is known to be of it
  // For each unknown: the parameters, the bins, the outliers.
  double* right;
  double* wished;
  double* matrix;   // unknowns x unknowns
  double* columns;  // kCrossSectionSize x unknowns
  // For each bin, filled up to whole lanes.
  float* light_x;  // of its direction
  float* light_y;
  float* bulge_x;  // of that, by the ellipticity
  float* bulge_y;
  float* log_weight;  // of its share, with what all have in common
  float* by_height;   // kHeightPowers x: weights of the points, times powers of height
  float* outlying;    // weights, times how likely the point is an outlier
  float* cross;       // kCrossSectionSize x: what a parameter and its share have in common
  float* together;    // bins x bins, those before and of the pack: of points that may be of both
};
FIELD_PHENOTYPING_HD constexpr std::size_t sharedScratchSize(int bins) {
  const auto n = static_cast<std::size_t>(bins);
  const auto padded = static_cast<std::size_t>(paddedBins(bins));
  const auto unknowns = static_cast<std::size_t>(unknownsOf(bins));
  const std::size_t floats = padded * (6U + kHeightPowers + kCrossSectionSize + padded);
  return kSumsSize + kCrossSectionSize * kPatches + n * (5U + kShapePairs) +
         unknowns * (2U + unknowns + kCrossSectionSize) + (floats + 1U) / 2U;
}
FIELD_PHENOTYPING_HD inline SharedScratch sharedScratchAt(double* memory, int bins) {
  double* at = memory;
  const int unknowns = unknownsOf(bins);
  const int padded = paddedBins(bins);
  SharedScratch s;
  s.sums = reinterpret_cast<Sums*>(takeFrom(at, kSumsSize));
  s.moved = takeFrom(at, kCrossSectionSize * kPatches);
  s.x = takeFrom(at, bins);
  s.y = takeFrom(at, bins);
  s.log_shares = takeFrom(at, bins);
  s.trial = takeFrom(at, bins);
  s.shares = takeFrom(at, bins);
  s.stiffness = takeFrom(at, bins * kShapePairs);
  s.right = takeFrom(at, unknowns);
  s.wished = takeFrom(at, unknowns);
  s.matrix = takeFrom(at, unknowns * unknowns);
  s.columns = takeFrom(at, kCrossSectionSize * unknowns);
  auto* light = reinterpret_cast<float*>(at);
  s.light_x = takeFrom(light, padded);
  s.light_y = takeFrom(light, padded);
  s.bulge_x = takeFrom(light, padded);
  s.bulge_y = takeFrom(light, padded);
  s.log_weight = takeFrom(light, padded);
  s.by_height = takeFrom(light, padded * kHeightPowers);
  s.outlying = takeFrom(light, padded);
  s.cross = takeFrom(light, padded * kCrossSectionSize);
  s.together = takeFrom(light, padded * padded);
  return s;
}

/// Adds the products of deviations with weighted ones to the lower half of their matrix.
template <int kRow = 0, class Float>
FIELD_PHENOTYPING_HD inline void addScatter(const Float* deviations, const Float* weighted,
                                            Float* scatter) {
  if constexpr (kRow < kLocalSize) {
    for (int b = 0; b <= kRow; ++b) scatter[pairOf(kRow, b)] += weighted[kRow] * deviations[b];
    addScatter<kRow + 1>(deviations, weighted, scatter);
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
        padded_(mixture::paddedBins(bins)),
        unknowns_(mixture::unknownsOf(bins)),
        shared_(mixture::sharedScratchAt(shared, bins)),
        of_points_(of_points),
        information_(team),
        parameters_(start.parameters) {
    // Logarithms of the shares change by this much over as much of the surface as the noise blurs:
    // the end of an arc may be sharp, noise in how many points there are may not.
    constexpr double kJump = 2.5;
    smoothness_ = bins_ * mixture::blurOf(parameters_) / (mixture::kTwoPi * kJump * kJump);
    for (int k = rank(); k < bins_; k += size()) {
      const Direction u = directionOf(k, bins_);
      shared_.x[k] = u.x;
      shared_.y[k] = u.y;
    }
    beginAt(start);
  }

  /// Up to `steps` steps; true once what is left of them is negligible.
  FIELD_PHENOTYPING_HD bool run(int steps) {
    // A step of Newton's method that is as small leaves next to nothing: relative to the radius,
    // and of the noise's logarithm.
    constexpr double kConverged = 1e-3;
    constexpr double kConvergedNoise = 5e-3;
    // Where the information had to be made positive steps are small long before that.
    constexpr double kStill = 1e-5;
    constexpr double kStillNoise = 1e-4;
    constexpr int kHalvings = 8;
    constexpr double kMostLogStep = 3.0;  // of a share
    // What depends on the parameters but is taken as given follows them in the first steps only.
    constexpr int kSettling = 6;
    constexpr double kRounding = 1e-3;  // of the log-posterior: bins that hardly count are left out
    for (int step = 1; step <= steps; ++step) {
      const bool settled = step > kSettling;
      if (!settled) follow();
      const double complete = factorInformation();
      if (complete > 1.0) return false;
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
      const bool is_newtons = complete == 0.0 && share_of_step == 1.0;
      const bool is_last =
          movedBy(move) < (is_newtons ? kConverged : kStill) * parameters_[kRadius] &&
          magnitudeOf(move[kNoise]) < (is_newtons ? kConvergedNoise : kStillNoise);
      if (is_last) {
        take(sumOf(parameters_, move), share_of_step);
        return true;
      }
      const double least = posteriorAt(parameters_) - kRounding;
      CrossSectionVector next = sumOf(parameters_, move);
      evaluate(next, share_of_step);
      for (int halving = 0; !(posteriorAt(next) >= least) && halving < kHalvings; ++halving) {
        for (double& value : move.values) value *= 0.5;
        share_of_step *= 0.5;
        next = sumOf(parameters_, move);
        evaluate(next, share_of_step);
      }
      take(next, share_of_step);
      if (settled && !(posteriorAt(next) >= least)) return false;  // at a limit of the parameters
    }
    return false;
  }

  FIELD_PHENOTYPING_HD_ONCE void beginAt(const CrossSectionStart& start) {
    parameters_ = start.parameters;
    outlier_odds_ = logarithm(start.outlier_share / (1.0 - start.outlier_share));
    trial_odds_ = outlier_odds_;
    team_.sync();  // all may still be read
    clear(shared_.trial, bins_);
    clear(shared_.wished, unknowns_);
    team_.sync();
    findShares();
    evaluate(parameters_, 0.0);
  }

  /// Where points depart from the surface together, as no stem is an exact ellipse, a point counts
  /// for less than one, from here on. To be called after describe(). @return whether that is so
  FIELD_PHENOTYPING_HD bool countTogether(const CrossSectionStart& start) {
    constexpr double kByChance = 2.0;  // of exact ellipses it is less
    // Of thicker noise most points of a patch are another's.
    const double patch = mixture::kTwoPi / mixture::kSectors * parameters_[kRadius];
    if (!(togetherness_ > kByChance && exponential(parameters_[kNoise]) < patch)) return false;
    weight_ = 1.0 / (1.0 + togetherness_ - kByChance);
    beginAt(start);
    return true;
  }

  /// @param fit the same memory for all members, who may read it afterwards
  FIELD_PHENOTYPING_HD void describe(bool converged, SurfaceMixtureFit& fit) {
    const double members = shared_.sums->members;
    const double arc_coverage = arcCoverage();
    const bool has_covariance = isFinite(parameters_) && factorInformation() <= 1.0;
    if (has_covariance) addCovariance(fit);
    if (rank() == 0) {
      fit.converged = converged;
      fit.has_covariance = has_covariance;
      fit.parameters = parameters_;
      fit.radius_prior_variance = 1.0 / prior_.weight[kRadius];
      fit.outlier_share = shareAt(outlier_odds_);
      fit.surface_points = members / weight_;
      fit.freedom = members - fitted_shape_ + 0.5 * prior_.weight[kNoise];
      fit.arc_coverage = arc_coverage;
    }
    team_.sync();
  }

 private:
  static constexpr double kRidge = 1e-3;  // inverse variance of a share's logarithm: none is
                                          // exactly zero
  // Keep the share of the outliers off 0 and 1.
  static constexpr double kPseudoOutliers = 0.5;
  static constexpr double kPseudoPoints = 5.0;

  /// What is the same for all points.
  struct Constants {
    CrossSectionVector parameters;
    // Inverse variances of the noise along and across the direction of a place.
    double along;
    double across;
    double log_outlier;   // density of outliers, in its logarithm
    double lowest = 0.0;  // of the points' heights
    double slab = 1e6;    // [m] of patches
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
      shared_.shares[k] = exponential(shared_.trial[k] - top);
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
    const double outlier_share = shareAt(trial_odds_);
    const double log_scale = logarithm(1.0 - outlier_share) - logarithm(mixture::kTwoPi) -
                             2.0 * p[kNoise] - (top + logarithm(sum));
    c.log_outlier = logarithm(outlier_share / kPi) - 2.0 * logarithm(largerOf(extent_.reach, 1e-9));
    constexpr float kNever = -1e30F;
    for (int k = rank(); k < padded_; k += size()) {
      const bool is_bin = k < bins_;
      const double x = is_bin ? shared_.x[k] : 0.0;
      const double y = is_bin ? shared_.y[k] : 0.0;
      shared_.light_x[k] = static_cast<float>(x);
      shared_.light_y[k] = static_cast<float>(y);
      shared_.bulge_x[k] = static_cast<float>(p[kEllipse] * x + p[kEllipse + 1] * y);
      shared_.bulge_y[k] = static_cast<float>(p[kEllipse + 1] * x - p[kEllipse] * y);
      shared_.log_weight[k] = is_bin ? static_cast<float>(shared_.trial[k] + log_scale) : kNever;
    }
    team_.sync();
    return c;
  }

  /// The share of what has odds of that logarithm.
  FIELD_PHENOTYPING_HD static double shareAt(double log_odds) {
    return 1.0 / (1.0 + exponential(-log_odds));
  }
  FIELD_PHENOTYPING_HD double shareOf(int k) const { return shared_.shares[k] * share_scale_; }
  /// Weights of a bin, times how likely the points are outliers.
  FIELD_PHENOTYPING_HD double outlyingOf(int k) const {
    return static_cast<double>(shared_.outlying[k]);
  }
  /// Expected number of points of a bin.
  FIELD_PHENOTYPING_HD double occupancyOf(int k) const {
    return static_cast<double>(shared_.by_height[k]);
  }

  static constexpr auto kPack = static_cast<int>(kLanes);

  /// visit(first bin) for the packs that a point may be of and that are first ... of `step`, in
  /// their order.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forEachCandidate(const mixture::PointScratch& point, int first,
                                             int step, const Visit& visit) const {
    if constexpr (Team::kAlone) {
      const auto candidates = static_cast<int>(point.record->candidates);
      for (int j = 0; j < candidates; ++j) visit(kPack * static_cast<int>(point.candidates[j]));
    } else {
      for (int pack = first; pack * kPack < padded_; pack += step) {
        if (point.counts[pack] > 0.0F) visit(kPack * pack);
      }
    }
  }

  /// Finds the bins that a point may be of, and what it says of the surface. A group works on
  /// kLanes bins at once.
  /// @tparam kAll or only what the covariance needs
  template <bool kAll, class Lanes>
  FIELD_PHENOTYPING_HD void visit(const Lanes& lanes, const double* point, const Constants& c,
                                  const mixture::PointScratch& scratch) const {
    using Float = typename Lanes::Float;
    constexpr float kNegligible = -12.0F;  // log-likelihood, from the largest
    constexpr float kNone = -1.0F;         // weight of what does not count
    mixture::Record& record = *scratch.record;
    const double height = point[2];
    const Direction center = centerAt(c.parameters, height);
    const double far_x = point[0] - center.x;
    const double far_y = point[1] - center.y;
    const Float offset_x = lanes.all(static_cast<float>(far_x));
    const Float offset_y = lanes.all(static_cast<float>(far_y));
    const Float radius = lanes.all(static_cast<float>(radiusAt(c.parameters, height)));
    const Float along_precision = lanes.all(static_cast<float>(c.along));
    const Float across_precision = lanes.all(static_cast<float>(c.across));
    const Float half = lanes.all(0.5F);
    const auto end = static_cast<std::size_t>(padded_);
    Float tops = lanes.all(static_cast<float>(c.log_outlier));
    for (std::size_t k = 0U; k < end; k += kLanes) {
      const Float x = lanes.load(shared_.light_x, k, end);
      const Float y = lanes.load(shared_.light_y, k, end);
      const Float off_x = offset_x - radius * x - lanes.load(shared_.bulge_x, k, end);
      const Float off_y = offset_y - radius * y - lanes.load(shared_.bulge_y, k, end);
      const Float along = off_x * x + off_y * y;
      const Float across = off_y * x - off_x * y;
      const Float log_weight =
          lanes.load(shared_.log_weight, k, end) -
          half * (along_precision * along * along + across_precision * across * across);
      lanes.store(along, scratch.along, k, end);
      lanes.store(across, scratch.across, k, end);
      lanes.store(log_weight, scratch.weights, k, end);
      tops = lanes.larger(tops, log_weight);
    }
    const float top = lanes.greatest(tops);

    Float sums = lanes.all(0.0F);
    Float mean_lanes[kLocalSize];
    Float mean_along[kLocalShapeSize];
    for (Float& mean : mean_lanes) mean = lanes.all(0.0F);
    for (Float& mean : mean_along) mean = lanes.all(0.0F);
    int candidates = 0;
    for (std::size_t k = 0U; k < end; k += kLanes) {
      const Float below = lanes.load(scratch.weights, k, end) - lanes.all(top);
      const auto counts = lanes.atMost(lanes.all(kNegligible), below);
      const bool has_any = lanes.count(counts) > 0U;
      if constexpr (!Team::kAlone) {
        if (lanes.first()) scratch.counts[k / kLanes] = has_any ? 1.0F : 0.0F;
        if (!has_any) lanes.store(lanes.all(kNone), scratch.weights, k, end);
      }
      if (!has_any) continue;
      if constexpr (Team::kAlone) scratch.candidates[candidates++] = static_cast<float>(k / kLanes);
      const Float weight =
          lanes.where(counts, lanes.exponential(lanes.larger(below, lanes.all(kNegligible))));
      sums += weight;
      lanes.store(weight, scratch.weights, k, end);
      const Float x = lanes.load(shared_.light_x, k, end);
      const Float y = lanes.load(shared_.light_y, k, end);
      const Float along = lanes.load(scratch.along, k, end);
      const Float across = lanes.load(scratch.across, k, end);
      const Float along_pull = along_precision * along;
      const Float across_pull = across_precision * across;
      const Float pull_x = along_pull * x - across_pull * y;
      const Float pull_y = along_pull * y + across_pull * x;
      const Float along_square = along_pull * along;
      const Float across_square = across_pull * across;
      const Float score[kLocalSize] = {pull_x,
                                       pull_y,
                                       along_pull,
                                       x * pull_x - y * pull_y,
                                       x * pull_y + y * pull_x,
                                       along_square + across_square - lanes.all(2.0F),
                                       along_square - across_square};
      for (int a = 0; a < kLocalSize; ++a) {
        mean_lanes[a] += weight * score[a];
        if constexpr (kAll) lanes.store(score[a], scoresAt(scratch, k, a), 0U, kLanes);
      }
      if constexpr (kAll) {  // the part of the pull that is along the direction
        const Float weighted = weight * along_pull;
        mean_along[0] += weighted * x;
        mean_along[1] += weighted * y;
        mean_along[2] += weighted;
        mean_along[3] += weighted * (x * x - y * y);
        mean_along[4] += weighted * (lanes.all(2.0F) * x * y);
      }
    }
    const auto members = static_cast<double>(lanes.total(sums));
    const double sum = members + exponential(c.log_outlier - static_cast<double>(top));
    const double scale = 1.0 / sum;
    const Float light_scale = lanes.all(static_cast<float>(scale));
    double mean[kLocalSize];
    for (int a = 0; a < kLocalSize; ++a) {
      mean[a] = scale * static_cast<double>(lanes.total(mean_lanes[a]));
    }
    double along[kLocalShapeSize];
    if constexpr (kAll) {
      for (int a = 0; a < kLocalShapeSize; ++a) {
        along[a] = scale * static_cast<double>(lanes.total(mean_along[a]));
      }
    }
    Float scatter[kPairs];
    for (Float& value : scatter) value = lanes.all(0.0F);
    const auto scatterPack = [&](std::size_t k) {
      const Float weight = light_scale * lanes.load(scratch.weights, k, end);
      lanes.store(weight, scratch.weights, k, end);
      if constexpr (kAll) {
        Float deviations[kLocalSize];
        Float weighted[kLocalSize];
        for (int a = 0; a < kLocalSize; ++a) {
          deviations[a] = lanes.load(scoresAt(scratch, k, a), 0U, kLanes) -
                          lanes.all(static_cast<float>(mean[a]));
          weighted[a] = weight * deviations[a];
        }
        mixture::addScatter(deviations, weighted, scatter);
      }
    };
    // Lanes may be threads that have not waited for one another: each looks at its own memory.
    if constexpr (Team::kAlone) {
      for (int j = 0; j < candidates; ++j) {
        scatterPack(kLanes * static_cast<std::size_t>(scratch.candidates[j]));
      }
    } else {
      for (std::size_t k = 0U; k < end; k += kLanes) {
        const Float weight = lanes.load(scratch.weights, k, end);
        if (lanes.any(lanes.atMost(lanes.all(0.0F), weight))) scatterPack(k);
      }
    }
    double missing[kPairs] = {};
    const double member = scale * members;
    if constexpr (kAll) {
      const double outside = 1.0 - member;
      for (int a = 0; a < kLocalSize; ++a) {
        for (int b = 0; b <= a; ++b) {
          missing[pairOf(a, b)] =
              static_cast<double>(lanes.total(scatter[pairOf(a, b)])) + outside * mean[a] * mean[b];
        }
      }
    }
    if (!lanes.first()) return;
    powersOf(height, record.powers);
    record.log_density = static_cast<double>(top) + logarithm(sum);
    record.member = member;
    record.candidates = candidates;
    for (int a = 0; a < kLocalSize; ++a) record.score[a] = mean[a];
    if constexpr (kAll) {
      const double squares = mean[kLocalNoise] + 2.0 * member;
      for (int a = 0; a < kLocalShapeSize; ++a) {
        record.known[pairOf(kLocalNoise, a)] = 2.0 * mean[a];
        // By the pull, mirrored at the direction of the place.
        record.known[pairOf(kLocalElongation, a)] = 2.0 * (2.0 * along[a] - mean[a]);
      }
      record.known[pairOf(kLocalNoise, kLocalNoise)] = 2.0 * squares;
      record.known[pairOf(kLocalElongation, kLocalNoise)] = 2.0 * mean[kLocalElongation];
      record.known[pairOf(kLocalElongation, kLocalElongation)] = 2.0 * squares;
      for (int a = 0; a < kPairs; ++a) record.missing[a] = missing[a];
    } else {
      const auto level = static_cast<int>((height - c.lowest) / c.slab);
      record.patch = (level < mixture::kSlabs ? level : mixture::kSlabs - 1) * mixture::kSectors +
                     mixture::sectorOf(far_x, far_y);
    }
  }

  /// Where a score of a pack's bins is.
  FIELD_PHENOTYPING_HD static float* scoresAt(const mixture::PointScratch& point,
                                              std::size_t first_bin, int local) {
    return point.scores + first_bin * kLocalSize + static_cast<std::size_t>(local) * kLanes;
  }

  /// visit() for all points; add(those visited at once), whose values are to be added in their
  /// order, by all members. These may read what they have added up afterwards.
  template <bool kAll, class Add>
  FIELD_PHENOTYPING_HD void visitPoints(const Constants& c, const Add& add) const {
    mixture::Visited visited{of_points_, mixture::pointScratchSize(bins_), bins_, 0};
    for (int first = 0; first < points_.count; first += groups()) {
      if (first + group() < points_.count) {
        const double* point = points_.places + 3 * static_cast<std::ptrdiff_t>(first + group());
        visit<kAll>(team_.lanes(), point, c, visited[group()]);
      }
      team_.sync();
      visited.count = points_.count - first < groups() ? points_.count - first : groups();
      add(visited);
      team_.sync();
    }
  }

  /// Steps to some parameters, and with the shares' logarithms and the outliers' by `share_of_step`
  /// of shared_.wished.
  FIELD_PHENOTYPING_HD void take(const CrossSectionVector& p, double share_of_step) {
    parameters_ = p;
    for (int k = rank(); k < bins_; k += size()) {
      shared_.log_shares[k] += share_of_step * shared_.wished[kCrossSectionSize + k];
    }
    outlier_odds_ += share_of_step * shared_.wished[unknowns_ - 1];
    team_.sync();
  }

  /// The shares after one step of expectation maximisation from even ones.
  FIELD_PHENOTYPING_HD void findShares() {
    constexpr double kLeastShare = 0.05;  // of an even one
    const Constants c = prepare(parameters_);
    clearBins();
    team_.sync();
    double members = 0.0;
    visitPoints<false>(c, [&](const mixture::Visited& visited) {
      for (int j = 0; j < visited.count; ++j) {
        const mixture::PointScratch point = visited[j];
        members += point.record->member;
        const auto lanes = team_.lanes();
        forEachCandidate(point, group(), groups(), [&](int k) {
          addTo(lanes, shared_.by_height + k, lanes.load(point.weights + k, 0U, kLanes));
        });
      }
    });
    const double even = members / bins_;
    for (int k = rank(); k < bins_; k += size()) {
      shared_.log_shares[k] = logarithm(largerOf(occupancyOf(k) / even, kLeastShare));
    }
    team_.sync();
  }

  /// Takes the sums at some parameters, and at the shares' logarithms moved by `share_of_step` of
  /// shared_.wished; sets what is evaluated_.
  FIELD_PHENOTYPING_HD_ONCE void evaluate(const CrossSectionVector& p, double share_of_step) {
    team_.sync();  // all is still being read
    for (int k = rank(); k < bins_; k += size()) {
      shared_.trial[k] =
          shared_.log_shares[k] + share_of_step * shared_.wished[kCrossSectionSize + k];
    }
    trial_odds_ = outlier_odds_ + share_of_step * shared_.wished[unknowns_ - 1];
    team_.sync();
    const Constants c = prepare(p);
    mixture::Sums& sums = *shared_.sums;
    clear(reinterpret_cast<double*>(&sums), mixture::kSumsSize);
    for (int k = rank(); k < bins_; k += size()) {
      // How a place moves, twice.
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
    }
    clearBins();
    team_.sync();
    visitPoints<true>(c, [&](const mixture::Visited& visited) {
      if constexpr (Team::kAlone) {
        addOne(visited[0], sums);
      } else {
        addAll(visited, sums);
      }
    });
    if (weight_ < 1.0) weigh(sums);
    addStiffness(sums);

    double jumps = 0.0;
    double squares = 0.0;
    for (int k = 0; k < bins_; ++k) {
      const double jump = shared_.trial[k + 1 < bins_ ? k + 1 : 0] - shared_.trial[k];
      jumps += jump * jump;
      squares += shared_.trial[k] * shared_.trial[k];
    }
    const double outlier_share = shareAt(trial_odds_);
    likelihood_ = sums.log_density - (0.5 * smoothness_ * jumps + 0.5 * kRidge * squares) +
                  kPseudoOutliers * logarithm(outlier_share) +
                  (kPseudoPoints - kPseudoOutliers) * logarithm(1.0 - outlier_share);
  }

  /// Logarithm of the residual posterior of the parameters where the sums were taken.
  FIELD_PHENOTYPING_HD double posteriorAt(const CrossSectionVector& evaluated) const {
    return likelihood_ + prior_.valueAt(evaluated) + fitted_ * evaluated[kNoise];
  }

  /// Makes sums over the points ones over as many as they count for.
  FIELD_PHENOTYPING_HD void weigh(mixture::Sums& sums) const {
    auto* const all = reinterpret_cast<double*>(&sums);
    for (int i = rank(); i < mixture::kSumsSize; i += size()) all[i] *= weight_;
    const auto weight = static_cast<float>(weight_);
    for (int i = rank(); i < binSums(); i += size()) shared_.by_height[i] *= weight;
    team_.sync();
  }

  FIELD_PHENOTYPING_HD void clear(double* values, int count) const {
    for (int i = rank(); i < count; i += size()) values[i] = 0.0;
  }
  /// Numbers from by_height on that are sums over the points.
  FIELD_PHENOTYPING_HD int binSums() const {
    return padded_ * (kHeightPowers + 1 + kCrossSectionSize + padded_);
  }
  FIELD_PHENOTYPING_HD void clearBins() const {
    for (int i = rank(); i < binSums(); i += size()) shared_.by_height[i] = 0.0F;
  }

  /// Adds to what lies at the bins of a pack.
  template <class Lanes>
  FIELD_PHENOTYPING_HD static void addTo(const Lanes& lanes, float* values,
                                         const typename Lanes::Float& more) {
    lanes.store(lanes.load(values, 0U, kLanes) + more, values, 0U, kLanes);
  }

  /// Adds what one point says, by a member that is alone: of the bins only those that it may be of.
  FIELD_PHENOTYPING_HD void addOne(const mixture::PointScratch& point, mixture::Sums& sums) const {
    const mixture::Record& record = *point.record;
    const double outside = 1.0 - record.member;
    sums.log_density += record.log_density;
    sums.members += record.member;
    sums.doubt += record.member * outside;
    for (int i = 0; i < kCrossSectionSize; ++i) {
      const double score = record.powers[powerOf(i)] * record.score[localOf(i)];
      sums.score[i] += score;
      sums.cross_outliers[i] += outside * score;
    }
    information_.template add<kLocalNoise>(record.known, record.powers, sums.known);
    information_.add(record.missing, record.powers, sums.missing);

    const auto lanes = team_.lanes();
    using Float = typename std::decay_t<decltype(lanes)>::Float;
    float powers[kHeightPowers];
    for (int i = 0; i < kHeightPowers; ++i) powers[i] = static_cast<float>(record.powers[i]);
    float mean[kLocalSize];
    for (int a = 0; a < kLocalSize; ++a) mean[a] = static_cast<float>(record.score[a]);
    forEachCandidate(point, 0, 1, [&](int k) {
      const Float weight = lanes.load(point.weights + k, 0U, kLanes);
      for (int i = 0; i < kHeightPowers; ++i) {
        addTo(lanes, shared_.by_height + i * padded_ + k, weight * lanes.all(powers[i]));
      }
      addTo(lanes, shared_.outlying + k, lanes.all(static_cast<float>(outside)) * weight);
      Float weighted[kLocalSize];
      for (int a = 0; a < kLocalSize; ++a) {
        weighted[a] =
            weight * (lanes.load(scoresAt(point, static_cast<std::size_t>(k), a), 0U, kLanes) -
                      lanes.all(mean[a]));
      }
      addCross(lanes, weighted, powers, shared_.cross + k);
      float* const together = shared_.together + k * padded_;
      forEachCandidate(point, 0, 1, [&](int other) {
        if (other > k) return;
        const Float others = lanes.load(point.weights + other, 0U, kLanes);
        for (int i = 0; i < kPack; ++i) {
          addTo(lanes, together + i * padded_ + other, lanes.all(point.weights[k + i]) * others);
        }
      });
    });
  }

  /// addOne() for some points, by many members: each adds up values of its own in registers.
  FIELD_PHENOTYPING_HD void addAll(const mixture::Visited& visited, mixture::Sums& sums) const {
    const int count = visited.count;
    if (rank() == 0) {
      for (int k = 0; k < count; ++k) {
        const mixture::Record& record = *visited[k].record;
        sums.log_density += record.log_density;
        sums.members += record.member;
        sums.doubt += record.member * (1.0 - record.member);
      }
    }
    for (int i = rank(); i < kCrossSectionSize; i += size()) {
      double scores = sums.score[i];
      double outliers = sums.cross_outliers[i];
      for (int k = 0; k < count; ++k) {
        const mixture::Record& record = *visited[k].record;
        const double score = record.powers[powerOf(i)] * record.score[localOf(i)];
        scores += score;
        outliers += (1.0 - record.member) * score;
      }
      sums.score[i] = scores;
      sums.cross_outliers[i] = outliers;
    }
    information_.template addAll<kLocalNoise>(
        count, [&](int k) { return visited[k].record->known; },
        [&](int k) { return visited[k].record->powers; }, sums.known);
    information_.addAll(
        count, [&](int k) { return visited[k].record->missing; },
        [&](int k) { return visited[k].record->powers; }, sums.missing);

    using Point = mixture::PointScratch;
    addUp(visited, shared_.by_height, kHeightPowers, [](const Point& point, int power, int bin) {
      return point.weights[bin] * static_cast<float>(point.record->powers[power]);
    });
    addUp(visited, shared_.outlying, 1, [](const Point& point, int /*row*/, int bin) {
      return static_cast<float>(1.0 - point.record->member) * point.weights[bin];
    });
    addUp(visited, shared_.cross, kCrossSectionSize, [](const Point& point, int i, int bin) {
      const int lane = bin % kPack;
      const float score = scoresAt(point, static_cast<std::size_t>(bin - lane), localOf(i))[lane];
      const float weighted =
          point.weights[bin] * (score - static_cast<float>(point.record->score[localOf(i)]));
      return weighted * static_cast<float>(point.record->powers[powerOf(i)]);
    });
    addUp(visited, shared_.together, padded_, [](const Point& point, int other, int bin) {
      // Later packs' are never read; of a pack that does not count there is nothing to add.
      if (bin / kPack > other / kPack || !(point.counts[other / kPack] > 0.0F)) return 0.0F;
      return point.weights[other] * point.weights[bin];
    });
  }

  /// Adds what points say to `rows` values of each bin.
  template <class ValueOf>
  FIELD_PHENOTYPING_HD void addUp(const mixture::Visited& visited, float* values, int rows,
                                  const ValueOf& valueOf) const {
    for (int i = rank(); i < rows * padded_; i += size()) {
      const int row = i / padded_;
      const int bin = i - row * padded_;
      float sum = values[i];
      for (int k = 0; k < visited.count; ++k) {
        const mixture::PointScratch point = visited[k];
        if (point.counts[bin / kPack] > 0.0F) sum += valueOf(point, row, bin);
      }
      values[i] = sum;
    }
  }

  template <int kIndex = 0, class Lanes>
  FIELD_PHENOTYPING_HD void addCross(const Lanes& lanes, const typename Lanes::Float* weighted,
                                     const float* powers, float* cross) const {
    if constexpr (kIndex < kCrossSectionSize) {
      addTo(lanes, cross + kIndex * padded_,
            weighted[localOf(kIndex)] * lanes.all(powers[powerOf(kIndex)]));
      addCross<kIndex + 1>(lanes, weighted, powers, cross);
    }
  }

  /// Adds the information of the shape, if every point's bin were known, of all points at once.
  FIELD_PHENOTYPING_HD void addStiffness(mixture::Sums& sums) const {
    constexpr int kCount = sumsOf(kLocalShapeSize, 0);
    for (int i = rank(); i < kCount; i += size()) {
      const InformationSum own = informationSum(i);
      const float* const weights = shared_.by_height + own.power * padded_;
      double sum = 0.0;
      for (int k = 0; k < bins_; ++k) {
        sum += shared_.stiffness[k * mixture::kShapePairs + own.pair] *
               static_cast<double>(weights[k]);
      }
      sums.known[i] = sum;
    }
    team_.sync();
  }

  /// What is taken as given follows the parameters: priors, freedom.
  FIELD_PHENOTYPING_HD_ONCE void follow() {
    prior_ = ParameterPrior(known_, extent_, parameters_);
    fillParameters(shared_.sums->known, prior_);
    teamFactor(team_, shared_.matrix, kCrossSectionSize);
    fitted_shape_ = fittedParameters(team_, shared_.matrix, prior_, shared_.right);
    fitted_ = fitted_shape_ + fittedByShares();
  }

  /// How many parameters' worth of the noise the shares were fitted to: minus half of the
  /// derivative of the log-determinant of their information by the logarithm of the noise. Waves of
  /// m periods round the stem that the noise blurs by exp(-m^2 s^2 / (2 r^2)) are known by the
  /// square of that.
  FIELD_PHENOTYPING_HD double fittedByShares() const {
    constexpr double kNegligible = 1e-3;
    const double blur = exponential(parameters_[kNoise]) / parameters_[kRadius];
    const double arc = arcCoverage();
    const double of_points = 0.5 * shared_.sums->members / arc;
    double fitted = 0.0;
    for (int m = 1; 2 * m < bins_; ++m) {
      const double blurred = m * m * blur * blur;
      const double information = of_points * exponential(-blurred);
      const double slope = mixture::kTwoPi * m / bins_;
      const double prior = 0.5 * bins_ * (smoothness_ * slope * slope + kRidge);
      const double more = 2.0 * blurred * information / (information + prior);  // sine and cosine
      fitted += arc * more;
      if (blurred > 1.0 && more < kNegligible) break;
    }
    return fitted;
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
  /// factored. @return how much of it; above 1 where none does
  FIELD_PHENOTYPING_HD_ONCE double factorInformation() const {
    constexpr double kSharesOfComplete[] = {0.0, 0.1, 0.25, 0.5, 1.0};
    for (const double share : kSharesOfComplete) {
      fillInformation(1.0 - share);
      if (teamFactor(team_, shared_.matrix, unknowns_)) return share;
    }
    return 2.0;
  }

  /// The complete information less `observed` times what is missing of it (Louis 1982).
  FIELD_PHENOTYPING_HD void fillInformation(double observed) const {
    team_.sync();
    const mixture::Sums& sums = *shared_.sums;
    if (rank() == 0) {
      forEachInformation([&](int i, int j, int sum) {
        shared_.matrix[i * unknowns_ + j] =
            sums.known[sum] - observed * sums.missing[sum] + (i == j ? prior_.weight[i] : 0.0);
      });
    }
    for (int i = group(); i < kCrossSectionSize; i += groups()) {
      double* const row = shared_.matrix + i * unknowns_ + kCrossSectionSize;
      for (int k = lane(); k < bins_; k += lanes()) {
        row[k] = -observed * (static_cast<double>(shared_.cross[i * padded_ + k]) -
                              sums.cross_outliers[i] * shareOf(k));
      }
      if (lane() == 0) row[bins_] = observed * sums.cross_outliers[i];
    }
    for (int k = group(); k < bins_; k += groups()) {
      double* const row = shared_.matrix + (kCrossSectionSize + k) * unknowns_ + kCrossSectionSize;
      const double share = shareOf(k);
      for (int l = k + lane(); l < bins_; l += lanes()) {
        const double other = shareOf(l);
        double complete = -sums.members * share * other;
        double missing = -static_cast<double>(shared_.together[l * padded_ + k]) -
                         outlyingOf(k) * other - share * outlyingOf(l) + sums.doubt * share * other;
        if (k == l) {
          complete += kRidge + 2.0 * smoothness_ + sums.members * share;
          missing += occupancyOf(k);
        }
        if (l == k + 1 || l == k + bins_ - 1) complete -= smoothness_;
        row[l] = complete - observed * missing;
      }
      if (lane() == 0) row[bins_] = observed * (outlyingOf(k) - sums.doubt * share);
    }
    if (rank() == 0) {
      const double outlier_share = shareAt(trial_odds_);
      shared_.matrix[unknowns_ * unknowns_ - 1] =
          (weight_ * points_.count + kPseudoPoints) * outlier_share * (1.0 - outlier_share) -
          observed * sums.doubt;
    }
    team_.sync();
  }

  /// The score of all unknowns, where the sums were taken.
  FIELD_PHENOTYPING_HD void fillScore() const {
    const mixture::Sums& sums = *shared_.sums;
    for (int i = rank(); i < kCrossSectionSize; i += size()) {
      shared_.right[i] =
          sums.score[i] + prior_.scoreOf(parameters_, i) + (i == kNoise ? fitted_ : 0.0);
    }
    const double* const log_shares = shared_.trial;
    for (int k = rank(); k < bins_; k += size()) {
      const double next = log_shares[k + 1 < bins_ ? k + 1 : 0];
      const double before = log_shares[k > 0 ? k - 1 : bins_ - 1];
      shared_.right[kCrossSectionSize + k] =
          occupancyOf(k) - sums.members * shareOf(k) - kRidge * log_shares[k] +
          smoothness_ * ((next - log_shares[k]) - (log_shares[k] - before));
    }
    if (rank() == 0) {
      const double count = weight_ * points_.count;
      shared_.right[unknowns_ - 1] =
          count - sums.members + kPseudoOutliers - (count + kPseudoPoints) * shareAt(trial_odds_);
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
      const double share = occupancyOf(k) * scale;
      usual += share * share;
      if (occupancyOf(k) > occupancyOf(first)) first = k;
    }
    const auto longest = static_cast<int>(kGap * bins_);
    int unseen = 0;
    int gap = 0;
    for (int k = 1; k <= bins_; ++k) {
      if (occupancyOf((first + k) % bins_) * scale < kStray * usual) {
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
    double* const columns = shared_.columns;
    for (int r = rank(); r < kCrossSectionSize; r += size()) {
      double* const column = columns + r * unknowns_;
      columnOfInverse(shared_.matrix, unknowns_, r, column);
      for (int i = 0; i < kCrossSectionSize; ++i) {
        fit.posterior[i * kCrossSectionSize + r] = column[i];
      }
    }
    for (int k = rank(); k < bins_; k += size()) shared_.trial[k] = shared_.log_shares[k];
    trial_odds_ = outlier_odds_;
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
    const double outlier_share = shareAt(outlier_odds_);
    double* const members = shared_.moved;  // of each patch
    clear(members, mixture::kPatches);
    clearBins();
    team_.sync();
    double squares = 0.0;
    visitPoints<false>(c, [&](const mixture::Visited& visited) {
      for (int j = 0; j < visited.count; ++j) {
        const mixture::PointScratch point = visited[j];
        const mixture::Record& record = *point.record;
        squares += record.score[localOf(kRadius)] * record.score[localOf(kRadius)];
        const auto at = static_cast<int>(record.patch);
        double* const patch = patches + at * unknowns_;
        if (rank() == 0) {
          members[at] += record.member;
          patch[unknowns_ - 1] += 1.0 - record.member - outlier_share;
        }
        for (int i = rank(); i < kCrossSectionSize; i += size()) {
          patch[i] += record.powers[powerOf(i)] * record.score[localOf(i)];
        }
        const auto lanes = team_.lanes();
        forEachCandidate(point, group(), groups(), [&](int k) {
          const auto weight = lanes.load(point.weights + k, 0U, kLanes);
          for (int i = 0; i < kHeightPowers; ++i) {
            addTo(lanes, shared_.by_height + i * padded_ + k,
                  weight * lanes.all(static_cast<float>(record.powers[i])));
          }
          for (int bin = k + lane(); bin < k + kPack && bin < bins_; bin += this->lanes()) {
            patch[kCrossSectionSize + bin] += static_cast<double>(point.weights[bin]);
          }
        });
      }
    });
    double together = 0.0;
    for (int at = 0; at < mixture::kPatches; ++at) {
      const double score = patches[at * unknowns_ + kRadius];
      together += score * score;
    }
    togetherness_ = together / squares;
    addStiffness(sums);
    if (rank() == 0) {
      // The noise is known from the whole of a point.
      double all = 0.0;
      for (int at = 0; at < mixture::kPatches; ++at) all += members[at];
      sums.known[sumsOf(kLocalNoise, kLocalNoise)] = 2.0 * all;
    }
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
      fit.patches[at] = weight_ * weight_ * sum;
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
  int padded_;
  int unknowns_;
  mixture::SharedScratch shared_;
  double* of_points_;
  InformationAdder<kLocalSize, Team> information_;
  ParameterPrior prior_;
  CrossSectionVector parameters_;
  double smoothness_ = 0.0;  // inverse variance of the difference of neighbours
  double share_scale_ = 1.0;
  double weight_ = 1.0;        // of a point
  double togetherness_ = 1.0;  // how much patches of the surface depart from it, in what as many
                               // points would that know nothing of each other
  double outlier_odds_ = 0.0;  // of a point, in their logarithm
  double trial_odds_ = 0.0;    // the same where the sums are taken
  double fitted_shape_ = 0.0;  // parameters that the points, not the priors, decide
  double fitted_ = 0.0;        // those, and what the shares take from the noise
  // Where the sums were taken.
  double likelihood_ = 0.0;  // its logarithm, with the shares' prior
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
  solver.describe(solver.run(kMaxSteps), fit);
  if (solver.countTogether(start)) solver.describe(solver.run(kMaxSteps), fit);
}

}  // namespace field_phenotyping
