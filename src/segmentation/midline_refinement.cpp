#include "field_phenotyping/segmentation/midline_refinement.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

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
      : samples_(std::move(samples)),
        curve_(std::move(start)),
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
      const double distance = (sample.offset - curve.centerAt(sample.height)).norm();
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
      iterate((from + (1.0 - from) * share) * length_, round >= kSettled);
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

  static std::size_t sectorOf(const Eigen::Vector2d& away) {
    static_assert(kSectors == 6U, "three sectors on either side of the x axis");
    constexpr double kTan60 = 1.7320508075688772;
    const double aside = std::abs(away.y());
    const std::size_t from_x = aside < kTan60 * away.x()    ? 0U
                               : aside < -kTan60 * away.x() ? 2U
                                                            : 1U;
    return away.y() < 0.0 ? 2U - from_x : 3U + from_x;
  }

  void iterate(double highest, bool with_spread) {
    CurveEquations equations(curve_.centers.size());
    std::vector<Counts> counts(bands_.size());
    Eigen::Matrix2d radius_normal = Eigen::Matrix2d::Zero();
    Eigen::Vector2d radius_right = Eigen::Vector2d::Zero();
    double squares = 0.0;
    double total = 1e-9;
    const double ring = reach();
    for (const Sample& sample : samples_) {
      if (sample.height > highest) break;
      const StemCurve::Place place = curve_.placeOf(sample.height);
      const Eigen::Vector2d away = sample.offset - curve_.centerAt(place);
      const double radius = curve_.radiusAt(sample.height);
      const double squared = away.squaredNorm();
      if (squared > (radius + ring) * (radius + ring)) continue;
      const double distance = std::max(std::sqrt(squared), 1e-6);
      const double beyond = distance - radius;
      const double z = beyond / spread_;
      const std::size_t band = bandOf(sample.height);
      const std::size_t sector = sectorOf(away);
      constexpr double kSqrtTwoPi = 2.5066282746310002;
      const double stem =
          bands_[band].stem * std::exp(-0.5 * z * z) / (kSqrtTwoPi * spread_ * 2.0 * M_PI * radius);
      const double other = bands_[band].others[sector] * 0.5 * std::erfc(-z * M_SQRT1_2);
      const double posterior = stem / (stem + other + 1e-9);

      Counts& count = counts[band];
      count.stem += posterior;
      count.seen[sector] += posterior;
      count.others[sector] += 1.0 - posterior;
      count.radius += radius;
      count.points += 1.0;
      squares += posterior * beyond * beyond;
      total += posterior;
      constexpr double kNegligible = 1e-4;
      if (posterior < kNegligible) continue;

      // Neighbouring points err together (leaf bases, out-of-roundness), so many count as a few.
      constexpr double kIndependent = 0.2;
      const double weight = kIndependent * posterior / (spread_ * spread_);
      const Eigen::Vector2d toward = away / distance;
      const double target = toward.dot(sample.offset);
      const std::array<double, 4> row{(1.0 - place.share) * toward.x(),
                                      (1.0 - place.share) * toward.y(), place.share * toward.x(),
                                      place.share * toward.y()};
      const std::size_t first = 2U * place.node;
      const Eigen::Vector3d border = weight * Eigen::Vector3d(target, 1.0, sample.height);
      for (std::size_t i = 0; i < 4U; ++i) {
        for (std::size_t k = 0; k <= i; ++k) {
          equations.add(first + i, first + k, weight * row[i] * row[k]);
        }
        equations.addRight(first + i, row[i] * border);
      }
      const Eigen::Vector2d profile(1.0, sample.height);
      radius_normal += weight * profile * profile.transpose();
      radius_right += weight * target * profile;
    }
    explained_ = total;
    seen_around_ = shareSeen(counts);
    describeBands(counts, ring);
    if (with_spread) {
      spread_ = std::clamp(std::sqrt(squares / total), kMinSpread, most_spread_);
    }

    const double level = 1.0 / std::pow(kRadiusStddev * typical_radius_, 2);
    const Eigen::Vector2d middle(1.0, 0.5 * length_);
    radius_normal += level * middle * middle.transpose();
    radius_right += level * typical_radius_ * middle;
    const double slope = 1.0 / std::pow(kTaperStddev * typical_radius_, 2);
    const Eigen::Vector2d lost(kTaper, length_);  // nothing but what the taper explains
    radius_normal += slope * lost * lost.transpose();
    equations.addRadius(radius_normal, radius_right);
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

  std::vector<Sample> samples_;  // by height
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
