#include "field_phenotyping/segmentation/stem_axis.hpp"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <utility>

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

std::size_t StemAxis::segmentAtHeight(float z) const {
  // Nodes are about as far from one another, so that the first guess is near.
  const std::size_t last = nodes_.size() - 2U;
  const float guess = (z - nodes_.front().position.z()) * segments_per_metre_;
  std::size_t i =
      guess > 0.0F ? static_cast<std::size_t>(std::min(guess, static_cast<float>(last))) : 0U;
  while (i < last && nodes_[i + 1U].position.z() <= z) ++i;
  while (i > 0U && nodes_[i].position.z() > z) --i;
  return i;
}

Eigen::Vector3f StemAxis::directionAt(float s) const {
  return directions_[segmentAt(s)];
}

Eigen::Vector3f StemAxis::pointAt(float s) const {
  const std::size_t i = segmentAt(s);
  return nodes_[i].position + (s - arc_lengths_[i]) * directions_[i];
}

float StemAxis::radiusAt(float s) const {
  return radiusAt(s, segmentAt(s));
}

float StemAxis::radiusAt(float s, std::size_t segment) const {
  const std::size_t i = segment;
  const float share =
      std::clamp((s - arc_lengths_[i]) / (arc_lengths_[i + 1] - arc_lengths_[i]), 0.0F, 1.0F);
  return (1.0F - share) * nodes_[i].radius + share * nodes_[i + 1].radius;
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

StemAxis::Projection StemAxis::project(const Eigen::Vector3f& point) const {
  float least = std::numeric_limits<float>::max();  // squared distance
  std::size_t nearest = 0U;
  float along = 0.0F;  // the nearest segment
  const std::size_t last = nodes_.size() - 2;
  const auto look = [&](std::size_t i) {
    const Eigen::Vector3f& direction = directions_[i];
    const Eigen::Vector3f away = point - nodes_[i].position;
    float t = direction.dot(away);
    if (i > 0) t = std::max(t, 0.0F);
    if (i < last) t = std::min(t, arc_lengths_[i + 1] - arc_lengths_[i]);
    const float squared = (away - t * direction).squaredNorm();
    if (squared < least) {
      least = squared;
      nearest = i;
      along = t;
    }
  };
  const auto mayBeNearer = [&](float apart) { return apart <= 0.0F || apart * apart <= least; };
  if (rising_) {
    // Outwards from the point's own height, until no segment can be nearer.
    const std::size_t middle = segmentAtHeight(point.z());
    look(middle);
    for (std::size_t i = middle + 1U; i <= last && mayBeNearer(nodes_[i].position.z() - point.z());
         ++i) {
      look(i);
    }
    for (std::size_t i = middle; i > 0U && mayBeNearer(point.z() - nodes_[i].position.z()); --i) {
      look(i - 1U);
    }
  } else {
    for (std::size_t i = 0; i <= last; ++i) look(i);
  }
  Projection best;
  best.direction = directions_[nearest];
  best.foot = nodes_[nearest].position + along * best.direction;
  best.distance = (point - best.foot).norm();
  best.arc_length = arc_lengths_[nearest] + along;
  best.radius = radiusAt(best.arc_length, nearest);
  return best;
}

}  // namespace field_phenotyping
