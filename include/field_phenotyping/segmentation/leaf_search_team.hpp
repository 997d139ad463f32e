#pragma once

#include <cmath>
#include <cstddef>
#include <type_traits>
#include <utility>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/common/team_order.hpp"

// The search for the leaf bases of one stem, see LeafBases, for a team of threads (see team.hpp),
// on the CPU and on the GPU. Bases climb to their places one for each group of the team, whose
// lanes sum over the points: the same bits whatever the team.

namespace field_phenotyping {

/// An organ that leaves a stem: a leaf, an ear, a tassel branch.
struct LeafBase {
  float arc_length = 0.0F;  ///< where its midrib meets the stem's surface, along the midline [m]
  float azimuth = 0.0F;     ///< which way it leaves, about the midline, from x towards y [rad]
  float slope = 0.0F;       ///< metres outwards per metre along the stem
  float evidence = 0.0F;    ///< log likelihood gained by an organ there
  float sight = 1.0F;       ///< how much more of the stem is seen behind it than behind most leaves
};

/// What is known of the points round a stem before any leaf is. Arrays go by arc length and have
/// kLanes numbers more at their ends.
struct LeafSearchTask {
  const float* arc_lengths = nullptr;  ///< of each point [m]
  const float* azimuths = nullptr;     ///< about the axis [rad]
  const float* distances = nullptr;    ///< from the axis [m]
  const float* radii = nullptr;        ///< of the stem there [m]
  const float* stem = nullptr;         ///< density of the stem's points, with no leaf in front
  const LeafBase* guesses = nullptr;
  int count = 0;  ///< of the points
  int guess_count = 0;
  float spread = 0.003F;      ///< noise of the surface [m]
  float stem_density = 0.0F;  ///< [1/m^2] of the surface
  float clutter = 0.0F;       ///< [1/m^3] beside it
};

namespace leaf {

constexpr float kPi = 3.14159265F;
constexpr float kReach = 0.025F;       // [m] beyond the surface that shows leaves
constexpr float kLongest = 0.10F;      // [m] along the stem that a base is looked at
constexpr float kLeafSpread = 0.002F;  // [m] of a leaf about a flat sheet
constexpr float kFlattest = 0.18F;     // slopes
constexpr float kSteepest = 2.0F;
constexpr float kVoteStep = 0.005F;  // [m] along the stem that guesses are apart
constexpr int kDirections = 16;      // round it, likewise

FIELD_PHENOTYPING_HD inline float turned(float angle) {
  while (angle > kPi) angle -= 2.0F * kPi;
  while (angle < -kPi) angle += 2.0F * kPi;
  return angle;
}

FIELD_PHENOTYPING_HD inline float blurOf(float spread) {
  return std::sqrt(spread * spread + kLeafSpread * kLeafSpread);
}

/// Points as the lanes of a group see them.
template <class Float>
struct Places {
  Float arc_length;
  Float azimuth;
  Float distance;  // from the axis
  Float radius;    // of the stem there
};

/// What a leaf base does to places: points of its own, and stem that it hides.
template <class Float>
struct Influence {
  Float leaf;    // density across its sheet [1/m], for a stem's density of 1
  Float hidden;  // [0, 1] of the stem
};

/// A leaf's points on its area, to those of as much stem: it shows both of its sides.
template <class Lanes, class Float>
FIELD_PHENOTYPING_HD inline Float leafDensity(const Lanes& lanes, const Float& above) {
  constexpr float kFoot = 1.5F;
  constexpr float kMore = 1.5F;
  constexpr float kFull = 0.03F;  // [m] above the foot
  return kFoot + kMore * lanes.clamped(above * (1.0F / kFull), 0.0F, 1.0F);
}

/// Share of the stem that is seen behind a leaf so far off it.
template <class Float>
FIELD_PHENOTYPING_HD inline Float seenPast(const Float& beyond) {
  constexpr float kHalf = 0.025F;  // [m]
  return beyond / (kHalf + beyond);
}

/// Half of the angle that a leaf takes up round the stem [rad]: a foot is wrapped round half of it,
/// and the blade flattens as it leaves.
template <class Lanes, class Float>
FIELD_PHENOTYPING_HD inline Float halfAngle(const Lanes& lanes, const Float& radius,
                                            const Float& up, const Float& beyond) {
  constexpr float kWiden = 0.3F;  // half width gained per metre along the stem
  return lanes.arcsine(lanes.smaller((radius + kWiden * up) / (radius + beyond), lanes.all(1.0F)));
}

template <class Lanes, class Float>
FIELD_PHENOTYPING_HD inline Influence<Float> influenceOf(const Lanes& lanes, const LeafBase& base,
                                                         const Places<Float>& place, float blur) {
  constexpr float kHidesAll = 1.0F;  // [rad] from its midrib a clasping leaf hides what it can
  constexpr float kHidesNone = 1.75F;
  constexpr float kFarthest = 4.0F;  // blurs off the sheet
  constexpr float kSoft = 0.25F;     // [rad]
  const Float none = lanes.all(0.0F);
  const Float above = place.arc_length - base.arc_length;
  const Float apart = lanes.magnitude(place.azimuth - base.azimuth);
  const Float turn = lanes.smaller(apart, 2.0F * kPi - apart);
  const auto counts = lanes.both(lanes.both(lanes.atMost(lanes.all(-2.0F * blur), above),
                                            lanes.atMost(above, lanes.all(kLongest))),
                                 lanes.atMost(turn, lanes.all(kHidesNone)));
  const Float up = lanes.larger(above, none);
  const Float beyond = base.slope * up;
  const Float begun = lanes.clamped(0.5F + above * (0.5F / blur), 0.0F, 1.0F);
  constexpr float kPerTurn = 1.0F / (kHidesNone - kHidesAll);
  const Float hidden = begun * lanes.clamped((kHidesNone - turn) * kPerTurn, 0.0F, 1.0F) *
                       (1.0F - lanes.smaller(base.sight * seenPast(beyond), lanes.all(1.0F)));
  const float cosine = 1.0F / std::sqrt(1.0F + base.slope * base.slope);
  const Float off = (place.distance - place.radius - beyond) * (cosine / blur);  // in blurs
  const auto near = lanes.both(counts, lanes.atMost(off * off, lanes.all(kFarthest * kFarthest)));
  Influence<Float> influence{none, lanes.where(counts, hidden)};
  if (!lanes.any(near)) return influence;
  const Float half = halfAngle(lanes, place.radius, up, beyond);
  const Float margin = lanes.clamped(0.5F + (half - turn) * (0.5F / kSoft), 0.0F, 1.0F);
  constexpr float kInverseRootTwoPi = 0.39894228F;
  const Float density =
      kInverseRootTwoPi / blur * lanes.exponential(lanes.where(near, -0.5F * off * off));
  influence.leaf = lanes.where(near, leafDensity(lanes, up) * margin * begun * density);
  return influence;
}

/// What leaf bases do to places together.
template <class Lanes, class Float>
FIELD_PHENOTYPING_HD inline Influence<Float> influenceOfAll(const Lanes& lanes,
                                                            const LeafBase* bases, int count,
                                                            const Places<Float>& place,
                                                            float blur) {
  Influence<Float> all{lanes.all(0.0F), lanes.all(0.0F)};
  for (int k = 0; k < count; ++k) {
    const Float above = place.arc_length - bases[k].arc_length;
    if (!lanes.any(lanes.both(lanes.atMost(lanes.all(-2.0F * blur), above),
                              lanes.atMost(above, lanes.all(kLongest))))) {
      continue;
    }
    const Influence<Float> one = influenceOf(lanes, bases[k], place, blur);
    all.leaf += one.leaf;
    all.hidden = lanes.larger(all.hidden, one.hidden);
  }
  return all;
}

/// Density of a stem's points across its surface [1/m], of 1 on it, with no leaf in front.
FIELD_PHENOTYPING_HD inline float stemDensity(float distance, float radius, float spread) {
  constexpr float kInverseRootTwoPi = 0.39894228F;
  const float off = (distance - radius) / spread;
  return kInverseRootTwoPi / spread *
         static_cast<float>(exponential(static_cast<double>(-0.5F * off * off)));
}

/// Probability that a point is a leaf base's rather than the stem's.
/// @param stem density of the stem's points there
FIELD_PHENOTYPING_HD inline float shareOf(float leaf, float hidden, float stem) {
  return leaf > 0.0F ? leaf / (leaf + (1.0F - hidden) * stem) : 0.0F;
}

/// How far a round of the search moves a base.
struct Steps {
  float along = 1.5F * kVoteStep;                      // [m]
  float turn = kPi / static_cast<float>(kDirections);  // [rad]
  float steeper = 0.3F;                                // of the slope

  FIELD_PHENOTYPING_HD void shrink() {
    constexpr float kShrink = 0.65F;
    along *= kShrink;
    turn *= kShrink;
    steeper *= kShrink;
  }
  /// Whether two bases are less than a step apart.
  FIELD_PHENOTYPING_HD bool haveMet(const LeafBase& a, const LeafBase& b) const {
    const float factor = 1.0F + steeper;
    return std::fabs(a.arc_length - b.arc_length) < along &&
           std::fabs(turned(a.azimuth - b.azimuth)) < turn && a.slope < factor * b.slope &&
           b.slope < factor * a.slope;
  }
};

/// Memory of a team, which all members see.
struct Memory {
  float* hidden;         // of each point, padded: share of the stem that leaves found so far hide
  float* leaves;         // likewise: density of those leaves' points
  LeafBase* candidates;  // one for each guess
  LeafBase* others;      // likewise
  LeafBase* found;       // likewise: the result
  int* kept;             // likewise: whether a candidate is
  int* counts;           // of candidates; of those found
};

}  // namespace leaf

/// Finds the bases of one stem. All members of the team make one and call find().
template <class Team>
class LeafSearch {
 public:
  FIELD_PHENOTYPING_HD LeafSearch(const Team& team, const LeafSearchTask& task,
                                  const leaf::Memory& memory)
      : team_(team), task_(task), memory_(memory), blur_(leaf::blurOf(task.spread)) {
    if (task_.count > 0) radius_ = task_.radii[task_.count / 2];
  }

  /// Greedy: the most evident first; what it explains says nothing for others.
  /// @return how many there are in memory.found; all members may read them
  FIELD_PHENOTYPING_HD int find() {
    constexpr float kLeastEvidence = 4.0F;
    forOwn(task_.count + static_cast<int>(kLanes), [&](int i) {
      memory_.hidden[i] = 0.0F;
      memory_.leaves[i] = 0.0F;
    });
    forOwn(task_.guess_count, [&](int k) { memory_.candidates[k] = task_.guesses[k]; });
    if (team_.rank() == 0U) memory_.counts[0] = task_.guess_count;
    team_.sync();
    forCandidates([&](LeafBase& base, int) {
      base.evidence = evidenceOf(base);
      return true;
    });
    refine();
    forCandidates([&](LeafBase& base, int k) {
      const bool is_leaf = isLeaf(base);
      if (team_.lanes().first()) memory_.kept[k] = is_leaf ? 1 : 0;
      return false;
    });
    keepThose();
    int found = 0;
    for (; memory_.counts[0] > 0; ++found) {
      if (team_.rank() == 0U) {
        int most = 0;
        for (int k = 1; k < memory_.counts[0]; ++k) {
          if (memory_.candidates[most].evidence < memory_.candidates[k].evidence) most = k;
        }
        memory_.found[found] = memory_.candidates[most];
      }
      team_.sync();
      const LeafBase best = memory_.found[found];
      if (best.evidence < kLeastEvidence) break;
      team_.sync();  // all have read it
      if (team_.rank() == 0U) memory_.found[found].sight = sightPast(best);
      team_.sync();
      accept(memory_.found[found]);
      team_.sync();
      forCandidates([&](LeafBase& base, int k) {
        constexpr float kSamePlace = 0.04F;  // [m] nearer, leaves grow on opposite sides
        const float apart = std::fabs(base.arc_length - best.arc_length);
        const float turn = std::fabs(leaf::turned(base.azimuth - best.azimuth));
        const bool is_same = apart < kSamePlace && turn < 0.5F * leaf::kPi;
        if (team_.lanes().first()) memory_.kept[k] = is_same ? 0 : 1;
        if (is_same || !(apart < 2.0F * leaf::kLongest)) return false;
        base.evidence = evidenceOf(base);
        return true;
      });
      keepThose();
    }
    return found;
  }

 private:
  using Lanes = decltype(std::declval<const Team&>().lanes());
  using Float = typename Lanes::Float;

  /// visit(i) for those of 0 ... count - 1 that are this member's.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forOwn(int count, const Visit& visit) const {
    for (int i = static_cast<int>(team_.rank()); i < count; i += static_cast<int>(team_.size())) {
      visit(i);
    }
  }
  /// change(base, its number) for those candidates that are this group's: all its members come with
  /// a base of their own, and true keeps what it was changed to. All may read them afterwards.
  template <class Change>
  FIELD_PHENOTYPING_HD void forCandidates(const Change& change) const {
    const int count = memory_.counts[0];
    for (int k = static_cast<int>(team_.group()); k < count;
         k += static_cast<int>(team_.groups())) {
      LeafBase base = memory_.candidates[k];
      team_.lanes().meet();  // all have read it
      if (change(base, k) && team_.lanes().first()) memory_.candidates[k] = base;
    }
    team_.sync();
  }
  /// Leaves out candidates that are not kept.
  FIELD_PHENOTYPING_HD void keepThose() const {
    if (team_.rank() == 0U) {
      int kept = 0;
      for (int k = 0; k < memory_.counts[0]; ++k) {
        if (memory_.kept[k] != 0) memory_.candidates[kept++] = memory_.candidates[k];
      }
      memory_.counts[0] = kept;
    }
    team_.sync();
  }

  /// Index of the first place at that arc length or above.
  FIELD_PHENOTYPING_HD int firstAt(float arc_length) const {
    return firstFor([&](float here) { return here >= arc_length; });
  }
  /// Index of the first place above that arc length.
  FIELD_PHENOTYPING_HD int firstAbove(float arc_length) const {
    return firstFor([&](float here) { return here > arc_length; });
  }
  /// Index of the first place whose arc length is enough.
  template <class Enough>
  FIELD_PHENOTYPING_HD int firstFor(const Enough& is_enough) const {
    unsigned first = 0U;
    for (auto left = static_cast<unsigned>(task_.count); left > 0U;) {
      const unsigned half = left / 2U;
      if (is_enough(task_.arc_lengths[first + half])) {
        left = half;
      } else {
        first += half + 1U;
        left -= half + 1U;
      }
    }
    return static_cast<int>(first);
  }

  FIELD_PHENOTYPING_HD Float load(const float* values, int i) const {
    return team_.lanes().load(values, static_cast<std::size_t>(i),
                              static_cast<std::size_t>(task_.count));
  }
  FIELD_PHENOTYPING_HD leaf::Places<Float> placesFrom(int i) const {
    return {load(task_.arc_lengths, i), load(task_.azimuths, i), load(task_.distances, i),
            load(task_.radii, i)};
  }

  FIELD_PHENOTYPING_HD bool isLeaf(const LeafBase& base) const {
    // Where points are many, a few of them fit anything.
    constexpr float kLeastOfPoints = 1.0F;
    const float points = task_.stem_density * sheetOf(base, radius_, tallestOf(base, leaf::kReach));
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

  FIELD_PHENOTYPING_HD static float tallestOf(const LeafBase& base, float reach) {
    const float tallest = reach / base.slope;
    return tallest < leaf::kLongest ? tallest : leaf::kLongest;
  }

  FIELD_PHENOTYPING_HD float evidenceOf(const LeafBase& base) const {
    return evidenceWithin(base, leaf::kReach);
  }

  /// Log likelihood gained where the leaf is so near to the surface. All members of a group come.
  FIELD_PHENOTYPING_HD_ONCE float evidenceWithin(const LeafBase& base, float reach) const {
    const Lanes lanes = team_.lanes();
    const float tallest = tallestOf(base, reach);
    const int first = firstAt(base.arc_length - 2.0F * task_.spread);
    const int end = firstAbove(base.arc_length + tallest);
    if (first >= end) return 0.0F;
    const LeafSearchTask task = task_;  // copies that nothing written can change
    const float* const all_hidden = memory_.hidden;
    const float* const all_leaves = memory_.leaves;
    const auto of = static_cast<std::size_t>(end);
    const auto gainedAt = [&](const auto& at, std::size_t i) {
      using Values = typename std::decay_t<decltype(at)>::Float;
      const leaf::Places<Values> place{at.load(task.arc_lengths, i, of),
                                       at.load(task.azimuths, i, of),
                                       at.load(task.distances, i, of), at.load(task.radii, i, of)};
      const leaf::Influence<Values> influence = leaf::influenceOf(at, base, place, blur_);
      const Values stem = at.load(task.stem, i, of);
      const Values hidden = at.load(all_hidden, i, of);
      const Values others = at.load(all_leaves, i, of) + task.clutter;
      const Values before = (1.0F - hidden) * stem + others;
      const Values after = (1.0F - at.larger(hidden, influence.hidden)) * stem + others +
                           task.stem_density * influence.leaf;
      return at.choose(at.atMost(place.distance - place.radius, at.all(reach)), after / before,
                       at.all(1.0F));
    };
    // One logarithm for many points.
    double sum = 0.0;
    double odds = 1.0;
    const auto gain = [&](double ratio) {
      odds *= ratio;
      constexpr double kMost = 0x1p600;
      constexpr double kLogMost = 600.0 * 0.69314718055994531;
      if (odds > kMost) {
        odds *= 1.0 / kMost;
        sum += kLogMost;
      } else if (odds < 1.0 / kMost) {
        odds *= kMost;
        sum -= kLogMost;
      }
    };
    auto i = static_cast<std::size_t>(first);
    if constexpr (Team::kAlone) {
      const typename Team::Wide wide{};
      for (; i + 2U * kLanes <= of; i += 2U * kLanes) {
        const auto gained = gainedAt(wide, i);
        gain(lanes.product(wide.half(gained, 0U)));
        gain(lanes.product(wide.half(gained, 1U)));
      }
    }
    for (; i + kLanes <= of; i += kLanes) gain(lanes.product(gainedAt(lanes, i)));
    if (i < of) {
      odds *= lanes.product(lanes.choose(lanes.before(i, of), gainedAt(lanes, i), lanes.all(1.0F)));
    }
    const float radius = task_.radii[end - 1];
    return static_cast<float>(sum + logarithm(odds)) +
           task_.stem_density * (hiddenBy(base, radius, tallest) - sheetOf(base, radius, tallest));
  }

  /// Points that a leaf adds up to there, of a stem's density of 1 [m^2].
  FIELD_PHENOTYPING_HD float sheetOf(const LeafBase& base, float radius, float tallest) const {
    const Lanes lanes = team_.lanes();
    const float steepness = std::sqrt(1.0F + base.slope * base.slope);
    return steepness * sumUp(tallest, [&](const Float& up) -> Float {
             const Float beyond = base.slope * up;
             return leaf::leafDensity(lanes, up) * 2.0F *
                    leaf::halfAngle(lanes, lanes.all(radius), up, beyond) * (radius + beyond);
           });
  }

  /// Points that it hides.
  FIELD_PHENOTYPING_HD float hiddenBy(const LeafBase& base, float radius, float tallest) const {
    const Lanes lanes = team_.lanes();
    constexpr float kHiddenArc = 2.75F;  // [rad], what the shares of it add up to
    return kHiddenArc * radius * sumUp(tallest, [&](const Float& up) -> Float {
             const Float beyond = base.slope * up;
             return 1.0F - lanes.smaller(base.sight * leaf::seenPast(beyond), lanes.all(1.0F));
           });
  }

  template <class OfHeight>
  FIELD_PHENOTYPING_HD float sumUp(float tallest, const OfHeight& of_height) const {
    const Lanes lanes = team_.lanes();
    constexpr int kWidth = static_cast<int>(kLanes);
    constexpr int kSteps = 3 * kWidth;
    const float step = tallest / static_cast<float>(kSteps);
    const Float middles = lanes.numbers() + 0.5F;
    Float sum = lanes.all(0.0F);
    for (int k = 0; k < kSteps; k += kWidth) {
      sum += of_height((middles + static_cast<float>(k)) * step);
    }
    return lanes.total(sum) * step;
  }

  /// Bases climb to the nearest places of most evidence. Those that soon find none are given up,
  /// and those that then meet go on as one.
  FIELD_PHENOTYPING_HD void refine() {
    constexpr int kRounds = 6;
    constexpr int kHopeful = 1;  // rounds
    leaf::Steps steps;
    for (int round = 0; round < kRounds; ++round) {
      if (round == kHopeful) {
        forOwn(memory_.counts[0],
               [&](int k) { memory_.kept[k] = memory_.candidates[k].evidence < 0.0F ? 0 : 1; });
        team_.sync();
        keepThose();
      }
      forCandidates([&](LeafBase& base, int) {
        climb(base, steps);
        return true;
      });
      if (round >= kHopeful) keepBest(steps);
      steps.shrink();
    }
  }

  FIELD_PHENOTYPING_HD void climb(LeafBase& base, const leaf::Steps& steps) const {
    constexpr float kPivot = 0.012F;  // [m] beyond the surface, about where most points are
    constexpr int kAttempts = 8;      // in four ways, down and up
    unsigned gone = 0U;               // ways that led higher, where the way back does not
    for (int k = 0; k < kAttempts; ++k) {
      const float sign = k < kAttempts / 2 ? -1.0F : 1.0F;
      const int way = k % (kAttempts / 2);
      if ((gone >> way & 1U) != 0U) continue;
      const float steeper = sign > 0.0F ? 1.0F + steps.steeper : 1.0F / (1.0F + steps.steeper);
      const float raised = way == 0 ? sign * steps.along : 0.0F;
      const float turned_by = way == 1 ? sign * steps.turn : 0.0F;
      const float factor = way >= 2 ? steeper : 1.0F;
      const float pivot = way == 3 ? kPivot : 0.0F;
      LeafBase changed = base;
      const float slope = base.slope * factor;
      changed.slope = slope < leaf::kFlattest   ? leaf::kFlattest
                      : slope > leaf::kSteepest ? leaf::kSteepest
                                                : slope;
      if (way >= 2 && !(changed.slope < base.slope || base.slope < changed.slope)) continue;
      changed.arc_length += raised + pivot / base.slope - pivot / changed.slope;
      changed.azimuth = leaf::turned(base.azimuth + turned_by);
      changed.evidence = evidenceOf(changed);
      if (changed.evidence > base.evidence) {
        base = changed;
        gone |= 1U << way;
      }
    }
  }

  /// Of bases less than a step apart the one with most evidence.
  FIELD_PHENOTYPING_HD void keepBest(const leaf::Steps& steps) {
    LeafBase* const sorted =
        teamSort(team_, memory_.candidates, memory_.others, memory_.counts[0],
                 [](const LeafBase& a, const LeafBase& b) { return a.evidence > b.evidence; });
    if (sorted != memory_.candidates) {
      memory_.others = memory_.candidates;
      memory_.candidates = sorted;
    }
    if (team_.rank() == 0U) {
      int kept = 0;
      for (int k = 0; k < memory_.counts[0]; ++k) {
        bool met = false;
        for (int better = 0; better < kept && !met; ++better) {
          met = steps.haveMet(memory_.candidates[k], memory_.candidates[better]);
        }
        if (!met) memory_.candidates[kept++] = memory_.candidates[k];
      }
      memory_.counts[0] = kept;
    }
    team_.sync();
  }

  /// How much more of the stem is seen behind a leaf than usual, where it is too far off to be
  /// taken for it. By one member alone.
  FIELD_PHENOTYPING_HD float sightPast(const LeafBase& base) const {
    constexpr float kClear = 2.5F;     // spreads off the stem
    constexpr float kSkin = 1.5F;      // spreads about the surface
    constexpr float kInSkin = 0.87F;   // of the stem's points
    constexpr float kHighest = 0.05F;  // [m] above the foot
    constexpr float kBehind = 1.2F;    // [rad]
    constexpr float kUsual = 4.0F;     // points that what is usual is worth
    const float lowest = kClear * task_.spread / base.slope;
    if (lowest >= kHighest) return 1.0F;
    float seen = 0.0F;
    float radius = 0.0F;
    for (int i = firstAt(base.arc_length + lowest); i < task_.count; ++i) {
      if (task_.arc_lengths[i] > base.arc_length + kHighest) break;
      radius = task_.radii[i];
      if (std::fabs(task_.distances[i] - radius) > kSkin * task_.spread) continue;
      if (std::fabs(leaf::turned(task_.azimuths[i] - base.azimuth)) < kBehind) seen += 1.0F;
    }
    const float usual = leaf::seenPast(base.slope * 0.5F * (lowest + kHighest));
    const float whole =
        kInSkin * task_.stem_density * 2.0F * kBehind * radius * (kHighest - lowest);
    return (seen + kUsual * usual) / ((whole + kUsual) * usual);
  }

  FIELD_PHENOTYPING_HD void accept(const LeafBase& base) const {
    const Lanes lanes = team_.lanes();
    constexpr int kWidth = static_cast<int>(kLanes);
    const int first = firstAt(base.arc_length - 2.0F * task_.spread);
    const int end = firstAbove(base.arc_length + leaf::kLongest);
    for (int i = first + kWidth * static_cast<int>(team_.group()); i < end;
         i += kWidth * static_cast<int>(team_.groups())) {
      const auto at = static_cast<std::size_t>(i);
      const auto of = static_cast<std::size_t>(end);
      const leaf::Influence<Float> influence = leaf::influenceOf(lanes, base, placesFrom(i), blur_);
      const auto counts = lanes.before(at, of);
      const Float hidden = load(memory_.hidden, i);
      const Float leaves = load(memory_.leaves, i);
      lanes.store(lanes.choose(counts, lanes.larger(hidden, influence.hidden), hidden),
                  memory_.hidden, at, of);
      lanes.store(lanes.choose(counts, leaves + task_.stem_density * influence.leaf, leaves),
                  memory_.leaves, at, of);
    }
  }

  Team team_;
  LeafSearchTask task_;
  leaf::Memory memory_;
  float blur_;
  float radius_ = 0.0F;  // about halfway up [m]
};

}  // namespace field_phenotyping
