#pragma once

#include <ros/ros.h>

#include <cstddef>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "phenotype_journal.hpp"
#include "plant_table.hpp"
#include "stage_health.hpp"

namespace field_phenotyping {

/// A PlantTable that outlives its process: every report goes to the journal `~journal` before
/// anybody else hears of it, and what that holds is known from the start. Only the blocks of the
/// last reports are in memory; the others are read again when they are passed again. Without
/// `~journal` a temporary file takes its place. Where it cannot be written, measuring goes on,
/// `health` says so, and reports wait in memory until it can. Where another writes it, one beside
/// it takes its place, and `health` goes on saying so. Not thread-safe.
class DurableTable {
 public:
  /// With `~new_journal`, which is set to false then, an older journal is moved aside and a new one
  /// begun.
  DurableTable(const ros::NodeHandle& pnh, StageHealth& health);

  PlantTable::Change update(const BlockHeader& header, const std::vector<Phenotype>& plants);
  /// Tries again to write what waits, at most once a second; call it often.
  void retry();
  /// What is known of the blocks of the last reports.
  const PlantTable& recent() const { return table_; }
  /// Everything, as PlantTable::plants() gives it.
  std::vector<Phenotype> allPlants() const;
  /// Of all plants.
  std::size_t size() const { return size_; }

 private:
  /// @param anew one that is there is moved aside
  void open(bool anew);
  void tellInUse();
  void recall(const BlockIndex& block, const std::vector<Phenotype>& plants);
  void forgetOldest();
  void write();
  void writeAnewIfRemoved();

  std::string path_;
  std::string in_use_;  // why it is not the one that was given
  StageHealth& health_;
  PlantTable table_;
  std::unique_ptr<PhenotypeJournal> journal_;
  std::size_t size_ = 0U;
  std::map<BlockIndex, std::uint64_t> used_;  // blocks in memory, by which report was their last
  std::uint64_t reports_ = 0U;
  std::deque<PlantReport> waiting_;  // to be written
  std::string frame_id_;             // of those
  ros::SteadyTime tried_;            // to write them
  bool begun_ = false;               // reports were made, so an older journal comes too late
};

/// Who names plants: as an earlier run did, whose journal is `~journal`; with `~new_journal`, which
/// is set to false then, anew. A nodelet that starts again while its manager stays gets what its
/// predecessor had, for reports that are still under way to the journal hold names too.
std::shared_ptr<PlantRegistry> registryFor(const ros::NodeHandle& pnh, StageHealth& health);

}  // namespace field_phenotyping
