#pragma once

#include <field_phenotyping/SegmentationConfig.h>
#include <ros/ros.h>

#include <boost/shared_ptr.hpp>
#include <cstddef>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "block_stage.hpp"
#include "display_topic.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/segmentation/fruitless_blocks.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "named_revisions.hpp"

namespace field_phenotyping {

/// Second stage as a node: blocks in, the same blocks with their points given to plants out. Gives
/// every plant its one id.
class SegmentationStage {
 public:
  SegmentationStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh, const std::string& name);
  ~SegmentationStage();

 private:
  using Stage = BlockStage<Block, SegmentedBlock, SegmentationConfig, SegmentationParameters>;

  std::vector<Stage::OutputPtr> work(const Block& block, const SegmentationParameters& parameters);
  void keepProvisional(const boost::shared_ptr<const SegmentedBlock>& block, std::size_t ids);
  boost::shared_ptr<const SegmentedBlock> takeBack(const PlantRegistry::TakenBack& wrong);
  void noteOutcome(const Block& block, std::size_t plants,
                   const SegmentationParameters& parameters);

  Stage stage_;
  NamedRevisions revisions_;
  std::mutex mutex_;  // of all below
  const std::shared_ptr<PlantRegistry> registry_;
  /// Last reports with ids that may be taken back, the oldest first.
  std::deque<boost::shared_ptr<const SegmentedBlock>> provisional_;
  FruitlessBlocks fruitless_;  ///< finished, before the first plant
  BlockHistory<SegmentedBlock> done_;
  DisplayTopic<SegmentedBlock> stems_;
  DisplayTopic<SegmentedBlock> plants_;
};

}  // namespace field_phenotyping
