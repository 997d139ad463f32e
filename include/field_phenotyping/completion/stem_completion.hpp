#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/completion/completion_flags.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// A stem with its gaps filled, in the local frame of the block's cloud.
struct CompletedStem {
  std::vector<Eigen::Vector3f> points;  ///< made up [m]
  std::vector<std::uint32_t> colors;    ///< 0x00RRGGBB; empty when the cloud has none
  std::vector<float> stddev;            ///< of each one's distance to the true surface [m]
  double density = 0.0;                 ///< that gaps were filled to [1/m^2]; 0: nothing was filled
  StemSolution solution;
};

/// Fills the gaps of one stem (paper 2.5, Eq 17-26), region by region on a coarse model. A stem
/// whose points do not carry a surface gives no points and says so in its flags. The cost is
/// bounded by `max_centers`, `density` and the stem's length. Thread-safe; deterministic.
///
/// @param previous the stem as completed before newer scans came, or null: regions whose points and
///        coarse model are the same within 0.05 mm are taken over, the others solved again. The
///        result is that of a completion from scratch within 0.1 mm.
/// Nothing is filled in where nothing was measured and beams saw empty space, as far as the cloud's
/// scan origins are known.
CompletedStem completeStem(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                           const GroundModel& ground, const CompletionParameters& parameters,
                           const StemState* previous = nullptr);

/// The same of many stems, whose priors are fitted together before, see fitSurfacePriors().
/// @return without points where the stem has too few
StemToModel stemToModel(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                        const CompletionParameters& parameters);

struct StemToComplete {
  IndexSpan stem;
  const SurfacePrior* prior;  ///< null where the stem does not carry a surface
  const StemState* previous;  ///< as for completeStem()
  bool is_last = false;       ///< no newer revision goes on from it: `solution.state` is null
};

/// On all cores, a stem at a time on each; or together where there is a GPU.
std::vector<CompletedStem> completeStems(const PointCloud& cloud,
                                         const std::vector<StemToComplete>& stems,
                                         const GroundModel& ground,
                                         const CompletionParameters& parameters,
                                         const ComputeDevice& device);

/// The same, with the same bits, all stems step by step, so that the surfaces and filters of all
/// their regions are found at once: on the device, or where it has no GPU on all cores.
std::vector<CompletedStem> completeStemsTogether(const PointCloud& cloud,
                                                 const std::vector<StemToComplete>& stems,
                                                 const GroundModel& ground,
                                                 const CompletionParameters& parameters,
                                                 const ComputeDevice& device);

}  // namespace field_phenotyping
