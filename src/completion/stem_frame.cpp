#include "field_phenotyping/completion/stem_frame.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

/// Any unit vector across `tangent`; x for anything near upright, so that theta means the same on
/// every stem.
Vector3d acrossTangent(const Vector3d& tangent) {
  const Vector3d reference =
      std::abs(tangent.x()) < 0.9 ? Vector3d(Vector3d::UnitX()) : Vector3d(Vector3d::UnitY());
  return (reference - reference.dot(tangent) * tangent).normalized();
}

void completeFrame(StemFrame::Frame& frame, const Vector3d& u) {
  frame.u = (u - u.dot(frame.tangent) * frame.tangent).normalized();
  frame.v = frame.tangent.cross(frame.u);
}

/// Carries u from one frame to the next without turning it about the axis (double reflection).
Vector3d transport(const StemFrame::Frame& from, const StemFrame::Frame& to) {
  const Vector3d chord = to.position - from.position;
  const double c1 = chord.squaredNorm();
  const Vector3d u = from.u - 2.0 / c1 * chord.dot(from.u) * chord;
  const Vector3d tangent = from.tangent - 2.0 / c1 * chord.dot(from.tangent) * chord;
  const Vector3d difference = to.tangent - tangent;
  const double c2 = difference.squaredNorm();
  return c2 > 0.0 ? Vector3d(u - 2.0 / c2 * difference.dot(u) * difference) : u;
}

/// Of a point over the plane across the axis.
double heightOver(const StemFrame::Frame& frame, const Vector3d& point) {
  return (point - frame.position).dot(frame.tangent);
}

/// Where between two nodes the plane across the axis holds `point`, which lies between their
/// planes: the height over the plane is quadratic in the share, once the tangent is not normalised.
double shareOfPlane(const StemFrame::Frame& low, const StemFrame::Frame& high,
                    const Vector3d& point) {
  const Vector3d offset = point - low.position;
  const Vector3d step = high.position - low.position;
  const Vector3d turn = high.tangent - low.tangent;
  const double constant = offset.dot(low.tangent);
  const double linear = offset.dot(turn) - step.dot(low.tangent);
  const double quadratic = -step.dot(turn);
  double share = constant / (constant - (point - high.position).dot(high.tangent));
  constexpr int kNewtonSteps = 2;
  for (int i = 0; i < kNewtonSteps; ++i) {
    const double slope = linear + 2.0 * quadratic * share;
    if (!(slope < 0.0)) break;
    share -= (constant + share * (linear + quadratic * share)) / slope;
  }
  return std::clamp(share, 0.0, 1.0);
}

}  // namespace

StemFrame::StemFrame(const std::vector<Vector3d>& curve) : nodes_(curve.size()) {
  if (curve.size() < 2U) throw std::invalid_argument("StemFrame: at least two points are needed");
  for (std::size_t i = 0; i < curve.size(); ++i) {
    nodes_[i].position = curve[i];
    if (i == 0) continue;
    const double step = (curve[i] - curve[i - 1]).norm();
    if (!(step > 0.0)) throw std::invalid_argument("StemFrame: two points in one place");
    nodes_[i].s = nodes_[i - 1].s + step;
  }
  for (std::size_t i = 0; i < curve.size(); ++i) {
    const Vector3d& before = curve[i > 0 ? i - 1 : 0];
    const Vector3d& after = curve[std::min(i + 1, curve.size() - 1)];
    const Vector3d chord = after - before;
    // A curve that folds back on itself has no central difference.
    nodes_[i].tangent = chord.norm() > 0.0 ? Vector3d(chord.normalized()) : nodes_[i - 1].tangent;
  }
  completeFrame(nodes_[0], acrossTangent(nodes_[0].tangent));
  for (std::size_t i = 1; i < nodes_.size(); ++i) {
    completeFrame(nodes_[i], transport(nodes_[i - 1], nodes_[i]));
  }
}

StemFrame::Frame StemFrame::interpolate(std::size_t segment, double share) const {
  const Frame& low = nodes_[segment];
  const Frame& high = nodes_[segment + 1];
  Frame frame;
  frame.position = (1.0 - share) * low.position + share * high.position;
  frame.tangent = ((1.0 - share) * low.tangent + share * high.tangent).normalized();
  frame.s = (1.0 - share) * low.s + share * high.s;
  completeFrame(frame, (1.0 - share) * low.u + share * high.u);
  return frame;
}

StemFrame::Frame StemFrame::at(double s) const {
  if (s <= 0.0 || s >= length()) {
    Frame frame = s <= 0.0 ? nodes_.front() : nodes_.back();
    frame.position += (s - frame.s) * frame.tangent;
    frame.s = s;
    return frame;
  }
  const auto above =
      std::upper_bound(nodes_.begin() + 1, nodes_.end() - 1, s,
                       [](double value, const Frame& node) { return value < node.s; });
  const auto segment = static_cast<std::size_t>(above - nodes_.begin()) - 1U;
  return interpolate(segment,
                     (s - nodes_[segment].s) / (nodes_[segment + 1].s - nodes_[segment].s));
}

std::size_t StemFrame::segmentOf(const Vector3d& point) const {
  const Vector3d chord = nodes_.back().position - nodes_.front().position;
  const std::size_t last = nodes_.size() - 2U;
  const double share = (point - nodes_.front().position).dot(chord) / chord.squaredNorm();
  const double guess = share * static_cast<double>(last + 1U);
  // A stem is nearly straight, so that few steps lead from the guess to the segment.
  std::size_t segment =
      guess > 0.0 ? std::min(static_cast<std::size_t>(std::min(guess, 1e6)), last) : 0U;
  while (segment > 0U && heightOver(nodes_[segment], point) <= 0.0) --segment;
  while (segment < last && heightOver(nodes_[segment + 1U], point) > 0.0) ++segment;
  return segment;
}

UnrolledPoint StemFrame::unroll(const Vector3d& point) const {
  Vector3d outward;
  return unroll(point, outward);
}

UnrolledPoint StemFrame::unroll(const Vector3d& point, Vector3d& outward) const {
  const double over_first = heightOver(nodes_.front(), point);
  const double over_last = heightOver(nodes_.back(), point);
  Vector3d offset, tangent, u;
  double s = 0.0;
  if (over_first <= 0.0 || over_last >= 0.0) {
    const Frame& end = over_first <= 0.0 ? nodes_.front() : nodes_.back();
    const double beyond = over_first <= 0.0 ? over_first : over_last;
    s = end.s + beyond;
    tangent = end.tangent;
    u = end.u;
    offset = point - end.position - beyond * tangent;
  } else {
    const std::size_t segment = segmentOf(point);
    const Frame& low = nodes_[segment];
    const Frame& high = nodes_[segment + 1U];
    const double share = shareOfPlane(low, high, point);
    s = low.s + share * (high.s - low.s);
    tangent = low.tangent + share * (high.tangent - low.tangent);
    u = low.u + share * (high.u - low.u);
    offset = point - low.position - share * (high.position - low.position);
  }
  // Between nodes tangent and u are neither of unit length nor quite at right angles; across the
  // tangent only the length of u is off, which the angle does not feel.
  const double length = tangent.norm();
  const double along = offset.dot(tangent) / length;
  const double r = std::sqrt(std::max(offset.squaredNorm() - along * along, 0.0));
  outward = r > 0.0 ? Vector3d(offset / r) : u;
  return {std::atan2(tangent.cross(u).dot(offset), length * u.dot(offset)), s, r};
}

Vector3d StemFrame::roll(const UnrolledPoint& point) const {
  const Frame frame = at(point.s);
  return frame.position +
         point.r * (std::cos(point.theta) * frame.u + std::sin(point.theta) * frame.v);
}

}  // namespace field_phenotyping
