#include "field_phenotyping/completion/completion.hpp"

#include <utility>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/stem_completion.hpp"

namespace field_phenotyping {

CompletedBlock completeBlock(std::shared_ptr<const SegmentedBlock> segmented,
                             const CompletionParameters& parameters) {
  const std::vector<Plant>& plants = segmented->plants;
  std::vector<CompletedStem> stems(plants.size());
  if (parameters.enabled) {
    parallelFor(plants.size(), [&](std::size_t i) {
      if (!plants[i].owned) return;
      stems[i] = completeStem(segmented->cloud, plants[i].stem, plants[i].axis, segmented->ground,
                              parameters);
    });
  }

  // Step 5: measured and new points side by side (Eq 24).
  CompletedBlock completed;
  completed.synthetic.origin = segmented->cloud.origin;
  completed.synthetic_span.reserve(plants.size());
  for (const CompletedStem& stem : stems) {
    PointCloud& cloud = completed.synthetic;
    const auto begin = static_cast<std::uint32_t>(cloud.size());
    cloud.points.insert(cloud.points.end(), stem.points.begin(), stem.points.end());
    cloud.colors.insert(cloud.colors.end(), stem.colors.begin(), stem.colors.end());
    completed.synthetic_stddev.insert(completed.synthetic_stddev.end(), stem.stddev.begin(),
                                      stem.stddev.end());
    completed.synthetic_span.push_back({begin, static_cast<std::uint32_t>(cloud.size())});
  }
  completed.segmented = std::move(segmented);
  return completed;
}

}  // namespace field_phenotyping
