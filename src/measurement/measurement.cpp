#include "field_phenotyping/measurement/measurement.hpp"

#include <algorithm>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/measurement/lean.hpp"
#include "field_phenotyping/measurement/plant_height.hpp"
#include "field_phenotyping/measurement/row_spacing.hpp"
#include "field_phenotyping/measurement/stem_coverage.hpp"
#include "field_phenotyping/measurement/stem_diameter.hpp"
#include "field_phenotyping/measurement/stem_population.hpp"

namespace field_phenotyping {
namespace {

/// Whether the plant has points where the block's data end.
bool reachesBorder(const SegmentedBlock& block, const Plant& plant) {
  constexpr double kNear = 0.01;  // [m]
  const BlockHeader& header = block.header;
  const Eigen::Vector2d low = header.lowCorner() - Eigen::Vector2d::Constant(header.margin - kNear);
  const Eigen::Vector2d high =
      low + Eigen::Vector2d::Constant(header.tile_size + 2.0 * (header.margin - kNear));
  for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
    const Eigen::Vector2d point = block.cloud.mapPoint(i).head<2>();
    if ((point.array() < low.array()).any() || (point.array() > high.array()).any()) return true;
  }
  return false;
}

/// What the block's stems, those of its margin too, say of each other.
CrossSectionPrior blockPrior(const SegmentedBlock& block, const MeasurementParameters& parameters) {
  const CrossSectionPrior weak = weakPrior(parameters);
  if (parameters.mode == "paper" || !parameters.block_shape_prior) return weak;
  std::vector<StemCrossSection> fits(block.plants.size());
  parallelFor(fits.size(), [&](std::size_t i) {
    fits[i] = measureStemDiameter(block, block.plants[i], parameters, weak).section;
  });
  return populationPrior(
      fits, weak,
      parameters.block_diameter_prior ? PopulationPrior::kShapeAndSize : PopulationPrior::kShape);
}

Phenotype measurePlant(const CompletedBlock& completed, std::size_t index, const Trait& spacing,
                       const CrossSectionPrior& prior, const MeasurementParameters& parameters) {
  const SegmentedBlock& block = *completed.segmented;
  const Plant& plant = block.plants[index];
  Phenotype phenotype;
  phenotype.id = plant.id;
  phenotype.revision = block.header.revision;
  phenotype.final = block.header.final;
  phenotype.base = block.cloud.origin + plant.base.cast<double>();

  const PlantHeight height = measurePlantHeight(block, plant, parameters);
  phenotype.height = height.height;

  const StemDiameter diameter = measureStemDiameter(block, plant, parameters, prior);
  phenotype.stem_diameter = diameter.major;
  phenotype.stem_diameter_minor = diameter.minor;
  phenotype.stem_diameter_equivalent = diameter.equivalent;
  phenotype.diameter_height = diameter.height;
  phenotype.arc_coverage = diameter.arc_coverage;
  phenotype.diameter_points = diameter.points;

  const Lean lean = measureLean(plant);
  phenotype.axis = lean.axis;
  phenotype.lean = lean.angle;
  phenotype.lean_azimuth = lean.azimuth;
  phenotype.spacing = spacing;

  phenotype.completeness = stemCompleteness(block, plant);
  phenotype.stem_points = plant.stem.size();
  phenotype.plant_points = plant.points.size();
  if (index < completed.synthetic_span.size()) {
    phenotype.synthetic_points = completed.synthetic_span[index].size();
  }
  phenotype.segmentation_quality = plant.growth.quality;
  phenotype.growth_iterations = plant.growth.iterations;
  phenotype.growth_r1 = plant.growth.r1;
  phenotype.growth_M = plant.growth.M;
  phenotype.growth_alpha = plant.growth.alpha;
  phenotype.growth_beta = plant.growth.beta;
  phenotype.flags = height.flags | diameter.flags;
  if (reachesBorder(block, plant)) phenotype.flags |= kTruncated;
  if (plant.growth.quality < parameters.min_quality) phenotype.flags |= kLowConfidence;
  return phenotype;
}

}  // namespace

std::vector<Phenotype> measureBlock(const CompletedBlock& block,
                                    const MeasurementParameters& parameters) {
  const std::vector<Plant>& plants = block.segmented->plants;
  std::vector<std::size_t> owned;
  for (std::size_t i = 0; i < plants.size(); ++i) {
    if (plants[i].owned) owned.push_back(i);
  }
  const std::vector<Trait> spacings = measureRowSpacing(*block.segmented);
  const CrossSectionPrior prior = blockPrior(*block.segmented, parameters);
  std::vector<Phenotype> phenotypes(owned.size());
  parallelFor(owned.size(), [&](std::size_t i) {
    phenotypes[i] = measurePlant(block, owned[i], spacings[owned[i]], prior, parameters);
  });
  return phenotypes;
}

}  // namespace field_phenotyping
