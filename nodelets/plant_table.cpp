#include "plant_table.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "field_phenotyping/measurement/pass_fusion.hpp"

namespace field_phenotyping {
namespace {

/// Blocks are begun and left at times of their own, but in one pass these overlap.
bool ofOnePass(const ReportSource& a, const ReportSource& b) {
  return a.began_ns <= b.stamp_ns && b.began_ns <= a.stamp_ns;
}

bool isNewer(const ReportSource& a, const ReportSource& b) {
  return a.stamp_ns != b.stamp_ns ? a.stamp_ns > b.stamp_ns : a.revision > b.revision;
}

}  // namespace

PlantTable::Change PlantTable::update(const ReportSource& source,
                                      const std::vector<Phenotype>& plants) {
  // What was said of the block in the same pass, by this process or one before it.
  std::vector<Said> earlier;
  std::vector<Said>& said = reports_[source.block];
  for (const Said& other : said) {
    if (!ofOnePass(other.source, source)) continue;
    if (isNewer(other.source, source)) return {};
    earlier.push_back(other);
  }
  said.erase(std::remove_if(said.begin(), said.end(),
                            [&](const Said& other) { return ofOnePass(other.source, source); }),
             said.end());
  said.push_back({source, {}});
  Change change;
  change.accepted = true;
  for (const Phenotype& plant : plants) {
    if (plants_.count(plant.id) == 0U) change.added.push_back(plant.id);
    put(source, plant);
    said.back().ids.insert(plant.id);
  }
  for (const Said& other : earlier) {
    for (const std::int32_t id : other.ids) {
      if (said.back().ids.count(id) > 0U) continue;
      if (takeBack(other.source, id)) change.removed.push_back(id);
    }
  }
  return change;
}

std::vector<Phenotype> PlantTable::withUntouched(const BlockHeader& header,
                                                 std::vector<Phenotype> plants) const {
  const ReportSource source(header);
  const auto reports = reports_.find(header.index);
  if (!header.isPart() || reports == reports_.end()) return plants;
  std::set<std::int32_t> ids;
  for (const Phenotype& plant : plants) ids.insert(plant.id);
  for (const Said& said : reports->second) {
    if (!ofOnePass(said.source, source)) continue;
    for (const std::int32_t id : said.ids) {
      const auto found = plants_.find(id);
      if (found == plants_.end() || !(found->second.block == header.index)) continue;
      for (const Record& record : found->second.passes) {
        const Eigen::Vector3d& base = record.plant.base;
        const bool untouched =
            ofOnePass(record.source, source) && !header.holds(base.x(), base.y());
        if (untouched && ids.insert(id).second) plants.push_back(record.plant);
      }
    }
  }
  return plants;
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
  if (!entry.passes.empty()) return false;
  by_block_[entry.block].erase(id);
  plants_.erase(found);
  return true;
}

void PlantTable::recall(const BlockIndex& block, const std::vector<PlantReport>& reports) {
  PlantTable earlier;
  for (const PlantReport& report : reports) earlier.update(report.source, report.plants);
  for (auto& [id, entry] : earlier.plants_) {
    if (plants_.count(id) > 0U) continue;
    by_block_[entry.block].insert(id);
    plants_.emplace(id, std::move(entry));
  }
  const auto said = earlier.reports_.find(block);
  if (said != earlier.reports_.end()) reports_.emplace(block, std::move(said->second));
}

void PlantTable::keepOnly(const std::set<BlockIndex>& blocks) {
  for (auto entry = by_block_.begin(); entry != by_block_.end();) {
    if (blocks.count(entry->first) > 0U) {
      ++entry;
      continue;
    }
    for (const std::int32_t id : entry->second) plants_.erase(id);
    entry = by_block_.erase(entry);
  }
  for (auto said = reports_.begin(); said != reports_.end();) {
    said = blocks.count(said->first) > 0U ? std::next(said) : reports_.erase(said);
  }
}

/// Not kept: most plants are passed once, and there are many of them.
Phenotype PlantTable::fused(const Entry& entry) {
  std::vector<Phenotype> passes;
  for (const Record& record : entry.passes) passes.push_back(record.plant);
  return fusePasses(passes);
}

std::vector<Phenotype> PlantTable::plants() const {
  std::vector<Phenotype> all;
  all.reserve(plants_.size());
  for (const auto& entry : plants_) all.push_back(fused(entry.second));
  return all;
}

std::vector<Phenotype> PlantTable::plantsOf(const BlockIndex& block) const {
  std::vector<Phenotype> plants;
  const auto ids = by_block_.find(block);
  if (ids == by_block_.end()) return plants;
  for (const std::int32_t id : ids->second) plants.push_back(fused(plants_.at(id)));
  return plants;
}

}  // namespace field_phenotyping
