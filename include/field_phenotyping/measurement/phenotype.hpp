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
  Trait lean;  ///< angle of the axis from vertical [rad]
  double lean_azimuth = std::numeric_limits<double>::quiet_NaN();  ///< from x towards y [rad]
  Trait spacing;  ///< to the next plant in its row [m]
  double arc_coverage = std::numeric_limits<double>::quiet_NaN();  ///< seen, share of 2 pi
  double completeness = std::numeric_limits<double>::quiet_NaN();  ///< measured share of the stem
  std::uint32_t stem_points = 0U;
  std::uint32_t plant_points = 0U;
  std::uint32_t diameter_points = 0U;    ///< that the diameter was fitted to
  std::uint32_t synthetic_points = 0U;   ///< added by completion, used in no trait
  float segmentation_quality = 0.0F;     ///< Q of Eq 9
  std::uint32_t growth_iterations = 0U;  ///< growths of the stem that it took (Step 4)
  float growth_r1 = 0.0F;                ///< growth radius of the stem's best growth [m]
  float growth_M = 0.0F;                 ///< its similarity threshold
  float growth_alpha = 0.0F;             ///< its weights of Eq 2
  float growth_beta = 0.0F;
  std::uint32_t flags = kOk;
};

}  // namespace field_phenotyping
