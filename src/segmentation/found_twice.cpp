#include "field_phenotyping/segmentation/found_twice.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

#include "field_phenotyping/segmentation/stem_foot.hpp"

namespace field_phenotyping {
namespace {

/// Whether two are seen beside one another so well that both must be stems.
bool seenSideBySide(const Midline& a, const Midline& b, float apart) {
  constexpr float kLeast = 0.10F;     // [m] of height that both are seen over
  constexpr float kEvidence = 40.0F;  // of each: leaves that stand upright by chance gain up to 25
  if (std::min(a.evidence, b.evidence) < kEvidence) return false;
  const float low = std::max(a.axis.pointAt(a.hidden).z(), b.axis.pointAt(b.hidden).z());
  const float high =
      std::min(a.axis.nodes().back().position.z(), b.axis.nodes().back().position.z());
  if (high - low < kLeast) return false;
  const float middle = 0.5F * (low + high);
  return (a.axis.pointAtHeight(middle) - b.axis.pointAtHeight(middle)).head<2>().norm() >= apart;
}

}  // namespace

std::vector<GrownStem> withoutFoundTwice(const Block& block, std::vector<GrownStem> stems,
                                         float least_distance) {
  constexpr float kApart = 0.5F;  // of the least distance, where they are seen
  std::vector<Eigen::Vector2f> bases;
  for (const GrownStem& stem : stems) {
    bases.emplace_back(baseOf(block, stem.midline.axis).head<2>());
  }
  std::vector<std::size_t> order(stems.size());
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return stems[a].points.size() > stems[b].points.size();
  });
  std::vector<std::size_t> kept;
  for (const std::size_t s : order) {
    const bool found_twice = std::any_of(kept.begin(), kept.end(), [&](std::size_t other) {
      return (bases[s] - bases[other]).norm() < least_distance &&
             !seenSideBySide(stems[s].midline, stems[other].midline, kApart * least_distance);
    });
    if (!found_twice) kept.push_back(s);
  }
  std::sort(kept.begin(), kept.end());
  std::vector<GrownStem> plants;
  for (const std::size_t s : kept) plants.push_back(std::move(stems[s]));
  return plants;
}

}  // namespace field_phenotyping
