#include "field_phenotyping/segmentation/stem_segments.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {

std::vector<StemSegment> splitStem(float length, const std::vector<float>& branchings) {
  constexpr float kBelow = 0.01F;  // [m] of a node's swelling below an organ
  constexpr float kAbove = 0.03F;  // [m] that an organ needs to leave the stem
  constexpr float kLongest = 0.10F;
  std::vector<StemSegment> stretches;
  float reached = 0.0F;
  const auto add = [&](float to, bool branching) {
    if (to - reached < 1e-3F) return;
    stretches.push_back({reached, to, branching});
    reached = to;
  };
  for (const float at : branchings) {
    const float begin = std::clamp(at - kBelow, reached, length);
    const float end = std::clamp(at + kAbove, reached, length);
    if (begin > reached || stretches.empty() || !stretches.back().branching) {
      add(begin, false);
      add(end, true);
    } else {
      stretches.back().end = end;
      reached = end;
    }
  }
  add(length, false);

  std::vector<StemSegment> segments;
  for (const StemSegment& stretch : stretches) {
    const int parts =
        std::max(1, static_cast<int>(std::ceil((stretch.end - stretch.begin) / kLongest)));
    const float part = (stretch.end - stretch.begin) / static_cast<float>(parts);
    for (int k = 0; k < parts; ++k) {
      const float begin = stretch.begin + part * static_cast<float>(k);
      segments.push_back({begin, begin + part, stretch.branching});
    }
  }
  return segments;
}

}  // namespace field_phenotyping
