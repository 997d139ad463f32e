#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <string>
#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"

namespace field_phenotyping {

/// Blocks in which no plant was found, to tell people why. Not thread-safe.
class FruitlessBlocks {
 public:
  /// @param header of the block, or of one of the tiles that it is joined of
  /// @param points above the soil, in the frame that `ground` is in [m]
  /// @param tiles  that it is joined of
  void add(const BlockHeader& header, const std::vector<Eigen::Vector3f>& points,
           const GroundModel& ground, const SegmentationParameters& parameters,
           std::size_t tiles = 1U);

  /// Tiles that were added.
  std::size_t count() const { return tiles_; }

  /// What may be wrong and what to do, in a sentence.
  std::string reason(const SegmentationParameters& parameters) const;

 private:
  std::size_t tiles_ = 0U;
  std::size_t with_soil_ = 0U;
  std::size_t points_ = 0U;          // above the soil
  std::size_t points_in_band_ = 0U;  // at heights where seeds are looked for
  double area_ = 0.0;                // [m^2] that points lie on
};

}  // namespace field_phenotyping
