#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/sampling_profile.hpp"
#include "field_phenotyping/segmentation/stand_length.hpp"

namespace field_phenotyping {

/// Finds where a stem ends: the arc length [m] on a midline that may run on through leaves or
/// tassel.
///
/// Two things end it. The core of the axis empties where the whorl opens, for leaves lean away from
/// it: the cut parts bands that have a stem's number of points from bands that have no more than
/// the leaves beside it would put there. Or the tassel begins: its spike continues the stem, but
/// its side branches leave it all round, above a bare stretch, and nothing comes after them. Of
/// several such places the highest is the tassel's, the others are ears'; where a stand is known,
/// it must be a place where its stems end. Gives midline.axis.length() where neither is found.
///
/// @param points  local frame [m]
/// @param members indices of the points near the midline, leaf points included
/// @param sampling how many points are to be expected of a stem, by its height
/// @param stand   tips the scales where the points leave the end open
/// @param leaf_density of leaves that may stand in the core, to that of those just beside it
float findStemTop(const std::vector<Eigen::Vector3f>& points,
                  const std::vector<std::uint32_t>& members, const Midline& midline,
                  const SamplingProfile& sampling = {}, const StandLength& stand = {},
                  double leaf_density = 1.0);

/// How far up the core of an axis holds as many points as a stem shows: the arc length [m], be it
/// of a stem or of what carries one on.
/// Parameters as of findStemTop().
float findOccupiedEnd(const std::vector<Eigen::Vector3f>& points,
                      const std::vector<std::uint32_t>& members, const Midline& midline,
                      const SamplingProfile& sampling = {});

}  // namespace field_phenotyping
