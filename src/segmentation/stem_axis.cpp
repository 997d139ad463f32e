#include "field_phenotyping/segmentation/stem_axis.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "field_phenotyping/segmentation/axis_view.hpp"

namespace field_phenotyping {

StemAxis::StemAxis(std::vector<Node> nodes) : nodes_(std::move(nodes)) {
  if (nodes_.size() < 2U) throw std::invalid_argument("StemAxis: at least two nodes are needed");
  arc_lengths_.resize(nodes_.size());
  directions_.reserve(nodes_.size() - 1U);
  for (std::size_t i = 1; i < nodes_.size(); ++i) {
    const Eigen::Vector3f step = nodes_[i].position - nodes_[i - 1].position;
    if (!(step.norm() > 0.0F)) throw std::invalid_argument("StemAxis: two nodes in one place");
    arc_lengths_[i] = arc_lengths_[i - 1] + step.norm();
    directions_.emplace_back(step / (arc_lengths_[i] - arc_lengths_[i - 1]));
    rising_ = rising_ && nodes_[i].position.z() > nodes_[i - 1].position.z();
  }
  const float rise = nodes_.back().position.z() - nodes_.front().position.z();
  if (rising_) segments_per_metre_ = static_cast<float>(directions_.size()) / rise;
}

std::size_t StemAxis::segmentAt(float s) const {
  const auto above = std::upper_bound(arc_lengths_.begin() + 1, arc_lengths_.end() - 1, s);
  return static_cast<std::size_t>(above - arc_lengths_.begin()) - 1U;
}

Eigen::Vector3f StemAxis::directionAt(float s) const {
  return directions_[segmentAt(s)];
}

Eigen::Vector3f StemAxis::pointAt(float s) const {
  const std::size_t i = segmentAt(s);
  return nodes_[i].position + (s - arc_lengths_[i]) * directions_[i];
}

float StemAxis::radiusAt(float s) const {
  return view().radiusAt(s, static_cast<int>(segmentAt(s)));
}

Eigen::Vector3f StemAxis::pointAtHeight(float z) const {
  std::size_t i = 0;
  if (rising_) {
    const auto above =
        std::lower_bound(nodes_.begin() + 1, nodes_.end() - 1, z,
                         [](const Node& node, float height) { return node.position.z() < height; });
    i = static_cast<std::size_t>(above - nodes_.begin()) - 1U;
  }
  return pointAtHeight(z, i);
}

StemAxis StemAxis::below(float s) const {
  constexpr float kLeastLength = 0.02F;
  const float top = std::clamp(s, std::min(kLeastLength, length()), length());
  std::vector<Node> lower;
  constexpr float kLeastStep = 1e-3F;  // a cut just above a node replaces it
  lower.push_back(nodes_.front());
  for (std::size_t i = 1; i < nodes_.size() && arc_lengths_[i] < top - kLeastStep; ++i) {
    lower.push_back(nodes_[i]);
  }
  lower.push_back({pointAt(top), radiusAt(top)});
  return StemAxis(std::move(lower));
}

StemAxis StemAxis::extendedBy(float length) const {
  if (!(length > 0.0F)) return *this;
  std::vector<Node> longer = nodes_;
  longer.push_back({pointAt(this->length() + length), nodes_.back().radius});
  return StemAxis(std::move(longer));
}

AxisView StemAxis::view() const {
  static_assert(sizeof(Node) == sizeof(AxisNode), "nodes lie in memory as four numbers each");
  return {reinterpret_cast<const AxisNode*>(nodes_.data()),
          arc_lengths_.data(),
          reinterpret_cast<const Place*>(directions_.data()),
          static_cast<int>(directions_.size()),
          rising_,
          segments_per_metre_};
}

StemAxis::Projection StemAxis::project(const Eigen::Vector3f& point) const {
  const AxisProjection at = view().project({point.x(), point.y(), point.z()});
  return {at.arc_length,
          at.distance,
          at.radius,
          {at.foot.x, at.foot.y, at.foot.z},
          {at.direction.x, at.direction.y, at.direction.z}};
}

}  // namespace field_phenotyping
