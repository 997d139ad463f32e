#include "field_phenotyping/measurement/surface_mixture.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"

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

/// Inverse variances of the noise along and across the direction of a place.
struct Precision {
  double along;
  double across;

  explicit Precision(const CrossSectionVector& p)
      : along(std::exp(-2.0 * (p[kNoise] + p[kElongation]))),
        across(std::exp(-2.0 * (p[kNoise] - p[kElongation]))) {}
};

/// kLanes bins side by side that a point may be of, and what it says if it is.
struct BinGroup {
  Eigen::Index first;  // bin
  Floats weight;       // 0 of a bin that does not count
  std::array<Floats, kLocalSize> score;
  std::array<Floats, kLocalShapeSize> along;  // the part of it that pulls along the direction
};

/// What one point says: the bins that it may be of.
struct Candidates {
  double log_density = 0.0;
  double member = 0.0;           // that it is no outlier; the sum of the weights
  std::vector<BinGroup> groups;  // those with bins that count
  LocalVector score;             // their mean, times `member`
  LocalVector along;
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
  constexpr float kNegligible = -12.0F;  // log-likelihood, from the largest
  constexpr float kNever = -1e30F;
  const double noise = std::exp(p[kNoise]);
  const Precision precision(p);
  const double top_share = log_shares.maxCoeff();
  const double log_sum = top_share + std::log((log_shares.array() - top_share).exp().sum());
  const double scale = std::log1p(-outlier_share_) - std::log(2.0 * M_PI * noise * noise) - log_sum;
  const double log_outlier =
      std::log(outlier_share_ / M_PI) - 2.0 * std::log(std::max(extent_.reach, 1e-9));

  // Of the bins, filled up to whole lanes.
  const Eigen::Index bins = log_shares.size();
  const Eigen::Index padded = paddedBins();
  Eigen::ArrayXf log_weight = Eigen::ArrayXf::Constant(padded, kNever);
  log_weight.head(bins) = (log_shares.array() + scale).cast<float>();
  Eigen::Matrix2d ellipse;
  ellipse << p[kEllipse], p[kEllipse + 1], p[kEllipse + 1], -p[kEllipse];
  Eigen::ArrayX2f directions = Eigen::ArrayX2f::Zero(padded, 2);
  Eigen::ArrayX2f bulges = Eigen::ArrayX2f::Zero(padded, 2);
  directions.topRows(bins) = directions_.transpose().cast<float>();
  bulges.topRows(bins) = (ellipse * directions_).transpose().cast<float>();

  const auto along_precision = static_cast<float>(precision.along);
  const auto across_precision = static_cast<float>(precision.across);
  std::vector<Floats> along(static_cast<std::size_t>(padded) / kLanes);
  std::vector<Floats> across(along.size());
  std::vector<Floats> log_weights(along.size());
  Candidates candidates;
  for (const Eigen::Vector3d& point : *points_) {
    const Eigen::Vector2f offset = (point.head<2>() - centerAt(p, point.z())).cast<float>();
    const auto radius = static_cast<float>(radiusAt(p, point.z()));
    Floats tops = allOf(static_cast<float>(log_outlier));
    for (std::size_t g = 0; g < along.size(); ++g) {
      const auto first = static_cast<Eigen::Index>(g * kLanes);
      const Floats x = loadFloats(&directions(first, 0));
      const Floats y = loadFloats(&directions(first, 1));
      const Floats off_x = offset.x() - radius * x - loadFloats(&bulges(first, 0));
      const Floats off_y = offset.y() - radius * y - loadFloats(&bulges(first, 1));
      along[g] = off_x * x + off_y * y;
      across[g] = off_y * x - off_x * y;
      log_weights[g] =
          loadFloats(&log_weight[first]) -
          0.5F * (along_precision * along[g] * along[g] + across_precision * across[g] * across[g]);
      tops = largerOf(tops, log_weights[g]);
    }
    const float top = std::max(std::max(tops[0], tops[1]), std::max(tops[2], tops[3]));
    candidates.groups.clear();
    Floats sums = {};
    for (std::size_t g = 0; g < along.size(); ++g) {
      const Floats below = log_weights[g] - top;
      const Integers counts = below > kNegligible;
      if (!anyOf(counts)) continue;
      BinGroup group;
      group.first = static_cast<Eigen::Index>(g * kLanes);
      group.weight = counts ? exponentialOf(largerOf(below, allOf(kNegligible))) : Floats{};
      sums += group.weight;
      const Floats x = loadFloats(&directions(group.first, 0));
      const Floats y = loadFloats(&directions(group.first, 1));
      const Floats along_pull = along_precision * along[g];
      const Floats across_pull = across_precision * across[g];
      const Floats pull_x = along_pull * x - across_pull * y;
      const Floats pull_y = along_pull * y + across_pull * x;
      const Floats along_square = along_pull * along[g];
      const Floats across_square = across_pull * across[g];
      group.score = {pull_x,
                     pull_y,
                     along_pull,
                     x * pull_x - y * pull_y,
                     x * pull_y + y * pull_x,
                     along_square + across_square - 2.0F,
                     along_square - across_square};
      group.along = {along_pull * x, along_pull * y, along_pull, along_pull * (x * x - y * y),
                     along_pull * (2.0F * x * y)};
      candidates.groups.push_back(group);
    }
    const double members = static_cast<double>(total(sums));
    const double sum = members + std::exp(log_outlier - static_cast<double>(top));
    candidates.log_density = static_cast<double>(top) + std::log(sum);
    candidates.member = members / sum;
    std::array<Floats, kLocalSize> score = {};
    std::array<Floats, kLocalShapeSize> score_along = {};
    for (BinGroup& group : candidates.groups) {
      group.weight *= static_cast<float>(1.0 / sum);
      for (std::size_t i = 0; i < score.size(); ++i) score[i] += group.weight * group.score[i];
      for (std::size_t i = 0; i < score_along.size(); ++i) {
        score_along[i] += group.weight * group.along[i];
      }
    }
    for (std::size_t i = 0; i < score.size(); ++i) {
      candidates.score[static_cast<Eigen::Index>(i)] = static_cast<double>(total(score[i]));
    }
    for (std::size_t i = 0; i < score_along.size(); ++i) {
      candidates.along[static_cast<Eigen::Index>(i)] = static_cast<double>(total(score_along[i]));
    }
    visit(point, candidates);
  }
}

SurfaceMixture::Evaluation SurfaceMixture::evaluate(const CrossSectionVector& p,
                                                    const Eigen::VectorXd& log_shares) const {
  const auto bins = log_shares.size();
  const Eigen::Index padded = paddedBins();
  const Eigen::Index size = kCrossSectionSize + bins;
  Evaluation result;

  // The priors.
  const CrossSectionVector deviation = p - prior_.mean;
  result.value = -0.5 * deviation.dot(prior_.weight.cwiseProduct(deviation));
  result.value += fitted_ * p[kNoise];  // residual maximum likelihood
  Eigen::VectorXd jumps(bins);
  for (Eigen::Index k = 0; k < bins; ++k) jumps[k] = log_shares[(k + 1) % bins] - log_shares[k];
  result.value -= 0.5 * smoothness_ * jumps.squaredNorm() + 0.5 * kRidge * log_shares.squaredNorm();

  // The points.
  const Eigen::VectorXd shares = sharesOf(log_shares);
  CrossSectionVector score = CrossSectionVector::Zero();
  HeightSums complete;
  HeightSums missing;
  CrossSectionVector cross_outliers = CrossSectionVector::Zero();
  double doubt = 0.0;
  Eigen::ArrayXXf by_height = Eigen::ArrayXXf::Zero(padded, kHeightPowers);  // weights times powers
  Eigen::ArrayXXf cross_lanes = Eigen::ArrayXXf::Zero(padded, kCrossSectionSize);
  Eigen::MatrixXf together_lanes = Eigen::MatrixXf::Zero(padded, padded);
  Eigen::ArrayXf outlying_lanes = Eigen::ArrayXf::Zero(padded);
  const auto addTo = [](float& first, const Floats& values) {
    store(loadFloats(&first) + values, &first);
  };
  visitPoints(p, log_shares, [&](const Eigen::Vector3d& point, const Candidates& c) {
    const HeightPowers powers = heightPowers(point.z());
    const Eigen::Matrix<float, kHeightPowers, 1> light_powers = powers.cast<float>();
    const Eigen::Matrix<float, kLocalSize, 1> mean = c.score.cast<float>();
    result.value += c.log_density;
    result.members += c.member;
    score += spread(c.score, powers);
    const double outside = 1.0 - c.member;
    doubt += c.member * outside;
    cross_outliers += outside * spread(c.score, powers);
    std::array<Floats, kLocalPairs> scatter = {};
    for (const BinGroup& group : c.groups) {
      const Floats& w = group.weight;
      for (int i = 0; i < kHeightPowers - 1; ++i) {
        addTo(by_height(group.first, i), w * light_powers[i]);
      }
      addTo(outlying_lanes[group.first], static_cast<float>(outside) * w);
      std::array<Floats, kLocalSize> deviations;
      std::array<Floats, kLocalSize> weighted;
      for (int i = 0; i < kLocalSize; ++i) {
        const auto at = static_cast<std::size_t>(i);
        deviations[at] = group.score[at] - mean[i];
        weighted[at] = w * deviations[at];
        for (int j = 0; j <= i; ++j) {
          scatter[static_cast<std::size_t>(localPair(i, j))] +=
              weighted[at] * deviations[static_cast<std::size_t>(j)];
        }
      }
      for (int i = 0; i < kCrossSectionSize; ++i) {
        const ParameterEffect& effect = kParameterEffects[static_cast<std::size_t>(i)];
        addTo(cross_lanes(group.first, i),
              weighted[static_cast<std::size_t>(effect.local)] * light_powers[effect.power]);
      }
      for (const BinGroup& other : c.groups) {
        for (int i = 0; i < static_cast<int>(kLanes); ++i) {
          addTo(together_lanes(other.first, group.first + i), w[i] * other.weight);
        }
      }
    }
    LocalPairs known = LocalPairs::Zero();
    LocalPairs second;
    for (int i = 0; i < kLocalSize; ++i) {
      for (int j = 0; j <= i; ++j) {
        const int pair = localPair(i, j);
        second[pair] = static_cast<double>(total(scatter[static_cast<std::size_t>(pair)])) +
                       outside * c.score[i] * c.score[j];
      }
    }
    for (int i = 0; i < kLocalShapeSize; ++i) {
      known[localPair(kLocalNoise, i)] = 2.0 * c.score[i];
      known[localPair(kLocalElongation, i)] = 2.0 * (2.0 * c.along[i] - c.score[i]);
    }
    const double squares = c.score[kLocalNoise] + 2.0 * c.member;
    known[localPair(kLocalNoise, kLocalNoise)] = 2.0 * squares;
    known[localPair(kLocalElongation, kLocalElongation)] = 2.0 * squares;
    known[localPair(kLocalElongation, kLocalNoise)] = 2.0 * c.score[kLocalElongation];
    complete.add(known, powers);
    missing.add(second, powers);
  });
  const Precision precision(p);
  for (Eigen::Index k = 0; k < bins; ++k) {
    const Eigen::Vector2d u = directions_.col(k);
    const SurfaceMotion outward = surfaceMotion(u, u);
    const SurfaceMotion sideward = surfaceMotion(u, Eigen::Vector2d(-u.y(), u.x()));
    LocalPairs stiffness = LocalPairs::Zero();  // of a place: how it moves, twice
    for (int i = 0; i < kLocalShapeSize; ++i) {
      for (int j = 0; j <= i; ++j) {
        stiffness[localPair(i, j)] = precision.along * outward[i] * outward[j] +
                                     precision.across * sideward[i] * sideward[j];
      }
    }
    complete.add(stiffness, by_height.row(k).transpose().matrix().cast<double>());
  }
  result.occupancy = by_height.col(0).head(bins).matrix().cast<double>();
  const Eigen::VectorXd outlying = outlying_lanes.head(bins).matrix().cast<double>();
  const Eigen::MatrixXd together = together_lanes.topLeftCorner(bins, bins).cast<double>();

  score -= prior_.weight.cwiseProduct(deviation);
  score[kNoise] += fitted_;
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
  Eigen::MatrixXd share_missing = -together;
  share_missing.diagonal() += result.occupancy;
  share_missing -= outlying * shares.transpose() + shares * outlying.transpose();
  share_missing += doubt * shares * shares.transpose();

  result.complete = Eigen::MatrixXd::Zero(size, size);
  result.complete.topLeftCorner<kCrossSectionSize, kCrossSectionSize>() = complete.total();
  result.complete.diagonal().head<kCrossSectionSize>() += prior_.weight;
  result.complete.bottomRightCorner(bins, bins) = share_complete;
  result.observed = result.complete;
  result.observed.topLeftCorner<kCrossSectionSize, kCrossSectionSize>() -= missing.total();
  result.observed.bottomRightCorner(bins, bins) -= share_missing;
  const Eigen::MatrixXd cross = cross_lanes.topRows(bins).matrix().transpose().cast<double>() -
                                cross_outliers * shares.transpose();
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

Eigen::Index SurfaceMixture::paddedBins() const {
  constexpr auto kWhole = static_cast<Eigen::Index>(kLanes);
  return (log_shares_.size() + kWhole - 1) / kWhole * kWhole;
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
  std::vector<LocalPairs> informations;
  for (Eigen::Index k = 0; k < bins; ++k) {
    const Eigen::Vector2d u = directions_.col(k);
    const Eigen::Vector2d n = (shape.inverse() * u).normalized();
    const SurfaceMotion motion = surfaceMotion(u, n);
    LocalPairs information = LocalPairs::Zero();
    for (int i = 0; i < kLocalShapeSize; ++i) {
      for (int j = 0; j <= i; ++j) {
        information[localPair(i, j)] = precision.along * motion[i] * motion[j];
      }
    }
    informations.push_back(information);
  }
  HeightSums sums;

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
    patch.head<kCrossSectionSize>() += spread(c.score, heightPowers(point.z()));
    patch.tail(bins) -= c.member * shares;
    LocalPairs information = LocalPairs::Zero();
    for (const BinGroup& group : c.groups) {
      for (Eigen::Index i = 0; i < std::min<Eigen::Index>(kLanes, bins - group.first); ++i) {
        const Eigen::Index k = group.first + i;
        const auto weight = static_cast<double>(group.weight[i]);
        patch[kCrossSectionSize + k] += weight;
        information += weight * informations[static_cast<std::size_t>(k)];
      }
    }
    information[localPair(kLocalNoise, kLocalNoise)] = 2.0 * c.member;
    sums.add(information, heightPowers(point.z()));
  });
  CrossSectionMatrix bound = sums.total();
  bound.diagonal() += prior_.weight;
  const Eigen::MatrixXd moved = rows * patches;
  result.patches = moved * moved.transpose();
  result.bound = bound.llt().solve(CrossSectionMatrix::Identity());
  return result;
}

}  // namespace field_phenotyping
