#include "field_phenotyping/segmentation/stem_curve.hpp"

namespace field_phenotyping {

void sortByHeight(std::vector<Sample>& samples) {
  std::sort(samples.begin(), samples.end(),
            [](const Sample& a, const Sample& b) { return a.height < b.height; });
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
