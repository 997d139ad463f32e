#include "field_phenotyping/measurement/measurement.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/measurement/diameter_doubt.hpp"
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
  const Eigen::AlignedBox2d about = block.header.extent();
  const Eigen::Vector2d low = about.min() - Eigen::Vector2d::Constant(block.header.margin - kNear);
  const Eigen::Vector2d high = about.max() + Eigen::Vector2d::Constant(block.header.margin - kNear);
  for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
    const Eigen::Vector2d point = block.cloud.mapPoint(i).head<2>();
    if ((point.array() < low.array()).any() || (point.array() > high.array()).any()) return true;
  }
  return false;
}

/// What the block's stems, those of its margin too, say of each other.
struct BlockPrior {
  CrossSectionPrior prior;
  std::vector<StemDiameter> alone;    ///< of each plant, by its own points; or none
  double median_outlier_share = 0.0;  ///< of those
};

BlockPrior blockPrior(const SegmentedBlock& block, const MeasurementParameters& parameters,
                      const ComputeDevice& device) {
  const CrossSectionPrior weak = weakPrior(parameters);
  if (parameters.mode == "paper" || !parameters.block_shape_prior) return {weak, {}, 0.0};
  std::vector<std::size_t> all(block.plants.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  std::vector<StemDiameter> alone = measureStemDiameters(block, all, parameters, weak, {}, device);
  std::vector<StemCrossSection> fits;
  for (const StemDiameter& stem : alone) fits.push_back(stem.section);
  const PopulationPrior kind =
      parameters.block_diameter_prior ? PopulationPrior::kShapeAndSize : PopulationPrior::kShape;
  const CrossSectionPrior prior = populationPrior(fits, weak, kind);
  std::vector<double> outliers;
  for (const StemCrossSection& fit : fits) {
    if (fit.valid) outliers.push_back(fit.outlier_share);
  }
  const double median_outliers = outliers.empty() ? 0.0 : medianOf(outliers);
  return {prior, std::move(alone), median_outliers};
}

/// Of a point across a stem [m].
double noiseOf(const CrossSectionPrior& stems) {
  constexpr double kUsual = 0.004;  // of a LiDAR in a map, where stems are not seen well enough
  if (stems.noise > 0.0) return stems.noise;
  return std::isfinite(stems.log_noise.value) ? std::exp(stems.log_noise.value) : kUsual;
}

/// Whether a stem is flatter than any other, its points scatter more than those of the block's
/// other stems, beyond chance, or far more of them lie off its surface.
bool looksMerged(const BlockPrior& block, std::size_t index) {
  constexpr double kStddevs = 4.0;
  constexpr double kLeastExcess = 0.5;      // of the noise, in its logarithm
  constexpr double kMostEllipticity = 0.2;  // (a - b) / (a + b): one axis is half as long again
  constexpr double kManyOutliers = 0.3;
  constexpr double kMoreOutliers = 3.0;  // times the median stem's
  if (block.alone.empty() || !block.alone[index].section.valid) return false;
  if (std::isnan(block.prior.log_noise.value)) return false;  // nothing is known of the others
  const StemCrossSection& own = block.alone[index].section;
  const auto beyond = [](double value, double least, double own_stddev, double others_stddev) {
    return value > least && value > kStddevs * std::hypot(own_stddev, others_stddev);
  };
  return beyond(own.log_noise.value - block.prior.log_noise.value, kLeastExcess,
                own.log_noise.stddev, block.prior.log_noise.stddev) ||
         beyond(own.ellipticity.norm(), kMostEllipticity, own.ellipticity_stddev,
                block.prior.ellipticity_stddev) ||
         own.outlier_share > std::max(kManyOutliers, kMoreOutliers * block.median_outlier_share);
}

/// Widens what a fit says it is known to where it is likely wrong.
void allowFor(const DiameterDoubt& doubt, StemDiameter& diameter) {
  if (doubt.wrong > 0.5) diameter.flags |= kUnlikeStand;
  const double factor = doubt.diameter.stddev / diameter.major.stddev;
  if (!(factor > 1.0)) return;
  for (Trait* trait : {&diameter.minor, &diameter.equivalent, &diameter.volume}) {
    trait->stddev *= factor;
  }
  diameter.major = doubt.diameter;
}

/// As much as the priors have in a diameter it has of the error that all of the block's stems
/// share.
void allowForAlike(const CrossSectionPrior& prior, StemDiameter& diameter) {
  const double alike = 2.0 * prior.radius_alike_stddev * diameter.prior_share;
  if (!(alike > 0.0)) return;
  for (Trait* trait : {&diameter.major, &diameter.minor, &diameter.equivalent}) {
    trait->stddev = std::hypot(trait->stddev, alike);
  }
  const double of_volume = 2.0 * alike / diameter.major.value * diameter.volume.value;
  diameter.volume.stddev = std::hypot(diameter.volume.stddev, of_volume);
}

/// Of the stems that the block owns, given those of all its stems as they are alone.
void compareWithStand(const std::vector<std::size_t>& owned, const std::vector<StemDiameter>& alone,
                      std::vector<StemDiameter>& diameters) {
  std::vector<Trait> stand;
  for (const StemDiameter& stem : alone) stand.push_back(stem.major);
  for (std::size_t k = 0; k < owned.size(); ++k) stand[owned[k]] = diameters[k].major;
  const std::vector<DiameterDoubt> doubts = doubtDiameters(stand);
  for (std::size_t k = 0; k < owned.size(); ++k) allowFor(doubts[owned[k]], diameters[k]);
}

Phenotype measurePlant(const CompletedBlock& completed, std::size_t index,
                       const PlantSpacing& spacing, const PlantHeight& height,
                       const BlockPrior& prior, const StemDiameter& diameter,
                       const MeasurementParameters& parameters) {
  const SegmentedBlock& block = *completed.segmented;
  const Plant& plant = block.plants[index];
  Phenotype phenotype;
  phenotype.id = plant.id;
  phenotype.revision = block.header.revision;
  phenotype.final = block.header.final;
  phenotype.base = block.cloud.origin + plant.base.cast<double>();

  phenotype.height = height.height;
  phenotype.stem_diameter = diameter.major;
  phenotype.stem_diameter_minor = diameter.minor;
  phenotype.stem_diameter_equivalent = diameter.equivalent;
  phenotype.diameter_height = diameter.height;
  phenotype.diameter_prior_share = diameter.prior_share;
  phenotype.stem_volume = diameter.volume;
  phenotype.arc_coverage = diameter.arc_coverage;
  phenotype.diameter_points = diameter.points;

  const Lean lean = measureLean(plant);
  phenotype.axis = lean.axis;
  phenotype.lean = lean.angle;
  phenotype.lean_azimuth = lean.azimuth;
  phenotype.spacing = spacing.in_row;
  phenotype.row_spacing = spacing.to_row;

  phenotype.completeness = stemCompleteness(block, plant);
  phenotype.stem_points = plant.stem.size();
  phenotype.plant_points = plant.points.size();
  if (index < completed.synthetic_span.size()) {
    phenotype.synthetic_points = completed.synthetic_span[index].size();
  }
  if (index < completed.stems.size()) {
    phenotype.completion_flags = completed.stems[index].flags;
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
  if (looksMerged(prior, index)) phenotype.flags |= kMergedSuspect;
  phenotype.score = qualityScore(phenotype);
  return phenotype;
}

}  // namespace

std::vector<Phenotype> measureBlock(const CompletedBlock& block,
                                    const MeasurementParameters& parameters,
                                    const ComputeDevice& device) {
  const std::vector<Plant>& plants = block.segmented->plants;
  std::vector<std::size_t> owned;
  for (std::size_t i = 0; i < plants.size(); ++i) {
    if (plants[i].owned) owned.push_back(i);
  }
  const std::vector<PlantSpacing> spacings = measureRowSpacing(*block.segmented);
  const BlockPrior prior = blockPrior(*block.segmented, parameters, device);
  const std::vector<PlantHeight> heights =
      measurePlantHeights(*block.segmented, parameters, noiseOf(prior.prior), device);
  std::vector<StemDiameter> alone;
  if (!prior.alone.empty()) {
    for (const std::size_t i : owned) alone.push_back(prior.alone[i]);
  }
  std::vector<StemDiameter> diameters =
      measureStemDiameters(*block.segmented, owned, parameters, prior.prior, alone, device);
  if (!prior.alone.empty()) compareWithStand(owned, prior.alone, diameters);
  for (StemDiameter& diameter : diameters) allowForAlike(prior.prior, diameter);
  std::vector<Phenotype> phenotypes(owned.size());
  parallelFor(owned.size(), [&](std::size_t i) {
    phenotypes[i] = measurePlant(block, owned[i], spacings[owned[i]], heights[owned[i]], prior,
                                 diameters[i], parameters);
  });
  return phenotypes;
}

}  // namespace field_phenotyping
