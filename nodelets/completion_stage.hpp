#pragma once

#include <field_phenotyping/CompletionConfig.h>
#include <ros/ros.h>

#include <map>
#include <mutex>
#include <string>

#include "block_stage.hpp"
#include "display_topic.hpp"
#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// Third stage as a node: fills the gaps of the stems, but of drafts, which pass as they are. The
/// segmented block is passed on by reference, never copied.
class CompletionStage {
 public:
  CompletionStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh, const std::string& name);
  ~CompletionStage();

 private:
  using Stage = BlockStage<SegmentedBlock, CompletedBlock, CompletionConfig, CompletionParameters>;

  boost::shared_ptr<const CompletedBlock> work(const boost::shared_ptr<const SegmentedBlock>& block,
                                               const CompletionParameters& parameters);

  boost::shared_ptr<const CompletedBlock> latestOf(const BlockIndex& index);
  void keepLatest(const BlockIndex& index, const boost::shared_ptr<const CompletedBlock>& block);

  std::mutex latest_mutex_;
  /// Newest revision of each open block: only what newer scans touch is solved again.
  std::map<BlockIndex, boost::shared_ptr<const CompletedBlock>> latest_;
  Stage stage_;
  BlockHistory<CompletedBlock> done_;
  DisplayTopic<CompletedBlock> completed_;
};

}  // namespace field_phenotyping
