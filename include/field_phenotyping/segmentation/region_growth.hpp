#pragma once

#include <cstdint>
#include <vector>

#include "field_phenotyping/common/key_map.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/growing_surface.hpp"
#include "field_phenotyping/segmentation/leaf_bases.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/midline.hpp"

namespace field_phenotyping {

/// The cloud as growth sees it. Holds references; the arrays must outlive it.
struct GrowthScene {
  const std::vector<Eigen::Vector3f>& points;  ///< local frame [m]
  const std::vector<LocalShape>& shapes;       ///< of each point
  const NeighborGrid& grid;                    ///< over the points
};

/// The parameters that the paper adapts while a stem grows (Eq 11-14).
struct GrowthSettings {
  float r1 = 0.0F;     ///< growth radius [m]
  float M = 0.0F;      ///< similarity threshold
  float alpha = 0.0F;  ///< weights of Eq 2
  float beta = 0.0F;
  int max_steps = 0;

  GrowthSettings() = default;
  explicit GrowthSettings(const SegmentationParameters& parameters);
};

/// What the growth of one region gave.
struct GrowthRegion {
  Eigen::Vector3f start = Eigen::Vector3f::Zero();  ///< its start point s_0 [m]
  Eigen::Vector3f end = Eigen::Vector3f::Zero();    ///< its end point s_n [m]
  std::vector<std::uint32_t> points;                ///< that joined, ascending
  std::uint32_t steps = 0U;
};

/// Points within about `radius` [m] of an axis, its ends included; ascending.
std::vector<std::uint32_t> pointsAround(const GrowthScene& scene, const StemAxis& axis,
                                        float radius);

/// How alike point `i` is to the stem that `midline` describes, in [0, 1]: distance to the stem's
/// surface, normal across the axis, upright shape. Compared with M.
float similarity(const GrowthScene& scene, std::uint32_t i, const Midline& midline);
/// The same where it is known how the point lies to the axis.
float similarity(const LocalShape& shape, const StemAxis::Projection& at, float spread);

/// The cloud with one stem's midline in it, and where leaves leave it, as far as that is known.
/// Remembers how the points lie about that stem: the spheres of its growth overlap, and it is
/// grown again and again. Not thread-safe.
class StemScene {
 public:
  StemScene(const GrowthScene& scene, Midline midline, LeafBases leaf_bases = {});
  const GrowthScene& cloud() const { return cloud_; }
  const Midline& midline() const { return midline_; }
  /// As similarity(), times the probability that the point is no leaf base's.
  float similarityOf(std::uint32_t i) const { return placeOf(i).similarity; }
  /// Where point `i` lies about the midline.
  SurfaceSighting sightingOf(std::uint32_t i) const { return placeOf(i).sighting; }

 private:
  struct Place {
    float similarity = 0.0F;
    SurfaceSighting sighting;
  };
  Place placeOf(std::uint32_t i) const;

  GrowthScene cloud_;
  Midline midline_;
  LeafBases leaf_bases_;
  mutable KeyMap<Place> known_;
};

/// Grows one constrained region from `start` towards `end` (paper 2.4.1, Step 2, Eq 1-5): a sphere
/// of radius r1 walks up the stem; points inside that are similar to it by M or more join. Stops
/// past `end` or after max_steps.
GrowthRegion growRegion(const StemScene& scene, const Eigen::Vector3f& start,
                        const Eigen::Vector3f& end, const GrowthSettings& settings);

}  // namespace field_phenotyping
