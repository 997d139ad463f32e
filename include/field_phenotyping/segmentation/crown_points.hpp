#pragma once

#include <vector>

#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/isolated_points.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// Gives what stands right above a stem to that stem's plant, where nothing but that tells whose it
/// is. The points of a tassel that is hardly seen lie so far apart that nothing leads from one to
/// the next, or to those of another plant sooner than to its own; but a tassel stands on its stem's
/// line, and hardly anything else does up there.
///
/// What is no plant's yet goes to the line that it is nearest to, up to where too much of that is
/// empty. From `sparse_from` upwards so does what was given to another plant, unless that one's
/// line is nearly as near or it stands high above the plant alone, and what was taken out as an
/// outlier, if there is no dust. In such a stand what is no plant's may stand farther off a line,
/// where the next one is much farther. In any stand a plant gets, beyond a gap wider than those of
/// the others, only what is far nearer to its line than to the next one.
///
/// @param axes        one a plant; the upper part shows where a stem points
/// @param sparse_from height above the soil [m], see SamplingProfile::sparseFrom(); infinite: in a
///                    stand that is well seen to its tops, plants reach less far beyond their stems
/// @param owners      of the points of `block.cloud`; filled in. Points of stems stay theirs
/// @param isolated    of the points of `block.isolated`; filled in
/// Pure function; lengths in metres.
void giveCrownPoints(const Block& block, const std::vector<StemAxis>& axes, double sparse_from,
                     PointOwners& owners, PointOwners& isolated);

}  // namespace field_phenotyping
