#include "field_phenotyping/segmentation/low_stand.hpp"

#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/nearest_distances.hpp"
#include "field_phenotyping/segmentation/leaf_convergence.hpp"
#include "field_phenotyping/segmentation/row_model.hpp"
#include "field_phenotyping/segmentation/stem_curve.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"

namespace field_phenotyping {
namespace {

/// Whether most stand as upright as stems do: blades of grass lean outwards from where they grow.
bool standUpright(const std::vector<GrownStem>& stems) {
  constexpr float kUpright = 0.93F;  // cosine of the lean
  std::vector<float> upright;
  for (const GrownStem& stem : stems) {
    const std::vector<StemAxis::Node>& nodes = stem.midline.axis.nodes();
    upright.push_back((nodes.back().position - nodes.front().position).normalized().z());
  }
  return !upright.empty() && medianOf(std::move(upright)) > kUpright;
}

/// Those of the stems that are likelier one of the rows' than one of what stands anywhere; none
/// where they show no rows.
std::vector<GrownStem> onlyInRows(const Block& block, std::vector<GrownStem> stems,
                                  const SegmentationParameters& parameters) {
  std::vector<PlantPlace> places;
  for (const GrownStem& stem : stems) {
    places.push_back({baseOf(block, stem.midline.axis).head<2>().cast<double>(), 1.0});
  }
  const std::optional<RowModel> rows =
      RowModel::find(places, {parameters.row_spacing, parameters.plant_spacing});
  if (!rows) return {};
  const double anywhere = 1.0 - rows->inRows();
  std::vector<GrownStem> in_rows;
  for (std::size_t s = 0; s < stems.size(); ++s) {
    if (rows->rowOdds(places[s].position) - anywhere > anywhere) {
      in_rows.push_back(std::move(stems[s]));
    }
  }
  return in_rows;
}

/// Those places where as many leaves come together as plants of the stand have; fewer do where the
/// rows show none.
std::vector<LeafConvergence> onlyPlants(std::vector<LeafConvergence> places,
                                        const SegmentationParameters& parameters) {
  if (places.empty()) return {};
  std::vector<float> votes;
  for (const LeafConvergence& place : places) votes.push_back(place.votes);
  const float usual = usualOf(votes);
  constexpr float kSure = 0.5F;  // of the usual: of a plant
  std::vector<PlantPlace> plants;
  for (const LeafConvergence& place : places) {
    if (place.votes >= kSure * usual) plants.push_back({place.place.cast<double>(), 1.0});
  }
  const std::optional<RowModel> rows =
      RowModel::find(plants, {parameters.row_spacing, parameters.plant_spacing});
  const auto isPlant = [&](const LeafConvergence& place) {
    constexpr float kLeast = 0.3F;  // of the usual
    const double odds = rows ? rows->rowOdds(place.place.cast<double>()) : 1.0;
    return meritOfOdds(odds) * place.votes >= kLeast * usual;
  };
  places.erase(std::remove_if(places.begin(), places.end(),
                              [&](const auto& place) { return !isPlant(place); }),
               places.end());
  return places;
}

/// Plants of one stand keep their distance: leaves that come together far nearer to a plant than
/// others stand are its own, unless nearly as many do. `places`: the strongest first.
std::vector<LeafConvergence> withoutCrowding(std::vector<LeafConvergence> places) {
  constexpr float kCrowded = 0.5F;  // of the usual distance
  constexpr float kAsMany = 0.6F;
  if (places.empty()) return places;
  std::vector<Eigen::Vector2f> all;
  for (const LeafConvergence& place : places) all.push_back(place.place);
  const float crowded = kCrowded * medianOf(nearestDistances(all));
  std::vector<LeafConvergence> kept;
  for (const LeafConvergence& place : places) {
    const bool crowds = std::any_of(kept.begin(), kept.end(), [&](const auto& stronger) {
      return (place.place - stronger.place).norm() < crowded &&
             place.votes < kAsMany * stronger.votes;
    });
    if (!crowds) kept.push_back(place);
  }
  return kept;
}

/// Whether a stem's axis passes a place about where its leaves begin.
bool passes(const StemAxis& axis, const Eigen::Vector3f& place) {
  constexpr float kApart = 0.025F;  // [m]
  return (axis.pointAtHeight(place.z()) - place).head<2>().norm() < kApart;
}

/// Points that any stem shows where the stand's stems are seen well: many were found by their own
/// points, and have several times as many; 0 where they are not.
/// @param known  found by their own points
/// @param places where leaves come together
float fewestPoints(const std::vector<GrownStem>& known, std::size_t places) {
  constexpr float kShare = 0.4F;
  constexpr float kWell = 40.0F;      // points
  constexpr std::size_t kOneIn = 4U;  // places shows a stem
  if (kOneIn * known.size() < places) return 0.0F;
  std::vector<float> counts;
  for (const GrownStem& stem : known) counts.push_back(static_cast<float>(stem.points.size()));
  const float usual = medianOf(std::move(counts));
  return usual >= kWell ? kShare * usual : 0.0F;
}

/// The stems of seedlings stand where their leaves come together: of those found the ones that do,
/// and one more where none does, unless it would be seen. As found where too few leaves come
/// together to show what a plant of the stand looks like.
std::vector<GrownStem> onlyWhereLeavesConverge(const GrowthScene& scene, const Block& block,
                                               float plant_height, std::vector<GrownStem> found,
                                               const SegmentationParameters& parameters) {
  constexpr std::size_t kLeastPlants = 4U;
  const std::vector<LeafConvergence> places = withoutCrowding(
      onlyPlants(findLeafConvergences(block, scene.shapes, plant_height,
                                      static_cast<float>(parameters.min_plant_spacing)),
                 parameters));
  if (places.size() < kLeastPlants) return found;
  constexpr float kLow = 0.2F;   // of the plants' height: about where leaves begin
  constexpr float kHigh = 0.5F;  // above any stem
  std::vector<GrownStem> stems;
  std::vector<GrownStem> more;
  for (const LeafConvergence& place : places) {
    const Eigen::Vector3f foot(place.place.x(), place.place.y(),
                               block.ground.heightAt(place.place.x(), place.place.y()));
    const Eigen::Vector3f leaves = foot + kLow * plant_height * Eigen::Vector3f::UnitZ();
    const auto known = std::find_if(found.begin(), found.end(), [&](const GrownStem& stem) {
      return passes(stem.midline.axis, leaves);
    });
    if (known != found.end()) {
      stems.push_back(std::move(*known));
      found.erase(known);
      continue;
    }
    const float radius = 0.5F * static_cast<float>(parameters.max_stem_radius);
    const Eigen::Vector3f top = foot + kHigh * plant_height * Eigen::Vector3f::UnitZ();
    more.push_back(growAlong(scene, StemAxis({{foot, radius}, {top, radius}}), 0.0F, plant_height,
                             parameters));
  }
  const float fewest = fewestPoints(stems, places.size());
  std::copy_if(std::make_move_iterator(more.begin()), std::make_move_iterator(more.end()),
               std::back_inserter(stems), [&](const GrownStem& stem) {
                 return static_cast<float>(stem.points.size()) >= fewest;
               });
  return stems;
}

}  // namespace

SegmentationParameters adaptToHeight(float plant_height, SegmentationParameters parameters) {
  constexpr double kShare = 0.03;   // of the plants' height
  constexpr double kLowest = 0.01;  // [m] below it soil is left
  constexpr double kFull = 0.8;     // [m] height of plants from which on pieces are as asked for
  constexpr double kLeast = 0.15;   // [m] height of the lowest that have a stem
  const auto height = std::max(static_cast<double>(plant_height), kLeast);
  parameters.seed_min_height =
      std::min(parameters.seed_min_height, std::max(kShare * height, kLowest));
  const double size = std::min(height / kFull, 1.0);
  parameters.seed_slab *= size;
  parameters.seed_min_length *= size;
  return parameters;
}

std::vector<GrownStem> findStandingStems(const GrowthScene& scene, const Block& block,
                                         const StemSelection& selection, float plant_height,
                                         const SegmentationParameters& parameters) {
  constexpr float kWeeds = 0.30F;  // [m] as high as weeds are left to grow
  const SegmentationParameters adapted = adaptToHeight(plant_height, parameters);
  std::vector<GrownStem> stems = findStems(scene, block, selection, plant_height, adapted);
  if (isSeedling(plant_height)) {
    stems = onlyWhereLeavesConverge(scene, block, plant_height, std::move(stems), adapted);
  }
  if (plant_height >= kWeeds) return stems;
  constexpr std::size_t kMany = 16U;  // that would show rows if they were plants
  const bool many = stems.size() >= kMany;
  stems = onlyInRows(block, std::move(stems), parameters);
  if (standUpright(stems)) return stems;
  if (many) return {};
  return findStems(scene, block, selection, plant_height, parameters);
}

}  // namespace field_phenotyping
