#include "field_phenotyping/segmentation/segmentation.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/organ_assignment.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "field_phenotyping/segmentation/region_growth.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"
#include "field_phenotyping/segmentation/stem_top.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"

namespace field_phenotyping {
namespace {

/// One stem on its way through the steps.
struct Stem {
  Midline midline;
  std::vector<std::uint32_t> points;
  GrowthSummary growth;
};

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

std::vector<std::uint32_t> pointsAround(const GrowthScene& scene, const StemAxis& axis,
                                        float radius) {
  std::vector<std::uint32_t> found;
  const int steps = static_cast<int>(std::ceil(axis.length() / radius));
  for (int k = 0; k <= steps; ++k) {
    const float s = axis.length() * static_cast<float>(k) / static_cast<float>(steps);
    scene.grid.forEachWithin(axis.pointAt(s), 2.5F * radius,
                             [&](std::uint32_t i, float) { found.push_back(i); });
  }
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

/// Step 2 for one stem: a region from each start point to the next, grown independently.
std::vector<std::uint32_t> growAlong(const GrowthScene& scene, const Midline& midline,
                                     const SegmentationParameters& parameters) {
  std::vector<std::uint32_t> joined;
  const std::vector<StemAxis::Node>& nodes = midline.axis.nodes();
  for (std::size_t k = 0; k + 1 < nodes.size(); ++k) {
    const GrowthRegion region =
        growRegion(scene, nodes[k].position, nodes[k + 1].position, midline, parameters);
    joined.insert(joined.end(), region.points.begin(), region.points.end());
  }
  std::sort(joined.begin(), joined.end());
  joined.erase(std::unique(joined.begin(), joined.end()), joined.end());
  return joined;
}

/// Structural integrity (Eq 8), with distances from the region's own axis.
float structuralQuality(const GrowthScene& scene, const std::vector<std::uint32_t>& before,
                        const std::vector<std::uint32_t>& after, const StemAxis& axis) {
  if (before.empty() || after.empty()) return 0.0F;
  float sum = 0.0F;
  float most = 0.0F;
  for (const std::uint32_t i : after) {
    const StemAxis::Projection at = axis.project(scene.points[i]);
    const float away = std::abs(at.distance - at.radius);
    sum += away;
    most = std::max(most, away);
  }
  const float kept = static_cast<float>(after.size()) / static_cast<float>(before.size());
  const float compact = most > 0.0F ? 1.0F - sum / static_cast<float>(after.size()) / most : 1.0F;
  return 0.5F * kept + 0.5F * compact;
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
Midline findMidline(const GrowthScene& scene, const StemSeeds& seeds, const GroundModel& ground,
                    float max_radius, float plant_height) {
  const StemAxis prior = axisFromSeeds(seeds, ground, 0.5F * max_radius);
  const std::vector<std::uint32_t> around = pointsAround(scene, prior, max_radius);
  Midline midline = fitMidline(scene.points, around, prior, max_radius, plant_height);
  midline.axis = midline.axis.below(findStemTop(scene.points, around, midline));
  // Without the leaves above, the axis points straight up through them, and shows its end better.
  constexpr float kMostBeyond = 0.25F;  // [m]
  constexpr float kBeyond = 0.2F;       // of the plant's height
  midline = fitMidline(scene.points, around, midline.axis, max_radius, plant_height);
  midline.axis = midline.axis.extendedBy(std::min(kMostBeyond, kBeyond * plant_height));
  midline.axis = midline.axis.below(findStemTop(scene.points, around, midline));
  return midline;
}

/// Steps 2 and 3: growth along the midline; what was over-segmented goes (2.4.2).
Stem growStem(const GrowthScene& scene, Midline midline, const SegmentationParameters& parameters) {
  Stem stem;
  stem.midline = std::move(midline);
  const std::vector<std::uint32_t> grown = growAlong(scene, stem.midline, parameters);
  stem.points = pruneByMidline(scene.points, grown, stem.midline.axis,
                               static_cast<float>(parameters.prune_factor));
  stem.growth.quality = structuralQuality(scene, grown, stem.points, stem.midline.axis);
  stem.growth.iterations = 1U;
  stem.growth.r1 = static_cast<float>(parameters.r1);
  stem.growth.M = static_cast<float>(parameters.M);
  stem.growth.alpha = static_cast<float>(parameters.alpha);
  stem.growth.beta = static_cast<float>(parameters.beta);
  return stem;
}

void growCandidates(const GrowthScene& scene, const std::vector<StemSeeds>& seeds,
                    const GroundModel& ground, const SegmentationParameters& parameters,
                    std::vector<Stem>& stems) {
  const float plant_height = canopyHeight(scene, ground);
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  for (const StemSeeds& one : seeds) {
    Stem stem =
        growStem(scene, findMidline(scene, one, ground, max_radius, plant_height), parameters);
    if (!stem.points.empty()) stems.push_back(std::move(stem));
  }
}

std::vector<Stem> onlyStems(const Block& block, const NeighborGrid& grid, std::vector<Stem> grown,
                            const SegmentationParameters& parameters) {
  std::vector<StemCandidate> candidates;
  for (const Stem& stem : grown) candidates.push_back({stem.midline, stem.points});
  std::vector<Stem> stems;
  for (const std::size_t k : selectStems(block, grid, candidates, parameters)) {
    stems.push_back(std::move(grown[k]));
  }
  return stems;
}

/// Points so near to a stem that no other one can begin there.
std::vector<std::uint8_t> explainedPoints(const GrowthScene& scene,
                                          const std::vector<Stem>& stems) {
  std::vector<std::uint8_t> explained(scene.points.size(), 0U);
  constexpr float kStep = 0.02F;  // [m]
  constexpr float kReach = 3.0F;  // standard deviations beyond the surface
  for (const Stem& stem : stems) {
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
std::vector<std::int32_t> resolveOwners(const GrowthScene& scene, const std::vector<Stem>& stems) {
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

/// Reorders the block's points plant by plant, stems first.
SegmentedBlock assemble(const Block& block, const std::vector<Stem>& stems,
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
  const auto middle = counts.begin() + static_cast<std::ptrdiff_t>(counts.size() / 2U);
  std::nth_element(counts.begin(), middle, counts.end());
  if (*middle >= kEnoughNeighbors) return parameters;
  parameters.seed_radius *= kWiden;
  parameters.seed_slab *= kWiden;
  return parameters;
}

}  // namespace

SegmentedBlock segmentBlock(const Block& block, const SegmentationParameters& wanted) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  if (points.empty()) return assemble(block, {}, {}, {});
  const SegmentationParameters parameters = adaptToDensity(points, wanted);
  const auto radius = static_cast<float>(parameters.seed_radius);
  const NeighborGrid grid(points, 0.5F * radius);
  const std::vector<LocalShape> shapes = computeLocalShapes(points, grid, radius);
  const GrowthScene scene{points, shapes, grid};

  // Steps 1-3: start points, growth and pruning. What has grown shows which of them are stems.
  std::vector<Stem> stems;
  growCandidates(scene, findStemSeeds(block, grid, shapes, parameters, SeedEvidence::kUpright),
                 block.ground, parameters, stems);
  stems = onlyStems(block, grid, std::move(stems), parameters);
  // Step 4: again, with other evidence, where nothing was found.
  const std::size_t most = 8U + stems.size();  // few are missing where many were found
  growCandidates(scene,
                 findStemSeeds(block, grid, shapes, parameters, SeedEvidence::kDensity,
                               explainedPoints(scene, stems), most),
                 block.ground, parameters, stems);
  stems = onlyStems(block, grid, std::move(stems), parameters);
  std::sort(stems.begin(), stems.end(), [](const Stem& a, const Stem& b) {
    const Eigen::Vector3f low_a = a.midline.axis.nodes().front().position;
    const Eigen::Vector3f low_b = b.midline.axis.nodes().front().position;
    return low_a.x() != low_b.x() ? low_a.x() < low_b.x() : low_a.y() < low_b.y();
  });

  // Every other organ to its plant.
  const std::vector<std::int32_t> stem_owner = resolveOwners(scene, stems);
  std::vector<StemAxis> axes;
  for (const Stem& stem : stems) axes.push_back(stem.midline.axis);
  const std::vector<std::int32_t> plant_owner = assignOrgans(block, axes, stem_owner, parameters);
  return assemble(block, stems, stem_owner, plant_owner);
}

}  // namespace field_phenotyping
