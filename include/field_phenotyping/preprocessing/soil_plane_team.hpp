#pragma once

#include <cstdint>

#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

// The RANSAC score of estimateGround(), for a team of threads (see team.hpp), on the CPU and on the
// GPU.

/// z = a x + b y + c, local frame [m].
struct SoilPlane {
  float a = 0.0F;
  float b = 0.0F;
  float c = 0.0F;

  FIELD_PHENOTYPING_HD float heightAt(float x, float y) const { return a * x + b * y + c; }
};

/// Points that may be soil, coordinate by coordinate [m]; kLanes values beyond the last can be
/// read.
struct SoilCandidates {
  const float* x;
  const float* y;
  const float* z;
  std::uint32_t count;
};

/// How good a soil plane is: many cells' lowest points lie on it and few lie below. All members get
/// the same.
/// @param tolerance [m]
/// @param scratch as many numbers as the team has groups; all members see the same memory
template <class Team>
FIELD_PHENOTYPING_HD int scorePlane(const Team& team, const SoilPlane& plane,
                                    const SoilCandidates& points, float tolerance, int* scratch) {
  const auto lanes = team.lanes();
  int on_plane = 0;
  int not_below = 0;
  int seen = 0;
  const std::uint32_t stride = team.groups() * static_cast<std::uint32_t>(kLanes);
  for (std::uint32_t k = team.group() * static_cast<std::uint32_t>(kLanes); k < points.count;
       k += stride) {
    const auto height = lanes.all(plane.a) * lanes.load(points.x, k, points.count) +
                        lanes.all(plane.b) * lanes.load(points.y, k, points.count) +
                        lanes.all(plane.c);
    const auto residual = lanes.load(points.z, k, points.count) - height;
    const auto there = lanes.before(k, points.count);
    const auto above_low = lanes.both(there, lanes.atMost(lanes.all(-tolerance), residual));
    on_plane += static_cast<int>(
        lanes.count(lanes.both(above_low, lanes.atMost(residual, lanes.all(tolerance)))));
    not_below += static_cast<int>(lanes.count(above_low));
    seen += static_cast<int>(lanes.count(there));
  }
  constexpr int kBelowPenalty = 3;
  return teamSum(team, on_plane - kBelowPenalty * (seen - not_below), scratch);
}

}  // namespace field_phenotyping
