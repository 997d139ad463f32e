#include "plant_table.hpp"

#include <algorithm>

namespace field_phenotyping {

PlantTable::Change PlantTable::update(const BlockIndex& block, std::uint32_t revision,
                                      const std::vector<Phenotype>& plants) {
  Known& known = blocks_[block];
  if (revision < known.revision) return {};
  known.revision = revision;

  std::vector<std::int32_t> ids;
  for (const Phenotype& plant : plants) {
    plants_[plant.id] = {plant, block};
    ids.push_back(plant.id);
  }
  Change change;
  change.accepted = true;
  for (const std::int32_t id : known.ids) {
    if (std::find(ids.begin(), ids.end(), id) != ids.end()) continue;
    const auto entry = plants_.find(id);
    if (entry == plants_.end() || !(entry->second.block == block)) continue;
    plants_.erase(entry);
    change.removed.push_back(id);
  }
  known.ids = std::move(ids);
  return change;
}

std::vector<Phenotype> PlantTable::plants() const {
  std::vector<Phenotype> all;
  all.reserve(plants_.size());
  for (const auto& entry : plants_) all.push_back(entry.second.plant);
  return all;
}

}  // namespace field_phenotyping
