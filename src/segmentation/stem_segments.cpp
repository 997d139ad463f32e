#include "field_phenotyping/segmentation/stem_segments.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr std::size_t kSectors = 8U;
using Sectors = std::array<float, kSectors>;

/// Points just outside the surface, by steps along the stem and sectors round it.
std::vector<Sectors> countAround(const std::vector<Eigen::Vector3f>& points,
                                 const std::vector<std::uint32_t>& members, const Midline& midline,
                                 float step) {
  constexpr float kReach = 0.025F;  // [m] beyond the stem's skin
  const float length = midline.axis.length();
  std::vector<Sectors> counts(static_cast<std::size_t>(length / step) + 1U, Sectors{});
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    const float beyond = at.distance - at.radius - 2.0F * midline.spread;
    if (at.arc_length < 0.0F || at.arc_length > length || beyond < 0.0F || beyond > kReach) {
      continue;
    }
    const Eigen::Vector3f away = points[i] - at.foot;
    const auto turn = static_cast<float>(0.5 + std::atan2(away.y(), away.x()) / (2.0 * M_PI));
    const auto sector = static_cast<std::size_t>(turn * static_cast<float>(kSectors)) % kSectors;
    counts[static_cast<std::size_t>(at.arc_length / step)][sector] += 1.0F;
  }
  return counts;
}

}  // namespace

std::vector<float> findBranchings(const std::vector<Eigen::Vector3f>& points,
                                  const std::vector<std::uint32_t>& members,
                                  const Midline& midline) {
  constexpr float kStep = 0.0125F;      // [m]
  constexpr std::size_t kWindow = 3U;   // steps compared
  constexpr float kLeastPoints = 4.0F;  // above
  constexpr float kLeastContrast = 4.0F;
  const std::vector<Sectors> counts = countAround(points, members, midline, kStep);
  std::vector<float> branchings;
  for (std::size_t k = kWindow; k + kWindow <= counts.size(); ++k) {
    bool begins = false;
    for (std::size_t sector = 0; sector < kSectors && !begins; ++sector) {
      float below = 0.0F;
      float above = 0.0F;
      for (std::size_t j = 0; j < kWindow; ++j) {
        below += counts[k - 1U - j][sector];
        above += counts[k + j][sector];
      }
      begins = above >= kLeastPoints && above + 1.0F >= kLeastContrast * (below + 1.0F);
    }
    if (begins) branchings.push_back(kStep * static_cast<float>(k));
  }
  return branchings;
}

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
