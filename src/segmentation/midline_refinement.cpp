#include "field_phenotyping/segmentation/midline_refinement.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/segmentation/curve_samples.hpp"
#include "field_phenotyping/segmentation/stem_curve.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTaper = 0.42;         // share of the radius at the foot that is lost at the top
constexpr double kTaperStddev = 0.05;   // of the radius
constexpr double kRadiusStddev = 0.10;  // of the radius
constexpr double kMinSpread = 0.002;    // [m]
constexpr double kMaxSpread = 0.012;    // [m]

/// Expectation maximisation of a stem's surface, seen with noise, among points that lie outside it.
class SurfaceFit {
 public:
  SurfaceFit(std::vector<Sample> samples, StemCurve start, double typical_radius, double spread)
      : curve_(std::move(start)),
        length_(curve_.length()),
        spread_(std::max(spread, kMinSpread)),
        most_spread_(spread_),
        typical_radius_(typical_radius) {
    // A fit that begins within the stem meets its surface before the leaves; one that begins
    // outside stays with the leaves, for it finds none of them out of place.
    constexpr double kWithin = 0.9;
    curve_.radius = kWithin * typical_radius_ / (1.0 - 0.5 * kTaper);
    curve_.taper = -kTaper * curve_.radius / length_;

    constexpr double kBand = 0.10;  // [m] with a density of its own
    const double size = stretch(length_);
    bands_.resize(
        std::max<std::size_t>(1U, static_cast<std::size_t>(std::lround(length_ / (kBand * size)))));
    for (Sample& sample : samples) {
      const StemCurve::Place place = curve_.placeOf(sample.height);
      sample.node = static_cast<std::uint32_t>(place.node);
      sample.share = place.share;
      sample.band = static_cast<std::uint32_t>(bandOf(sample.height));
    }
    samples_ = CurveSamples(std::move(samples));
    weights_.resize(samples_.padded());
  }

  /// Steps that a stretch of the stem's length stands for: shorter for a seedling's.
  static double stretch(double length) {
    constexpr double kFull = 0.6;  // [m]
    constexpr double kLeast = 0.25;
    return std::clamp(length / kFull, kLeast, 1.0);
  }

  const StemCurve& curve() const { return curve_; }
  double spread() const { return spread_; }

  /// Points that the stem's surface explains.
  double explained() const { return explained_; }
  /// Share of the circumference that it is seen from: 1 from all round, 1/2 from one side.
  double seenAround() const { return seen_around_; }
  /// Points within the surface of a midline with the same nodes, or near to it.
  double within(const StemCurve& curve, double radius, double spread) const {
    double count = 0.0;
    for (const Sample& sample : samples_) {
      const double distance = (sample.offset - curve.centerAt(sample)).norm();
      if (distance < radius + 2.0 * spread) count += 1.0;
    }
    return count;
  }

  /// @param from share of the stem that the fit begins with; it goes on upwards, straight on until
  /// points say otherwise
  void run(double from) {
    const auto nodes = static_cast<std::size_t>(from * length_ / curve_.spacing) + 1U;
    known_.assign(curve_.centers.begin(),
                  curve_.centers.begin() +
                      static_cast<std::ptrdiff_t>(std::min(nodes, curve_.centers.size())));
    constexpr int kRounds = 20;
    constexpr int kGrowing = 10;  // until the fit has reached the top
    constexpr int kSettled = 12;  // until the spread is believed
    for (int round = 0; round < kRounds; ++round) {
      const double share = std::min(1.0, (round + 1.0) / kGrowing);
      withWideVectors([&] { iterate((from + (1.0 - from) * share) * length_, round >= kSettled); });
    }
  }

 private:
  static constexpr std::size_t kSectors = 6U;

  /// What a stretch of the stem shows.
  struct Band {
    double stem = 20.0;                     ///< points of the stem
    std::array<double, kSectors> others{};  ///< density of the rest, by direction [1/m^2]

    Band() {
      constexpr double kStart = 2000.0;
      others.fill(kStart);
    }
  };

  struct Counts {
    double stem = 0.0;
    double radius = 0.0;  ///< sum over the points
    double points = 0.0;
    std::array<double, kSectors> seen{};  ///< points of the stem, by direction
    std::array<double, kSectors> others{};
  };

  /// Distance beyond the surface within which points count [m].
  double reach() const {
    constexpr double kLeast = 0.012;
    constexpr double kSpreads = 4.0;
    return std::max(kLeast, kSpreads * spread_);
  }

  /// Of each lane.
  static Integers sectorsOf(const Floats& x, const Floats& y) {
    static_assert(kSectors == 6U, "three sectors on either side of the x axis");
    constexpr float kTan60 = 1.73205081F;
    const Floats aside = magnitudeOf(y);
    const Integers from_x = aside < kTan60 * x    ? allOf(0)
                            : aside < -kTan60 * x ? allOf(2)
                                                  : allOf(1);
    return y < 0.0F ? 2 - from_x : 3 + from_x;
  }

  /// Share of a standard normal distribution that lies below z.
  static Floats normalShare(const Floats& z) {
    // Abramowitz and Stegun, 26.2.17.
    const Floats size = magnitudeOf(z);
    const Floats t = 1.0F / (1.0F + 0.2316419F * size);
    const Floats series =
        t * (0.319381530F +
             t * (-0.356563782F + t * (1.781477937F + t * (-1.821255978F + t * 1.330274429F))));
    const Floats beyond = 0.39894228F * gauss(z) * series;
    return z > 0.0F ? 1.0F - beyond : beyond;
  }
  static Floats gauss(const Floats& z) {
    constexpr float kSmallest = -80.0F;  // that exponentialOf() takes
    return exponentialOf(largerOf(-0.5F * z * z, allOf(kSmallest)));
  }

  /// How probably each sample of a run belongs to the surface, and what its band shows.
  void weigh(const CurveSamples::Run& run, float ring, Counts& count, double& squares,
             double& total) {
    const Sample& first = samples_[run.begin];
    const Band& band = bands_[first.band];
    const Eigen::Vector2f low = curve_.centers[first.node].cast<float>();
    const Eigen::Vector2f step =
        (curve_.centers[first.node + 1U] - curve_.centers[first.node]).cast<float>();
    const auto spread = static_cast<float>(spread_);
    const auto foot_radius = static_cast<float>(curve_.radius);
    const auto taper = static_cast<float>(curve_.taper);
    const auto thinnest = static_cast<float>(curve_.thinnest());
    constexpr double kSqrtTwoPi = 2.5066282746310002;
    const auto density = static_cast<float>(band.stem / (kSqrtTwoPi * spread_ * 2.0 * M_PI));
    // Neighbouring points err together (leaf bases, out-of-roundness), so many count as a few.
    constexpr float kIndependent = 0.2F;
    const float precision = kIndependent / (spread * spread);
    const Floats none{};
    for (std::size_t i = run.begin; i < run.end; i += kLanes) {
      const CurveSamples::Lanes at = samples_.lanesFrom(i);
      const Floats x = at.u - (low.x() + at.share * step.x());
      const Floats y = at.v - (low.y() + at.share * step.y());
      const Floats radius = largerOf(foot_radius + taper * at.height, allOf(thinnest));
      const Floats beyond = squareRootOf(x * x + y * y) - radius;
      const Integers near = lanesBefore(run.end - i) & (beyond <= ring);
      if (!anyOf(near)) {
        store(none, &weights_[i]);
        continue;
      }
      const Floats z = beyond * (1.0F / spread);
      const Integers sectors = sectorsOf(x, y);
      Floats others{};
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        others[lane] = static_cast<float>(band.others[static_cast<std::size_t>(sectors[lane])]);
      }
      const Floats stem = density * gauss(z) / radius;
      const Floats posterior = stem / (stem + others * normalShare(z) + 1e-9F);
      const Floats probable = near ? posterior : none;
      constexpr float kNegligible = 1e-4F;
      store(probable < kNegligible ? none : precision * probable, &weights_[i]);
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        if (near[lane] == 0) continue;
        const auto sector = static_cast<std::size_t>(sectors[lane]);
        count.seen[sector] += static_cast<double>(probable[lane]);
        count.others[sector] += 1.0 - static_cast<double>(probable[lane]);
        count.points += 1.0;
      }
      count.stem += static_cast<double>(field_phenotyping::total(probable));
      count.radius += static_cast<double>(field_phenotyping::total(near ? radius : none));
      squares += static_cast<double>(field_phenotyping::total(probable * beyond * beyond));
      total += static_cast<double>(field_phenotyping::total(probable));
    }
  }

  void iterate(double highest, bool with_spread) {
    CurveEquations equations(curve_.centers.size());
    std::vector<Counts> counts(bands_.size());
    std::vector<CellSums> cells(curve_.centers.size());
    double squares = 0.0;
    double total = 1e-9;
    const double ring = reach();
    const auto end = static_cast<std::size_t>(
        std::partition_point(samples_.begin(), samples_.end(),
                             [&](const Sample& sample) { return sample.height <= highest; }) -
        samples_.begin());
    samples_.forEachRun(0U, end, [&](const CurveSamples::Run& run) {
      const Sample& first = samples_[run.begin];
      weigh(run, static_cast<float>(ring), counts[first.band], squares, total);
      samples_.sumSurface(run, curve_, weights_, cells[first.node]);
    });
    for (std::size_t node = 0; node + 1U < cells.size(); ++node) {
      cells[node].addTo(equations, node, 1.0);
    }
    explained_ = total;
    seen_around_ = shareSeen(counts);
    describeBands(counts, ring);
    if (with_spread) {
      spread_ = std::clamp(std::sqrt(squares / total), kMinSpread, most_spread_);
    }

    const double level = 1.0 / std::pow(kRadiusStddev * typical_radius_, 2);
    const Eigen::Vector2d middle(1.0, 0.5 * length_);
    equations.addRadius(level * middle * middle.transpose(), level * typical_radius_ * middle);
    const double slope = 1.0 / std::pow(kTaperStddev * typical_radius_, 2);
    const Eigen::Vector2d lost(kTaper, length_);  // nothing but what the taper explains
    equations.addRadius(slope * lost * lost.transpose(), Eigen::Vector2d::Zero());
    equations.addBending(curve_.spacing);
    equations.addHold(curve_.centers);
    // Where hardly a point is seen, the midline knows better, and the stand behind it.
    constexpr double kKnown = 1.0 / (0.005 * 0.005);  // [1/m^2]
    for (std::size_t k = 0; k < known_.size(); ++k) {
      equations.add(2U * k, 2U * k, kKnown);
      equations.add(2U * k + 1U, 2U * k + 1U, kKnown);
      equations.addRight(2U * k, {kKnown * known_[k].x(), 0.0, 0.0});
      equations.addRight(2U * k + 1U, {kKnown * known_[k].y(), 0.0, 0.0});
    }

    const Eigen::VectorXd solved = std::move(equations).solve(true);
    if (!solved.allFinite()) return;
    for (std::size_t k = 0; k < curve_.centers.size(); ++k) {
      curve_.centers[k] = solved.segment<2>(2 * static_cast<Eigen::Index>(k));
    }
    constexpr double kThinnest = 1e-3;  // [m]
    curve_.radius = std::max(solved[solved.size() - 2], kThinnest);
    curve_.taper = std::min(solved[solved.size() - 1], 0.0);
  }

  /// From how often two points of a band lie in one sector.
  static double shareSeen(const std::vector<Counts>& counts) {
    double pairs = 0.0;
    double together = 0.0;
    for (const Counts& count : counts) {
      pairs += count.stem * (count.stem - 1.0);
      for (const double seen : count.seen) together += seen * (seen - 1.0);
    }
    return together > 0.0 ? pairs / (together * static_cast<double>(kSectors)) : 1.0;
  }

  std::size_t bandOf(double height) const {
    const double share = std::clamp(height / length_, 0.0, 1.0);
    return std::min(static_cast<std::size_t>(share * static_cast<double>(bands_.size())),
                    bands_.size() - 1U);
  }

  void describeBands(const std::vector<Counts>& counts, double ring) {
    for (std::size_t b = 0; b < bands_.size(); ++b) {
      const Counts& count = counts[b];
      bands_[b].stem = count.stem + 1.0;
      const double radius = count.points > 0.0 ? count.radius / count.points : curve_.radius;
      const double area = M_PI * ring * (2.0 * radius + ring) / static_cast<double>(kSectors);
      for (std::size_t k = 0; k < kSectors; ++k) {
        const double before = count.others[(k + kSectors - 1U) % kSectors];
        const double after = count.others[(k + 1U) % kSectors];
        constexpr double kPrior = 0.3;  // points
        bands_[b].others[k] =
            (0.25 * before + 0.5 * count.others[k] + 0.25 * after + kPrior) / area;
      }
    }
  }

  CurveSamples samples_;
  std::vector<float> weights_;  // of the samples, in the equations
  StemCurve curve_;
  double length_;
  double spread_;
  double most_spread_;                  ///< [m] leaves have widened what the fit begins with
  double typical_radius_;               ///< [m] halfway up
  std::vector<Eigen::Vector2d> known_;  // the first centres, as they were
  double explained_ = 0.0;
  double seen_around_ = 1.0;
  std::vector<Band> bands_;
};

}  // namespace

Midline refineMidline(const std::vector<Eigen::Vector3f>& points,
                      const std::vector<std::uint32_t>& members, const Midline& midline,
                      float plant_height, double widened) {
  const ChordFrame frame(midline.axis);
  std::vector<Sample> samples;
  constexpr double kAbove = 0.02;  // [m]
  for (const std::uint32_t i : members) {
    const Sample sample = frame.toFrame(points[i]);
    if (sample.height > 0.0 && sample.height < frame.length + kAbove) samples.push_back(sample);
  }
  constexpr std::size_t kMinPoints = 20U;
  if (samples.size() < kMinPoints) return midline;
  sortByHeight(samples);

  constexpr double kSpacing = 0.05;  // [m]
  StemCurve start = curveAlong(midline.axis, frame, kSpacing * SurfaceFit::stretch(frame.length));
  const double typical =
      static_cast<double>(midline.axis.radiusAt(0.5F * midline.axis.length())) / widened;
  const StemCurve before = start;
  SurfaceFit fit(std::move(samples), std::move(start), typical,
                 static_cast<double>(midline.spread));
  // Half of a young stem is below the whorl; a short one shows too little of itself to go on from.
  constexpr double kBare = 0.5;
  constexpr double kLeastStretch = 0.3;  // [m]
  fit.run(isYoung(plant_height) ? std::clamp(kLeastStretch / frame.length, kBare, 1.0) : 1.0);

  // A surface that leaves most of what the midline holds unexplained is another's: a sheath within
  // a sheath, or ribs.
  constexpr double kLeastShare = 0.5;
  const double held = fit.within(before, typical * widened, static_cast<double>(midline.spread));
  if (fit.explained() < kLeastShare * held) return midline;
  // Seen from one side, a flat arc, a surface moves off without its points saying so.
  constexpr double kLeastSeen = 0.6;
  if (fit.seenAround() < kLeastSeen) return midline;

  constexpr double kThickest = 0.10;  // [m]
  Midline refined = midline;
  std::optional<StemAxis> axis = axisOf(fit.curve(), frame, kThickest);
  if (!axis) return midline;
  refined.axis = *std::move(axis);
  // Points far from the surface count as leaves', so the tails of the noise are longer than those
  // of what the fit sees. Leaves have widened what it began with.
  constexpr double kTails = 1.3;
  refined.spread = std::min(static_cast<float>(kTails * fit.spread()), midline.spread);
  return refined;
}

}  // namespace field_phenotyping
