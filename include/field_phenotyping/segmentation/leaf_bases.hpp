#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/segmentation/leaf_search_team.hpp"
#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// The leaf bases of one stem, and which points near its surface are theirs.
///
/// Within the first centimetres a leaf lies closer to the stem than the noise of a point, so that
/// no distance tells them apart. What tells is the leaf farther out: carried back to the surface it
/// says where the leaf begins, and from there on it hides the stem on its side.
class LeafBases {
 public:
  LeafBases() = default;

  /// Finds them: sheets of points that rise from the surface and leave it at one place, with the
  /// surface hidden behind them. Greedy by evidence.
  /// Deterministic; thread-safe.
  /// @param points  local frame [m]
  /// @param members indices of the points within about `kReach` of the surface, those of leaves
  /// included
  LeafBases(const std::vector<Eigen::Vector3f>& points, const std::vector<std::uint32_t>& members,
            const Midline& midline);
  /// @param spread noise of the midline's surface [m]
  LeafBases(std::vector<LeafBase> bases, float spread);

  /// Distance beyond the surface that shows leaves [m].
  static constexpr float kReach = leaf::kReach;

  /// Radius about the midline within which points are of use [m].
  static float reachOf(const Midline& midline);

  /// By arc length.
  const std::vector<LeafBase>& all() const { return bases_; }
  std::vector<float> arcLengths() const;
  /// Noise of the surface that they were found about [m].
  float spread() const { return spread_; }

  /// Probability that a point near the surface is a leaf base's rather than the stem's, [0, 1].
  float leafShare(const Eigen::Vector3f& point, const StemAxis& axis) const;

 private:
  std::vector<LeafBase> bases_;
  float spread_ = 0.0F;
};

/// The leaf bases of many stems at once, on all cores or, a thread block each, on the GPU, with the
/// same bits. Thread-safe.
/// @param members, midlines of each stem, as for LeafBases; not null
std::vector<LeafBases> findLeafBases(const std::vector<Eigen::Vector3f>& points,
                                     const std::vector<std::vector<std::uint32_t>>& members,
                                     const std::vector<const Midline*>& midlines,
                                     const ComputeDevice& device);

}  // namespace field_phenotyping
