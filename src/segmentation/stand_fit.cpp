#include "field_phenotyping/segmentation/stand_fit.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/leaf_bases.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/midline_refinement.hpp"
#include "field_phenotyping/segmentation/stand_length.hpp"
#include "field_phenotyping/segmentation/stem_curve.hpp"
#include "field_phenotyping/segmentation/stem_search.hpp"
#include "field_phenotyping/segmentation/stem_top.hpp"

namespace field_phenotyping {
namespace {

constexpr double kWidened = 1.2;  // a midline among leaves

/// Carries an axis on by some way, and cuts it where the stem ends; see findStemTop().
/// @param beyond [m]
Midline cutAtTop(const GrowthScene& scene, const SamplingProfile& sampling, Midline midline,
                 float beyond, float max_radius, const StandLength& stand = {},
                 double leaf_density = 1.0) {
  midline.axis = midline.axis.extendedBy(beyond);
  const std::vector<std::uint32_t> around =
      pointsAround(scene, midline.axis, kStemSurroundings * max_radius);
  midline.axis =
      midline.axis.below(findStemTop(scene.points, around, midline, sampling, stand, leaf_density));
  return midline;
}

/// Whether an axis is another one, carried on.
bool staysOn(const StemAxis& longer, const StemAxis& axis) {
  constexpr float kApart = 0.01F;  // [m]
  return longer.length() > axis.length() &&
         std::all_of(axis.nodes().begin(), axis.nodes().end(), [&](const StemAxis::Node& node) {
           return longer.project(node.position).distance < kApart;
         });
}

/// Carries stems on upwards as far as points show them, where plants are taller than the sensor
/// sees well: what is sampled ever more sparsely looked empty as long as it was not known how
/// sparsely.
void carryOn(const GrowthScene& scene, const SamplingProfile& sampling, float max_radius,
             float plant_height, std::vector<GrownStem>& stems) {
  constexpr float kStep = 0.25F;   // [m]
  constexpr float kLeast = 0.05F;  // [m] that counts as going on
  constexpr int kMostSteps = 6;
  constexpr double kSparse = 0.35;  // of the best sampling: where an end could be overlooked
  const auto samplingAtEnd = [&](const StemAxis& axis) {
    return sampling.ofStems(static_cast<double>(axis.length()));
  };
  // Straight on, which takes no fit, most stems show where they end. Where hardly one of a stand
  // does so beyond what is seen well, only those few are followed.
  constexpr std::size_t kFew = 10U;  // one in so many
  std::vector<std::uint8_t> is_far(stems.size(), 0U);
  parallelFor(stems.size(), [&](std::size_t s) {
    const Midline& midline = stems[s].midline;
    if (samplingAtEnd(midline.axis) >= 1.0) return;
    const Midline straight = cutAtTop(scene, sampling, midline, kMostSteps * kStep, max_radius);
    is_far[s] = samplingAtEnd(straight.axis) < kSparse ? 1U : 0U;
  });
  const auto far = static_cast<std::size_t>(std::count(is_far.begin(), is_far.end(), 1U));
  const bool is_tall = kFew * far > stems.size();
  parallelFor(stems.size(), [&](std::size_t s) {
    if (!is_tall && is_far[s] == 0U) return;
    Midline midline = stems[s].midline;
    bool goes_on = false;
    for (int step = 0; step < kMostSteps; ++step) {
      const float end = midline.axis.length();
      if (samplingAtEnd(midline.axis) >= 1.0) break;
      Midline longer = midline;
      longer.axis = midline.axis.extendedBy(kStep);
      const std::vector<std::uint32_t> around =
          pointsAround(scene, longer.axis, kStemSurroundings * max_radius);
      const float occupied = findOccupiedEnd(scene.points, around, longer, sampling);
      if (occupied < end + kLeast) break;
      Midline fitted = midline;
      fitted.axis = longer.axis.below(occupied);
      fitted = refitMidline(scene.points, around, fitted, max_radius, plant_height);
      if (!staysOn(fitted.axis, midline.axis)) break;
      midline = std::move(fitted);
      goes_on = true;
    }
    if (!goes_on) return;
    midline = cutAtTop(scene, sampling, std::move(midline), kStep, max_radius);
    if (midline.axis.length() > stems[s].midline.axis.length() &&
        samplingAtEnd(midline.axis) < kSparse) {
      stems[s].midline = std::move(midline);
    }
  });
}

/// Where a stem of that stand ends; its axis has been cut where it alone shows an end.
Midline withLikelyEnd(const GrowthScene& scene, const SamplingProfile& sampling, Midline midline,
                      const StandLength& stand, float max_radius, float plant_height) {
  constexpr float kSpreads = 2.0F;
  const StemAxis& axis = midline.axis;
  const float longest =
      std::max(axis.length() + kBeyondEnd * plant_height,
               static_cast<float>(stand.typical) + kSpreads * static_cast<float>(stand.spread));
  const float beyond = longest - axis.length();
  return cutAtTop(scene, sampling, std::move(midline), beyond, max_radius, stand);
}

/// How far along a stem's axis the canopy reaches there [m].
double canopyAlong(const GrowthScene& scene, const StemAxis& axis, float plant_height) {
  constexpr float kCanopy = 0.10F;    // [m] half of what plants stand apart
  constexpr float kHighest = 2.0F;    // plant_height
  constexpr std::size_t kStray = 4U;  // points above it
  const StemAxis whole = axis.extendedBy(std::max(kHighest * plant_height - axis.length(), 0.0F));
  // Downwards, stretch by stretch, until there are enough.
  const int steps = std::max(static_cast<int>(std::ceil(whole.length() / kCanopy)), 1);
  const float step = whole.length() / static_cast<float>(steps);
  std::vector<float> along;
  for (int k = steps - 1; k >= 0 && along.size() <= kStray; --k) {
    const float low = step * static_cast<float>(k);
    const float high = step * static_cast<float>(k + 1);
    scene.grid.forEachWithinOfLine(whole.pointAt(low), whole.pointAt(high), kCanopy,
                                   [&](std::uint32_t i) {
                                     const float at = whole.project(scene.points[i]).arc_length;
                                     if ((k == 0 || at >= low) && (k + 1 == steps || at < high))
                                       along.push_back(at);
                                   });
  }
  if (along.size() <= kStray) return static_cast<double>(axis.length());
  const auto high = along.begin() + kStray;
  std::nth_element(along.begin(), high, along.end(), std::greater<>());
  return static_cast<double>(std::max(*high, axis.length()));
}

/// Lets the stems learn from one another where they end.
void poolEnds(const GrowthScene& scene, const SamplingProfile& sampling, float max_radius,
              float plant_height, std::vector<GrownStem>& stems) {
  std::vector<double> lengths(stems.size());
  std::vector<double> heights(stems.size());
  parallelFor(stems.size(), [&](std::size_t s) {
    lengths[s] = static_cast<double>(stems[s].midline.axis.length());
    heights[s] = canopyAlong(scene, stems[s].midline.axis, plant_height);
  });
  const std::vector<StandLength> stands = standLengths(lengths, heights, sampling);
  // Rolled leaves run on where a whorl begins. Where nothing else shows that a stem came out too
  // long, leaves are believed to stand in its core more densely than beside it.
  constexpr double kAlone = 2.0;
  parallelFor(stems.size(), [&](std::size_t s) {
    Midline& midline = stems[s].midline;
    if (stands[s].known()) {
      midline =
          withLikelyEnd(scene, sampling, std::move(midline), stands[s], max_radius, plant_height);
    } else {
      midline = cutAtTop(scene, sampling, std::move(midline), kBeyondEnd * plant_height, max_radius,
                         {}, kAlone);
    }
  });
}

float radiusHalfwayUp(const StemAxis& axis) {
  return axis.radiusAt(0.5F * axis.length());
}

/// Whether an axis is about that of another stem's lower half; above it that may have followed a
/// leaf.
bool isAlong(const StemAxis& axis, const StemAxis& thick) {
  constexpr float kStep = 0.05F;     // [m]
  constexpr float kFarthest = 1.5F;  // of the radius
  for (float s = 0.0F; s < 0.5F * thick.length(); s += kStep) {
    if (!(axis.project(thick.pointAt(s)).distance < kFarthest * thick.radiusAt(s))) return false;
  }
  return true;
}

/// Fits stems anew that came out far thicker than the others of their stand: leaves that wrap a
/// stem look like one, and from their surface no fit finds the way back to the stem's. Young plants
/// are left as they are, for they show too little of a stem within.
void refitThickStems(const GrowthScene& scene, float max_radius, float plant_height,
                     std::vector<GrownStem>& stems) {
  constexpr std::size_t kLeastStems = 5U;
  // Of thin stems most may be wrapped.
  constexpr std::size_t kThinner = 4U;  // one in so many is thinner than the radius taken for usual
  constexpr float kThick = 1.3F;     // of the usual radius: stems of a stand are alike to a tenth
  constexpr float kThickest = 2.0F;  // of the same, that is looked for
  constexpr float kLeastEvidence = 0.5F;  // of what spoke for the thick one, leaves and all
  if (stems.size() < kLeastStems || isYoung(plant_height)) return;
  std::vector<float> radii;
  for (const GrownStem& stem : stems) radii.push_back(radiusHalfwayUp(stem.midline.axis));
  std::vector<float> sorted = radii;
  const auto quarter = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / kThinner);
  std::nth_element(sorted.begin(), quarter, sorted.end());
  const float usual = *quarter;
  const float thickest = std::min(max_radius, kThickest * usual);
  parallelFor(stems.size(), [&](std::size_t s) {
    if (!(radii[s] > kThick * usual)) return;
    Midline& midline = stems[s].midline;
    const std::vector<std::uint32_t> around =
        pointsAround(scene, midline.axis, kStemSurroundings * max_radius);
    Midline thinner = fitMidline(scene.points, around, midline.axis, thickest, plant_height);
    thinner = refineMidline(scene.points, around, thinner, plant_height, kWidened);
    if (radiusHalfwayUp(thinner.axis) < kThick * usual &&
        thinner.evidence > kLeastEvidence * midline.evidence &&
        isAlong(thinner.axis, midline.axis)) {
      midline = std::move(thinner);
    }
  });
}

/// Where the stems' surfaces are, once their ends are about known.
/// @param leaves_known leave out what the midlines so far show to be leaf bases'
void refineMidlines(const GrowthScene& scene, float max_radius, float plant_height, double widened,
                    bool leaves_known, const ComputeDevice& device, std::vector<GrownStem>& stems) {
  std::vector<std::vector<std::uint32_t>> members(stems.size());
  parallelFor(stems.size(), [&](std::size_t s) {
    members[s] = pointsAround(scene, stems[s].midline.axis, kStemSurroundings * max_radius);
  });
  std::vector<LeafBases> leaf_bases(stems.size());
  if (leaves_known) {
    leaf_bases = findLeafBases(scene.points, members, midlinesOf(stems), device);
  }
  parallelFor(stems.size(), [&](std::size_t s) {
    Midline& midline = stems[s].midline;
    const auto isLeaf = [&](std::uint32_t i) {
      constexpr float kLeaf = 0.6F;
      return leaf_bases[s].leafShare(scene.points[i], midline.axis) > kLeaf;
    };
    members[s].erase(std::remove_if(members[s].begin(), members[s].end(), isLeaf),
                     members[s].end());
    midline = refineMidline(scene.points, members[s], midline, plant_height, widened);
  });
}

/// Fits the midlines of seedlings anew, now that it is known where they end: the leaves above are
/// many, and bend the axes their way. Two that come to one stem are one; one that comes to no stem
/// stays as it was, for that was like a stem.
std::vector<GrownStem> refitSeedlings(const GrowthScene& scene, const StemSelection& selection,
                                      float plant_height, std::vector<GrownStem> stems,
                                      const SegmentationParameters& parameters) {
  if (!isSeedling(plant_height)) return stems;
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  std::vector<GrownStem> refitted(stems.size());
  parallelFor(stems.size(), [&](std::size_t s) {
    const StemAxis& prior = stems[s].midline.axis;
    refitted[s] = growCandidate(
        scene,
        fitMidline(scene.points, pointsAround(scene, prior, kStemSurroundings * max_radius), prior,
                   max_radius, plant_height),
        parameters);
  });
  const auto footOf = [](const GrownStem& stem) -> Eigen::Vector2f {
    return stem.midline.axis.nodes().front().position.head<2>();
  };
  const StandLean lean = leanOf(axesOf(stems));
  const auto leaning = [&](const GrownStem& stem) {
    return (slopeOf(stem.midline.axis) - lean.slope).norm();
  };
  constexpr float kAstray = 0.03F;   // [m] along a leaf
  constexpr float kLeaning = 0.36F;  // slope to the usual axis
  std::vector<Eigen::Vector2f> feet;
  for (std::size_t s = 0; s < stems.size(); ++s) {
    const bool astray = (footOf(refitted[s]) - footOf(stems[s])).norm() > kAstray &&
                        leaning(refitted[s]) > std::max(leaning(stems[s]), kLeaning);
    if (astray) refitted[s] = stems[s];
    feet.push_back(footOf(refitted[s]));
  }
  std::vector<GrownStem> kept = onlyStems(selection, std::move(refitted));
  for (std::size_t s = 0; s < stems.size(); ++s) {
    const bool is_kept = std::any_of(kept.begin(), kept.end(), [&](const GrownStem& stem) {
      return (footOf(stem) - feet[s]).norm() < static_cast<float>(parameters.min_plant_spacing);
    });
    if (!is_kept) kept.push_back(std::move(stems[s]));
  }
  return kept;
}

/// Draws the slopes of seedlings' axes towards what the stand's lean makes likely. Few points show
/// the upper half of so short a stem, and many leaves there pull it their way; its foot stands.
void steadySeedlings(float plant_height, std::vector<GrownStem>& stems) {
  if (!isSeedling(plant_height)) return;
  const StandLean lean = leanOf(axesOf(stems));
  if (!(lean.scatter > 0.0F)) return;
  constexpr float kPull = 0.006F;          // [m] by which leaves move the upper end
  constexpr float kLeastScatter = 0.015F;  // of the true slopes
  constexpr float kFoot = 0.2F;            // of the length
  for (GrownStem& stem : stems) {
    const StemAxis& axis = stem.midline.axis;
    const Eigen::Vector3f chord = axis.nodes().back().position - axis.nodes().front().position;
    const float error = kPull / chord.z();
    const float scatter =
        std::max(lean.scatter * lean.scatter - error * error, kLeastScatter * kLeastScatter);
    const float share = error * error / (scatter + error * error);
    const Eigen::Vector2f change = share * (lean.slope - slopeOf(axis));
    const float foot = axis.nodes().front().position.z() + kFoot * chord.z();
    std::vector<StemAxis::Node> nodes = axis.nodes();
    for (StemAxis::Node& node : nodes) {
      node.position.head<2>() += (node.position.z() - foot) * change;
    }
    stem.midline.axis = StemAxis(std::move(nodes));
  }
}

}  // namespace

std::vector<GrownStem> fitStand(const GrowthScene& scene, const StemSelection& selection,
                                float plant_height, const SamplingProfile& of_stand,
                                std::vector<GrownStem> stems,
                                const SegmentationParameters& parameters,
                                const ComputeDevice& device) {
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  // A few plants show how a plant is built rather than how it is sampled.
  constexpr std::size_t kFewStems = 5U;
  const SamplingProfile sampling = stems.size() < kFewStems ? SamplingProfile() : of_stand;
  carryOn(scene, sampling, max_radius, plant_height, stems);
  refineMidlines(scene, max_radius, plant_height, kWidened, false, device, stems);
  refitThickStems(scene, max_radius, plant_height, stems);
  poolEnds(scene, sampling, max_radius, plant_height, stems);
  stems = refitSeedlings(scene, selection, plant_height, std::move(stems), parameters);
  refineMidlines(scene, max_radius, plant_height, 1.0, true, device, stems);
  steadySeedlings(plant_height, stems);
  return stems;
}

}  // namespace field_phenotyping
