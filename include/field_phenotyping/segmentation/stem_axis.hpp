#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <vector>

namespace field_phenotyping {

struct AxisView;

/// Curved midline of a stem (the paper's L(t), Eq 15, piecewise): a polyline whose nodes rise from
/// the base to the top of the stem, each with the stem's radius there.
///
/// Metres, local frame of the block's cloud. Nodes are ordered by arc length from the base.
class StemAxis {
 public:
  struct Node {
    Eigen::Vector3f position = Eigen::Vector3f::Zero();
    float radius = 0.0F;
  };

  /// Where a point lies relative to the axis.
  struct Projection {
    float arc_length = 0.0F;  ///< along the axis from its base; < 0 below it, > length() above it
    float distance = 0.0F;    ///< from the axis, the ends being extended straight (Eq 16)
    float radius = 0.0F;      ///< of the stem at that height
    Eigen::Vector3f foot = Eigen::Vector3f::Zero();        ///< nearest point of the axis
    Eigen::Vector3f direction = Eigen::Vector3f::UnitZ();  ///< of the axis there, upwards
  };

  StemAxis() = default;
  /// @throws std::invalid_argument for fewer than two nodes or two nodes in one place
  explicit StemAxis(std::vector<Node> nodes);

  Projection project(const Eigen::Vector3f& point) const;
  /// Point of the axis at arc length `s`; straight continuation outside [0, length()].
  Eigen::Vector3f pointAt(float s) const;
  Eigen::Vector3f directionAt(float s) const;
  float radiusAt(float s) const;
  /// Where the axis passes local height `z`; the ends are continued straight.
  Eigen::Vector3f pointAtHeight(float z) const;
  /// The same, for many heights that are near to one another.
  /// @param segment where to look first, any number; where it was found afterwards
  Eigen::Vector3f pointAtHeight(float z, std::size_t& segment) const {
    std::size_t i = rising_ ? std::min(segment, nodes_.size() - 2U) : 0U;
    while (i + 2U < nodes_.size() && nodes_[i + 1U].position.z() < z) ++i;
    while (rising_ && i > 0U && nodes_[i].position.z() >= z) --i;
    segment = i;
    const Eigen::Vector3f& low = nodes_[i].position;
    const Eigen::Vector3f step = nodes_[i + 1U].position - low;
    if (!(step.z() > 0.0F)) return {low.x(), low.y(), z};
    return low + (z - low.z()) / step.z() * step;
  }

  /// The part of the axis below arc length `s`, which is clamped so that something remains.
  StemAxis below(float s) const;
  /// The axis carried on straight beyond its top.
  StemAxis extendedBy(float length) const;

  float length() const { return arc_lengths_.empty() ? 0.0F : arc_lengths_.back(); }
  bool empty() const { return nodes_.empty(); }
  const std::vector<Node>& nodes() const { return nodes_; }

  /// What projections run on; holds while the axis lives and is not assigned to.
  AxisView view() const;

 private:
  std::size_t segmentAt(float s) const;

  std::vector<Node> nodes_;
  std::vector<float> arc_lengths_;
  std::vector<Eigen::Vector3f> directions_;  // of the segments, of length 1
  bool rising_ = true;                       ///< every node is higher than the one before
  float segments_per_metre_ = 0.0F;          ///< of height
};

}  // namespace field_phenotyping
