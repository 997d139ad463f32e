#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// An organ that leaves a stem: a leaf, an ear, a tassel branch.
struct LeafBase {
  float arc_length = 0.0F;  ///< where its midrib meets the stem's surface, along the midline [m]
  float azimuth = 0.0F;     ///< which way it leaves, about the midline, from x towards y [rad]
  float slope = 0.0F;       ///< metres outwards per metre along the stem
  float evidence = 0.0F;    ///< log likelihood gained by an organ there
  float sight = 1.0F;       ///< how much more of the stem is seen behind it than behind most leaves
};

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

  /// Distance beyond the surface that shows leaves [m].
  static constexpr float kReach = 0.025F;

  /// Radius about the midline within which points are of use [m].
  static float reachOf(const Midline& midline);

  /// By arc length.
  const std::vector<LeafBase>& all() const { return bases_; }
  std::vector<float> arcLengths() const;

  /// Probability that a point near the surface is a leaf base's rather than the stem's, [0, 1].
  float leafShare(const Eigen::Vector3f& point, const StemAxis& axis) const;

 private:
  std::vector<LeafBase> bases_;
  float spread_ = 0.0F;
};

}  // namespace field_phenotyping
