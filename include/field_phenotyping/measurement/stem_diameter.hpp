#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Stem diameter of one plant. Metres; NaN where it could not be measured, `flags` say why.
struct StemDiameter {
  Trait major;       ///< 2a of Eq 27, across the stem's axis
  Trait minor;       ///< 2b
  Trait equivalent;  ///< 2 sqrt(a b)
  Trait volume;      ///< of the stem from the soil to `height` [m^3]; not in mode "paper"
  double height =
      std::numeric_limits<double>::quiet_NaN();  ///< above the soil, that they stand for
  double major_azimuth = std::numeric_limits<double>::quiet_NaN();  ///< from x towards y [rad]
  double noise =
      std::numeric_limits<double>::quiet_NaN();  ///< of a point across the stem, one axis
  double arc_coverage = std::numeric_limits<double>::quiet_NaN();
  double prior_share = std::numeric_limits<double>::quiet_NaN();  ///< in what is known of `major`
  std::uint32_t points = 0U;  ///< on the stem's surface, that decided the fit
  StemCrossSection section;   ///< the fit itself; not valid in mode "paper"
  Eigen::Vector3d section_origin = Eigen::Vector3d::Zero();  ///< of its frame, in the block's cloud
  Eigen::Matrix3d section_axes = Eigen::Matrix3d::Identity();  ///< columns: its x and y, along
  std::uint32_t flags = kOk;
};

/// What is known of any stem: what the parameters say.
CrossSectionPrior weakPrior(const MeasurementParameters& parameters);

/// Measures the stem at `diameter_height` above the soil, on short stems at `diameter_height_share`
/// of the stem's length (paper 2.8), from the points of `diameter_span` round it: the flared foot
/// of the stem and its upper end are left out. Where few points are there, the span is longer, by
/// up to `max_shift` at either end; where too few, those of the best populated height within
/// `max_shift` are fitted, and the result is carried to the height asked for with the stem's taper
/// (kHeightShifted). In mode "paper" Eq 27 is solved as printed, on the points within half of
/// `diameter_span` of the height, their z dropped. Thread-safe; deterministic.
/// @param prior of the fit: weakPrior(), or what the block's stems say of each other
/// @param before what the same stem gave with another prior: where the fit begins, if it can be
///        trusted
StemDiameter measureStemDiameter(const SegmentedBlock& block, const Plant& plant,
                                 const MeasurementParameters& parameters,
                                 const CrossSectionPrior& prior,
                                 const StemDiameter& before = StemDiameter());

/// measureStemDiameter() of many plants of a block, on several cores, or all at once on a GPU: the
/// results are the same. Thread-safe; deterministic.
/// @param plants their numbers
/// @param before of each of them; or none
std::vector<StemDiameter> measureStemDiameters(const SegmentedBlock& block,
                                               const std::vector<std::size_t>& plants,
                                               const MeasurementParameters& parameters,
                                               const CrossSectionPrior& prior,
                                               const std::vector<StemDiameter>& before,
                                               const ComputeDevice& device);

}  // namespace field_phenotyping
