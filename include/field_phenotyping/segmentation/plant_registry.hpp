#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <mutex>
#include <set>
#include <utility>

#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Gives each plant one id for as long as the map frame lasts: a plant found again near a known
/// base keeps its id through every revision of its block.
///
/// It also settles which block reports a plant. Two blocks that share a border both see the plants
/// on it, and may place a base on either side; the first block to claim such a plant keeps it until
/// it no longer finds it, so no plant is reported twice or lost. Thread-safe.
class PlantRegistry {
 public:
  /// A block may claim plants this far outside its tile [m].
  static constexpr double kBorderTolerance = 0.10;

  /// @param match_radius [m] two bases nearer than this are one plant
  explicit PlantRegistry(double match_radius = 0.06);

  /// Names the owned plants of `block`, each with an id of its own; plants that another block has
  /// claimed are marked as not owned.
  void identify(SegmentedBlock& block);

  /// Plants ever named.
  std::size_t size() const;

 private:
  using Cell = std::pair<std::int64_t, std::int64_t>;
  struct Entry {
    std::int32_t id = -1;
    Eigen::Vector2d base = Eigen::Vector2d::Zero();  // x, y in the map frame [m]
    BlockIndex owner;
    bool claimed = false;
  };
  using Entries = std::multimap<Cell, Entry>;

  Cell cellOf(const Eigen::Vector2d& base) const;
  Entries::iterator findNearest(const Eigen::Vector2d& base, const std::set<std::int32_t>& given);

  const double match_radius_;
  mutable std::mutex mutex_;
  Entries entries_;
  std::int32_t next_id_ = 0;
};

}  // namespace field_phenotyping
