#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

constexpr float kMostEvidence = 100.0F;  ///< [log likelihood/m] what a few points of a stem say

/// A stem's midline with what the points round it look like.
struct Midline {
  StemAxis axis;
  float spread = 0.0F;    ///< robust standard deviation of the points about the stem surface [m]
  float evidence = 0.0F;  ///< log likelihood gained by a stem there over leaves and noise alone,
                          ///< kMostEvidence for each metre at most
  float hidden = 0.0F;    ///< [m] of the axis from its base that is guessed from what is seen above
};

/// Fits the curved midline of a stem and its radius profile (2.4.2, Step 1; Eq 15 made a curve that
/// bends little).
///
/// Expectation maximisation of a thin skin of stem points among leaf points: it begins at the
/// stretch of the prior that agrees best with what lies straight above and below it, grows from
/// there up and down, and trusts bands where leaves crowd little. The end of the stem is not looked
/// for here: see findStemTop(). A half-seen stem is centred by its curvature and by a prior on
/// radius and taper.
///
/// @param points     candidates, local frame [m]
/// @param members    indices of the points round the stem (leaf points among them are survived)
/// @param prior      rough axis; its ends are the midline's
/// @param max_radius thickest stem that is believed [m]
/// @param plant_height about how high the plant is [m]: its stem is slender, and a seedling's is
/// short Gives back the prior where there are too few points. Thread-safe; deterministic.
Midline fitMidline(const std::vector<Eigen::Vector3f>& points,
                   const std::vector<std::uint32_t>& members, const StemAxis& prior,
                   float max_radius, float plant_height);

/// The same from a midline that was fitted before, within a centimetre, and whose axis has been cut
/// or carried on straight since: its radius is about known, and no stretch is looked for.
/// Gives it back where there are too few points. Other parameters as of fitMidline().
Midline refitMidline(const std::vector<Eigen::Vector3f>& points,
                     const std::vector<std::uint32_t>& members, const Midline& known,
                     float max_radius, float plant_height);

/// The same along an axis that is known within a few millimetres, where a free fit would follow the
/// leaves that hide the stem: radius, spread and evidence, with the axis hardly moved.
Midline followMidline(const std::vector<Eigen::Vector3f>& points,
                      const std::vector<std::uint32_t>& members, const StemAxis& known,
                      float max_radius, float plant_height);

}  // namespace field_phenotyping
