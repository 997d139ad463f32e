#include "field_phenotyping/segmentation/low_stand.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/segmentation/row_model.hpp"
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
  std::vector<GrownStem> stems =
      findStems(scene, block, selection, plant_height, adaptToHeight(plant_height, parameters));
  if (plant_height >= kWeeds) return stems;
  constexpr std::size_t kMany = 16U;  // that would show rows if they were plants
  const bool many = stems.size() >= kMany;
  stems = onlyInRows(block, std::move(stems), parameters);
  if (standUpright(stems)) return stems;
  if (many) return {};
  return findStems(scene, block, selection, plant_height, parameters);
}

}  // namespace field_phenotyping
