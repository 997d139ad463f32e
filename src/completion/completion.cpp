#include "field_phenotyping/completion/completion.hpp"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/stem_completion.hpp"

namespace field_phenotyping {

namespace {

/// The plant's stem in an older revision; null where it was not there.
const StemState* stateOf(const CompletedBlock* previous, std::int32_t id) {
  if (previous == nullptr || id < 0) return nullptr;
  const std::vector<Plant>& plants = previous->segmented->plants;
  for (std::size_t i = 0; i < std::min(plants.size(), previous->stems.size()); ++i) {
    if (plants[i].id == id) return previous->stems[i].state.get();
  }
  return nullptr;
}

}  // namespace

CompletedBlock completeBlock(std::shared_ptr<const SegmentedBlock> segmented,
                             const CompletionParameters& parameters, const CompletedBlock* previous,
                             const ComputeDevice& device) {
  const std::vector<Plant>& plants = segmented->plants;
  std::vector<CompletedStem> stems(plants.size());
  if (parameters.enabled) {
    // Step 2, coarse: cylinder priors (Eq 18).
    std::vector<std::size_t> owned;
    std::vector<StemToModel> to_model;
    for (std::size_t i = 0; i < plants.size(); ++i) {
      if (!plants[i].owned) continue;
      owned.push_back(i);
      to_model.push_back(stemToModel(segmented->cloud, plants[i].stem, plants[i].axis, parameters));
    }
    const std::vector<std::optional<SurfacePrior>> priors = fitSurfacePriors(to_model, device);
    // Steps 2 to 6.
    std::vector<StemToComplete> to_complete;
    for (std::size_t k = 0; k < owned.size(); ++k) {
      const Plant& plant = plants[owned[k]];
      to_complete.push_back({plant.stem, priors[k] ? &*priors[k] : nullptr,
                             stateOf(previous, plant.id), segmented->header.final});
    }
    std::vector<CompletedStem> completed_stems =
        completeStems(segmented->cloud, to_complete, segmented->ground, parameters, device);
    for (std::size_t k = 0; k < owned.size(); ++k) {
      stems[owned[k]] = std::move(completed_stems[k]);
    }
  }

  // Step 5: measured and new points side by side (Eq 24).
  CompletedBlock completed;
  completed.synthetic.origin = segmented->cloud.origin;
  completed.synthetic_span.reserve(plants.size());
  std::uint32_t points = 0U;
  bool has_colors = false;
  for (CompletedStem& stem : stems) {
    const std::uint32_t begin = points;
    points += static_cast<std::uint32_t>(stem.points.size());
    has_colors = has_colors || !stem.colors.empty();
    completed.synthetic_span.push_back({begin, points});
    completed.stems.push_back(std::move(stem.solution));
  }
  completed.synthetic.points.resize(points);
  if (has_colors) completed.synthetic.colors.resize(points);
  completed.synthetic_stddev.resize(points);
  parallelFor(stems.size(), [&](std::size_t s) {
    const auto begin = static_cast<std::ptrdiff_t>(completed.synthetic_span[s].begin);
    const auto place = [&](const auto& values, auto& all) {
      std::copy(values.begin(), values.end(), all.begin() + begin);
    };
    place(stems[s].points, completed.synthetic.points);
    place(stems[s].colors, completed.synthetic.colors);
    place(stems[s].stddev, completed.synthetic_stddev);
  });
  completed.segmented = std::move(segmented);
  return completed;
}

}  // namespace field_phenotyping
