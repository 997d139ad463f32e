#include "field_phenotyping/measurement/surface_mixture.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr double kBinWidth = 1.0;  // [standard deviations of the noise] bins as far apart make a
                                   // density even to two parts in a thousand
constexpr int kLeastBins = 30;
// Logarithms of the shares change by this much over as much of the surface as the noise blurs: the
// end of an arc may be sharp, noise in how many points there are may not.
constexpr double kJump = 2.5;
constexpr double kRidge = 1e-2;  // inverse variance of a share's logarithm: none is exactly zero
constexpr double kConverged = 1e-5;       // step, relative to the radius
constexpr double kConvergedNoise = 1e-4;  // of its logarithm
constexpr int kHalvings = 8;
// What depends on the parameters but is taken as given, as the share of the outliers, follows them
// in the first steps only, and moves the log-posterior by up to so much.
constexpr int kSettling = 6;
constexpr double kSlack = 1.0;
constexpr double kRounding = 1e-3;    // of the log-posterior: bins that hardly count are left out
constexpr double kMostLogStep = 3.0;  // of a share
constexpr int kSectors = 12;          // patches that the covariance is checked on
constexpr int kSlabs = 3;

// A place of the surface moves by a shift in x and y, by the radius, and by the two components of
// ellipticity; the others are the noise and its elongation.
constexpr int kLocalShapeSize = 5;
constexpr int kLocalNoise = 5;
constexpr int kLocalElongation = 6;
constexpr int kLocalSize = 7;
using LocalVector = Eigen::Matrix<double, kLocalSize, 1>;
using LocalMatrix = Eigen::Matrix<double, kLocalSize, kLocalSize>;

/// Which local quantity a parameter moves, and with which power of height.
struct Effect {
  int local;
  int power;
};
constexpr std::array<Effect, kCrossSectionSize> kEffects = {{{0, 0},
                                                             {1, 0},
                                                             {0, 1},
                                                             {1, 1},
                                                             {0, 2},
                                                             {1, 2},
                                                             {0, 3},
                                                             {1, 3},
                                                             {2, 0},
                                                             {2, 1},
                                                             {2, 2},
                                                             {3, 0},
                                                             {4, 0},
                                                             {kLocalNoise, 0},
                                                             {kLocalElongation, 0}}};

std::array<double, 4> powersOf(double height) {
  return {1.0, height, height * height, height * height * height};
}

CrossSectionVector spread(const LocalVector& local, const std::array<double, 4>& powers) {
  CrossSectionVector result;
  for (int i = 0; i < kCrossSectionSize; ++i) {
    const Effect& effect = kEffects[static_cast<std::size_t>(i)];
    result[i] = powers[static_cast<std::size_t>(effect.power)] * local[effect.local];
  }
  return result;
}

void addSpread(const LocalMatrix& local, const std::array<double, 4>& powers,
               CrossSectionMatrix& sum) {
  for (int j = 0; j < kCrossSectionSize; ++j) {
    const Effect& b = kEffects[static_cast<std::size_t>(j)];
    for (int i = j; i < kCrossSectionSize; ++i) {
      const Effect& a = kEffects[static_cast<std::size_t>(i)];
      sum(i, j) += powers[static_cast<std::size_t>(a.power)] *
                   powers[static_cast<std::size_t>(b.power)] * local(a.local, b.local);
    }
  }
}

/// Inverse variances of the noise along and across the direction of a place.
struct Precision {
  double along;
  double across;

  explicit Precision(const CrossSectionVector& p)
      : along(std::exp(-2.0 * (p[kNoise] + p[kElongation]))),
        across(std::exp(-2.0 * (p[kNoise] - p[kElongation]))) {}
};

/// What one point says: the bins that it may be of.
struct Candidates {
  double log_density = 0.0;
  double member = 0.0;          // that it is no outlier
  std::vector<int> bins;        // those that count
  std::vector<double> weights;  // of the bins; their sum is `member`
  std::vector<LocalVector> scores;
  LocalVector score;  // the mean
};

/// The shares whose logarithms, up to a constant, are given.
Eigen::VectorXd sharesOf(const Eigen::VectorXd& log_shares) {
  const Eigen::VectorXd shares = (log_shares.array() - log_shares.maxCoeff()).exp();
  return shares / shares.sum();
}

}  // namespace

SurfaceMixture::SurfaceMixture(const std::vector<Eigen::Vector3d>& points,
                               const CrossSectionPrior& prior, const StemExtent& extent,
                               const CrossSectionVector& start, double outlier_share)
    : points_(&points),
      given_(prior),
      extent_(extent),
      parameters_(start),
      outlier_share_(outlier_share) {
  const double blur = std::max(std::exp(start[kNoise]) / start[kRadius], kFinest);
  const int bins =
      std::max(kLeastBins, static_cast<int>(std::ceil(2.0 * M_PI / (kBinWidth * blur))));
  directions_.resize(2, bins);
  for (int k = 0; k < bins; ++k) {
    const double angle = 2.0 * M_PI * k / bins;
    directions_.col(k) << std::cos(angle), std::sin(angle);
  }
  smoothness_ = bins * blur / (2.0 * M_PI * kJump * kJump);
  log_shares_ = Eigen::VectorXd::Zero(bins);
  prior_ = ParameterPrior(given_, extent_, parameters_);
  evaluation_ = evaluate(parameters_, log_shares_);
  constexpr double kLeastShare = 0.05;  // of an even one
  const double even = evaluation_.members / bins;
  log_shares_ = (evaluation_.occupancy.array() / even).max(kLeastShare).log();
  update();
  evaluation_ = evaluate(parameters_, log_shares_);
}

template <typename Visitor>
void SurfaceMixture::visitPoints(const CrossSectionVector& p, const Eigen::VectorXd& log_shares,
                                 const Visitor& visit) const {
  constexpr double kNegligible = 12.0;  // of a log-likelihood
  const auto bins = static_cast<int>(log_shares.size());
  const double noise = std::exp(p[kNoise]);
  const Precision precision(p);
  const double top_share = log_shares.maxCoeff();
  const double log_sum = top_share + std::log((log_shares.array() - top_share).exp().sum());
  const double scale = std::log1p(-outlier_share_) - std::log(2.0 * M_PI * noise * noise) - log_sum;
  const double log_outlier =
      std::log(outlier_share_ / M_PI) - 2.0 * std::log(std::max(extent_.reach, 1e-9));
  Eigen::Matrix2d ellipse;
  ellipse << p[kEllipse], p[kEllipse + 1], p[kEllipse + 1], -p[kEllipse];
  const Eigen::Matrix2Xd elongation = ellipse * directions_;
  Eigen::VectorXd log_weights(bins);
  Eigen::VectorXd along(bins);
  Eigen::Matrix2Xd residuals(2, bins);
  Candidates candidates;
  for (const Eigen::Vector3d& point : *points_) {
    const Eigen::Vector2d offset = point.head<2>() - centerAt(p, point.z());
    residuals = (-radiusAt(p, point.z()) * directions_ - elongation).colwise() + offset;
    along = residuals.cwiseProduct(directions_).colwise().sum();
    log_weights = log_shares -
                  0.5 * precision.across * residuals.colwise().squaredNorm().transpose() +
                  0.5 * (precision.across - precision.along) * along.cwiseAbs2();
    log_weights.array() += scale;
    const double top = std::max(log_weights.maxCoeff(), log_outlier);
    double sum = std::exp(log_outlier - top);
    candidates.bins.clear();
    candidates.weights.clear();
    candidates.scores.clear();
    for (int k = 0; k < bins; ++k) {
      if (log_weights[k] < top - kNegligible) continue;
      candidates.bins.push_back(k);
      candidates.weights.push_back(std::exp(log_weights[k] - top));
      sum += candidates.weights.back();
    }
    candidates.log_density = top + std::log(sum);
    candidates.member = 0.0;
    candidates.score.setZero();
    for (std::size_t j = 0; j < candidates.bins.size(); ++j) {
      candidates.weights[j] /= sum;
      candidates.member += candidates.weights[j];
      const int k = candidates.bins[j];
      const Eigen::Vector2d u = directions_.col(k);
      const Eigen::Vector2d r = residuals.col(k);
      const Eigen::Vector2d tangent(-u.y(), u.x());
      const double across = tangent.dot(r);
      const double along_pull = precision.along * along[k];
      const double across_pull = precision.across * across;
      const double along_square = along_pull * along[k];
      const double across_square = across_pull * across;
      LocalVector score;
      score << surfaceMotion(u, along_pull * u + across_pull * tangent),
          along_square + across_square - 2.0, along_square - across_square;
      candidates.score += candidates.weights[j] * score;
      candidates.scores.push_back(score);
    }
    visit(point, candidates);
  }
}

SurfaceMixture::Evaluation SurfaceMixture::evaluate(const CrossSectionVector& p,
                                                    const Eigen::VectorXd& log_shares) const {
  const auto bins = log_shares.size();
  const Eigen::Index size = kCrossSectionSize + bins;
  Evaluation result;

  // The priors.
  const CrossSectionVector deviation = p - prior_.mean;
  result.value = -0.5 * deviation.dot(prior_.weight.cwiseProduct(deviation));
  result.value += fitted_ * p[kNoise];  // residual maximum likelihood
  Eigen::VectorXd jumps(bins);
  for (Eigen::Index k = 0; k < bins; ++k) jumps[k] = log_shares[(k + 1) % bins] - log_shares[k];
  result.value -= 0.5 * smoothness_ * jumps.squaredNorm() + 0.5 * kRidge * log_shares.squaredNorm();

  const Precision precision(p);
  std::vector<LocalMatrix> stiffness;  // of the bins: how a place moves, twice
  for (Eigen::Index k = 0; k < bins; ++k) {
    const Eigen::Vector2d u = directions_.col(k);
    const auto outward = surfaceMotion(u, u);
    const auto sideward = surfaceMotion(u, Eigen::Vector2d(-u.y(), u.x()));
    LocalMatrix both = LocalMatrix::Zero();
    both.topLeftCorner<kLocalShapeSize, kLocalShapeSize>() =
        precision.along * outward * outward.transpose() +
        precision.across * sideward * sideward.transpose();
    stiffness.push_back(both);
  }
  const Eigen::VectorXd shares = sharesOf(log_shares);
  CrossSectionVector score = CrossSectionVector::Zero();
  CrossSectionMatrix complete = CrossSectionMatrix::Zero();
  CrossSectionMatrix missing = CrossSectionMatrix::Zero();
  Eigen::MatrixXd cross = Eigen::MatrixXd::Zero(kCrossSectionSize, bins);
  CrossSectionVector cross_outliers = CrossSectionVector::Zero();
  Eigen::MatrixXd together = Eigen::MatrixXd::Zero(bins, bins);
  Eigen::VectorXd outlying = Eigen::VectorXd::Zero(bins);
  double doubt = 0.0;
  result.occupancy = Eigen::VectorXd::Zero(bins);
  visitPoints(p, log_shares, [&](const Eigen::Vector3d& point, const Candidates& c) {
    const std::array<double, 4> powers = powersOf(point.z());
    result.value += c.log_density;
    result.members += c.member;
    score += spread(c.score, powers);
    const double outside = 1.0 - c.member;
    doubt += c.member * outside;
    LocalMatrix second = -c.score * c.score.transpose();
    LocalMatrix known = LocalMatrix::Zero();
    double squares = 0.0;
    double difference = 0.0;
    for (std::size_t j = 0; j < c.bins.size(); ++j) {
      const int k = c.bins[j];
      const double w = c.weights[j];
      known += w * stiffness[static_cast<std::size_t>(k)];
      const Eigen::Vector2d u = directions_.col(k);
      const Eigen::Vector2d pull = c.scores[j].head<2>();
      const Eigen::Vector2d mirrored = 2.0 * u.dot(pull) * u - pull;
      known.col(kLocalElongation).head<kLocalShapeSize>() += 2.0 * w * surfaceMotion(u, mirrored);
      squares += w * (c.scores[j][kLocalNoise] + 2.0);
      difference += w * c.scores[j][kLocalElongation];
      second.noalias() += w * c.scores[j] * c.scores[j].transpose();
      cross.col(k) += w * spread(c.scores[j] - c.score, powers);
      result.occupancy[k] += w;
      outlying[k] += outside * w;
      for (std::size_t i = 0; i <= j; ++i) together(k, c.bins[i]) += w * c.weights[i];
    }
    cross_outliers += outside * spread(c.score, powers);
    known.col(kLocalNoise).head<kLocalShapeSize>() = 2.0 * c.score.head<kLocalShapeSize>();
    known.bottomRightCorner<2, 2>() << 2.0 * squares, 2.0 * difference, 2.0 * difference,
        2.0 * squares;
    known.bottomLeftCorner<2, kLocalShapeSize>() =
        known.topRightCorner<kLocalShapeSize, 2>().transpose();
    addSpread(known, powers, complete);
    addSpread(second, powers, missing);
  });

  score -= prior_.weight.cwiseProduct(deviation);
  score[kNoise] += fitted_;
  complete.diagonal() += prior_.weight;
  result.score.resize(size);
  result.score.head<kCrossSectionSize>() = score;
  Eigen::MatrixXd smooth = Eigen::MatrixXd::Zero(bins, bins);
  smooth.diagonal().setConstant(kRidge + 2.0 * smoothness_);
  Eigen::VectorXd share_score = result.occupancy - result.members * shares - kRidge * log_shares;
  for (Eigen::Index k = 0; k < bins; ++k) {
    const Eigen::Index next = (k + 1) % bins;
    smooth(next, k) -= smoothness_;
    smooth(k, next) -= smoothness_;
    share_score[k] += smoothness_ * jumps[k];
    share_score[next] -= smoothness_ * jumps[k];
  }
  result.score.tail(bins) = share_score;

  Eigen::MatrixXd share_complete = smooth;
  share_complete.diagonal() += result.members * shares;
  share_complete -= result.members * shares * shares.transpose();
  Eigen::MatrixXd share_missing = -(together + Eigen::MatrixXd(together.transpose()));
  share_missing.diagonal() += together.diagonal() + result.occupancy;
  share_missing -= outlying * shares.transpose() + shares * outlying.transpose();
  share_missing += doubt * shares * shares.transpose();

  result.complete = Eigen::MatrixXd::Zero(size, size);
  result.complete.topLeftCorner<kCrossSectionSize, kCrossSectionSize>() =
      complete.selfadjointView<Eigen::Lower>();
  result.complete.bottomRightCorner(bins, bins) = share_complete;
  result.observed = result.complete;
  result.observed.topLeftCorner<kCrossSectionSize, kCrossSectionSize>() -=
      CrossSectionMatrix(missing.selfadjointView<Eigen::Lower>());
  result.observed.bottomRightCorner(bins, bins) -= share_missing;
  cross -= cross_outliers * shares.transpose();
  result.observed.topRightCorner(kCrossSectionSize, bins) = -cross;
  result.observed.bottomLeftCorner(bins, kCrossSectionSize) = -cross.transpose();
  return result;
}

void SurfaceMixture::update() {
  prior_ = ParameterPrior(given_, extent_, parameters_);
  constexpr double kPseudoOutliers = 0.5, kPseudoPoints = 5.0;  // keep the share off 0 and 1
  const auto count = static_cast<double>(points_->size());
  outlier_share_ = (count - evaluation_.members + kPseudoOutliers) / (count + kPseudoPoints);
  const CrossSectionMatrix inverse =
      evaluation_.complete.topLeftCorner<kCrossSectionSize, kCrossSectionSize>().llt().solve(
          CrossSectionMatrix::Identity());
  fitted_ = kNoise - prior_.weight.head<kNoise>().dot(inverse.diagonal().head<kNoise>());
}

Eigen::LLT<Eigen::MatrixXd> SurfaceMixture::information() const {
  for (const double share : {0.0, 0.1, 0.25, 0.5}) {
    Eigen::LLT<Eigen::MatrixXd> factors((1.0 - share) * evaluation_.observed +
                                        share * evaluation_.complete);
    if (factors.info() == Eigen::Success) return factors;
  }
  return evaluation_.complete.llt();
}

bool SurfaceMixture::run(int steps) {
  const Eigen::Index bins = log_shares_.size();
  for (int i = 0; i < steps; ++i) {
    const Eigen::VectorXd wished = information().solve(evaluation_.score);
    if (!wished.allFinite()) return false;
    CrossSectionVector move = wished.head<kCrossSectionSize>();
    const double length = std::max(move.norm(), 1e-300);
    limitStep(parameters_, move);
    Eigen::VectorXd shift = wished.tail(bins) * std::min(1.0, move.norm() / length);
    shift *= std::min(1.0, kMostLogStep / std::max(shift.cwiseAbs().maxCoeff(), 1e-300));
    Evaluation next = evaluate(parameters_ + move, log_shares_ + shift);
    const bool settled = steps_ >= kSettling;
    const double least = evaluation_.value - (settled ? kRounding : kSlack);
    for (int halving = 0; !(next.value >= least) && halving < kHalvings; ++halving) {
      move *= 0.5;
      shift *= 0.5;
      next = evaluate(parameters_ + move, log_shares_ + shift);
    }
    parameters_ += move;
    log_shares_ += shift;
    evaluation_ = std::move(next);
    ++steps_;
    if (!settled) update();
    if (steps_ == kSettling) evaluation_ = evaluate(parameters_, log_shares_);
    const double moved = move.segment<2>(kCenter).norm() + std::abs(move[kRadius]) +
                         move.segment<2>(kEllipse).norm();
    if (moved < kConverged * parameters_[kRadius] && std::abs(move[kNoise]) < kConvergedNoise) {
      return true;
    }
  }
  return false;
}

double SurfaceMixture::surfacePoints() const {
  return evaluation_.members;
}

double SurfaceMixture::freedom() const {
  return surfacePoints() - fitted_ + 0.5 * prior_.weight[kNoise];
}

double SurfaceMixture::arcCoverage() const {
  constexpr double kStray = 0.2;         // of the usual density, below which a bin is not seen
  constexpr double kGap = 40.0 / 360.0;  // shorter ones are chance
  const Eigen::ArrayXd shares = evaluation_.occupancy.array() / evaluation_.members;
  const double least = kStray * shares.square().sum();
  const Eigen::Index bins = shares.size();
  Eigen::Index first = 0;  // where to begin: at a bin that is seen
  shares.maxCoeff(&first);
  const auto longest = static_cast<Eigen::Index>(kGap * static_cast<double>(bins));
  Eigen::Index unseen = 0;
  Eigen::Index run = 0;
  for (Eigen::Index k = 1; k <= bins; ++k) {
    if (shares[(first + k) % bins] < least) {
      ++run;
      continue;
    }
    if (run > longest) unseen += run;
    run = 0;
  }
  return 1.0 - static_cast<double>(unseen) / static_cast<double>(bins);
}

SurfaceMixture::Covariance SurfaceMixture::covariance() const {
  Covariance result;
  if (!parameters_.allFinite() || !evaluation_.complete.allFinite()) return result;
  result.valid = true;
  const Eigen::Index bins = log_shares_.size();
  const Eigen::Index size = kCrossSectionSize + bins;
  const Eigen::MatrixXd rows =
      information().solve(Eigen::MatrixXd::Identity(size, kCrossSectionSize)).transpose();
  result.posterior = rows.leftCols<kCrossSectionSize>();

  // What a point says of the surface at best: how far off it is along the normal (Kanatani 1998).
  Eigen::Matrix2d shape;
  shape << parameters_[kRadius] + parameters_[kEllipse], parameters_[kEllipse + 1],
      parameters_[kEllipse + 1], parameters_[kRadius] - parameters_[kEllipse];
  const Precision precision(parameters_);
  std::vector<LocalMatrix> informations;
  for (Eigen::Index k = 0; k < bins; ++k) {
    const Eigen::Vector2d u = directions_.col(k);
    const Eigen::Vector2d n = (shape.inverse() * u).normalized();
    LocalVector motion = LocalVector::Zero();
    motion.head<kLocalShapeSize>() = surfaceMotion(u, n);
    informations.push_back(precision.along * motion * motion.transpose());
  }
  CrossSectionMatrix bound = prior_.weight.asDiagonal();

  const auto [low, high] = std::minmax_element(
      points_->begin(), points_->end(),
      [](const Eigen::Vector3d& a, const Eigen::Vector3d& b) { return a.z() < b.z(); });
  const double slab = std::max(high->z() - low->z(), 1e-9) / kSlabs;
  const Eigen::VectorXd shares = sharesOf(log_shares_);
  Eigen::MatrixXd patches = Eigen::MatrixXd::Zero(size, kSectors * kSlabs);
  visitPoints(parameters_, log_shares_, [&](const Eigen::Vector3d& point, const Candidates& c) {
    const Eigen::Vector2d offset = point.head<2>() - centerAt(parameters_, point.z());
    const double turn = std::atan2(offset.y(), offset.x()) / (2.0 * M_PI) + 0.5;
    const int sector = std::min(static_cast<int>(turn * kSectors), kSectors - 1);
    const int level = std::min(static_cast<int>((point.z() - low->z()) / slab), kSlabs - 1);
    auto patch = patches.col(level * kSectors + sector);
    patch.head<kCrossSectionSize>() += spread(c.score, powersOf(point.z()));
    patch.tail(bins) -= c.member * shares;
    LocalMatrix information = LocalMatrix::Zero();
    for (std::size_t j = 0; j < c.bins.size(); ++j) {
      patch[kCrossSectionSize + c.bins[j]] += c.weights[j];
      information += c.weights[j] * informations[static_cast<std::size_t>(c.bins[j])];
    }
    information(kLocalNoise, kLocalNoise) = 2.0 * c.member;
    addSpread(information, powersOf(point.z()), bound);
  });
  const Eigen::MatrixXd moved = rows * patches;
  result.patches = moved * moved.transpose();
  result.bound = CrossSectionMatrix(bound.selfadjointView<Eigen::Lower>())
                     .llt()
                     .solve(CrossSectionMatrix::Identity());
  return result;
}

}  // namespace field_phenotyping
