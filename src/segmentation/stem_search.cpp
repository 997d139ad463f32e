#include "field_phenotyping/segmentation/stem_search.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/row_model.hpp"
#include "field_phenotyping/segmentation/stem_curve.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"
#include "field_phenotyping/segmentation/stem_top.hpp"

namespace field_phenotyping {
namespace {

constexpr double kWideSlab = 2.0;  // of the seeds' slabs, where those hold few points of a stem
constexpr float kHighSeeds =
    0.3F;  // of the plants' height: a stem that begins above hides its foot

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

bool beginsHigh(const StemSeeds& seeds, const GroundModel& ground, float plant_height) {
  return ground.heightAbove(seeds.points.front()) > kHighSeeds * plant_height;
}

/// Whether most of some places lie within `distance` [m] of the axis.
bool follows(const StemAxis& axis, const std::vector<Eigen::Vector3f>& places, float distance) {
  const auto near = std::count_if(places.begin(), places.end(), [&](const auto& place) {
    return axis.project(place).distance < distance;
  });
  return 2 * static_cast<std::size_t>(near) > places.size();
}

/// Whether two axes come so near to one another across the field that one may be the other.
bool mayMeet(const StemAxis& a, const StemAxis& b, float distance) {
  using Box = Eigen::AlignedBox2f;
  const auto boxOf = [](const StemAxis& axis) {
    Box box;
    for (const StemAxis::Node& node : axis.nodes()) box.extend(node.position.head<2>());
    return box;
  };
  return boxOf(a).exteriorDistance(boxOf(b)) < distance;
}

/// Whether an axis is another stem's, and ends where that does.
bool isSameStem(const StemAxis& axis, const StemAxis& other) {
  constexpr float kApart = 0.005F;  // [m]
  constexpr float kLonger = 0.01F;  // [m]
  if (std::abs(axis.length() - other.length()) >= kLonger || !mayMeet(axis, other, kApart)) {
    return false;
  }
  std::vector<Eigen::Vector3f> places;
  for (const StemAxis::Node& node : axis.nodes()) places.push_back(node.position);
  return follows(other, places, kApart);
}

/// What start points lead to.
struct Lead {
  std::vector<std::uint32_t> around;  ///< points round it
  Midline midline;                    ///< cut where the stem ends
  bool is_new = true;                 ///< it leads to no stem that is known
};

/// Step 1: the start points give the axis prior, the points round it the midline and where it ends.
Lead follow(const GrowthScene& scene, const StemAxis& prior, float max_radius, float plant_height) {
  Lead lead;
  lead.around = pointsAround(scene, prior, kStemSurroundings * max_radius);
  lead.midline = fitMidline(scene.points, lead.around, prior, max_radius, plant_height);
  lead.midline.axis = lead.midline.axis.below(findStemTop(scene.points, lead.around, lead.midline));
  return lead;
}

/// Marks the leads that are new: they lead to none of `known`, nor where one before them does.
/// Of seedlings all count: their leaves are so near that the better of two fits does.
void markNew(const std::vector<GrownStem>& known, float plant_height, std::vector<Lead>& leads) {
  if (isSeedling(plant_height)) return;
  parallelFor(leads.size(), [&](std::size_t k) {
    leads[k].is_new = std::none_of(known.begin(), known.end(), [&](const GrownStem& stem) {
      return isSameStem(leads[k].midline.axis, stem.midline.axis);
    });
  });
  for (std::size_t k = 0; k < leads.size(); ++k) {
    for (std::size_t before = 0; before < k && leads[k].is_new; ++before) {
      leads[k].is_new =
          !leads[before].is_new || !isSameStem(leads[k].midline.axis, leads[before].midline.axis);
    }
  }
}

/// Fits a midline again: without the leaves above, the axis points straight up through them, and
/// shows its end better.
Midline fitAgain(const GrowthScene& scene, const Lead& lead, float max_radius, float plant_height) {
  constexpr float kMostBeyond = 0.25F;  // [m]
  Midline midline =
      fitMidline(scene.points, lead.around, lead.midline.axis, max_radius, plant_height);
  midline.axis = midline.axis.extendedBy(std::min(kMostBeyond, kBeyondEnd * plant_height));
  midline.axis = midline.axis.below(findStemTop(scene.points, lead.around, midline));
  return midline;
}

/// Leaves out what nothing grew from.
std::vector<GrownStem> withPoints(std::vector<GrownStem> grown) {
  grown.erase(std::remove_if(grown.begin(), grown.end(),
                             [](const GrownStem& stem) { return stem.points.empty(); }),
              grown.end());
  return grown;
}

/// What grows from every candidate; those that nothing grows from, or that lead where one of
/// `known` or another candidate is, are left out.
std::vector<GrownStem> growCandidates(const GrowthScene& scene, const std::vector<StemSeeds>& seeds,
                                      const std::vector<GrownStem>& known,
                                      const GroundModel& ground, float plant_height,
                                      const SegmentationParameters& parameters) {
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  std::vector<Lead> leads(seeds.size());
  parallelFor(seeds.size(), [&](std::size_t k) {
    leads[k] =
        follow(scene, axisFromSeeds(seeds[k], ground, 0.5F * max_radius), max_radius, plant_height);
  });
  markNew(known, plant_height, leads);
  std::vector<GrownStem> grown(seeds.size());
  parallelFor(leads.size(), [&](std::size_t k) {
    if (!leads[k].is_new) return;
    grown[k] =
        growCandidate(scene, fitAgain(scene, leads[k], max_radius, plant_height), parameters);
  });
  return withPoints(std::move(grown));
}

/// How the stems stand.
Stand standOf(const Block& block, const std::vector<GrownStem>& stems,
              const SegmentationParameters& parameters) {
  Stand stand;
  stand.lean = leanOf(axesOf(stems));
  std::vector<PlantPlace> places;
  for (const GrownStem& stem : stems) {
    stand.plants.push_back(baseOf(block, stem.midline.axis).head<2>().cast<double>());
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

/// The midline along an axis that is known within millimetres.
Midline midlineAlong(const GrowthScene& scene, const StemAxis& axis, float plant_height,
                     const SegmentationParameters& parameters) {
  const auto max_radius = static_cast<float>(parameters.max_stem_radius);
  return followMidline(scene.points, pointsAround(scene, axis, kStemSurroundings * max_radius),
                       axis, max_radius, plant_height);
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
      return follows(stem.midline.axis, points, max_radius);
    });
    if (is_known) return;
    std::vector<StemAxis::Node> nodes;
    for (const Eigen::Vector3f& point : points) nodes.push_back({point, 0.5F * max_radius});
    const std::optional<SettledFoot> settled = settleFoot(
        block, scene.grid,
        midlineAlong(scene, StemAxis(std::move(nodes)), plant_height, parameters), stand);
    if (!settled) return;
    grown[k] = growAlong(scene, settled->axis, settled->hidden, plant_height, parameters);
  });
  return withPoints(std::move(grown));
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
/// @param stand of `stems`
void settleAmongNeighbors(const GrowthScene& scene, const Block& block, Stand stand,
                          std::vector<GrownStem>& stems) {
  std::vector<Eigen::Vector2d> bases = stand.plants;
  for (std::size_t s = 0; s < stems.size(); ++s) {
    if (!(stems[s].midline.hidden > 0.0F)) continue;
    stand.plants = bases;
    stand.plants.erase(stand.plants.begin() + static_cast<std::ptrdiff_t>(s));
    const std::optional<SettledFoot> settled =
        settleFoot(block, scene.grid, stems[s].midline, stand);
    if (!settled) continue;
    const Eigen::Vector2d base = baseOf(block, settled->axis).head<2>().cast<double>();
    moveFoot(stems[s].midline, (base - bases[s]).cast<float>());
    bases[s] = base;
  }
}

/// Points so near to a stem that no other one can begin there.
std::vector<std::uint8_t> explainedPoints(const GrowthScene& scene,
                                          const std::vector<GrownStem>& stems) {
  std::vector<std::uint8_t> explained(scene.points.size(), 0U);
  constexpr float kStep = 0.02F;  // [m]
  constexpr float kReach = 3.0F;  // standard deviations beyond the surface
  std::vector<std::vector<std::uint32_t>> near(stems.size());
  parallelFor(stems.size(), [&](std::size_t k) {
    const Midline& midline = stems[k].midline;
    const StemAxis& axis = midline.axis;
    for (float s = 0.0F; s <= axis.length(); s += kStep) {
      const float reach = axis.radiusAt(s) + kReach * midline.spread;
      scene.grid.forEachWithin(axis.pointAt(s), std::hypot(reach, 0.5F * kStep),
                               [&](std::uint32_t i, float) { near[k].push_back(i); });
    }
  });
  for (const std::vector<std::uint32_t>& of_stem : near) {
    for (const std::uint32_t i : of_stem) explained[i] = 1U;
  }
  return explained;
}

/// Whether the cloud is so sparse that slabs of a height [m] hold few points of a stem.
bool showLittle(const std::vector<GrownStem>& stems, double slab) {
  constexpr float kFew = 4.0F;
  std::vector<float> counts;
  for (const GrownStem& stem : stems) {
    counts.push_back(static_cast<float>(stem.points.size()) / stem.midline.axis.length() *
                     static_cast<float>(slab));
  }
  return counts.empty() || medianOf(std::move(counts)) < kFew;
}

}  // namespace

GrownStem growAlong(const GrowthScene& scene, const StemAxis& axis, float hidden,
                    float plant_height, const SegmentationParameters& parameters) {
  const float reach = kStemSurroundings * static_cast<float>(parameters.max_stem_radius);
  Midline midline = midlineAlong(scene, axis, plant_height, parameters);
  midline.hidden = hidden;
  midline.axis = midline.axis.below(
      findStemTop(scene.points, pointsAround(scene, midline.axis, reach), midline));
  return growCandidate(scene, std::move(midline), parameters);
}

std::vector<StemSeeds> withoutFloating(std::vector<StemSeeds> seeds,
                                       const std::vector<GrownStem>& stand,
                                       const GroundModel& ground, const Canopy& canopy,
                                       float plant_height) {
  constexpr std::ptrdiff_t kOneIn = 20;  // stems may hide its foot
  const auto hidden = std::count_if(
      stand.begin(), stand.end(), [](const GrownStem& stem) { return stem.midline.hidden > 0.0F; });
  constexpr std::size_t kLeastStems = 5U;  // that show how a stand is seen
  if (stand.size() < kLeastStems || kOneIn * hidden > static_cast<std::ptrdiff_t>(stand.size())) {
    return seeds;
  }
  constexpr float kStep = 0.05F;  // [m]
  constexpr float kSeen = 0.9F;   // of the way down
  const auto floats = [&](const StemSeeds& one) {
    if (!beginsHigh(one, ground, plant_height)) return false;
    const Eigen::Vector3f& low = one.points.front();
    const float height = ground.heightAbove(low);
    float light = 0.0F;
    float steps = 0.0F;
    for (float below = 0.0F; below < height; below += kStep) {
      light += canopy.lightAround(low - below * Eigen::Vector3f::UnitZ());
      steps += 1.0F;
    }
    return light >= kSeen * steps;
  };
  seeds.erase(std::remove_if(seeds.begin(), seeds.end(), floats), seeds.end());
  return seeds;
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

std::vector<StemAxis> axesOf(const std::vector<GrownStem>& stems) {
  std::vector<StemAxis> axes;
  for (const GrownStem& stem : stems) axes.push_back(stem.midline.axis);
  return axes;
}

std::vector<GrownStem> findStems(const GrowthScene& scene, const Block& block,
                                 const StemSelection& selection, float plant_height,
                                 const SegmentationParameters& parameters) {
  // What grows from the start points shows which are stems', and those how the stand stands.
  const std::vector<LocalShape>& shapes = scene.shapes;
  const std::vector<float> upright = uprightWeights(block, scene.grid, shapes, parameters);
  std::vector<StemSeeds> seeds =
      findStemSeeds(block, shapes, upright, parameters, SeedEvidence::kUpright);
  std::vector<GrownStem> stems =
      growCandidates(scene, seeds, {}, block.ground, plant_height, parameters);
  Stand stand = standOf(block, onlyStems(selection, stems), parameters);
  settleFeet(scene, block, stand, parameters, stems);
  stems = onlyStems(selection, std::move(stems));
  stand = standOf(block, stems, parameters);
  const auto select = [&](std::vector<GrownStem> more) {
    if (more.empty()) return;
    std::move(more.begin(), more.end(), std::back_inserter(stems));
    stems = onlyStems(selection, std::move(stems));
    stand = standOf(block, stems, parameters);
  };
  const auto onStems = [&](std::vector<StemSeeds> found) {
    return withoutFloating(std::move(found), stems, block.ground, selection.canopy(), plant_height);
  };
  seeds = onStems(std::move(seeds));
  select(growHanging(scene, block, seeds, stand, stems, plant_height, parameters));
  // Again where nothing was found, knowing the stand, then with other evidence. Few are missing
  // where many were found; where most of those that may be missing were found, more are.
  constexpr std::size_t kMissing = 8U;
  const auto searchAgain = [&](SeedEvidence evidence, const SegmentationParameters& settings) {
    for (bool more_missing = true; more_missing;) {
      const std::size_t known = stems.size();
      const std::size_t most = kMissing + known;
      seeds = onStems(findStemSeeds(block, shapes, upright, settings, evidence, stand.lean,
                                    explainedPoints(scene, stems), most));
      std::vector<GrownStem> more =
          growHanging(scene, block, seeds, stand, stems, plant_height, parameters);
      std::vector<GrownStem> free =
          growCandidates(scene, seeds, stems, block.ground, plant_height, parameters);
      settleFeet(scene, block, stand, parameters, free);
      std::move(free.begin(), free.end(), std::back_inserter(more));
      select(std::move(more));
      more_missing = stems.size() > known && 2U * (stems.size() - known) > most;
    }
  };
  searchAgain(SeedEvidence::kUpright, parameters);
  searchAgain(SeedEvidence::kDensity, parameters);
  if (showLittle(stems, parameters.seed_slab)) {
    SegmentationParameters settings = parameters;
    settings.seed_slab *= kWideSlab;
    searchAgain(SeedEvidence::kDensity, settings);
  }
  settleAmongNeighbors(scene, block, std::move(stand), stems);
  std::sort(stems.begin(), stems.end(), [](const GrownStem& a, const GrownStem& b) {
    const Eigen::Vector3f low_a = a.midline.axis.nodes().front().position;
    const Eigen::Vector3f low_b = b.midline.axis.nodes().front().position;
    return low_a.x() != low_b.x() ? low_a.x() < low_b.x() : low_a.y() < low_b.y();
  });
  return stems;
}

}  // namespace field_phenotyping
