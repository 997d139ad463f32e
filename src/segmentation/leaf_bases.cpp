#include "field_phenotyping/segmentation/leaf_bases.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "field_phenotyping/common/lanes.hpp"
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

/// kLanes places at once.
struct PlaceLanes {
  Floats arc_length;
  Floats azimuth;
  Floats distance;
  Floats radius;
};

/// Places by arc length, coordinate by coordinate; padded so that the last lanes can be loaded.
class Places {
 public:
  Places() = default;
  /// @param places by arc length
  explicit Places(const std::vector<Place>& places) : count_(places.size()) {
    for (std::vector<float>* values : {&arc_length_, &azimuth_, &distance_, &radius_}) {
      values->assign(count_ + kLanes, 0.0F);
    }
    for (std::size_t i = 0; i < count_; ++i) {
      arc_length_[i] = places[i].arc_length;
      azimuth_[i] = places[i].azimuth;
      distance_[i] = places[i].distance;
      radius_[i] = places[i].radius;
    }
  }

  bool empty() const { return count_ == 0U; }
  std::size_t size() const { return count_; }
  Place operator[](std::size_t i) const {
    return {arc_length_[i], azimuth_[i], distance_[i], radius_[i]};
  }
  PlaceLanes lanesFrom(std::size_t i) const {
    return {loadFloats(&arc_length_[i]), loadFloats(&azimuth_[i]), loadFloats(&distance_[i]),
            loadFloats(&radius_[i])};
  }

  /// Index of the first place at that arc length or above.
  std::size_t firstAt(float arc_length) const {
    const auto end = arc_length_.begin() + static_cast<std::ptrdiff_t>(count_);
    return static_cast<std::size_t>(std::lower_bound(arc_length_.begin(), end, arc_length) -
                                    arc_length_.begin());
  }
  /// Index of the first place above that arc length.
  std::size_t firstAbove(float arc_length) const {
    const auto end = arc_length_.begin() + static_cast<std::ptrdiff_t>(count_);
    return static_cast<std::size_t>(std::upper_bound(arc_length_.begin(), end, arc_length) -
                                    arc_length_.begin());
  }

 private:
  std::size_t count_ = 0U;
  std::vector<float> arc_length_;
  std::vector<float> azimuth_;
  std::vector<float> distance_;
  std::vector<float> radius_;
};

/// What a leaf base does to places: points of its own, and stem that it hides.
struct Influence {
  Floats leaf{};    // density across its sheet [1/m], for a stem's density of 1
  Floats hidden{};  // [0, 1] of the stem
};

/// A leaf's points on its area, to those of as much stem: it shows both of its sides.
Floats leafDensity(const Floats& above) {
  constexpr float kFoot = 1.5F;
  constexpr float kMore = 1.5F;
  constexpr float kFull = 0.03F;  // [m] above the foot
  return kFoot + kMore * clampedTo(above * (1.0F / kFull), 0.0F, 1.0F);
}

/// Share of the stem that is seen behind a leaf so far off it.
template <class Value>
Value seenPast(const Value& beyond) {
  constexpr float kHalf = 0.025F;  // [m]
  return beyond / (kHalf + beyond);
}

/// Half of the angle that a leaf takes up round the stem [rad]: a foot is wrapped round half of it,
/// and the blade flattens as it leaves.
Floats halfAngle(const Floats& radius, const Floats& up, const Floats& beyond) {
  constexpr float kWiden = 0.3F;  // half width gained per metre along the stem
  return arcsineOf(smallerOf((radius + kWiden * up) / (radius + beyond), allOf(1.0F)));
}

float blurOf(float spread) {
  return std::sqrt(spread * spread + kLeafSpread * kLeafSpread);
}

Influence influenceOf(const LeafBase& base, const PlaceLanes& place, float blur) {
  constexpr float kHidesAll = 1.0F;  // [rad] from its midrib a clasping leaf hides what it can
  constexpr float kHidesNone = 1.75F;
  constexpr float kFarthest = 4.0F;  // blurs off the sheet
  constexpr float kSoft = 0.25F;     // [rad]
  const Floats none{};
  const Floats above = place.arc_length - base.arc_length;
  const Floats apart = magnitudeOf(place.azimuth - base.azimuth);
  const Floats turn = smallerOf(apart, 2.0F * kPi - apart);
  const Integers counts = (above >= -2.0F * blur) & (above <= kLongest) & (turn <= kHidesNone);
  const Floats up = largerOf(above, none);
  const Floats beyond = base.slope * up;
  const Floats begun = clampedTo(0.5F + above * (0.5F / blur), 0.0F, 1.0F);
  constexpr float kPerTurn = 1.0F / (kHidesNone - kHidesAll);
  const Floats hidden = begun * clampedTo((kHidesNone - turn) * kPerTurn, 0.0F, 1.0F) *
                        (1.0F - smallerOf(base.sight * seenPast(beyond), allOf(1.0F)));
  const float cosine = 1.0F / std::sqrt(1.0F + base.slope * base.slope);
  const Floats off = (place.distance - place.radius - beyond) * (cosine / blur);  // in blurs
  const Integers near = counts & (off * off <= kFarthest * kFarthest);
  Influence influence;
  influence.hidden = counts ? hidden : none;
  if (!anyOf(near)) return influence;
  const Floats half = halfAngle(place.radius, up, beyond);
  const Floats margin = clampedTo(0.5F + (half - turn) * (0.5F / kSoft), 0.0F, 1.0F);
  constexpr float kInverseRootTwoPi = 0.39894228F;
  const Floats density = kInverseRootTwoPi / blur * exponentialOf(near ? -0.5F * off * off : none);
  influence.leaf = near ? leafDensity(up) * margin * begun * density : none;
  return influence;
}

/// What is known of the points round a stem before any leaf is.
struct Surroundings {
  Places places;
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
    const std::size_t padded = around_.places.size() + kLanes;
    for (std::vector<float>* values : {&stem_, &hidden_, &leaves_}) values->assign(padded, 0.0F);
    for (std::size_t i = 0; i < around_.places.size(); ++i) {
      const Place place = around_.places[i];
      stem_[i] = around_.stem_density * stemDensity(place.distance, place.radius, around_.spread);
    }
    if (!around_.places.empty()) radius_ = around_.places[around_.places.size() / 2U].radius;
  }

  /// Greedy: the most evident first; what it explains says nothing for others.
  std::vector<LeafBase> find() {
    constexpr float kLeastEvidence = 4.0F;
    std::vector<LeafBase> candidates = guesses();
    refine(candidates);
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
    const Places& places = around_.places;
    Votes votes(places[0U].arc_length - kLongest, places[places.size() - 1U].arc_length);
    for (const float slope : kSlopes) {
      votes.clear();
      for (std::size_t i = 0; i < places.size(); ++i) {
        const Place place = places[i];
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

  float evidenceOf(const LeafBase& base) const { return evidenceWithin(base, LeafBases::kReach); }

  /// Log likelihood gained where the leaf is so near to the surface.
  float evidenceWithin(const LeafBase& base, float reach) const {
    const float tallest = std::min(kLongest, reach / base.slope);
    const float blur = blurOf(around_.spread);
    const std::size_t first = around_.places.firstAt(base.arc_length - 2.0F * around_.spread);
    const std::size_t end = around_.places.firstAbove(base.arc_length + tallest);
    if (first >= end) return 0.0F;
    double sum = 0.0;
    double odds = 1.0;
    for (std::size_t i = first; i < end; i += kLanes) {
      const PlaceLanes place = around_.places.lanesFrom(i);
      const Integers counts = lanesBefore(end - i) & (place.distance - place.radius <= reach);
      const Influence influence = influenceOf(base, place, blur);
      const Floats stem = loadFloats(&stem_[i]);
      const Floats hidden = loadFloats(&hidden_[i]);
      const Floats others = loadFloats(&leaves_[i]) + around_.clutter;
      const Floats before = (1.0F - hidden) * stem + others;
      const Floats after = (1.0F - largerOf(hidden, influence.hidden)) * stem + others +
                           around_.stem_density * influence.leaf;
      // One logarithm for many points.
      const Floats gained = counts ? after / before : allOf(1.0F);
      odds *=
          static_cast<double>(gained[0] * gained[1]) * static_cast<double>(gained[2] * gained[3]);
      constexpr double kMost = 1e200;
      if (odds > kMost || odds < 1.0 / kMost) {
        sum += std::log(odds);
        odds = 1.0;
      }
    }
    const float radius = around_.places[end - 1U].radius;
    return static_cast<float>(sum + std::log(odds)) +
           around_.stem_density *
               (hiddenBy(base, radius, tallest) - sheetOf(base, radius, tallest));
  }

  /// Points that a leaf adds up to there, of a stem's density of 1 [m^2].
  static float sheetOf(const LeafBase& base, float radius, float tallest) {
    const float steepness = std::sqrt(1.0F + base.slope * base.slope);
    return steepness * sumUp(tallest, [&](const Floats& up) {
             const Floats beyond = base.slope * up;
             return leafDensity(up) * 2.0F * halfAngle(allOf(radius), up, beyond) *
                    (radius + beyond);
           });
  }

  /// Points that it hides.
  static float hiddenBy(const LeafBase& base, float radius, float tallest) {
    constexpr float kHiddenArc = 2.75F;  // [rad], what the shares of it add up to
    return kHiddenArc * radius * sumUp(tallest, [&](const Floats& up) {
             return 1.0F - smallerOf(base.sight * seenPast(Floats(base.slope * up)), allOf(1.0F));
           });
  }

  template <class OfHeight>
  static float sumUp(float tallest, OfHeight&& of_height) {
    constexpr std::size_t kSteps = 3U * kLanes;
    const float step = tallest / static_cast<float>(kSteps);
    const Floats middles{0.5F, 1.5F, 2.5F, 3.5F};
    Floats sum{};
    for (std::size_t k = 0; k < kSteps; k += kLanes) {
      sum += of_height((middles + static_cast<float>(k)) * step);
    }
    return total(sum) * step;
  }

  /// How far a round of the search moves a base.
  struct Steps {
    float along = 1.5F * Votes::kStep;                          // [m]
    float turn = kPi / static_cast<float>(Votes::kDirections);  // [rad]
    float steeper = 0.3F;                                       // of the slope

    void shrink() {
      constexpr float kShrink = 0.65F;
      along *= kShrink;
      turn *= kShrink;
      steeper *= kShrink;
    }
  };

  /// Bases climb to the nearest places of most evidence. Those that soon find none are given up,
  /// and those that then meet go on as one.
  void refine(std::vector<LeafBase>& bases) const {
    constexpr int kRounds = 6;
    constexpr int kHopeful = 2;  // rounds
    Steps steps;
    for (int round = 0; round < kRounds; ++round) {
      if (round == kHopeful) {
        bases.erase(std::remove_if(bases.begin(), bases.end(),
                                   [](const LeafBase& base) { return base.evidence < 0.0F; }),
                    bases.end());
      }
      for (LeafBase& base : bases) climb(base, steps);
      if (round >= kHopeful) keepBest(bases, steps);
      steps.shrink();
    }
  }

  void climb(LeafBase& base, const Steps& steps) const {
    constexpr float kPivot = 0.012F;  // [m] beyond the surface, about where most points are
    for (const float sign : {-1.0F, 1.0F}) {
      const auto attempt = [&](float raised, float turned_by, float factor, float pivot) {
        LeafBase changed = base;
        changed.slope = std::clamp(base.slope * factor, kFlattest, kSteepest);
        changed.arc_length += raised + pivot / base.slope - pivot / changed.slope;
        changed.azimuth = turned(base.azimuth + turned_by);
        changed.evidence = evidenceOf(changed);
        if (changed.evidence > base.evidence) base = changed;
      };
      attempt(sign * steps.along, 0.0F, 1.0F, 0.0F);
      attempt(0.0F, sign * steps.turn, 1.0F, 0.0F);
      const float factor = sign > 0.0F ? 1.0F + steps.steeper : 1.0F / (1.0F + steps.steeper);
      attempt(0.0F, 0.0F, factor, 0.0F);
      attempt(0.0F, 0.0F, factor, kPivot);
    }
  }

  /// Of bases less than a step apart the one with most evidence.
  static void keepBest(std::vector<LeafBase>& bases, const Steps& steps) {
    std::stable_sort(bases.begin(), bases.end(),
                     [](const LeafBase& a, const LeafBase& b) { return a.evidence > b.evidence; });
    std::vector<LeafBase> kept;
    for (const LeafBase& base : bases) {
      const bool met = std::any_of(kept.begin(), kept.end(), [&](const LeafBase& better) {
        const float factor = 1.0F + steps.steeper;
        return std::abs(base.arc_length - better.arc_length) < steps.along &&
               std::abs(turned(base.azimuth - better.azimuth)) < steps.turn &&
               base.slope < factor * better.slope && better.slope < factor * base.slope;
      });
      if (!met) kept.push_back(base);
    }
    bases = std::move(kept);
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
    for (std::size_t i = around_.places.firstAt(base.arc_length + lowest);
         i < around_.places.size(); ++i) {
      const Place place = around_.places[i];
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
    const float blur = blurOf(around_.spread);
    const std::size_t end = around_.places.firstAbove(base.arc_length + kLongest);
    for (std::size_t i = around_.places.firstAt(base.arc_length - 2.0F * around_.spread); i < end;
         i += kLanes) {
      const Influence influence = influenceOf(base, around_.places.lanesFrom(i), blur);
      const Integers counts = lanesBefore(end - i);
      const Floats hidden = loadFloats(&hidden_[i]);
      const Floats leaves = loadFloats(&leaves_[i]);
      store(counts ? largerOf(hidden, influence.hidden) : hidden, &hidden_[i]);
      store(counts ? leaves + around_.stem_density * influence.leaf : leaves, &leaves_[i]);
    }
  }

  Surroundings around_;
  float radius_ = 0.0F;  // about halfway up [m]
  // At each place, padded:
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
  std::vector<Place> places;
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    if (at.arc_length < 0.0F || at.arc_length > length + kLongest) continue;
    const Place place = placeOf(points[i], at);
    const float beyond = place.distance - place.radius;
    if (beyond > LeafBases::kReach) continue;
    places.push_back(place);
    if (at.arc_length > length) continue;
    if (beyond < 2.0F * around.spread) {
      const float band_area = 2.0F * kPi * place.radius * kBand;
      counts[static_cast<std::size_t>(at.arc_length / kBand)] += 1.0F / band_area;
    } else {
      beside += 1.0F;
    }
  }
  std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) {
    return a.arc_length != b.arc_length ? a.arc_length < b.arc_length : a.azimuth < b.azimuth;
  });
  around.places = Places(places);
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
  const PlaceLanes lanes{allOf(place.arc_length), allOf(place.azimuth), allOf(place.distance),
                         allOf(place.radius)};
  const float blur = blurOf(spread_);
  float leaf = 0.0F;
  float hidden = 0.0F;
  for (const LeafBase& base : bases_) {
    const float above = place.arc_length - base.arc_length;
    if (above < -2.0F * blur || above > kLongest) continue;
    const Influence influence = influenceOf(base, lanes, blur);
    leaf += influence.leaf[0];
    hidden = std::max(hidden, influence.hidden[0]);
  }
  if (!(leaf > 0.0F)) return 0.0F;
  return leaf / (leaf + (1.0F - hidden) * stemDensity(place.distance, place.radius, spread_));
}

}  // namespace field_phenotyping
