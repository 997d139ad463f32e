#pragma once

#include <Eigen/Core>
#include <cmath>
#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"

namespace field_phenotyping {

/// Start points s_0 ... s_n up one stem (paper 2.4.1, Step 1), found without help: the places where
/// points form an upright line, slab by slab, followed upwards through gaps.
struct StemSeeds {
  std::vector<Eigen::Vector3f> points;  ///< from low to high, local frame [m]; at least two
  float score = 0.0F;  ///< stem evidence: about the number of slabs that show the stem
};

/// What makes a point a vote for a stem.
enum class SeedEvidence {
  kUpright,  ///< its neighbourhood is a line that stands up
  kDensity,  ///< that it is there: for stems too sparse or too hidden to show a shape
};

/// How the stems of a stand lean: as horizontal shift per metre of height.
struct StandLean {
  Eigen::Vector2f slope = Eigen::Vector2f::Zero();
  float scatter = 0.0F;  ///< standard deviation of either component; 0: not known
  bool known() const { return scatter > 0.0F; }

  /// How far a slope is from the stand's, in standard deviations; `error`: that of the slope
  /// itself.
  float deviation(const Eigen::Vector2f& of, float error) const {
    return known() ? (of - slope).norm() / std::hypot(scatter, error) : 0.0F;
  }
};

/// What every point says for a stem by the shape of its neighbourhood: its weight in (0, 1], or 0.
/// @param grid   over the points of `block.cloud`
/// @param shapes local shape of every point of `block.cloud`
std::vector<float> uprightWeights(const Block& block, const NeighborGrid& grid,
                                  const std::vector<LocalShape>& shapes,
                                  const SegmentationParameters& parameters);

/// Finds candidates for the stems of a block. Leaves at stem height, weeds and gaps are survived
/// because evidence must persist vertically: a stem is the best-supported chain of clusters of
/// votes over the slabs. Some candidates are leaves; what grows from them shows it (StemSelection).
/// Best-supported first.
/// @param shapes    local shape of every point of `block.cloud`
/// @param upright   of uprightWeights()
/// @param lean      of the stand: where points are few it tells a stem from a step to the next one
/// @param explained points to leave out, 1 each; empty: none
/// @param most      candidates
std::vector<StemSeeds> findStemSeeds(const Block& block, const std::vector<LocalShape>& shapes,
                                     const std::vector<float>& upright,
                                     const SegmentationParameters& parameters,
                                     SeedEvidence evidence, const StandLean& lean = {},
                                     const std::vector<std::uint8_t>& explained = {},
                                     std::size_t most = 1000U);

}  // namespace field_phenotyping
