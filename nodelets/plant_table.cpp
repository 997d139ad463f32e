#include "plant_table.hpp"

#include <algorithm>

#include "field_phenotyping/measurement/pass_fusion.hpp"

namespace field_phenotyping {
namespace {

/// Blocks are begun and left at times of their own, but in one pass these overlap.
bool ofOnePass(const ReportSource& a, const ReportSource& b) {
  return a.began_ns <= b.stamp_ns && b.began_ns <= a.stamp_ns;
}

}  // namespace

PlantTable::Change PlantTable::update(const ReportSource& source,
                                      const std::vector<Phenotype>& plants) {
  const auto [found, first] = reports_.try_emplace({source.block, source.began_ns});
  Known& known = found->second;
  const std::pair<std::uint64_t, std::uint32_t> newest{known.stamp_ns, known.revision};
  if (!first && std::make_pair(source.stamp_ns, source.revision) < newest) return {};
  known.stamp_ns = source.stamp_ns;
  known.revision = source.revision;

  std::vector<std::int32_t> ids;
  for (const Phenotype& plant : plants) {
    put(source, plant);
    ids.push_back(plant.id);
  }
  Change change;
  change.accepted = true;
  for (const std::int32_t id : known.ids) {
    if (std::find(ids.begin(), ids.end(), id) != ids.end()) continue;
    if (takeBack(source, id)) change.removed.push_back(id);
  }
  known.ids = std::move(ids);
  return change;
}

void PlantTable::put(const ReportSource& source, const Phenotype& plant) {
  const auto [found, first] = plants_.try_emplace(plant.id);
  Entry& entry = found->second;
  // What was seen of it after this report is not undone.
  const bool outdated =
      std::any_of(entry.passes.begin(), entry.passes.end(), [&](const Record& record) {
        return ofOnePass(record.source, source) && record.source.stamp_ns > source.stamp_ns;
      });
  if (outdated) return;
  entry.passes.erase(
      std::remove_if(entry.passes.begin(), entry.passes.end(),
                     [&](const Record& record) { return ofOnePass(record.source, source); }),
      entry.passes.end());
  const auto later =
      std::find_if(entry.passes.begin(), entry.passes.end(),
                   [&](const Record& record) { return record.source.began_ns > source.began_ns; });
  entry.passes.insert(later, {source, plant});
  if (!first) by_block_[entry.block].erase(plant.id);
  entry.block = source.block;
  by_block_[entry.block].insert(plant.id);
  fuseAgain(entry);
}

/// @return whether nothing is left of the plant
bool PlantTable::takeBack(const ReportSource& source, std::int32_t id) {
  const auto found = plants_.find(id);
  if (found == plants_.end()) return false;
  Entry& entry = found->second;
  entry.passes.erase(std::remove_if(entry.passes.begin(), entry.passes.end(),
                                    [&](const Record& record) {
                                      return record.source.block == source.block &&
                                             record.source.began_ns == source.began_ns;
                                    }),
                     entry.passes.end());
  if (!entry.passes.empty()) {
    fuseAgain(entry);
    return false;
  }
  by_block_[entry.block].erase(id);
  plants_.erase(found);
  return true;
}

void PlantTable::fuseAgain(Entry& entry) {
  std::vector<Phenotype> passes;
  for (const Record& record : entry.passes) passes.push_back(record.plant);
  entry.fused = fusePasses(passes);
}

std::vector<Phenotype> PlantTable::plants() const {
  std::vector<Phenotype> all;
  all.reserve(plants_.size());
  for (const auto& entry : plants_) all.push_back(entry.second.fused);
  return all;
}

std::vector<Phenotype> PlantTable::plantsOf(const BlockIndex& block) const {
  std::vector<Phenotype> plants;
  const auto ids = by_block_.find(block);
  if (ids == by_block_.end()) return plants;
  for (const std::int32_t id : ids->second) plants.push_back(plants_.at(id).fused);
  return plants;
}

std::vector<KnownPlant> PlantTable::known() const {
  std::vector<KnownPlant> known;
  for (const auto& [id, entry] : plants_) {
    known.push_back({id, entry.fused.base.head<2>(), entry.passes.back().source.stamp_ns});
  }
  return known;
}

}  // namespace field_phenotyping
