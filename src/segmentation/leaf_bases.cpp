#include "field_phenotyping/segmentation/leaf_bases.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

constexpr float kPi = 3.14159265F;
constexpr float kLongest = 0.10F;      // [m] along the stem that a base is looked at
constexpr float kLeafSpread = 0.002F;  // [m] of a leaf about a flat sheet
constexpr float kFlattest = 0.18F;     // slopes
constexpr float kSteepest = 2.0F;
constexpr std::array<float, 6> kSlopes{0.18F, 0.27F, 0.40F, 0.58F, 0.84F, 1.2F};

/// A point as the search sees it.
struct Place {
  float arc_length;
  float azimuth;
  float distance;  // from the axis
  float radius;    // of the stem there
};

Place placeOf(const Eigen::Vector3f& point, const StemAxis::Projection& at) {
  const Eigen::Vector3f away = point - at.foot;
  return {at.arc_length, std::atan2(away.y(), away.x()), at.distance, at.radius};
}

float turned(float angle) {
  while (angle > kPi) angle -= 2.0F * kPi;
  while (angle < -kPi) angle += 2.0F * kPi;
  return angle;
}

float normalDensity(float off, float spread) {
  const float z = off / spread;
  return 0.39894228F / spread * std::exp(-0.5F * z * z);
}

/// What a leaf base does to a place: points of its own, and stem that it hides.
struct Influence {
  float leaf = 0.0F;    // density across its sheet [1/m], for a stem's density of 1
  float hidden = 0.0F;  // [0, 1] of the stem
};

/// A leaf's points on its area, to those of as much stem: it shows both of its sides.
float leafDensity(float above) {
  constexpr float kFoot = 1.5F;
  constexpr float kMore = 1.5F;
  constexpr float kFull = 0.03F;  // [m] above the foot
  return kFoot + kMore * std::clamp(above / kFull, 0.0F, 1.0F);
}

/// Share of the stem that is seen behind a leaf so far off it.
float seenPast(float beyond) {
  constexpr float kHalf = 0.025F;  // [m]
  return beyond / (kHalf + beyond);
}

/// Half of the angle that a leaf takes up round the stem [rad]: a foot is wrapped round half of it,
/// and the blade flattens as it leaves.
float halfAngle(float radius, float up, float beyond) {
  constexpr float kWiden = 0.3F;  // half width gained per metre along the stem
  return std::asin(std::min((radius + kWiden * up) / (radius + beyond), 1.0F));
}

Influence influenceOf(const LeafBase& base, const Place& place, float spread) {
  Influence influence;
  const float above = place.arc_length - base.arc_length;
  const float blur = std::sqrt(spread * spread + kLeafSpread * kLeafSpread);
  if (above < -2.0F * blur || above > kLongest) return influence;
  constexpr float kHidesAll = 1.0F;  // [rad] from its midrib a clasping leaf hides what it can
  constexpr float kHidesNone = 1.75F;
  const float turn = std::abs(turned(place.azimuth - base.azimuth));
  if (turn > kHidesNone) return influence;
  const float up = std::max(above, 0.0F);
  const float beyond = base.slope * up;
  const float begun = std::clamp(0.5F + above / (2.0F * blur), 0.0F, 1.0F);
  influence.hidden = begun *
                     std::clamp((kHidesNone - turn) / (kHidesNone - kHidesAll), 0.0F, 1.0F) *
                     (1.0F - std::min(base.sight * seenPast(beyond), 1.0F));
  constexpr float kFarthest = 4.0F;  // blurs off the sheet
  const float cosine = 1.0F / std::sqrt(1.0F + base.slope * base.slope);
  const float off = (place.distance - place.radius - beyond) * cosine;
  if (std::abs(off) > kFarthest * blur) return influence;
  constexpr float kSoft = 0.25F;  // [rad]
  const float half = halfAngle(place.radius, up, beyond);
  const float margin = std::clamp(0.5F + (half - turn) / (2.0F * kSoft), 0.0F, 1.0F);
  influence.leaf = leafDensity(up) * margin * begun * normalDensity(off, blur);
  return influence;
}

/// What is known of the points round a stem before any leaf is.
struct Surroundings {
  std::vector<Place> places;  // by arc length
  float spread = 0.003F;
  float stem_density = 0.0F;  // [1/m^2] of the surface
  float clutter = 0.0F;       // [1/m^3] beside it
};

float stemDensity(float distance, float radius, float spread) {
  return normalDensity(distance - radius, spread);
}

/// Votes of points outside the surface for where the leaf that they are of leaves the stem.
class Votes {
 public:
  Votes(float lowest, float highest)
      : lowest_(lowest),
        rows_(static_cast<std::size_t>((highest - lowest) / kStep) + 2U),
        votes_(rows_ * kDirections) {}

  static constexpr std::size_t kDirections = 16U;
  static constexpr float kStep = 0.005F;  // [m]

  void clear() { std::fill(votes_.begin(), votes_.end(), 0.0F); }

  /// For that place, one step up and down, and directions up to a quarter turn aside.
  void add(float arc_length, float azimuth) {
    const float steps = (arc_length - lowest_) / kStep;
    if (steps < 0.0F) return;
    const auto row = static_cast<std::size_t>(steps);
    const auto direction =
        static_cast<std::size_t>((azimuth + kPi) / (2.0F * kPi) * static_cast<float>(kDirections));
    constexpr std::array<float, 5> kWeights{0.5F, 1.0F, 1.0F, 1.0F, 0.5F};
    for (std::size_t r = row - std::min<std::size_t>(row, 1U); r <= row + 1U && r < rows_; ++r) {
      for (std::size_t k = 0; k < kWeights.size(); ++k) {
        votes_[r * kDirections + (direction + kDirections + k - 2U) % kDirections] += kWeights[k];
      }
    }
  }

  /// Calls visit(arc length, azimuth) where more meet than anywhere near.
  template <class Visit>
  void forEachPeak(float least, Visit&& visit) const {
    for (std::size_t row = 0; row < rows_; ++row) {
      for (std::size_t d = 0; d < kDirections; ++d) {
        if (!(at(row, d) >= least && isPeak(row, d))) continue;
        visit(lowest_ + (static_cast<float>(row) + 0.5F) * kStep,
              (static_cast<float>(d) + 0.5F) * 2.0F * kPi / static_cast<float>(kDirections) - kPi);
      }
    }
  }

 private:
  float at(std::size_t row, std::size_t direction) const {
    return votes_[row * kDirections + direction];
  }

  bool isPeak(std::size_t row, std::size_t direction) const {
    constexpr std::size_t kRows = 2U;
    const float here = at(row, direction);
    for (std::size_t r = row - std::min(row, kRows); r <= row + kRows && r < rows_; ++r) {
      for (std::size_t turn = kDirections - 1U; turn <= kDirections + 1U; ++turn) {
        if (r == row && turn == kDirections) continue;
        const float there = at(r, (direction + turn) % kDirections);
        // Of equals the first.
        const bool later = r > row || (r == row && turn > kDirections);
        if (there > here || (there == here && !later)) return false;
      }
    }
    return true;
  }

  float lowest_;
  std::size_t rows_;
  std::vector<float> votes_;
};

class Search {
 public:
  explicit Search(Surroundings surroundings) : around_(std::move(surroundings)) {
    hidden_.assign(around_.places.size(), 0.0F);
    leaves_.assign(around_.places.size(), 0.0F);
    for (const Place& place : around_.places) {
      stem_.push_back(around_.stem_density *
                      stemDensity(place.distance, place.radius, around_.spread));
    }
    if (!around_.places.empty()) radius_ = around_.places[around_.places.size() / 2U].radius;
  }

  /// Greedy: the most evident first; what it explains says nothing for others.
  std::vector<LeafBase> find() {
    constexpr float kLeastEvidence = 4.0F;
    std::vector<LeafBase> candidates = guesses();
    for (LeafBase& candidate : candidates) refine(candidate);
    candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                    [this](const LeafBase& base) { return !isLeaf(base); }),
                     candidates.end());
    std::vector<LeafBase> found;
    while (!candidates.empty()) {
      const LeafBase best = *std::max_element(
          candidates.begin(), candidates.end(),
          [](const LeafBase& a, const LeafBase& b) { return a.evidence < b.evidence; });
      if (best.evidence < kLeastEvidence) break;
      found.push_back(best);
      found.back().sight = sightPast(best);
      accept(found.back());
      std::vector<LeafBase> rest;
      for (LeafBase& candidate : candidates) {
        constexpr float kSamePlace = 0.04F;  // [m] nearer, leaves grow on opposite sides
        const float apart = std::abs(candidate.arc_length - best.arc_length);
        const float turn = std::abs(turned(candidate.azimuth - best.azimuth));
        if (apart < kSamePlace && turn < 0.5F * kPi) continue;
        if (apart < 2.0F * kLongest) candidate.evidence = evidenceOf(candidate);
        rest.push_back(candidate);
      }
      candidates = std::move(rest);
    }
    return found;
  }

 private:
  bool isLeaf(const LeafBase& base) const {
    // Where points are many, a few of them fit anything.
    constexpr float kLeastOfPoints = 1.0F;
    const float tallest = std::min(kLongest, LeafBases::kReach / base.slope);
    const float points = around_.stem_density * sheetOf(base, radius_, tallest);
    if (base.evidence < kLeastOfPoints * points) return false;
    // What passes a stem leaves the place where its foot would be to the stem.
    constexpr float kFoot = 0.008F;  // [m] off the surface
    constexpr float kLeastOfFoot = -1.0F;
    if (evidenceWithin(base, kFoot) < kLeastOfFoot) return false;
    // What bulges does not go on outwards.
    constexpr float kBulge = 0.010F;  // [m] off the surface
    constexpr float kLeastBeyond = 2.0F;
    return base.evidence - evidenceWithin(base, kBulge) >= kLeastBeyond;
  }

  /// Where many points outside the surface, carried back along one slope, meet it in one place.
  std::vector<LeafBase> guesses() const {
    std::vector<LeafBase> found;
    if (around_.places.empty()) return found;
    constexpr float kClear = 2.0F;  // spreads beyond the surface
    constexpr float kLeastVotes = 2.5F;
    Votes votes(around_.places.front().arc_length - kLongest, around_.places.back().arc_length);
    for (const float slope : kSlopes) {
      votes.clear();
      for (const Place& place : around_.places) {
        const float beyond = place.distance - place.radius;
        if (beyond < kClear * around_.spread || beyond > slope * kLongest) continue;
        votes.add(place.arc_length - beyond / slope, place.azimuth);
      }
      votes.forEachPeak(kLeastVotes, [&](float arc_length, float azimuth) {
        LeafBase base;
        base.arc_length = arc_length;
        base.azimuth = azimuth;
        base.slope = slope;
        base.evidence = evidenceOf(base);
        found.push_back(base);
      });
    }
    return found;
  }

  std::size_t firstAt(float arc_length) const {
    return static_cast<std::size_t>(
        std::lower_bound(around_.places.begin(), around_.places.end(), arc_length,
                         [](const Place& place, float s) { return place.arc_length < s; }) -
        around_.places.begin());
  }

  float evidenceOf(const LeafBase& base) const { return evidenceWithin(base, LeafBases::kReach); }

  /// Log likelihood gained where the leaf is so near to the surface.
  float evidenceWithin(const LeafBase& base, float reach) const {
    const float spread = around_.spread;
    const float tallest = std::min(kLongest, reach / base.slope);
    double sum = 0.0;
    double odds = 1.0;
    float radius = 0.0F;
    std::size_t i = firstAt(base.arc_length - 2.0F * spread);
    for (; i < around_.places.size(); ++i) {
      const Place& place = around_.places[i];
      if (place.arc_length > base.arc_length + tallest) break;
      radius = place.radius;
      if (place.distance - place.radius > reach) continue;
      const Influence influence = influenceOf(base, place, spread);
      if (!(influence.leaf > 0.0F) && !(influence.hidden > 0.0F)) continue;
      const float others = leaves_[i] + around_.clutter;
      const float before = (1.0F - hidden_[i]) * stem_[i] + others;
      const float after = (1.0F - std::max(hidden_[i], influence.hidden)) * stem_[i] + others +
                          around_.stem_density * influence.leaf;
      // One logarithm for many points.
      odds *= static_cast<double>(after / before);
      constexpr double kMost = 1e200;
      if (odds > kMost || odds < 1.0 / kMost) {
        sum += std::log(odds);
        odds = 1.0;
      }
    }
    if (!(radius > 0.0F)) return 0.0F;
    return static_cast<float>(sum + std::log(odds)) +
           around_.stem_density *
               (hiddenBy(base, radius, tallest) - sheetOf(base, radius, tallest));
  }

  /// Points that a leaf adds up to there, of a stem's density of 1 [m^2].
  static float sheetOf(const LeafBase& base, float radius, float tallest) {
    const float steepness = std::sqrt(1.0F + base.slope * base.slope);
    return steepness * sumUp(tallest, [&](float up) {
             const float beyond = base.slope * up;
             return leafDensity(up) * 2.0F * halfAngle(radius, up, beyond) * (radius + beyond);
           });
  }

  /// Points that it hides.
  static float hiddenBy(const LeafBase& base, float radius, float tallest) {
    constexpr float kHiddenArc = 2.75F;  // [rad], what the shares of it add up to
    return kHiddenArc * radius * sumUp(tallest, [&](float up) {
             return 1.0F - std::min(base.sight * seenPast(base.slope * up), 1.0F);
           });
  }

  template <class OfHeight>
  static float sumUp(float tallest, OfHeight&& of_height) {
    constexpr int kSteps = 10;
    const float step = tallest / kSteps;
    float sum = 0.0F;
    for (int k = 0; k < kSteps; ++k) sum += of_height((static_cast<float>(k) + 0.5F) * step);
    return sum * step;
  }

  /// Climbs to the nearest place of most evidence.
  void refine(LeafBase& base) const {
    constexpr int kRounds = 6;
    constexpr float kShrink = 0.65F;
    constexpr float kPivot = 0.012F;  // [m] beyond the surface, about where most points are
    float step = 1.5F * Votes::kStep;
    float turn = kPi / static_cast<float>(Votes::kDirections);
    float steeper = 0.3F;
    for (int round = 0; round < kRounds; ++round) {
      for (const float sign : {-1.0F, 1.0F}) {
        const auto attempt = [&](float raised, float turned_by, float factor, float pivot) {
          LeafBase changed = base;
          changed.slope = std::clamp(base.slope * factor, kFlattest, kSteepest);
          changed.arc_length += raised + pivot / base.slope - pivot / changed.slope;
          changed.azimuth = turned(base.azimuth + turned_by);
          changed.evidence = evidenceOf(changed);
          if (changed.evidence > base.evidence) base = changed;
        };
        attempt(sign * step, 0.0F, 1.0F, 0.0F);
        attempt(0.0F, sign * turn, 1.0F, 0.0F);
        const float factor = sign > 0.0F ? 1.0F + steeper : 1.0F / (1.0F + steeper);
        attempt(0.0F, 0.0F, factor, 0.0F);
        attempt(0.0F, 0.0F, factor, kPivot);
      }
      step *= kShrink;
      turn *= kShrink;
      steeper *= kShrink;
    }
  }

  /// How much more of the stem is seen behind a leaf than usual, where it is too far off to be
  /// taken for it.
  float sightPast(const LeafBase& base) const {
    constexpr float kClear = 2.5F;     // spreads off the stem
    constexpr float kSkin = 1.5F;      // spreads about the surface
    constexpr float kInSkin = 0.87F;   // of the stem's points
    constexpr float kHighest = 0.05F;  // [m] above the foot
    constexpr float kBehind = 1.2F;    // [rad]
    constexpr float kUsual = 4.0F;     // points that what is usual is worth
    const float lowest = kClear * around_.spread / base.slope;
    if (lowest >= kHighest) return 1.0F;
    float seen = 0.0F;
    float radius = 0.0F;
    for (std::size_t i = firstAt(base.arc_length + lowest); i < around_.places.size(); ++i) {
      const Place& place = around_.places[i];
      if (place.arc_length > base.arc_length + kHighest) break;
      radius = place.radius;
      if (std::abs(place.distance - place.radius) > kSkin * around_.spread) continue;
      if (std::abs(turned(place.azimuth - base.azimuth)) < kBehind) seen += 1.0F;
    }
    const float usual = seenPast(base.slope * 0.5F * (lowest + kHighest));
    const float whole =
        kInSkin * around_.stem_density * 2.0F * kBehind * radius * (kHighest - lowest);
    return (seen + kUsual * usual) / ((whole + kUsual) * usual);
  }

  void accept(const LeafBase& base) {
    for (std::size_t i = firstAt(base.arc_length - 2.0F * around_.spread);
         i < around_.places.size(); ++i) {
      const Place& place = around_.places[i];
      if (place.arc_length > base.arc_length + kLongest) break;
      const Influence influence = influenceOf(base, place, around_.spread);
      hidden_[i] = std::max(hidden_[i], influence.hidden);
      leaves_[i] += around_.stem_density * influence.leaf;
    }
  }

  Surroundings around_;
  float radius_ = 0.0F;  // about halfway up [m]
  // At each place:
  std::vector<float> stem_;    ///< density of the stem's points, with no leaf in front
  std::vector<float> hidden_;  ///< share of them that the leaves found so far hide
  std::vector<float> leaves_;  ///< density of those leaves' points
};

Surroundings lookAround(const std::vector<Eigen::Vector3f>& points,
                        const std::vector<std::uint32_t>& members, const Midline& midline) {
  Surroundings around;
  constexpr float kThinnest = 0.002F;  // [m] skin
  around.spread = std::max(midline.spread, kThinnest);
  const float length = midline.axis.length();
  constexpr float kBand = 0.05F;  // [m]
  std::vector<float> counts(static_cast<std::size_t>(length / kBand) + 1U, 0.0F);
  float beside = 0.0F;
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    if (at.arc_length < 0.0F || at.arc_length > length + kLongest) continue;
    const Place place = placeOf(points[i], at);
    const float beyond = place.distance - place.radius;
    if (beyond > LeafBases::kReach) continue;
    around.places.push_back(place);
    if (at.arc_length > length) continue;
    if (beyond < 2.0F * around.spread) {
      const float band_area = 2.0F * kPi * place.radius * kBand;
      counts[static_cast<std::size_t>(at.arc_length / kBand)] += 1.0F / band_area;
    } else {
      beside += 1.0F;
    }
  }
  std::sort(around.places.begin(), around.places.end(), [](const Place& a, const Place& b) {
    return a.arc_length != b.arc_length ? a.arc_length < b.arc_length : a.azimuth < b.azimuth;
  });
  std::vector<float> seen;
  for (const float count : counts) {
    if (count > 0.0F) seen.push_back(count);
  }
  if (!seen.empty()) around.stem_density = medianOf(std::move(seen));
  const float radius = midline.axis.radiusAt(0.5F * length);
  const float outer = radius + LeafBases::kReach;
  const float inner = radius + 2.0F * around.spread;
  constexpr float kScattered = 0.15F;  // of what lies beside a stem is no leaf of its own
  around.clutter = kScattered * (beside + 1.0F) /
                   (kPi * (outer * outer - inner * inner) * std::max(length, kBand));
  return around;
}

}  // namespace

LeafBases::LeafBases(const std::vector<Eigen::Vector3f>& points,
                     const std::vector<std::uint32_t>& members, const Midline& midline) {
  Surroundings around = lookAround(points, members, midline);
  spread_ = around.spread;
  if (!(around.stem_density > 0.0F)) return;
  bases_ = Search(std::move(around)).find();
  std::sort(bases_.begin(), bases_.end(),
            [](const LeafBase& a, const LeafBase& b) { return a.arc_length < b.arc_length; });
}

float LeafBases::reachOf(const Midline& midline) {
  float thickest = 0.0F;
  for (const StemAxis::Node& node : midline.axis.nodes())
    thickest = std::max(thickest, node.radius);
  return thickest + kReach;
}

std::vector<float> LeafBases::arcLengths() const {
  std::vector<float> arc_lengths;
  for (const LeafBase& base : bases_) arc_lengths.push_back(base.arc_length);
  return arc_lengths;
}

float LeafBases::leafShare(const Eigen::Vector3f& point, const StemAxis& axis) const {
  if (bases_.empty()) return 0.0F;
  const Place place = placeOf(point, axis.project(point));
  float leaf = 0.0F;
  float hidden = 0.0F;
  for (const LeafBase& base : bases_) {
    const Influence influence = influenceOf(base, place, spread_);
    leaf += influence.leaf;
    hidden = std::max(hidden, influence.hidden);
  }
  if (!(leaf > 0.0F)) return 0.0F;
  return leaf / (leaf + (1.0F - hidden) * stemDensity(place.distance, place.radius, spread_));
}

}  // namespace field_phenotyping
