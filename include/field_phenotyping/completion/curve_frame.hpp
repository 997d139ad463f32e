#pragma once

#include <cmath>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"

// The curved axis of a stem with a rotation-minimising frame, as StemFrame has it, for the CPU and
// the GPU: templates over the vector, Eigen's Vector3d or Vector3.

namespace field_phenotyping {

/// A point of the axis and the right-handed orthonormal frame (u, v, tangent) there.
template <class Vector>
struct CurveFrame {
  Vector position = Vector(0.0, 0.0, 0.0);
  Vector tangent = Vector(0.0, 0.0, 1.0);
  Vector u = Vector(1.0, 0.0, 0.0);
  Vector v = Vector(0.0, 1.0, 0.0);
  double s = 0.0;  ///< arc length [m]
};

/// A point beside the axis. Between nodes tangent and u are neither of unit length nor quite at
/// right angles; across the tangent only the length of u is off, which the angle does not feel.
template <class Vector>
struct BesideCurve {
  Vector offset;   ///< from the axis
  Vector tangent;  ///< of the axis there
  Vector u;        ///< of its frame
  double s;        ///< arc length [m]; < 0 before its start
  double r;        ///< distance from the axis [m]

  /// The angle round the axis from u towards v is that of (cosine(), sine()), whatever their
  /// length.
  FIELD_PHENOTYPING_HD double cosine() const { return tangent.norm() * u.dot(offset); }
  FIELD_PHENOTYPING_HD double sine() const { return Vector(tangent.cross(u)).dot(offset); }
};

template <class Vector>
FIELD_PHENOTYPING_HD void completeFrame(CurveFrame<Vector>& frame, const Vector& u) {
  frame.u = Vector(u - u.dot(frame.tangent) * frame.tangent).normalized();
  frame.v = frame.tangent.cross(frame.u);
}

/// Position and tangent of a node; instead of the arc length, its distance from the node before it.
/// @param curve points along the axis, two or more
template <class Vector>
FIELD_PHENOTYPING_HD void placeNode(const Vector* curve, int count, int i,
                                    CurveFrame<Vector>& node) {
  const Vector& before = curve[i > 0 ? i - 1 : 0];
  const Vector& after = curve[i + 1 < count ? i + 1 : i];
  node.position = curve[i];
  node.s = i > 0 ? Vector(curve[i] - before).norm() : 0.0;
  // A curve that folds back on itself has no central difference: then it is 0.
  node.tangent = Vector(after - before).normalized();
}

/// What placeNode() has left of a node, from the complete one before it, without turning the frame
/// about the axis (double reflection).
template <class Vector>
FIELD_PHENOTYPING_HD void carryOn(const CurveFrame<Vector>& before, CurveFrame<Vector>& node) {
  node.s = before.s + node.s;
  if (!(node.tangent.squaredNorm() > 0.0)) node.tangent = before.tangent;
  const Vector chord = node.position - before.position;
  const double c1 = chord.squaredNorm();
  const Vector u = before.u - 2.0 / c1 * chord.dot(before.u) * chord;
  const Vector tangent = before.tangent - 2.0 / c1 * chord.dot(before.tangent) * chord;
  const Vector difference = node.tangent - tangent;
  const double c2 = difference.squaredNorm();
  completeFrame(node, c2 > 0.0 ? Vector(u - 2.0 / c2 * difference.dot(u) * difference) : u);
}

/// What placeNode() has left of the first node: u is x for anything near upright, so that the angle
/// means the same on every stem.
template <class Vector>
FIELD_PHENOTYPING_HD void startFrame(CurveFrame<Vector>& node) {
  constexpr double kFlat = 0.9;
  const Vector reference =
      magnitudeOf(node.tangent.x()) < kFlat ? Vector(1.0, 0.0, 0.0) : Vector(0.0, 1.0, 0.0);
  completeFrame(
      node, Vector(Vector(reference - reference.dot(node.tangent) * node.tangent).normalized()));
}

/// Of a point over the plane across the axis.
template <class Vector>
FIELD_PHENOTYPING_HD double heightOver(const CurveFrame<Vector>& frame, const Vector& point) {
  return Vector(point - frame.position).dot(frame.tangent);
}

/// Where between two nodes the plane across the axis holds `point`, which lies between their
/// planes: the height over the plane is quadratic in the share, once the tangent is not normalised.
template <class Vector>
FIELD_PHENOTYPING_HD double shareOfPlane(const CurveFrame<Vector>& low,
                                         const CurveFrame<Vector>& high, const Vector& point) {
  const Vector offset = point - low.position;
  const Vector step = high.position - low.position;
  const Vector turn = high.tangent - low.tangent;
  const double constant = offset.dot(low.tangent);
  const double linear = offset.dot(turn) - step.dot(low.tangent);
  const double quadratic = -step.dot(turn);
  double share = constant / (constant - heightOver(high, point));
  constexpr int kNewtonSteps = 2;
  for (int i = 0; i < kNewtonSteps; ++i) {
    const double slope = linear + 2.0 * quadratic * share;
    if (!(slope < 0.0)) break;
    share -= (constant + share * (linear + quadratic * share)) / slope;
  }
  return share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
}

/// Number of the lower node of the segment that a point between the ends lies beside.
template <class Vector>
FIELD_PHENOTYPING_HD int segmentOf(const CurveFrame<Vector>* nodes, int count,
                                   const Vector& point) {
  const Vector chord = nodes[count - 1].position - nodes[0].position;
  const int last = count - 2;
  const double share = Vector(point - nodes[0].position).dot(chord) / chord.squaredNorm();
  const double guess = share * (last + 1);
  // A stem is nearly straight, so that few steps lead from the guess to the segment.
  int segment = guess > 0.0 ? static_cast<int>(guess < last ? guess : last) : 0;
  while (segment > 0 && heightOver(nodes[segment], point) <= 0.0) --segment;
  while (segment < last && heightOver(nodes[segment + 1], point) > 0.0) ++segment;
  return segment;
}

/// The axis is straight beyond its ends.
/// @param nodes complete; two or more
template <class Vector>
FIELD_PHENOTYPING_HD BesideCurve<Vector> besideCurve(const CurveFrame<Vector>* nodes, int count,
                                                     const Vector& point) {
  const CurveFrame<Vector>& first = nodes[0];
  const CurveFrame<Vector>& last = nodes[count - 1];
  const double over_first = heightOver(first, point);
  const double over_last = heightOver(last, point);
  BesideCurve<Vector> beside;
  if (over_first <= 0.0 || over_last >= 0.0) {
    const CurveFrame<Vector>& end = over_first <= 0.0 ? first : last;
    const double beyond = over_first <= 0.0 ? over_first : over_last;
    beside.s = end.s + beyond;
    beside.tangent = end.tangent;
    beside.u = end.u;
    beside.offset = point - end.position - beyond * beside.tangent;
  } else {
    const int segment = segmentOf(nodes, count, point);
    const CurveFrame<Vector>& low = nodes[segment];
    const CurveFrame<Vector>& high = nodes[segment + 1];
    const double share = shareOfPlane(low, high, point);
    beside.s = low.s + share * (high.s - low.s);
    beside.tangent = low.tangent + share * (high.tangent - low.tangent);
    beside.u = low.u + share * (high.u - low.u);
    beside.offset = point - low.position - share * (high.position - low.position);
  }
  const double along = beside.offset.dot(beside.tangent) / beside.tangent.norm();
  const double square = beside.offset.squaredNorm() - along * along;
  beside.r = std::sqrt(square > 0.0 ? square : 0.0);
  return beside;
}

/// Number of the node at or before an arc length between the ends.
template <class Vector>
FIELD_PHENOTYPING_HD int nodeBefore(const CurveFrame<Vector>* nodes, int count, double s) {
  int low = 1;
  int high = count - 1;
  while (low < high) {
    const int middle = low + (high - low) / 2;
    if (s < nodes[middle].s) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  return low - 1;
}

/// The frame at an arc length, straight on beyond the ends.
template <class Vector>
FIELD_PHENOTYPING_HD CurveFrame<Vector> frameAt(const CurveFrame<Vector>* nodes, int count,
                                                double s) {
  const double length = nodes[count - 1].s;
  if (s <= 0.0 || s >= length) {
    CurveFrame<Vector> frame = s <= 0.0 ? nodes[0] : nodes[count - 1];
    frame.position += (s - frame.s) * frame.tangent;
    frame.s = s;
    return frame;
  }
  const int segment = nodeBefore(nodes, count, s);
  const CurveFrame<Vector>& low = nodes[segment];
  const CurveFrame<Vector>& high = nodes[segment + 1];
  const double share = (s - low.s) / (high.s - low.s);
  CurveFrame<Vector> frame;
  frame.position = (1.0 - share) * low.position + share * high.position;
  frame.tangent = Vector((1.0 - share) * low.tangent + share * high.tangent).normalized();
  frame.s = (1.0 - share) * low.s + share * high.s;
  completeFrame(frame, Vector((1.0 - share) * low.u + share * high.u));
  return frame;
}

}  // namespace field_phenotyping
