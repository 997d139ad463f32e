#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

struct StemState;

/// How one stem was completed, beside the points. Between processes only the flags are sent.
struct StemSolution {
  std::uint8_t flags = 0U;  ///< CompletionFlag of completion/completion_flags.hpp
  /// The measured stem points, in their order, after the bilateral filter (Eq 25), same frame. They
  /// complete the picture: traits are measured from the points as they were.
  std::vector<Eigen::Vector3f> smoothed;
  std::uint32_t regions = 0U;              ///< that the stem was solved in
  std::uint32_t regions_solved = 0U;       ///< of them solved anew, not taken over
  std::shared_ptr<const StemState> state;  ///< from which a newer revision goes on; final: null
};

/// A segmented block together with the stem points that were filled in (paper 2.5).
///
/// Measured and synthetic points are never mixed in one array, so that nothing can be measured from
/// an invented point by mistake. Shares the segmented block; immutable once handed on.
struct CompletedBlock {
  std::shared_ptr<const SegmentedBlock> segmented;
  PointCloud synthetic;                   ///< interpolated stem points, same origin as the block's
  std::vector<float> synthetic_stddev;    ///< of each one's distance to the true surface [m]
  std::vector<IndexSpan> synthetic_span;  ///< one per plant of `segmented`, into `synthetic`
  std::vector<StemSolution> stems;        ///< one per plant, or none at all
};

}  // namespace field_phenotyping
