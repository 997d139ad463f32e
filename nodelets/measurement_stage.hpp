#pragma once

#include <field_phenotyping/MeasurementConfig.h>
#include <field_phenotyping/PlantPhenotypeArray.h>
#include <ros/ros.h>

#include <atomic>
#include <mutex>
#include <string>
#include <vector>

#include "block_stage.hpp"
#include "durable_table.hpp"
#include "field_phenotyping/parameters.hpp"
#include "first_values.hpp"

namespace field_phenotyping {

/// Last stage as a node: completed blocks in, the traits of their plants out, fused over all passes
/// and kept in a journal.
class MeasurementStage {
 public:
  MeasurementStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh, const std::string& name);
  ~MeasurementStage();

 private:
  using Stage =
      BlockStage<CompletedBlock, PlantPhenotypeArray, MeasurementConfig, MeasurementParameters>;

  boost::shared_ptr<const PlantPhenotypeArray> work(const CompletedBlock& block,
                                                    const MeasurementParameters& parameters);
  void noteFirstValues(const BlockHeader& header, const PlantTable::Change& change);
  void noteLastValues(const BlockHeader& header);
  void showMarkers();
  void showRows();

  Stage stage_;
  std::mutex mutex_;  // of all below but the markers' publisher
  DurableTable plants_;
  std_msgs::Header header_;            // of the last block
  std::vector<std::int32_t> removed_;  // plants whose markers are to go
  FirstValues first_values_;
  std::vector<Phenotype> fresh_;                          // plants whose markers are to change
  Eigen::Vector2d last_place_ = Eigen::Vector2d::Zero();  // of the last block [m]
  std::size_t rows_shown_ = 0U;
  bool rows_outdated_ = false;
  ros::SteadyTime rows_time_;              // when they were shown
  std::atomic<bool> new_listener_{false};  // wants to see all of them
  ros::Publisher markers_;
};

}  // namespace field_phenotyping
