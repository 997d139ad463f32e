#include "field_phenotyping/segmentation/plant_registry.hpp"

#include <cmath>
#include <set>

namespace field_phenotyping {

PlantRegistry::PlantRegistry(double match_radius) : match_radius_(match_radius) {}

PlantRegistry::Cell PlantRegistry::cellOf(const Eigen::Vector2d& base) const {
  return {static_cast<std::int64_t>(std::floor(base.x() / match_radius_)),
          static_cast<std::int64_t>(std::floor(base.y() / match_radius_))};
}

PlantRegistry::Entries::iterator PlantRegistry::findNearest(const Eigen::Vector2d& base,
                                                            const std::set<std::int32_t>& given) {
  const Cell center = cellOf(base);
  auto nearest = entries_.end();
  double nearest_distance = match_radius_;
  for (std::int64_t dx = -1; dx <= 1; ++dx) {
    for (std::int64_t dy = -1; dy <= 1; ++dy) {
      const auto range = entries_.equal_range({center.first + dx, center.second + dy});
      for (auto entry = range.first; entry != range.second; ++entry) {
        const double distance = (entry->second.base - base).norm();
        if (distance < nearest_distance && given.count(entry->second.id) == 0U) {
          nearest_distance = distance;
          nearest = entry;
        }
      }
    }
  }
  return nearest;
}

void PlantRegistry::identify(SegmentedBlock& block) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const BlockIndex index = block.header.index;
  for (auto& cell_and_entry : entries_) {
    Entry& entry = cell_and_entry.second;
    if (entry.owner == index) entry.claimed = false;
  }
  std::set<std::int32_t> given;  // two plants of one block are two, however near
  for (Plant& plant : block.plants) {
    if (!plant.owned) continue;
    Entry entry;
    entry.base = block.cloud.origin.head<2>() + plant.base.head<2>().cast<double>();
    entry.owner = index;
    entry.claimed = true;
    const auto known = findNearest(entry.base, given);
    if (known == entries_.end()) {
      entry.id = next_id_++;
    } else {
      entry.id = known->second.id;
      if (known->second.claimed) {
        plant.owned = false;
        continue;
      }
      entries_.erase(known);  // filed again under its newest base
    }
    plant.id = entry.id;
    given.insert(entry.id);
    entries_.emplace(cellOf(entry.base), entry);
  }
}

std::size_t PlantRegistry::size() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return entries_.size();
}

}  // namespace field_phenotyping
