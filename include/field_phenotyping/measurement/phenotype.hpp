#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace field_phenotyping {

/// Why a trait is missing or to be used with care. A bit mask; names in `flagNames`.
enum QualityFlag : std::uint32_t {
  kOk = 0U,
  kTooFewPoints = 1U << 0U,        ///< too few stem points near the measuring height for a diameter
  kArcBelow = 1U << 1U,            ///< less of the stem's circumference was seen than asked for
  kPoorFit = 1U << 2U,             ///< the fit did not converge or its residuals are too large
  kGroundExtrapolated = 1U << 3U,  ///< no soil seen near the base; its height is extrapolated
  kGroundMissing = 1U << 4U,       ///< no soil in the block: height is from the lowest plant point
  kHeightShifted = 1U << 5U,       ///< diameter taken away from the height asked for
  kShortStem = 1U << 6U,           ///< measuring height is a share of the stem's own height
  kTruncated = 1U << 7U,           ///< the plant reaches the border of the data
  kLowConfidence = 1U << 8U,       ///< weak stem evidence: may not be a plant at all
  kPriorDriven = 1U << 9U,         ///< a prior, not the points, decides the value
  kMergedSuspect = 1U << 10U,      ///< stem is as flat, or scatters as much, as two in one
  kUnlikeStand = 1U << 11U,        ///< likelier a wrong fit than a plant so unlike the others
};

/// Lower-case names of the flags that are set, joined by '|'; "ok" when none is.
std::string flagNames(std::uint32_t flags);

/// A value with its standard deviation; both NaN where it could not be measured.
struct Trait {
  double value = std::numeric_limits<double>::quiet_NaN();
  double stddev = std::numeric_limits<double>::quiet_NaN();
};

/// What was measured on one plant. Metres and radians, map frame, z up.
struct Phenotype {
  std::int32_t id = -1;
  std::uint32_t revision = 0U;
  bool final = false;
  std::uint32_t passes = 1U;  ///< times that the sensor went past it, whose values are in these
  Eigen::Vector3d base = Eigen::Vector3d::Zero();   ///< where the stem's axis meets the soil [m]
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< mean direction of the stem, unit, upwards
  Trait height;                    ///< vertical, from the soil at the base to the plant's top [m]
  Trait stem_diameter;             ///< major axis 2a across the stem (Eq 27) [m]
  Trait stem_diameter_minor;       ///< minor axis 2b [m]
  Trait stem_diameter_equivalent;  ///< 2 sqrt(a b) [m]
  double diameter_height = std::numeric_limits<double>::quiet_NaN();  ///< above the soil [m]
  double diameter_prior_share =
      std::numeric_limits<double>::quiet_NaN();  ///< of priors in what is known of stem_diameter
  Trait stem_volume;  ///< of the stem, from the soil to diameter_height [m^3]
  Trait lean;         ///< angle of the axis from vertical [rad]
  double lean_azimuth = std::numeric_limits<double>::quiet_NaN();  ///< from x towards y [rad]
  Trait spacing;      ///< to the next plant in its row [m]
  Trait row_spacing;  ///< to the nearest neighbouring row [m]
  double arc_coverage = std::numeric_limits<double>::quiet_NaN();  ///< seen, share of 2 pi
  double completeness = std::numeric_limits<double>::quiet_NaN();  ///< measured share of the stem
  std::uint32_t stem_points = 0U;
  std::uint32_t plant_points = 0U;
  std::uint32_t diameter_points = 0U;    ///< that the diameter was fitted to
  std::uint32_t synthetic_points = 0U;   ///< added by completion, used in no trait
  std::uint8_t completion_flags = 0U;    ///< CompletionFlag: what was left unfilled, and why
  float segmentation_quality = 0.0F;     ///< Q of Eq 9
  std::uint32_t growth_iterations = 0U;  ///< growths of the stem that it took (Step 4)
  float growth_r1 = 0.0F;                ///< growth radius of the stem's best growth [m]
  float growth_M = 0.0F;                 ///< its similarity threshold
  float growth_alpha = 0.0F;             ///< its weights of Eq 2
  float growth_beta = 0.0F;
  std::uint32_t flags = kOk;
  double score = 0.0;  ///< qualityScore() of this
};

/// One number for how far a plant can be trusted, in [0, 1]: the product of
/// - the evidence for a stem, Q of Eq 9 over 0.7, at most 1;
/// - the diameter's, 1 / (1 + (s / 0.1)^2) with s its standard deviation relative to it, times the
///   arc coverage over 0.75, at most 1; 0.25 where there is no diameter;
/// - the height's, 1 / (1 + (s / 0.05)^2) likewise; 0.25 where there is none;
/// - 0.4 for merged_suspect, a half for each of poor_fit, prior_driven, ground_missing,
///   low_confidence, and 0.8 for each of arc_below, height_shifted, ground_extrapolated, truncated.
double qualityScore(const Phenotype& phenotype);

}  // namespace field_phenotyping
