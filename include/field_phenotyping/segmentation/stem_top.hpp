#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// Finds where a stem ends below its tassel: the arc length [m] on the midline above which the
/// points near it are better explained by a thin spike than by a stem of the tapered radius.
///
/// The tassel continues the stem in a straight line, so direction does not tell them apart;
/// thickness does. Compares the likelihoods of the points' distances from the axis under both, with
/// leaf points as clutter in either, and cuts where the whole upper part favours the spike most.
/// Gives midline.axis.length() where nothing does.
///
/// @param points  local frame [m]
/// @param members indices of the points near the midline, leaf points included
float findStemTop(const std::vector<Eigen::Vector3f>& points,
                  const std::vector<std::uint32_t>& members, const Midline& midline);

}  // namespace field_phenotyping
