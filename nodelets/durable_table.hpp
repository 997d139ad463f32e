#pragma once

#include <ros/ros.h>

#include <cstddef>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "phenotype_journal.hpp"
#include "plant_table.hpp"
#include "stage_health.hpp"

namespace field_phenotyping {

/// A PlantTable that outlives its process: every report goes to the journal `~journal` (empty:
/// none) before anybody else hears of it, and what that holds is known from the start. Where the
/// journal cannot be written, measuring goes on, `health` says so, and reports wait until it can.
/// Not thread-safe.
class DurableTable {
 public:
  /// With `~new_journal` an older journal is moved aside and a new one begun.
  DurableTable(const ros::NodeHandle& pnh, StageHealth& health);

  PlantTable::Change update(const BlockHeader& header, const std::vector<Phenotype>& plants);
  /// Tries again to write what waits, at most once a second; call it often.
  void retry();
  const PlantTable& table() const { return table_; }

 private:
  void open();
  void write();

  const std::string path_;
  StageHealth& health_;
  PlantTable table_;
  std::unique_ptr<PhenotypeJournal> journal_;
  std::deque<JournalReport> waiting_;  // to be written
  std::string frame_id_;               // of those
  ros::WallTime tried_;                // to write them
  bool begun_ = false;                 // reports were made, so an older journal comes too late
};

/// Names plants as an earlier run did, whose journal is `~journal`.
void restorePlants(const ros::NodeHandle& pnh, StageHealth& health, PlantRegistry& registry);

}  // namespace field_phenotyping
