#pragma once

#include <cstddef>
#include <cstdint>

#include "field_phenotyping/common/team.hpp"

// The outermost points of a plant in height, which its height is taken from (paper 2.7), for a team
// of threads (see team.hpp), on the CPU and on the GPU: the same whatever the team.

namespace field_phenotyping {

/// Points of a plant, and which of its ends is looked for.
struct PlantEndTask {
  std::uint32_t begin = 0U;  ///< first point
  std::uint32_t end = 0U;    ///< behind the last
  float upwards = 1.0F;      ///< 1: the top; -1: the bottom
};

/// The outermost heights at one end, the outermost first; each times PlantEndTask::upwards [m].
struct OutermostHeights {
  static constexpr int kMost = 8;

  float heights[kMost];
  int count;

  FIELD_PHENOTYPING_HD void clear() { count = 0; }
  FIELD_PHENOTYPING_HD void take(float height) {
    if (count == kMost && !(height > heights[kMost - 1])) return;
    int at = count < kMost ? count++ : kMost - 1;
    for (; at > 0 && height > heights[at - 1]; --at) heights[at] = heights[at - 1];
    heights[at] = height;
  }
};

/// Finds those of one end.
/// @param xyz    of the points of all plants, x y z x y z ..., local frame [m]
/// @param found  one for each member of the team, which all members see; the first is the result,
///               which all members may read
template <class Team>
FIELD_PHENOTYPING_HD void findOutermostHeights(const Team& team, const PlantEndTask& task,
                                               const float* xyz, OutermostHeights* found) {
  OutermostHeights own;
  own.clear();
  for (std::uint32_t i = task.begin + team.rank(); i < task.end; i += team.size()) {
    own.take(task.upwards * xyz[3U * static_cast<std::size_t>(i) + 2U]);
  }
  found[team.rank()] = own;
  team.sync();
  for (unsigned apart = 1U; apart < team.size(); apart *= 2U) {
    const unsigned other = team.rank() + apart;
    if (team.rank() % (2U * apart) == 0U && other < team.size()) {
      for (int k = 0; k < found[other].count; ++k) found[team.rank()].take(found[other].heights[k]);
    }
    team.sync();
  }
}

}  // namespace field_phenotyping
