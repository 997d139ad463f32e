#include "field_phenotyping/completion/stem_frame.hpp"

#include <cmath>
#include <stdexcept>

namespace field_phenotyping {

using Eigen::Vector3d;

StemFrame::StemFrame(const std::vector<Vector3d>& curve) : nodes_(curve.size()) {
  if (curve.size() < 2U) throw std::invalid_argument("StemFrame: at least two points are needed");
  for (std::size_t i = 0; i < curve.size(); ++i) {
    placeNode(curve.data(), count(), static_cast<int>(i), nodes_[i]);
    if (i > 0 && !(nodes_[i].s > 0.0)) {
      throw std::invalid_argument("StemFrame: two points in one place");
    }
  }
  startFrame(nodes_[0]);
  for (std::size_t i = 1; i < nodes_.size(); ++i) carryOn(nodes_[i - 1], nodes_[i]);
}

StemFrame::Frame StemFrame::at(double s) const {
  return frameAt(nodes_.data(), count(), s);
}

UnrolledPoint StemFrame::unroll(const Vector3d& point) const {
  Vector3d outward;
  return unroll(point, outward);
}

UnrolledPoint StemFrame::unroll(const Vector3d& point, Vector3d& outward) const {
  const BesideCurve<Vector3d> beside = besideCurve(nodes_.data(), count(), point);
  outward = beside.r > 0.0 ? Vector3d(beside.offset / beside.r) : beside.u;
  return {std::atan2(beside.sine(), beside.cosine()), beside.s, beside.r};
}

Vector3d StemFrame::roll(const UnrolledPoint& point) const {
  const Frame frame = at(point.s);
  return frame.position +
         point.r * (std::cos(point.theta) * frame.u + std::sin(point.theta) * frame.v);
}

}  // namespace field_phenotyping
