#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/preprocessing/block.hpp"

namespace field_phenotyping {

/// Which revision of a block, seen in which pass, says something about its plants.
struct ReportSource {
  BlockIndex block;
  std::uint64_t began_ns = 0U;  ///< first scan of the pass that reached the block
  std::uint64_t stamp_ns = 0U;  ///< newest scan
  std::uint32_t revision = 0U;

  ReportSource() = default;
  explicit ReportSource(const BlockHeader& header)
      : block(header.index),
        began_ns(header.began_ns),
        stamp_ns(header.stamp_ns),
        revision(header.revision) {}
};

/// What one revision of a block said about its plants.
struct PlantReport {
  ReportSource source;
  std::vector<Phenotype> plants;
};

/// What is believed of all plants seen so far, one entry an id. What several passes say of a plant
/// is fused (fusePasses()); within a pass the newest revision counts. Not thread-safe.
class PlantTable {
 public:
  struct Change {
    bool accepted = false;              ///< false: the revision was older than the one known
    std::vector<std::int32_t> added;    ///< ids that were not believed in before
    std::vector<std::int32_t> removed;  ///< ids that are no longer believed in
  };

  /// Replaces what earlier revisions of the block said in the same pass. An older revision than the
  /// one known says nothing new (a bag that starts again must not undo what was measured). A plant
  /// that another pass has found is believed in even where this one does not see it.
  Change update(const ReportSource& source, const std::vector<Phenotype>& plants);

  /// What a block says of all its plants: `plants`, and where that is a draft of a part of its tile
  /// also those that it has said stand elsewhere in it, as they were, if no other block has
  /// reported them since.
  std::vector<Phenotype> withUntouched(const BlockHeader& header,
                                       std::vector<Phenotype> plants) const;

  /// Takes in what was said before of a block and of plants, where it is not known here.
  /// @param reports of the block, and of all others that ever named one of these plants, as they
  ///                came; of other plants nothing
  void recall(const BlockIndex& block, const std::vector<PlantReport>& reports);
  /// Whether the table knows what was said of the block.
  bool holds(const BlockIndex& block) const { return reports_.count(block) > 0U; }
  bool holds(std::int32_t id) const { return plants_.count(id) > 0U; }
  /// Forgets all blocks but these, and the plants that others were the last to report.
  void keepOnly(const std::set<BlockIndex>& blocks);

  /// All plants, ordered by id.
  std::vector<Phenotype> plants() const;
  /// Those that the block was the last to report, ordered by id.
  std::vector<Phenotype> plantsOf(const BlockIndex& block) const;
  std::size_t size() const { return plants_.size(); }

 private:
  struct Record {
    ReportSource source;
    Phenotype plant;
  };
  struct Entry {
    std::vector<Record> passes;  ///< oldest first; no two overlap in time
    BlockIndex block;            ///< that reported it last: a plant near a border may change sides
  };
  struct Said {
    ReportSource source;
    std::set<std::int32_t> ids;
  };

  void put(const ReportSource& source, const Phenotype& plant);
  static Phenotype fused(const Entry& entry);
  bool takeBack(const ReportSource& source, std::int32_t id);

  std::map<std::int32_t, Entry> plants_;
  std::map<BlockIndex, std::set<std::int32_t>> by_block_;
  std::map<BlockIndex, std::vector<Said>> reports_;  // newest of each pass
};

}  // namespace field_phenotyping
