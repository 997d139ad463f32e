#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/preprocessing/block.hpp"

namespace field_phenotyping {

/// What is believed of all plants seen so far, one entry an id. Not thread-safe.
class PlantTable {
 public:
  struct Change {
    bool accepted = false;              ///< false: the revision was older than the one known
    std::vector<std::int32_t> removed;  ///< ids that are no longer believed in
  };

  /// Replaces what earlier revisions of a block said about its plants. An older revision than the
  /// one known says nothing new (a bag that starts again must not undo what was measured).
  Change update(const BlockIndex& block, std::uint32_t revision,
                const std::vector<Phenotype>& plants);

  /// All plants, ordered by id.
  std::vector<Phenotype> plants() const;
  std::size_t size() const { return plants_.size(); }

 private:
  struct Entry {
    Phenotype plant;
    BlockIndex block;  ///< that reported it last: a plant near a border may change sides
  };
  struct Known {
    std::uint32_t revision = 0U;
    std::vector<std::int32_t> ids;
  };

  std::map<std::int32_t, Entry> plants_;
  std::map<BlockIndex, Known> blocks_;
};

}  // namespace field_phenotyping
