#include "field_phenotyping/segmentation/stem_curve.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>

namespace field_phenotyping {

void sortByHeight(std::vector<Sample>& samples) {
  const auto isLower = [](const Sample& a, const Sample& b) { return a.height < b.height; };
  const auto [lowest, highest] = std::minmax_element(samples.begin(), samples.end(), isLower);
  if (samples.empty() || !(lowest->height < highest->height)) return;
  // First to levels that hold about one of them, which takes no comparisons.
  const double low = lowest->height;
  const std::size_t levels = samples.size();
  const double levels_per_metre = static_cast<double>(levels - 1U) / (highest->height - low);
  const auto levelOf = [&](const Sample& sample) {
    return static_cast<std::size_t>((sample.height - low) * levels_per_metre);
  };
  std::vector<std::uint32_t> end(levels + 1U, 0U);  // of each level, once they are filled
  for (const Sample& sample : samples) ++end[levelOf(sample) + 1U];
  std::partial_sum(end.begin(), end.end(), end.begin());
  std::vector<Sample> sorted(samples.size());
  for (const Sample& sample : samples) sorted[end[levelOf(sample)]++] = sample;
  for (std::size_t level = 0; level < levels; ++level) {
    const std::uint32_t begin = level == 0U ? 0U : end[level - 1U];
    if (end[level] - begin < 2U) continue;
    std::sort(sorted.begin() + begin, sorted.begin() + end[level], isLower);
  }
  samples.swap(sorted);
}

StemCurve curveAlong(const StemAxis& axis, const ChordFrame& frame, double spacing) {
  constexpr double kMostNodes = 80.0;
  StemCurve curve;
  const double count = std::clamp(std::ceil(frame.length / spacing), 2.0, kMostNodes);
  curve.spacing = frame.length / count;
  for (std::size_t k = 0; k <= static_cast<std::size_t>(count); ++k) {
    // Where the axis passes that height of the chord.
    const double height = curve.spacing * static_cast<double>(k);
    float s = static_cast<float>(height / frame.length) * axis.length();
    for (int round = 0; round < 3; ++round) {
      s += static_cast<float>(height - frame.toFrame(axis.pointAt(s)).height);
    }
    curve.centers.push_back(frame.toFrame(axis.pointAt(s)).offset);
  }
  curve.radius = static_cast<double>(axis.nodes().front().radius);
  return curve;
}

std::optional<StemAxis> axisOf(const StemCurve& curve, const ChordFrame& frame, double thickest) {
  std::vector<StemAxis::Node> nodes;
  for (std::size_t k = 0; k < curve.centers.size(); ++k) {
    const double height = curve.spacing * static_cast<double>(k);
    const Eigen::Vector3f position = frame.fromFrame(height, curve.centers[k]);
    constexpr float kLeastRise = 1e-3F;
    if (!nodes.empty() && position.z() <= nodes.back().position.z() + kLeastRise) continue;
    nodes.push_back({position, static_cast<float>(std::min(curve.radiusAt(height), thickest))});
  }
  if (nodes.size() < 2U) return std::nullopt;
  return StemAxis(std::move(nodes));
}

}  // namespace field_phenotyping
