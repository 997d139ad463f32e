#pragma once

#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/midline.hpp"
#include "field_phenotyping/segmentation/stem_seeds.hpp"

namespace field_phenotyping {

/// What the sensor shows of the canopy round every place of a block: how high it stands, and how
/// dark it is inside. Counts points in coarse columns; every answer takes in the neighbouring ones.
class Canopy {
 public:
  explicit Canopy(const Block& block);
  /// Above the soil [m]; 0 where there are no points.
  float heightAround(const Eigen::Vector3f& point) const;
  /// How much of what stands at a point's height the sensor sees, from 0 (hidden by the canopy
  /// above) to 1: the points there, against those of the height that shows most.
  float lightAround(const Eigen::Vector3f& point) const;

 private:
  struct Column {
    float height = 0.0F;
    std::vector<std::uint32_t> counts;  // by height above the soil

    void add(const Column& other);
  };
  using Columns = std::map<std::pair<int, int>, Column>;

  template <class Visit>
  void forEachAround(const Eigen::Vector3f& point, Visit&& visit) const;

  const GroundModel& ground_;
  Columns columns_;
};

/// A grown stem that may be a leaf, a weed, or a plant that another candidate has found as well.
struct StemCandidate {
  const Midline& midline;  ///< from the soil to the top of the stem
  const std::vector<std::uint32_t>&
      points;  ///< that grew, ascending indices into the block's cloud
};

/// Factor on the merit of a stem that the odds of its place (RowModel) are worth: merit is no
/// probability, and a place alone makes no stem.
float meritOfOdds(double odds);

/// What good ones of a stand usually have: of those with at least 0.3 of the best the middle one.
/// @param merits of one at least, the best first
float usualOf(const std::vector<float>& merits);

/// Horizontal shift per metre of height between the ends of a stem.
Eigen::Vector2f slopeOf(const StemAxis& axis);

/// How the stems lean that axes describe; not known from a few.
StandLean leanOf(const std::vector<StemAxis>& stems);

/// Tells the stems of a block from leaves, weeds and plants found twice.
///
/// Seeds are generous, for only a grown stem shows what it is: one that runs from the soil up
/// without long gaps, with much more evidence for its height than leaves and noise give. How much
/// that is depends on the sensor, so every candidate is measured against the block's best. Of two
/// candidates that share points, or that stand nearer than min_plant_spacing, the better stays.
///
/// Refers to block, grid and parameters, which must outlive it. Thread-safe; deterministic.
class StemSelection {
 public:
  /// @param grid over the points of `block.cloud`
  StemSelection(const Block& block, const NeighborGrid& grid,
                const SegmentationParameters& parameters);

  const Canopy& canopy() const { return canopy_; }

  /// Which candidates are stems; ascending indices.
  std::vector<std::size_t> stemsAmong(const std::vector<StemCandidate>& candidates) const;

 private:
  const Block& block_;
  const NeighborGrid& grid_;
  const SegmentationParameters& parameters_;
  Canopy canopy_;
};

}  // namespace field_phenotyping
