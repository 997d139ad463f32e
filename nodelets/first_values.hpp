#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>

#include "plant_table.hpp"

namespace field_phenotyping {

/// Tells the first values of a plant from those of one that a revision did not see and a later one
/// does again. Remembers the last kMostWithdrawn plants that went. Not thread-safe.
class FirstValues {
 public:
  static constexpr std::size_t kMostWithdrawn = 1000U;

  /// How many of the plants that a change has added had no values before.
  std::size_t countIn(const PlantTable::Change& change) {
    const auto had_none = [this](std::int32_t id) {
      return std::find(withdrawn_.begin(), withdrawn_.end(), id) == withdrawn_.end();
    };
    const auto first = std::count_if(change.added.begin(), change.added.end(), had_none);
    withdrawn_.insert(withdrawn_.end(), change.removed.begin(), change.removed.end());
    while (withdrawn_.size() > kMostWithdrawn) withdrawn_.pop_front();
    return static_cast<std::size_t>(first);
  }

 private:
  std::deque<std::int32_t> withdrawn_;  // the last one last
};

}  // namespace field_phenotyping
