#include "field_phenotyping/segmentation/midline.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/log_sum.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/segmentation/curve_samples.hpp"
#include "field_phenotyping/segmentation/stem_curve.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kMinPoints = 8U;
constexpr double kPointEvidence = 1.0;  // [log likelihood] what one point could say for a stem
constexpr double kMinSpread = 0.002;    // [m]
constexpr double kMaxSpread = 0.012;    // [m] beyond it nothing tells a stem from what is round it

/// Sizes that go with the plant's: what is a short stretch of a tall stem is all of a seedling's.
struct Scale {
  double reach;       ///< [m] from a centre within which a stem's points are looked for
  double thickest;    ///< [m] radius
  double spacing;     ///< [m] of the curve's nodes
  double share_band;  ///< [m] with a share of stem points of its own
  double stretch;     ///< [m] that a fit begins with
  double extension;   ///< [m] that it goes on by
  bool young;

  Scale(float max_radius, float plant_height) {
    constexpr double kFull = 1.2;      // [m] plants as high as this show stems a full step long
    constexpr double kLeast = 0.25;    // of full steps
    constexpr double kSlender = 50.0;  // heights of a plant to the radius of its stem, at least
    constexpr double kStocky = 0.006;  // [m] radius that seedlings reach though they are low
    const auto widest = static_cast<double>(max_radius);
    const auto height = static_cast<double>(plant_height);
    const double size = std::clamp(height / kFull, kLeast, 1.0);
    thickest = std::min(widest, std::max(height / kSlender, kStocky));
    reach = 1.2 * std::sqrt(widest * thickest);
    spacing = 0.05 * size;
    share_band = 0.10 * size;
    stretch = 0.40 * size;
    extension = 0.10 * size;
    young = isYoung(plant_height);
  }
};

/// Bands with a share of stem points of their own.
std::size_t countBands(const StemCurve& curve, const Scale& scale) {
  return static_cast<std::size_t>(std::ceil(curve.length() / scale.share_band)) + 1U;
}

/// Places samples on the nodes and bands of a curve.
void placeOn(const StemCurve& curve, const Scale& scale, std::vector<Sample>& samples) {
  const auto last = static_cast<double>(countBands(curve, scale) - 1U);
  for (Sample& sample : samples) {
    const StemCurve::Place place = curve.placeOf(sample.height);
    sample.node = static_cast<std::uint32_t>(place.node);
    sample.share = place.share;
    sample.band =
        static_cast<std::uint32_t>(std::clamp(sample.height / scale.share_band, 0.0, last));
  }
}

/// Expectation maximisation of a stem among clutter. Every height band has its own share of stem
/// points, so that bands full of leaves, or without any stem, do not draw the curve. Only samples
/// of the active range of heights are looked at; elsewhere the curve runs on straight.
class CurveFit {
 public:
  /// @param samples by height, placed on the curve's nodes
  CurveFit(const CurveSamples& samples, StemCurve start, const Scale& scale)
      : samples_(&samples),
        curve_(std::move(start)),
        scale_(scale),
        reach_(scale.reach),
        posterior_(samples.padded(), 0.0F) {
    shares_.assign(countBands(curve_, scale_), 0.5);
    trust_.assign(shares_.size(), 1.0);
  }

  /// The same curve among other samples, placed on the same nodes.
  CurveFit over(const CurveSamples& samples) const {
    CurveFit fit = *this;
    fit.samples_ = &samples;
    fit.posterior_.assign(samples.padded(), 0.0F);
    fit.setActive(low_, high_);
    return fit;
  }

  double length() const { return curve_.length(); }
  const StemCurve& curve() const { return curve_; }
  bool sameCurve(const CurveFit& other) const {
    return curve_.centers == other.curve_.centers && curve_.radius == other.curve_.radius;
  }

  void setActive(double low, double high) {
    low_ = low;
    high_ = high;
    first_ = firstFrom([&](const Sample& sample) { return sample.height >= low; });
    end_ = firstFrom([&](const Sample& sample) { return sample.height > high; });
  }

  /// Lets points below a height lie farther from the surface. A stem surely goes on down to the
  /// soil, so its foot may be looked for where the curve, carried on straight, misses it.
  void loosenBelow(double height, double spread) {
    foot_ = height;
    foot_spread_ = spread;
  }

  /// Trusts a stretch where points crowd within the stem's skin, and hardly where as many lie in
  /// the ring round it: leaves, which would draw the curve their way.
  void judge(double low, double high) {
    const std::size_t first = bandOf(low);
    const std::size_t last = bandOf(high);
    std::vector<double> inside(last - first + 1U, 0.0);
    std::vector<double> around(inside.size(), 0.0);
    const std::size_t begin = firstFrom([&](const Sample& sample) { return sample.band >= first; });
    for (std::size_t i = begin; i < samples_->size(); ++i) {
      const Sample& sample = (*samples_)[i];
      const std::size_t band = sample.band;
      if (band > last) break;
      const double skin = curve_.radiusAt(sample.height) + 2.0 * spreadAt(sample.height);
      const double squared = (sample.offset - curve_.centerAt(sample)).squaredNorm();
      if (squared < skin * skin) {
        inside[band - first] += 1.0;
      } else if (squared < 4.0 * skin * skin) {
        around[band - first] += 1.0;
      }
    }
    constexpr double kSureExcess = 0.3;
    constexpr double kLeastTrust = 0.05;
    for (std::size_t k = 0; k < inside.size(); ++k) {
      const double excess = inside[k] - around[k];
      trust_[first + k] =
          std::clamp(excess / (kSureExcess * (inside[k] + around[k]) + 1e-9), kLeastTrust, 1.0);
    }
  }

  /// The stem as a blob of points of that width, which finds it from afar.
  void fitBlob(double width) {
    spread_ = width;
    iterate(false);
  }

  /// The stem as its surface.
  void fitSurface(double spread) {
    spread_ = spread;
    iterate(true);
  }

  /// Robust standard deviation of the stem points about the surface.
  double surfaceSpread() const {
    double sum = 0.0;
    double total = 1e-9;
    for (std::size_t i = first_; i < end_; ++i) {
      if (!(posterior_[i] > 0.0F)) continue;
      const Sample& sample = (*samples_)[i];
      const double away =
          (sample.offset - curve_.centerAt(sample)).norm() - curve_.radiusAt(sample.height);
      const double trust = trust_[sample.band];
      const double weight = static_cast<double>(posterior_[i]) * trust * trust;
      sum += weight * away * away;
      total += weight;
    }
    return std::clamp(std::sqrt(sum / total), kMinSpread, kMaxSpread);
  }

  /// Whether a stem ends below [low, high], which no fit has seen yet: there are points, but they
  /// have left the core of the curve carried on straight, where the stem below has many. A fit
  /// that went on would follow a leaf of the open whorl.
  bool emptyCore(double low, double high) const {
    double core = 0.0;
    double near = 0.0;
    double below = 0.0;
    for (const Sample& sample : *samples_) {
      if (sample.height > high) break;
      const double distance = (sample.offset - curve_.centerAt(sample)).norm();
      const double skin = curve_.radiusAt(sample.height) + spreadAt(sample.height);
      if (sample.height < low) {
        if (distance < skin && sample.height > low_) below += 1.0;
      } else if (distance < skin) {
        core += 1.0;
      } else if (distance < 3.0 * skin) {
        near += 1.0;
      }
    }
    constexpr double kEmpty = 0.1;   // of what the stem shows below
    constexpr double kLeaves = 2.0;  // the same
    const double expected = below * (high - low) / std::max(low - std::max(low_, 0.0), 1e-3);
    return core < kEmpty * expected && near > kLeaves * expected;
  }

  /// Keeps the centres about where they are now.
  void anchor(double stddev) {
    anchors_ = curve_.centers;
    anchor_stddev_ = stddev;
  }

  /// Starts the surface at a typical radius, which also is its prior.
  void setRadius(double typical) {
    typical_radius_ = typical;
    curve_.taper = -kTaper * typical;
    curve_.radius = typical - curve_.taper * 0.5 * (std::max(low_, 0.0) + high_);
  }

  /// A fit over other samples that goes on from this one's curve, carried on straight.
  CurveFit continuedOver(const CurveSamples& samples, const StemCurve& wanted, double low,
                         double high) const {
    CurveFit fit(samples, wanted, scale_);
    const double first = low;
    const Eigen::Vector2d foot = curve_.centers.front();
    const Eigen::Vector2d top = curve_.centers.back();
    const Eigen::Vector2d slope = (top - foot) / length();
    for (std::size_t k = 0; k < fit.curve_.centers.size(); ++k) {
      const double height = fit.curve_.spacing * static_cast<double>(k) - first;
      fit.curve_.centers[k] = height < 0.0 ? Eigen::Vector2d(foot + height * slope)
                              : height > length()
                                  ? Eigen::Vector2d(top + (height - length()) * slope)
                                  : curve_.centerAt(height);
    }
    fit.setActive(low, high);
    fit.spread_ = spread_;
    fit.typical_radius_ = typical_radius_;
    fit.curve_.taper = curve_.taper;
    fit.curve_.radius = curve_.radius - curve_.taper * first;
    return fit;
  }

  /// Log likelihood gained by a stem there over clutter alone, with the curve carried on straight
  /// beyond [low, high]. No band says more than a few points of a stem would, since leaves are
  /// dense.
  double evidence(double low, double high) const {
    const std::vector<double> bands = evidenceOfBands(low, high);
    return std::accumulate(bands.begin(), bands.end(), 0.0);
  }

  /// The same of a stem that stands on the soil: a band counts by the share of what the bands below
  /// it could show that they do show. A leaf has nothing below.
  /// @param possible of possibleEvidence()
  double rootedEvidence(double low, double high, const std::vector<double>& possible) const {
    return rooted(evidenceOfBands(low, high), possible);
  }

  /// Both.
  std::array<double, 2> evidences(double low, double high,
                                  const std::vector<double>& possible) const {
    const std::vector<double> bands = evidenceOfBands(low, high);
    return {std::accumulate(bands.begin(), bands.end(), 0.0), rooted(bands, possible)};
  }

  /// What the samples of each band could say for a stem.
  std::vector<double> possibleEvidence(const CurveSamples& samples) const {
    std::vector<double> possible(shares_.size(), 0.0);
    for (const Sample& sample : samples) possible[sample.band] += kPointEvidence;
    return possible;
  }

 private:
  static constexpr double kTaper = 0.25;        // share of the radius lost per metre
  static constexpr double kTaperStddev = 0.12;  // of the same

  double mostEvidence() const { return static_cast<double>(kMostEvidence) * scale_.share_band; }

  double rooted(const std::vector<double>& bands, const std::vector<double>& possible) const {
    double sum = 0.0;
    double shown = 0.0;
    double could_show = 0.0;
    for (std::size_t band = 0; band < bands.size(); ++band) {
      shown += bands[band];
      could_show += std::min(possible[band], mostEvidence());
      if (could_show > 0.0) sum += bands[band] * std::pow(std::min(shown / could_show, 1.0), 2);
    }
    return sum;
  }

  std::vector<double> evidenceOfBands(double low, double high) const {
    return withWideVectors([&] { return bandEvidence(low, high); });
  }
  std::vector<double> bandEvidence(double low, double high) const {
    constexpr std::array<float, 2> kShares{0.2F, 0.7F};
    std::vector<std::array<LogSum, 2>> gains(shares_.size());
    constexpr float kLoosen = 0.01F;  // [m/m] what a straight continuation may miss by
    const auto reach = static_cast<float>(reach_);
    const auto surest = static_cast<float>(spread_);
    const auto norm = static_cast<float>(kSqrtTwoPi * 2.0 * M_PI * clutter());
    const Floats none{};
    samples_->forEachRun(0U, samples_->size(), [&](const CurveSamples::Run& run) {
      const Sample& first = (*samples_)[run.begin];
      const Eigen::Vector2f center = curve_.centers[first.node].cast<float>();
      const Eigen::Vector2f step =
          (curve_.centers[first.node + 1U] - curve_.centers[first.node]).cast<float>();
      std::array<LogSum, 2>& band = gains[first.band];
      for (std::size_t i = run.begin; i < run.end; i += kLanes) {
        const CurveSamples::Lanes at = samples_->lanesFrom(i);
        const Floats x = at.u - (center.x() + at.share * step.x());
        const Floats y = at.v - (center.y() + at.share * step.y());
        const Floats squared = x * x + y * y;
        const Integers counts = lanesBefore(run.end - i) & (squared <= reach * reach);
        if (!anyOf(counts)) continue;
        const Floats beyond = kLoosen * largerOf(largerOf(static_cast<float>(low) - at.height,
                                                          at.height - static_cast<float>(high)),
                                                 none);
        const Floats spread = squareRootOf(surest * surest + beyond * beyond);
        const Floats radius = largerOf(
            static_cast<float>(curve_.radius) + static_cast<float>(curve_.taper) * at.height,
            allOf(static_cast<float>(curve_.thinnest())));
        const Floats z = (squareRootOf(squared) - radius) / spread;
        const Integers near = counts & (z * z < static_cast<float>(kFarthest * kFarthest));
        const Floats density = exponentialOf(near ? -0.5F * z * z : none);
        const Floats ratio = near ? density / (norm * spread * largerOf(radius, spread)) : none;
        for (std::size_t k = 0; k < kShares.size(); ++k) {
          const Floats gain = counts ? 1.0F + kShares[k] * (ratio - 1.0F) : allOf(1.0F);
          band[k].add(static_cast<double>(gain[0] * gain[1]) *
                      static_cast<double>(gain[2] * gain[3]));
        }
      }
    });
    std::vector<double> bands;
    for (const std::array<LogSum, 2>& band : gains) {
      bands.push_back(std::min(std::max({0.0, band[0].value(), band[1].value()}), mostEvidence()));
    }
    return bands;
  }

  /// Index of the first sample, by height, for which `reached` holds.
  template <class Reached>
  std::size_t firstFrom(Reached&& reached) const {
    const auto found = std::partition_point(samples_->begin(), samples_->end(),
                                            [&](const Sample& sample) { return !reached(sample); });
    return static_cast<std::size_t>(found - samples_->begin());
  }

  std::size_t bandOf(double height) const {
    return static_cast<std::size_t>(
        std::clamp(height / scale_.share_band, 0.0, static_cast<double>(shares_.size() - 1U)));
  }

  static constexpr double kFarthest = 5.6;  // standard deviations: exp(-16) changes nothing
  static constexpr double kSqrtTwoPi = 2.5066282746310002;
  double clutter() const { return 1.0 / (M_PI * reach_ * reach_); }

  double reachAt(double height) const {
    return height < foot_ && foot_spread_ > 0.0 ? reach_ + 2.0 * foot_spread_ : reach_;
  }
  double spreadAt(double height) const {
    return height < foot_ ? std::max(foot_spread_, spread_) : spread_;
  }

  void iterate(bool surface) {
    withWideVectors([&] { maximise(expect(surface), surface); });
  }

  /// How probably each point is the stem's, and what the points then say, by cells between nodes.
  std::vector<CellSums> expect(bool surface) {
    std::vector<double> stem(shares_.size(), 0.0);
    std::vector<double> all(shares_.size(), 0.0);
    std::vector<CellSums> cells(curve_.centers.size());
    const auto expectBetween = [&](std::size_t first, std::size_t end, double height) {
      Skin skin{spreadAt(height), reachAt(height)};
      samples_->forEachRun(first, end, [&](const CurveSamples::Run& run) {
        const Sample& sample = (*samples_)[run.begin];
        const std::size_t band = sample.band;
        skin.odds = (1.0 - shares_[band]) / shares_[band] * clutter();
        skin.trust = trust_[band];
        CellSums& cell = cells[sample.node];
        const CurveSamples::Share share =
            surface ? samples_->expectSurface(run, curve_, skin, cell, posterior_)
                    : samples_->expectBlob(run, curve_, skin, cell, posterior_);
        stem[band] += share.stem;
        all[band] += share.all;
      });
    };
    const std::size_t above_foot = std::clamp(
        firstFrom([&](const Sample& sample) { return sample.height >= foot_; }), first_, end_);
    expectBetween(first_, above_foot, -std::numeric_limits<double>::max());
    expectBetween(above_foot, end_, std::numeric_limits<double>::max());
    for (std::size_t band = 0; band < shares_.size(); ++band) {
      shares_[band] = std::clamp((stem[band] + 0.5) / (all[band] + 1.0), 0.02, 0.98);
    }
    return cells;
  }

  /// Weighted least squares of the centres, and of radius and taper with the surface, under a prior
  /// that stems bend little. Unknowns: u, v of every node, with the surface also radius and taper.
  void maximise(const std::vector<CellSums>& cells, bool surface) {
    const std::size_t nodes = curve_.centers.size();
    CurveEquations equations(nodes);
    for (std::size_t k = 0; k + 1U < nodes; ++k) {
      const CellSums& cell = cells[k];
      if (!(cell.points > 0.0)) continue;
      // Points of one cell err together (leaf bases, out-of-roundness), so many count as a few.
      constexpr double kMostPoints = 12.0;
      const double few = std::min(1.0, kMostPoints / cell.points);
      cell.addTo(equations, k, few);
    }

    equations.addBending(curve_.spacing);
    equations.addHold(anchors_.empty() ? curve_.centers : anchors_, anchor_stddev_);
    if (surface) {
      const double level = 1.0 / std::pow(kRadiusStddev * typical_radius_, 2);
      const double slope = 1.0 / std::pow(kTaperStddev * typical_radius_, 2);
      const Eigen::Vector2d row(1.0, 0.5 * (std::max(low_, 0.0) + high_));
      equations.addRadius(level * row * row.transpose(), level * typical_radius_ * row);
      equations.addRadius(Eigen::Vector2d(0.0, slope).asDiagonal(),
                          {0.0, -slope * kTaper * typical_radius_});
    }

    const Eigen::VectorXd solved = std::move(equations).solve(surface);
    if (!solved.allFinite()) return;
    for (std::size_t k = 0; k < nodes; ++k) {
      curve_.centers[k] = solved.segment<2>(2 * static_cast<Eigen::Index>(k));
    }
    if (surface) {
      const Eigen::Vector2d radius = solved.tail<2>();
      curve_.taper = std::min(radius[1], 0.0);
      curve_.radius = std::max(radius[0], 1e-3);
    }
  }

  static constexpr double kRadiusStddev = 0.25;  // of the typical radius

  const CurveSamples* samples_;
  StemCurve curve_;
  Scale scale_;
  double reach_;
  double low_ = 0.0;
  double high_ = 0.0;
  std::size_t first_ = 0U;  // active samples
  std::size_t end_ = 0U;
  double spread_ = 0.0;
  double foot_ = -std::numeric_limits<double>::infinity();
  double foot_spread_ = 0.0;
  double typical_radius_ = 0.0;
  std::vector<Eigen::Vector2d> anchors_;          // empty: where the centres are
  double anchor_stddev_ = CurveEquations::kFree;  // [m]
  std::vector<double> shares_;
  std::vector<double> trust_;
  std::vector<float> posterior_;
};

/// Where a stem in that direction would have most points low above the soil.
Eigen::Vector2d densestFoot(const std::vector<Sample>& samples, const Eigen::Vector2d& upright,
                            const Scale& scale) {
  constexpr std::size_t kMostSamples = 200U;
  std::vector<Eigen::Vector2d> low;
  for (const Sample& sample : samples) {
    if (sample.height > 0.0 && sample.height < 0.5 * scale.stretch) {
      low.push_back(sample.offset - sample.height * upright);
    }
  }
  const std::size_t step = low.size() / kMostSamples + 1U;
  Eigen::Vector2d best = Eigen::Vector2d::Zero();
  double most = 0.0;
  for (std::size_t i = 0; i < low.size(); i += step) {
    double count = 0.0;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (const Eigen::Vector2d& other : low) {
      if ((other - low[i]).norm() > scale.thickest) continue;
      count += 1.0;
      sum += other;
    }
    if (count <= most) continue;
    most = count;
    best = sum / count;
  }
  return best;
}

/// A stem as it may be: a fit of [low, high].
struct Hypothesis {
  CurveFit fit;
  double low = 0.0;
  double high = 0.0;
  double sure = 0.0;      ///< [m] the fit began above it
  double spread = 0.004;  ///< [m] until the whole stem shows it
};

CurveSamples samplesAlong(const CurveSamples& samples, const StemCurve& way, const Scale& scale) {
  constexpr double kReach = 5.0 / 3.0;  // what any of the fits reaches, for they move
  std::vector<Sample> near;
  for (const Sample& sample : samples) {
    if ((sample.offset - way.centerAt(sample)).norm() < kReach * scale.reach) {
      near.push_back(sample);
    }
  }
  return CurveSamples(std::move(near));
}

/// Fits a stretch of a way along the plant with several radii.
std::vector<Hypothesis> fitStretch(const CurveSamples& near, const StemCurve& way,
                                   const Scale& scale, double low, double high) {
  std::vector<Sample> within;
  for (const Sample& sample : near) {
    if (sample.height > high) break;
    if (sample.height < low) continue;
    within.push_back(sample);
    within.back().height -= low;
  }
  if (within.size() < kMinPoints) return {};
  StemCurve line;
  line.spacing = (high - low) / std::ceil((high - low) / way.spacing);
  for (double at = low; at < high + 0.5 * line.spacing; at += line.spacing) {
    line.centers.push_back(way.centerAt(at));
  }
  placeOn(line, scale, within);
  const CurveSamples local(std::move(within));
  CurveFit blob(local, line, scale);
  blob.setActive(0.0, high - low);
  for (const double width : {0.42, 0.35, 0.29}) blob.fitBlob(width * scale.reach);
  std::vector<std::pair<double, CurveFit>> begun;  // with the evidence so far
  for (const double radius : {0.2, 0.3, 0.42, 0.58, 0.8}) {
    CurveFit fit = blob;
    fit.setRadius(radius * scale.thickest);
    for (const double spread : {0.006, 0.005}) fit.fitSurface(spread);
    const double evidence = fit.evidence(0.0, high - low);
    begun.emplace_back(evidence, std::move(fit));
  }
  // Soon it shows which radii are worth going on with.
  constexpr std::size_t kLikely = 2U;
  std::stable_sort(begun.begin(), begun.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  begun.erase(begun.begin() + kLikely, begun.end());
  std::vector<Hypothesis> fits;
  for (auto& one : begun) {
    CurveFit& fit = one.second;
    for (int round = 0; round < 3; ++round) fit.fitSurface(fit.surfaceSpread());
    fits.push_back({fit.continuedOver(near, way, low, high), low, high, low});
  }
  return fits;
}

/// The stretches that agree best with what lies above and below them: the one that most points
/// speak for, and the one that stands best on the soil, if it is another. The first may be a leaf.
/// @param samples by height, placed on the nodes of `start`
/// @param foot    of densestFoot(), for young plants
std::vector<Hypothesis> likelyStretches(const CurveSamples& samples, const StemCurve& start,
                                        const Eigen::Vector2d& foot, const Eigen::Vector2d& upright,
                                        const Scale& scale) {
  std::vector<Hypothesis> best;  // by evidence, by rooted evidence
  std::array<double, 2> most{};
  std::vector<double> possible;  // the same for all, whose bands are the same
  const auto keepBest = [&](const std::vector<Hypothesis>& fits) {
    for (const Hypothesis& one : fits) {
      if (possible.empty()) possible = one.fit.possibleEvidence(samples);
      const std::array<double, 2> evidence = one.fit.evidences(one.low, one.high, possible);
      if (best.empty()) {
        best = {one, one};
        most = evidence;
      }
      for (std::size_t k = 0; k < 2U; ++k) {
        if (evidence[k] <= most[k]) continue;
        most[k] = evidence[k];
        best[k] = one;
      }
    }
  };
  const CurveSamples near = samplesAlong(samples, start, scale);
  const double length = start.length();
  const double last = std::max(0.0, length - scale.stretch);
  const auto steps = static_cast<int>(std::ceil(last / (0.5 * scale.stretch)));
  for (int k = 0; k <= steps; ++k) {
    const double low = steps > 0 ? last * k / steps : 0.0;
    keepBest(fitStretch(near, start, scale, low, std::min(low + scale.stretch, length)));
  }
  // A prior that follows a leaf passes by the foot of its plant, which is where points crowd low.
  if (scale.young && (foot - start.centers.front()).norm() > scale.thickest) {
    StemCurve from_foot = start;
    for (std::size_t k = 0; k < from_foot.centers.size(); ++k) {
      from_foot.centers[k] = foot + start.spacing * static_cast<double>(k) * upright;
    }
    keepBest(fitStretch(samplesAlong(samples, from_foot, scale), from_foot, scale, 0.0,
                        std::min(scale.stretch, length)));
  }
  // What stands best on the soil counts for young plants only.
  if (best.size() == 2U &&
      (!scale.young || (best[0].low == best[1].low && best[0].fit.sameCurve(best[1].fit)))) {
    best.pop_back();
  }
  return best;
}

/// From a sure stretch up and down, straight on until points say otherwise; not into an open whorl.
void extend(Hypothesis& stem, const CurveSamples& samples, const Scale& scale) {
  CurveFit& fit = stem.fit;
  fit = fit.over(samples);
  double top = fit.length() + scale.spacing;
  while (stem.low > -scale.spacing || stem.high < top) {
    constexpr double kLook = 1.5;
    if (scale.young && stem.high < top &&
        fit.emptyCore(stem.high, stem.high + kLook * scale.extension)) {
      top = stem.high;
    }
    fit.judge(stem.low - scale.extension, stem.low);
    fit.judge(stem.high, stem.high + scale.extension);
    stem.low = std::max(stem.low - scale.extension, -scale.spacing);
    stem.high = std::min(stem.high + scale.extension, top);
    fit.setActive(stem.low, stem.high);
    fit.fitSurface(stem.spread);
  }
}

/// The whole of it at once.
void settle(Hypothesis& stem) {
  for (const double foot_spread : {0.02, 0.016, 0.012, 0.009, 0.006, 0.004, 0.0, 0.0}) {
    stem.fit.loosenBelow(stem.sure, foot_spread);
    stem.fit.judge(stem.low, stem.high);
    stem.fit.fitSurface(stem.spread);
    if (foot_spread == 0.0) stem.spread = stem.fit.surfaceSpread();
  }
}

/// The members that lie between the ends of the prior, or a little beyond, by height.
std::vector<Sample> samplesOf(const std::vector<Eigen::Vector3f>& points,
                              const std::vector<std::uint32_t>& members, const ChordFrame& frame,
                              const Scale& scale) {
  std::vector<Sample> samples;
  for (const std::uint32_t i : members) {
    const Sample sample = frame.toFrame(points[i]);
    if (sample.height > -scale.spacing && sample.height < frame.length + scale.spacing) {
      samples.push_back(sample);
    }
  }
  sortByHeight(samples);
  return samples;
}

/// The prior as it is where there are too few points.
Midline unfitted(const StemAxis& prior, float max_radius) {
  Midline midline;
  midline.axis = prior;
  midline.spread = 0.125F * max_radius;
  return midline;
}

Midline midlineOf(const Hypothesis& stem, const ChordFrame& frame, const Scale& scale,
                  Midline unfitted) {
  std::optional<StemAxis> axis = axisOf(stem.fit.curve(), frame, scale.thickest);
  if (!axis) return unfitted;
  Midline midline;
  midline.axis = *std::move(axis);
  midline.spread = static_cast<float>(stem.spread);
  midline.evidence = static_cast<float>(stem.fit.evidence(stem.low, stem.high));
  return midline;
}

}  // namespace

Midline fitMidline(const std::vector<Eigen::Vector3f>& points,
                   const std::vector<std::uint32_t>& members, const StemAxis& prior,
                   float max_radius, float plant_height) {
  const ChordFrame frame(prior);
  const Scale scale(max_radius, plant_height);
  std::vector<Sample> found = samplesOf(points, members, frame, scale);
  if (found.size() < kMinPoints) return unfitted(prior, max_radius);

  const Eigen::Vector2d foot = scale.young ? densestFoot(found, frame.upright(), scale)
                                           : Eigen::Vector2d(Eigen::Vector2d::Zero());
  const StemCurve start = curveAlong(prior, frame, scale.spacing);
  placeOn(start, scale, found);
  const CurveSamples samples(std::move(found));

  // 1. Stretches that are surely stem, or a leaf.
  std::vector<Hypothesis> stems = likelyStretches(samples, start, foot, frame.upright(), scale);
  if (stems.empty()) return unfitted(prior, max_radius);
  // 2. The whole stem from there. What stands on the soil is no leaf.
  for (Hypothesis& stem : stems) extend(stem, samples, scale);
  const auto rooted = [&](const Hypothesis& stem) {
    return stem.fit.rootedEvidence(stem.low, stem.high, stem.fit.possibleEvidence(samples));
  };
  Hypothesis& stem = stems.size() > 1U && rooted(stems[1]) > rooted(stems[0]) ? stems[1] : stems[0];
  settle(stem);

  return midlineOf(stem, frame, scale, unfitted(prior, max_radius));
}

Midline refitMidline(const std::vector<Eigen::Vector3f>& points,
                     const std::vector<std::uint32_t>& members, const Midline& known,
                     float max_radius, float plant_height) {
  const ChordFrame frame(known.axis);
  const Scale scale(max_radius, plant_height);
  std::vector<Sample> found = samplesOf(points, members, frame, scale);
  if (found.size() < kMinPoints) return known;
  const StemCurve start = curveAlong(known.axis, frame, scale.spacing);
  placeOn(start, scale, found);
  const CurveSamples samples(std::move(found));
  Hypothesis stem{CurveFit(samples, start, scale)};
  stem.high = frame.length;
  stem.fit.setActive(stem.low, stem.high);
  stem.fit.setRadius(
      static_cast<double>(known.axis.radiusAt(0.5F * static_cast<float>(frame.length))));
  extend(stem, samples, scale);
  settle(stem);
  return midlineOf(stem, frame, scale, known);
}

Midline followMidline(const std::vector<Eigen::Vector3f>& points,
                      const std::vector<std::uint32_t>& members, const StemAxis& known,
                      float max_radius, float plant_height) {
  const ChordFrame frame(known);
  const Scale scale(max_radius, plant_height);
  std::vector<Sample> found = samplesOf(points, members, frame, scale);
  if (found.size() < kMinPoints) return unfitted(known, max_radius);
  const StemCurve start = curveAlong(known, frame, scale.spacing);
  placeOn(start, scale, found);
  const CurveSamples samples(std::move(found));
  Hypothesis best{CurveFit(samples, start, scale)};
  double most = -1.0;
  for (const double radius : {0.2, 0.3, 0.42, 0.58, 0.8}) {
    Hypothesis stem{CurveFit(samples, start, scale)};
    stem.low = 0.0;
    stem.high = frame.length;
    stem.fit.setActive(stem.low, stem.high);
    constexpr double kError = 0.006;  // [m] of the known axis
    stem.fit.anchor(kError);
    stem.fit.setRadius(radius * scale.thickest);
    for (const double spread : {0.006, 0.005, 0.004, 0.004}) {
      stem.fit.judge(stem.low, stem.high);
      stem.fit.fitSurface(spread);
    }
    stem.spread = stem.fit.surfaceSpread();
    const double evidence = stem.fit.evidence(stem.low, stem.high);
    if (evidence <= most) continue;
    most = evidence;
    best = stem;
  }
  return midlineOf(best, frame, scale, unfitted(known, max_radius));
}

}  // namespace field_phenotyping
