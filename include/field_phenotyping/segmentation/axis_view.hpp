#pragma once

#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

// Products of three numbers, added in the order that Eigen adds them in.

FIELD_PHENOTYPING_HD inline float dotOf(const Place& a, const Place& b) {
  return a.x * b.x + (a.y * b.y + a.z * b.z);
}
FIELD_PHENOTYPING_HD inline Place differenceOf(const Place& a, const Place& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
/// a + t * b
FIELD_PHENOTYPING_HD inline Place movedAlong(const Place& a, float t, const Place& b) {
  return {a.x + t * b.x, a.y + t * b.y, a.z + t * b.z};
}

/// A node of a stem's axis.
struct AxisNode {
  Place position;  ///< [m]
  float radius;    ///< of the stem there [m]
};

/// Where a point lies relative to an axis; as StemAxis::Projection.
struct AxisProjection {
  float arc_length;  ///< along the axis from its base; < 0 below it, > its length above it [m]
  float distance;    ///< from the axis, the ends being extended straight [m]
  float radius;      ///< of the stem at that height [m]
  Place foot;        ///< nearest point of the axis
  Place direction;   ///< of the axis there, upwards
};

/// A StemAxis wherever it lies in memory, for code that runs on the GPU too. All pointers are of
/// the machine that the calls are made on.
struct AxisView {
  const AxisNode* nodes = nullptr;
  const float* arc_lengths = nullptr;  ///< of the nodes [m]
  const Place* directions = nullptr;   ///< of the segments, of length 1
  int segments = 0;                    ///< one less than the nodes
  bool rising = false;                 ///< every node is higher than the one before
  float segments_per_metre = 0.0F;     ///< of height

  FIELD_PHENOTYPING_HD float length() const { return arc_lengths[segments]; }

  FIELD_PHENOTYPING_HD float radiusAt(float s, int i) const {
    const float along = (s - arc_lengths[i]) / (arc_lengths[i + 1] - arc_lengths[i]);
    const float share = along < 0.0F ? 0.0F : along > 1.0F ? 1.0F : along;
    return (1.0F - share) * nodes[i].radius + share * nodes[i + 1].radius;
  }

  FIELD_PHENOTYPING_HD AxisProjection project(const Place& point) const {
    float least = 3.402823466e+38F;  // squared distance
    int nearest = 0;
    float along = 0.0F;  // the nearest segment
    const int last = segments - 1;
    const auto look = [&](int i) {
      const Place& direction = directions[i];
      const Place away = differenceOf(point, nodes[i].position);
      float t = dotOf(direction, away);
      if (i > 0 && t < 0.0F) t = 0.0F;
      if (i < last) {
        const float end = arc_lengths[i + 1] - arc_lengths[i];
        if (end < t) t = end;
      }
      const Place off = movedAlong(away, -t, direction);
      const float squared = dotOf(off, off);
      if (squared < least) {
        least = squared;
        nearest = i;
        along = t;
      }
    };
    const auto mayBeNearer = [&](float apart) { return apart <= 0.0F || apart * apart <= least; };
    if (rising) {
      // Outwards from the point's own height, until no segment can be nearer.
      const int middle = segmentAtHeight(point.z);
      look(middle);
      for (int i = middle + 1; i <= last && mayBeNearer(nodes[i].position.z - point.z); ++i) {
        look(i);
      }
      for (int i = middle; i > 0 && mayBeNearer(point.z - nodes[i].position.z); --i) look(i - 1);
    } else {
      for (int i = 0; i <= last; ++i) look(i);
    }
    AxisProjection best;
    best.direction = directions[nearest];
    best.foot = movedAlong(nodes[nearest].position, along, best.direction);
    const Place off = differenceOf(point, best.foot);
    best.distance = std::sqrt(dotOf(off, off));
    best.arc_length = arc_lengths[nearest] + along;
    best.radius = radiusAt(best.arc_length, nearest);
    return best;
  }

 private:
  /// The highest segment that begins at that height or below, else the first. Of a rising axis.
  FIELD_PHENOTYPING_HD int segmentAtHeight(float z) const {
    // Nodes are about as far from one another, so that the first guess is near.
    const int last = segments - 1;
    const float guess = (z - nodes[0].position.z) * segments_per_metre;
    const auto highest = static_cast<float>(last);
    int i = guess > 0.0F ? static_cast<int>(guess < highest ? guess : highest) : 0;
    while (i < last && nodes[i + 1].position.z <= z) ++i;
    while (i > 0 && nodes[i].position.z > z) --i;
    return i;
  }
};

}  // namespace field_phenotyping
