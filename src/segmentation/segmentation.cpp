#include "field_phenotyping/segmentation/segmentation.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/midline_refinement.hpp"
#include "field_phenotyping/segmentation/organ_assignment.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "field_phenotyping/segmentation/region_growth.hpp"
#include "field_phenotyping/segmentation/stand_length.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"
#include "field_phenotyping/segmentation/stem_top.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"

namespace field_phenotyping {
namespace {

constexpr float kAround = 2.5F;    // max_radius: points this near may tell of a stem
constexpr float kBeyond = 0.2F;    // of the plant's height, that a stem may go on above its end
constexpr float kSeedling = 0.7F;  // [m] lower than plants whose stems have grown out of the whorl

/// The axis prior that the start points give, carried down to the soil.
StemAxis axisFromSeeds(const StemSeeds& seeds, const GroundModel& ground, float radius) {
  std::vector<StemAxis::Node> nodes;
  for (const Eigen::Vector3f& seed : seeds.points) nodes.push_back({seed, radius});
  const Eigen::Vector3f low = nodes.front().position;
  const StemAxis upper(nodes);
  constexpr float kLever = 0.3F;  // [m] the slope of the lowest stretch carries on downwards
  const Eigen::Vector3f slope = upper.pointAt(std::min(kLever, upper.length())) - low;
  const float drop = ground.heightAbove(low);
  if (drop > 0.01F && slope.z() > 0.0F) {
    nodes.insert(nodes.begin(), {Eigen::Vector3f(low - drop / slope.z() * slope), radius});
  }
  return StemAxis(std::move(nodes));
}

/// About how high the block's plants are; soil does not count, nor a few points above them.
float canopyHeight(const GrowthScene& scene, const GroundModel& ground) {
  constexpr float kSoil = 0.05F;  // [m]
  constexpr float kShare = 0.98F;
  std::vector<float> heights;
  for (const Eigen::Vector3f& point : scene.points) {
    const float height = ground.heightAbove(point);
    if (height > kSoil) heights.push_back(height);
  }
  if (heights.empty()) return kSoil;
  const auto high = heights.begin() +
                    static_cast<std::ptrdiff_t>(kShare * static_cast<float>(heights.size() - 1U));
  std::nth_element(heights.begin(), high, heights.end());
  return *high;
}

/// Step 1: the start points give the axis prior, the points round it the midline and where it ends.
Midline findMidline(const GrowthScene& scene, const StemAxis& prior, float max_radius,
                    float plant_height) {
  const std::vector<std::uint32_t> around = pointsAround(scene, prior, kAround * max_radius);
  Midline midline = fitMidline(scene.points, around, prior, max_radius, plant_height);
  midline.axis = midline.axis.below(findStemTop(scene.points, around, midline));
  // Without the leaves above, the axis points straight up through them, and shows its end better.
  constexpr float kMostBeyond = 0.25F;  // [m]
  midline = fitMidline(scene.points, around, midline.axis, max_radius, plant_height);
  midline.axis = midline.axis.extendedBy(std::min(kMostBeyond, kBeyond * plant_height));
  midline.axis = midline.axis.below(findStemTop(scene.points, around, midline));
  return midline;
}

/// Where a stem of that stand ends; its axis has been cut where it alone shows an end.
Midline withLikelyEnd(const GrowthScene& scene, Midline midline, const StandLength& stand,
                      float max_radius, float plant_height) {
  constexpr float kSpreads = 2.0F;
  const StemAxis& axis = midline.axis;
  const float longest =
      std::max(axis.length() + kBeyond * plant_height,
               static_cast<float>(stand.typical) + kSpreads * static_cast<float>(stand.spread));
  Midline longer = midline;
  longer.axis = axis.extendedBy(longest - axis.length());
  const std::vector<std::uint32_t> around = pointsAround(scene, longer.axis, kAround * max_radius);
  midline.axis = longer.axis.below(findStemTop(scene.points, around, longer, stand));
  return midline;
}

/// How far along a stem's axis the canopy reaches there [m].
double canopyAlong(const GrowthScene& scene, const StemAxis& axis, float plant_height) {
  constexpr float kCanopy = 0.10F;    // [m] half of what plants stand apart
  constexpr float kHighest = 2.0F;    // plant_height
  constexpr std::size_t kStray = 4U;  // points above it
  const StemAxis whole = axis.extendedBy(std::max(kHighest * plant_height - axis.length(), 0.0F));
  std::vector<float> along;
  for (const std::uint32_t i : pointsAround(scene, whole, kCanopy)) {
    along.push_back(whole.project(scene.points[i]).arc_length);
  }
  if (along.size() <= kStray) return static_cast<double>(axis.length());
  const auto high = along.begin() + kStray;
  std::nth_element(along.begin(), high, along.end(), std::greater<>());
  return static_cast<double>(std::max(*high, axis.length()));
}

/// Lets the stems learn from one another where they end.
void poolEnds(const GrowthScene& scene, float max_radius, float plant_height,
              std::vector<GrownStem>& stems) {
  std::vector<double> lengths(stems.size());
  std::vector<double> heights(stems.size());
  parallelFor(stems.size(), [&](std::size_t s) {
    lengths[s] = static_cast<double>(stems[s].midline.axis.length());
    heights[s] = canopyAlong(scene, stems[s].midline.axis, plant_height);
  });
  const std::vector<StandLength> stands = standLengths(lengths, heights);
  parallelFor(stems.size(), [&](std::size_t s) {
    if (!stands[s].known()) return;
    stems[s].midline =
        withLikelyEnd(scene, std::move(stems[s].midline), stands[s], max_radius, plant_height);
  });
}

/// Where the stems' surfaces are, once their ends are about known.
void refineMidlines(const GrowthScene& scene, float max_radius, float plant_height, double widened,
                    std::vector<GrownStem>& stems) {
  parallelFor(stems.size(), [&](std::size_t s) {
    Midline& midline = stems[s].midline;
    midline = refineMidline(scene.points, pointsAround(scene, midline.axis, kAround * max_radius),
                            midline, plant_height, widened);
  });
}

/// What grows from every candidate; candidates that nothing grows from are left out.
std::vector<GrownStem> growCandidates(const GrowthScene& scene, const std::vector<StemSeeds>& seeds,
                                      const GroundModel& ground, float plant_height,
                                      const SegmentationParameters& parameters) {
  std::vector<GrownStem> grown(seeds.size());
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  parallelFor(seeds.size(), [&](std::size_t k) {
    grown[k] = growCandidate(scene,
                             findMidline(scene, axisFromSeeds(seeds[k], ground, 0.5F * max_radius),
                                         max_radius, plant_height),
                             parameters);
  });
  grown.erase(std::remove_if(grown.begin(), grown.end(),
                             [](const GrownStem& stem) { return stem.points.empty(); }),
              grown.end());
  return grown;
}

std::vector<GrownStem> onlyStems(const StemSelection& selection, std::vector<GrownStem> grown) {
  std::vector<StemCandidate> candidates;
  for (const GrownStem& stem : grown) candidates.push_back({stem.midline, stem.points});
  std::vector<GrownStem> stems;
  for (const std::size_t k : selection.stemsAmong(candidates)) {
    stems.push_back(std::move(grown[k]));
  }
  return stems;
}

/// Fits the midlines of seedlings anew, now that it is known where they end: the leaves above are
/// many, and bend the axes their way. Two that come to one stem are one.
std::vector<GrownStem> refitSeedlings(const GrowthScene& scene, const StemSelection& selection,
                                      float plant_height, std::vector<GrownStem> stems,
                                      const SegmentationParameters& parameters) {
  if (plant_height > kSeedling) return stems;
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  parallelFor(stems.size(), [&](std::size_t s) {
    const StemAxis prior = stems[s].midline.axis;
    stems[s] =
        growCandidate(scene,
                      fitMidline(scene.points, pointsAround(scene, prior, kAround * max_radius),
                                 prior, max_radius, plant_height),
                      parameters);
  });
  return onlyStems(selection, std::move(stems));
}

std::vector<StemAxis> axesOf(const std::vector<GrownStem>& stems) {
  std::vector<StemAxis> axes;
  for (const GrownStem& stem : stems) axes.push_back(stem.midline.axis);
  return axes;
}

/// Draws the slopes of seedlings' axes towards what the stand's lean makes likely. Few points show
/// the upper half of so short a stem, and many leaves there pull it their way; its foot stands.
void steadySeedlings(float plant_height, std::vector<GrownStem>& stems) {
  if (plant_height > kSeedling) return;
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
    const Eigen::Vector2f change = share * (lean.slope - chord.head<2>() / chord.z());
    const float foot = axis.nodes().front().position.z() + kFoot * chord.z();
    std::vector<StemAxis::Node> nodes = axis.nodes();
    for (StemAxis::Node& node : nodes) {
      node.position.head<2>() += (node.position.z() - foot) * change;
    }
    stem.midline.axis = StemAxis(std::move(nodes));
  }
}

/// Where an axis meets the soil.
Eigen::Vector2d baseOf(const Block& block, const StemAxis& axis) {
  const Eigen::Vector3f low = axis.nodes().front().position;
  const Eigen::Vector3f base = axis.pointAtHeight(block.ground.heightAt(low.x(), low.y()));
  return base.head<2>().cast<double>();
}

/// How the stems stand.
Stand standOf(const Block& block, const std::vector<GrownStem>& stems,
              const SegmentationParameters& parameters) {
  Stand stand;
  stand.lean = leanOf(axesOf(stems));
  std::vector<PlantPlace> places;
  for (const GrownStem& stem : stems) {
    stand.plants.push_back(baseOf(block, stem.midline.axis));
    places.push_back({stand.plants.back(), 1.0});
  }
  stand.rows = RowModel::find(places, {parameters.row_spacing, parameters.plant_spacing});
  return stand;
}

/// Carries candidates whose foot is hidden down to the soil anew.
void settleFeet(const GrowthScene& scene, const Block& block, Stand stand,
                const SegmentationParameters& parameters, std::vector<GrownStem>& candidates) {
  stand.plants.clear();  // the candidates may be among them
  parallelFor(candidates.size(), [&](std::size_t c) {
    Midline midline = candidates[c].midline;
    std::optional<SettledFoot> foot = settleFoot(block, scene.grid, midline, stand);
    if (!foot) return;
    midline.axis = std::move(foot->axis);
    midline.hidden = foot->hidden;
    GrownStem settled = growCandidate(scene, std::move(midline), parameters);
    if (!settled.points.empty()) candidates[c] = std::move(settled);
  });
}

constexpr float kHighSeeds =
    0.3F;  // of the plants' height: what begins above it has its foot hidden

bool beginsHigh(const StemSeeds& seeds, const GroundModel& ground, float plant_height) {
  return ground.heightAbove(seeds.points.front()) > kHighSeeds * plant_height;
}

/// The midline along an axis that is known within millimetres.
Midline midlineAlong(const GrowthScene& scene, const StemAxis& axis, float plant_height,
                     const SegmentationParameters& parameters) {
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  return followMidline(scene.points, pointsAround(scene, axis, kAround * max_radius), axis,
                       max_radius, plant_height);
}

/// What grows from start points high up, of stems that are none of `known`: a line through them,
/// carried down to the soil as the stand stands. A free fit would follow the leaves below.
std::vector<GrownStem> growHanging(const GrowthScene& scene, const Block& block,
                                   const std::vector<StemSeeds>& seeds, const Stand& stand,
                                   const std::vector<GrownStem>& known, float plant_height,
                                   const SegmentationParameters& parameters) {
  if (!stand.lean.known()) return {};
  std::vector<GrownStem> grown(seeds.size());
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  parallelFor(seeds.size(), [&](std::size_t k) {
    const std::vector<Eigen::Vector3f>& points = seeds[k].points;
    if (!beginsHigh(seeds[k], block.ground, plant_height)) return;
    const bool is_known = std::any_of(known.begin(), known.end(), [&](const GrownStem& stem) {
      const auto near = std::count_if(points.begin(), points.end(), [&](const auto& point) {
        return stem.midline.axis.project(point).distance < max_radius;
      });
      return 2 * static_cast<std::size_t>(near) > points.size();
    });
    if (is_known) return;
    std::vector<StemAxis::Node> nodes;
    for (const Eigen::Vector3f& point : points) nodes.push_back({point, 0.5F * max_radius});
    const std::optional<SettledFoot> settled = settleFoot(
        block, scene.grid,
        midlineAlong(scene, StemAxis(std::move(nodes)), plant_height, parameters), stand);
    if (!settled) return;
    Midline midline = midlineAlong(scene, settled->axis, plant_height, parameters);
    midline.hidden = settled->hidden;
    midline.axis = midline.axis.below(findStemTop(
        scene.points, pointsAround(scene, midline.axis, kAround * max_radius), midline));
    grown[k] = growCandidate(scene, std::move(midline), parameters);
  });
  grown.erase(std::remove_if(grown.begin(), grown.end(),
                             [](const GrownStem& stem) { return stem.points.empty(); }),
              grown.end());
  return grown;
}

/// Moves the foot of a stem; what is seen of it stays.
void moveFoot(Midline& midline, const Eigen::Vector2f& by) {
  std::vector<StemAxis::Node> nodes = midline.axis.nodes();
  float s = 0.0F;
  for (std::size_t k = 0; k < nodes.size() && s < midline.hidden; ++k) {
    nodes[k].position.head<2>() += (1.0F - s / midline.hidden) * by;
    if (k + 1U < nodes.size()) {
      s += (midline.axis.nodes()[k + 1U].position - midline.axis.nodes()[k].position).norm();
    }
  }
  midline.axis = StemAxis(std::move(nodes));
}

/// Settles the feet that are guessed once more, now that all their neighbours are known.
void settleAmongNeighbors(const GrowthScene& scene, const Block& block,
                          const SegmentationParameters& parameters, std::vector<GrownStem>& stems) {
  Stand stand = standOf(block, stems, parameters);
  std::vector<Eigen::Vector2d> bases = stand.plants;
  for (std::size_t s = 0; s < stems.size(); ++s) {
    if (!(stems[s].midline.hidden > 0.0F)) continue;
    stand.plants = bases;
    stand.plants.erase(stand.plants.begin() + static_cast<std::ptrdiff_t>(s));
    const std::optional<SettledFoot> settled =
        settleFoot(block, scene.grid, stems[s].midline, stand);
    if (!settled) continue;
    const Eigen::Vector2d base = baseOf(block, settled->axis);
    moveFoot(stems[s].midline, (base - bases[s]).cast<float>());
    bases[s] = base;
  }
}

/// Longest gap that regions of one stem may merge across [m]: twice the plants' usual spacing, for
/// what lies farther up may well be a neighbour's.
float longestGap(const std::vector<GrownStem>& stems) {
  constexpr float kMost = 0.40F;
  constexpr float kSpacings = 2.0F;
  std::vector<float> spacings;
  for (const GrownStem& stem : stems) {
    float nearest = kMost;
    for (const GrownStem& other : stems) {
      if (&stem == &other) continue;
      nearest = std::min(nearest, (stem.midline.axis.nodes().front().position -
                                   other.midline.axis.nodes().front().position)
                                      .head<2>()
                                      .norm());
    }
    spacings.push_back(nearest);
  }
  return spacings.empty() ? kMost : std::min(kMost, kSpacings * medianOf(spacings));
}

/// Points so near to a stem that no other one can begin there.
std::vector<std::uint8_t> explainedPoints(const GrowthScene& scene,
                                          const std::vector<GrownStem>& stems) {
  std::vector<std::uint8_t> explained(scene.points.size(), 0U);
  constexpr float kStep = 0.02F;  // [m]
  constexpr float kReach = 3.0F;  // standard deviations beyond the surface
  for (const GrownStem& stem : stems) {
    const StemAxis& axis = stem.midline.axis;
    for (float s = 0.0F; s <= axis.length(); s += kStep) {
      const float reach = axis.radiusAt(s) + kReach * stem.midline.spread;
      scene.grid.forEachWithin(axis.pointAt(s), std::hypot(reach, 0.5F * kStep),
                               [&](std::uint32_t i, float) { explained[i] = 1U; });
    }
  }
  return explained;
}

/// A point that two stems claim goes to the one whose surface it is nearer to.
std::vector<std::int32_t> resolveOwners(const GrowthScene& scene,
                                        const std::vector<GrownStem>& stems) {
  std::vector<std::int32_t> owner(scene.points.size(), -1);
  const auto away = [&](std::size_t stem, std::uint32_t i) {
    const StemAxis::Projection at = stems[stem].midline.axis.project(scene.points[i]);
    return std::abs(at.distance - at.radius);
  };
  for (std::size_t s = 0; s < stems.size(); ++s) {
    for (const std::uint32_t i : stems[s].points) {
      if (owner[i] < 0 || away(s, i) < away(static_cast<std::size_t>(owner[i]), i)) {
        owner[i] = static_cast<std::int32_t>(s);
      }
    }
  }
  return owner;
}

/// Whether each stem is a tiller or a leaf's, not a plant's: what belongs to it stays far below the
/// stand, and it rises so near to a plant that nothing would have been sown there.
std::vector<bool> findTillers(const GrowthScene& scene, const Block& block,
                              const std::vector<GrownStem>& stems,
                              const std::vector<std::int32_t>& plant_owner) {
  constexpr std::size_t kLeastStems = 5U;  // that show how a stand grows
  constexpr float kLow = 0.5F;             // of the stand's height
  constexpr double kNear = 0.35;           // of the plants' usual distance
  std::vector<bool> tillers(stems.size(), false);
  if (stems.size() < kLeastStems) return tillers;
  std::vector<float> heights(stems.size(), 0.0F);
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    if (plant_owner[i] < 0) continue;
    float& height = heights[static_cast<std::size_t>(plant_owner[i])];
    height = std::max(height, block.ground.heightAbove(scene.points[i]));
  }
  const float low = kLow * medianOf(heights);
  std::vector<Eigen::Vector2d> bases;
  for (const GrownStem& stem : stems) bases.push_back(baseOf(block, stem.midline.axis));
  std::vector<double> nearest(stems.size(), std::numeric_limits<double>::infinity());
  std::vector<double> spacings;
  for (std::size_t s = 0; s < stems.size(); ++s) {
    for (std::size_t other = 0; other < stems.size(); ++other) {
      if (other == s || heights[other] < low) continue;
      nearest[s] = std::min(nearest[s], (bases[other] - bases[s]).norm());
    }
    if (heights[s] >= low) spacings.push_back(nearest[s]);
  }
  const double near = kNear * medianOf(spacings);
  for (std::size_t s = 0; s < stems.size(); ++s) {
    tillers[s] = heights[s] < low && nearest[s] < near;
  }
  return tillers;
}

/// Reorders the block's points plant by plant, stems first.
SegmentedBlock assemble(const Block& block, const std::vector<GrownStem>& stems,
                        const std::vector<std::int32_t>& stem_owner,
                        const std::vector<std::int32_t>& plant_owner) {
  SegmentedBlock out;
  out.header = block.header;
  out.ground = block.ground;
  out.cloud.origin = block.cloud.origin;

  constexpr std::size_t kGroups = 2U;  // stem, other organs
  const std::size_t none = kGroups * stems.size();
  std::vector<std::vector<std::uint32_t>> groups(none + 1U);
  for (std::uint32_t i = 0; i < block.cloud.size(); ++i) {
    const bool is_stem = stem_owner[i] >= 0;
    const std::int32_t plant = is_stem ? stem_owner[i] : plant_owner[i];
    const std::size_t group =
        plant < 0 ? none : kGroups * static_cast<std::size_t>(plant) + (is_stem ? 0U : 1U);
    groups[group].push_back(i);
  }
  out.source_index.reserve(block.cloud.size());
  const auto append = [&](const std::vector<std::uint32_t>& group) {
    IndexSpan span;
    span.begin = static_cast<std::uint32_t>(out.source_index.size());
    out.source_index.insert(out.source_index.end(), group.begin(), group.end());
    span.end = static_cast<std::uint32_t>(out.source_index.size());
    return span;
  };
  for (std::size_t s = 0; s < stems.size(); ++s) {
    Plant plant;
    plant.stem = append(groups[kGroups * s]);
    plant.points = {plant.stem.begin, append(groups[kGroups * s + 1U]).end};
    plant.axis = stems[s].midline.axis;
    const Eigen::Vector3f low = plant.axis.nodes().front().position;
    plant.base = plant.axis.pointAtHeight(block.ground.heightAt(low.x(), low.y()));
    const Eigen::Vector3d base = block.cloud.origin + plant.base.cast<double>();
    plant.owned = block.header.holds(base.x(), base.y(), PlantRegistry::kBorderTolerance);
    plant.growth = stems[s].growth;
    out.plants.push_back(std::move(plant));
  }
  append(groups[none]);

  for (const std::uint32_t i : out.source_index) {
    out.cloud.points.push_back(block.cloud.points[i]);
    if (block.cloud.hasColors()) out.cloud.colors.push_back(block.cloud.colors[i]);
  }
  return out;
}

/// Widens the neighbourhood and the slabs that seeds are found in where the cloud is too sparse for
/// the ones asked for to show a stem's shape.
SegmentationParameters adaptToDensity(const std::vector<Eigen::Vector3f>& points,
                                      SegmentationParameters parameters) {
  constexpr std::size_t kSamples = 500U;
  constexpr std::uint32_t kEnoughNeighbors = 14U;
  constexpr double kWiden = 1.5;
  const auto radius = static_cast<float>(parameters.seed_radius);
  const NeighborGrid grid(points, radius);
  std::vector<std::uint32_t> counts;
  for (std::size_t i = 0; i < points.size();
       i += std::max<std::size_t>(1U, points.size() / kSamples)) {
    std::uint32_t count = 0U;
    grid.forEachWithin(points[i], radius, [&](std::uint32_t, float) { ++count; });
    counts.push_back(count);
  }
  if (medianOf(counts) >= kEnoughNeighbors) return parameters;
  parameters.seed_radius *= kWiden;
  parameters.seed_slab *= kWiden;
  return parameters;
}

/// Looks for the stems of low plants from nearer to the soil: leaves begin right above it there.
SegmentationParameters adaptToHeight(float plant_height, SegmentationParameters parameters) {
  constexpr double kShare = 0.03;   // of the plants' height
  constexpr double kLowest = 0.01;  // [m] below it soil is left
  constexpr float kWeeds = 0.20F;   // [m] what is lower looks like weeds from nearer
  if (plant_height < kWeeds) return parameters;
  parameters.seed_min_height = std::min(
      parameters.seed_min_height, std::max(kShare * static_cast<double>(plant_height), kLowest));
  return parameters;
}

}  // namespace

SegmentedBlock segmentBlock(const Block& block, const SegmentationParameters& wanted) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  if (points.empty()) return assemble(block, {}, {}, {});
  SegmentationParameters parameters = adaptToDensity(points, wanted);
  const auto radius = static_cast<float>(parameters.seed_radius);
  const NeighborGrid grid(points, 0.5F * radius);
  const std::vector<LocalShape> shapes = computeLocalShapes(points, grid, radius);
  const GrowthScene scene{points, shapes, grid};
  const float plant_height = canopyHeight(scene, block.ground);
  parameters = adaptToHeight(plant_height, parameters);
  const StemSelection selection(block, grid, parameters);

  // Step 1: start points. What grows from them shows which are stems', and those how the stand
  // stands.
  const std::vector<float> upright = uprightWeights(block, grid, shapes, parameters);
  std::vector<StemSeeds> seeds =
      findStemSeeds(block, shapes, upright, parameters, SeedEvidence::kUpright);
  std::vector<GrownStem> stems =
      growCandidates(scene, seeds, block.ground, plant_height, parameters);
  Stand stand = standOf(block, onlyStems(selection, stems), parameters);
  settleFeet(scene, block, stand, parameters, stems);
  stems = onlyStems(selection, std::move(stems));
  const auto select = [&](std::vector<GrownStem> more) {
    std::move(more.begin(), more.end(), std::back_inserter(stems));
    stems = onlyStems(selection, std::move(stems));
    stand = standOf(block, stems, parameters);
  };
  stand = standOf(block, stems, parameters);
  select(growHanging(scene, block, seeds, stand, stems, plant_height, parameters));
  // Again where nothing was found, knowing the stand, then with other evidence.
  for (const SeedEvidence evidence : {SeedEvidence::kUpright, SeedEvidence::kDensity}) {
    const std::size_t most = 8U + stems.size();  // few are missing where many were found
    seeds = findStemSeeds(block, shapes, upright, parameters, evidence, stand.lean,
                          explainedPoints(scene, stems), most);
    std::vector<GrownStem> more =
        growHanging(scene, block, seeds, stand, stems, plant_height, parameters);
    std::vector<GrownStem> free =
        growCandidates(scene, seeds, block.ground, plant_height, parameters);
    settleFeet(scene, block, stand, parameters, free);
    std::move(free.begin(), free.end(), std::back_inserter(more));
    select(std::move(more));
  }
  settleAmongNeighbors(scene, block, parameters, stems);
  std::sort(stems.begin(), stems.end(), [](const GrownStem& a, const GrownStem& b) {
    const Eigen::Vector3f low_a = a.midline.axis.nodes().front().position;
    const Eigen::Vector3f low_b = b.midline.axis.nodes().front().position;
    return low_a.x() != low_b.x() ? low_a.x() < low_b.x() : low_a.y() < low_b.y();
  });

  // Where their surfaces are and where they end: each shows the other.
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  constexpr double kWidened = 1.2;  // of a midline among leaves
  refineMidlines(scene, max_radius, plant_height, kWidened, stems);
  poolEnds(scene, max_radius, plant_height, stems);
  stems = refitSeedlings(scene, selection, plant_height, std::move(stems), parameters);
  refineMidlines(scene, max_radius, plant_height, 1.0, stems);
  steadySeedlings(plant_height, stems);

  // Steps 2-4: the growth of each stem, with parameters of its own.
  const float max_gap = longestGap(stems);
  parallelFor(stems.size(), [&](std::size_t s) {
    stems[s] = growStem(scene, stems[s].midline, max_gap, parameters);
  });

  // Every other organ to its plant.
  std::vector<std::int32_t> stem_owner = resolveOwners(scene, stems);
  std::vector<std::int32_t> plant_owner =
      assignOrgans(block, axesOf(stems), stem_owner, parameters);
  const std::vector<bool> tillers = findTillers(scene, block, stems, plant_owner);
  if (std::find(tillers.begin(), tillers.end(), true) != tillers.end()) {
    std::vector<GrownStem> plants;
    for (std::size_t s = 0; s < stems.size(); ++s) {
      if (!tillers[s]) plants.push_back(std::move(stems[s]));
    }
    stems = std::move(plants);
    stem_owner = resolveOwners(scene, stems);
    plant_owner = assignOrgans(block, axesOf(stems), stem_owner, parameters);
  }
  return assemble(block, stems, stem_owner, plant_owner);
}

}  // namespace field_phenotyping
