#include "field_phenotyping/segmentation/segmentation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/nearest_distances.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/crown_points.hpp"
#include "field_phenotyping/segmentation/detached_tops.hpp"
#include "field_phenotyping/segmentation/foot_points.hpp"
#include "field_phenotyping/segmentation/found_twice.hpp"
#include "field_phenotyping/segmentation/growth_scene.hpp"
#include "field_phenotyping/segmentation/isolated_points.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/low_stand.hpp"
#include "field_phenotyping/segmentation/organ_assignment.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "field_phenotyping/segmentation/stand_fit.hpp"
#include "field_phenotyping/segmentation/stand_tops.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "field_phenotyping/segmentation/stem_search.hpp"
#include "field_phenotyping/segmentation/stem_verification.hpp"

namespace field_phenotyping {
namespace {

/// About how high the block's plants are; soil does not count, nor a few points above them.
float canopyHeight(const std::vector<float>& heights) {
  constexpr float kSoil = 0.05F;  // [m]
  constexpr float kShare = 0.98F;
  std::vector<float> of_plants = heights;
  of_plants.erase(std::remove_if(of_plants.begin(), of_plants.end(),
                                 [](float height) { return !(height > kSoil); }),
                  of_plants.end());
  if (of_plants.empty()) return kSoil;
  const auto high = of_plants.begin() +
                    static_cast<std::ptrdiff_t>(kShare * static_cast<float>(of_plants.size() - 1U));
  std::nth_element(of_plants.begin(), high, of_plants.end());
  return *high;
}

/// Longest gap that regions of one stem may merge across [m]: twice the plants' usual spacing, for
/// what lies farther up may well be a neighbour's.
float longestGap(const std::vector<GrownStem>& stems) {
  constexpr float kMost = 0.40F;
  constexpr float kSpacings = 2.0F;
  std::vector<Eigen::Vector2f> feet;
  for (const GrownStem& stem : stems) {
    feet.emplace_back(stem.midline.axis.nodes().front().position.head<2>());
  }
  return feet.empty() ? kMost : std::min(kMost, kSpacings * medianOf(nearestDistances(feet)));
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
/// @param point_heights of the block's points above the soil [m]
std::vector<bool> findTillers(const Block& block, const std::vector<float>& point_heights,
                              const std::vector<GrownStem>& stems,
                              const std::vector<std::int32_t>& plant_owner) {
  constexpr std::size_t kLeastStems = 5U;  // that show how a stand grows
  constexpr float kLow = 0.5F;             // of the stand's height
  constexpr double kNear = 0.35;           // of the plants' usual distance
  std::vector<bool> tillers(stems.size(), false);
  if (stems.size() < kLeastStems) return tillers;
  std::vector<float> heights(stems.size(), 0.0F);
  for (std::size_t i = 0; i < point_heights.size(); ++i) {
    if (plant_owner[i] < 0) continue;
    float& height = heights[static_cast<std::size_t>(plant_owner[i])];
    height = std::max(height, point_heights[i]);
  }
  const float low = kLow * medianOf(heights);
  std::vector<Eigen::Vector2d> bases;
  for (const GrownStem& stem : stems)
    bases.push_back(baseOf(block, stem.midline.axis).head<2>().cast<double>());
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

/// Reorders the block's points plant by plant, stems first, with those that the soil gives back and
/// those that were taken for outliers.
SegmentedBlock assemble(const Block& block, const std::vector<GrownStem>& stems,
                        const PointOwners& owners, const PointOwners& isolated) {
  SegmentedBlock out;
  out.header = block.header;
  out.ground = block.ground;
  out.cloud = block.cloud.emptyAlike();

  constexpr std::size_t kGroups = 2U;  // stem, other organs
  const std::size_t none = kGroups * stems.size();
  std::vector<std::vector<std::uint32_t>> groups(none + 1U);
  const auto groupOf = [&](const PointOwners& owned, std::uint32_t i) {
    const std::int32_t plant = owned.of(i);
    return plant < 0 ? none
                     : kGroups * static_cast<std::size_t>(plant) + (owned.stem[i] >= 0 ? 0U : 1U);
  };
  for (std::uint32_t i = 0; i < block.cloud.size(); ++i) groups[groupOf(owners, i)].push_back(i);
  const auto feet_begin = static_cast<std::uint32_t>(block.cloud.size());
  const std::vector<std::int32_t> foot_owner = findFootPoints(block, axesOf(stems), owners.stem);
  for (std::uint32_t i = 0; i < foot_owner.size(); ++i) {
    if (foot_owner[i] < 0) continue;
    groups[kGroups * static_cast<std::size_t>(foot_owner[i])].push_back(feet_begin + i);
  }
  const auto isolated_begin = feet_begin + static_cast<std::uint32_t>(block.feet.size());
  for (std::uint32_t i = 0; i < isolated.plant.size(); ++i) {
    const std::size_t group = groupOf(isolated, i);
    if (group != none) groups[group].push_back(isolated_begin + i);
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
    plant.base = baseOf(block, plant.axis);
    const Eigen::Vector3d base = block.cloud.origin + plant.base.cast<double>();
    plant.owned = block.holds(base.x(), base.y(), PlantRegistry::kBorderTolerance);
    plant.growth = stems[s].growth;
    out.plants.push_back(std::move(plant));
  }
  append(groups[none]);

  constexpr std::size_t kPoints = 16384U;  // of a task
  out.cloud.resizeLike(block.cloud, out.source_index.size());
  parallelChunks(out.source_index.size(), kPoints, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint32_t source = out.source_index[k];
      if (source < feet_begin) {
        out.cloud.put(k, block.cloud, source);
      } else if (source < isolated_begin) {
        out.cloud.put(k, block.feet, source - feet_begin);
      } else {
        out.cloud.put(k, block.isolated, source - isolated_begin);
      }
    }
  });
  return out;
}

/// Widens the neighbourhood and the slabs that seeds are found in where the cloud is too sparse for
/// the ones asked for to show a stem's shape.
/// @param grid over the points
SegmentationParameters adaptToDensity(const std::vector<Eigen::Vector3f>& points,
                                      const NeighborGrid& grid, SegmentationParameters parameters) {
  constexpr std::size_t kSamples = 500U;
  constexpr std::uint32_t kEnoughNeighbors = 14U;
  constexpr double kWiden = 1.5;
  const auto radius = static_cast<float>(parameters.seed_radius);
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

}  // namespace

SegmentedBlock segmentBlock(const Block& block, const SegmentationParameters& wanted,
                            const ComputeDevice& device) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  if (points.empty()) return assemble(block, {}, {}, {});
  constexpr float kCell = 1.0F;  // of the radius of most queries
  NeighborGrid grid(points, kCell * static_cast<float>(wanted.seed_radius));
  const SegmentationParameters parameters = adaptToDensity(points, grid, wanted);
  const auto radius = static_cast<float>(parameters.seed_radius);
  if (parameters.seed_radius != wanted.seed_radius) grid = NeighborGrid(points, kCell * radius);
  const std::vector<LocalShape> shapes = computeLocalShapes(points, grid, radius, device);
  const std::vector<float> heights = block.ground.heightsAbove(points);
  const float plant_height = canopyHeight(heights);
  const SamplingProfile sampling(heights, shapes, static_cast<double>(plant_height));
  const GrowthScene scene{points, shapes, grid};
  const StemSelection selection(block, grid, parameters);

  // Step 1: start points, and the stems that grow from them; where those are, and where they end.
  std::vector<GrownStem> stems = fitStand(
      scene, selection, plant_height, sampling,
      findStandingStems(scene, block, selection, plant_height, parameters), parameters, device);

  // Steps 2-4: the growth of each stem, with parameters of its own.
  const float max_gap = longestGap(stems);
  stems = growStems(scene, midlinesOf(stems), max_gap, parameters, device);

  stems =
      withoutFoundTwice(block, std::move(stems), static_cast<float>(parameters.min_plant_spacing));

  // Every other organ to its plant.
  PointOwners owners;
  std::vector<float> top_stddevs;  // of each plant
  const auto giveToPlants = [&] {
    owners.stem = resolveOwners(scene, stems);
    const std::vector<StemAxis> axes = axesOf(stems);
    OrganOwners organs = assignOrgans(block, axes, owners.stem, parameters, device);
    owners.plant = std::move(organs.plant);
    top_stddevs = std::move(organs.top_stddev);
  };
  giveToPlants();
  const std::vector<bool> tillers = findTillers(block, heights, stems, owners.plant);
  if (std::find(tillers.begin(), tillers.end(), true) != tillers.end()) {
    std::vector<GrownStem> plants;
    for (std::size_t s = 0; s < stems.size(); ++s) {
      if (!tillers[s]) plants.push_back(std::move(stems[s]));
    }
    stems = std::move(plants);
    giveToPlants();
  }
  const std::vector<StemAxis> axes = axesOf(stems);
  PointOwners isolated = findIsolatedPoints(block, grid, axes, owners);
  giveCrownPoints(block, axes, sampling.sparseFrom(), owners, isolated);
  const std::vector<float> detached = giveDetachedTops(block, grid, axes.size(), owners, isolated);
  const std::vector<float> given = giveTopsBack(block.cloud.points, axes, owners);
  SegmentedBlock out = assemble(block, stems, owners, isolated);
  const std::vector<float> disputed = doubtTops(out);
  for (std::size_t s = 0; s < out.plants.size(); ++s) {
    out.plants[s].top_stddev =
        std::hypot(std::hypot(top_stddevs[s], detached[s]), given[s], disputed[s]);
  }
  return out;
}

}  // namespace field_phenotyping
