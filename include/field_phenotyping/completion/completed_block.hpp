#pragma once

#include <memory>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// A segmented block together with the stem points that were filled in (paper 2.5).
///
/// Measured and synthetic points are never mixed in one array, so that nothing can be measured from
/// an invented point by mistake. Shares the segmented block; immutable once handed on.
struct CompletedBlock {
  std::shared_ptr<const SegmentedBlock> segmented;
  PointCloud synthetic;                   ///< interpolated stem points, same origin as the block's
  std::vector<float> synthetic_stddev;    ///< of each one's distance to the true surface [m]
  std::vector<IndexSpan> synthetic_span;  ///< one per plant of `segmented`, into `synthetic`
};

}  // namespace field_phenotyping
