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
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "named_revisions.hpp"

namespace field_phenotyping {

/// Second stage as a node: blocks in, the same blocks with their points given to plants out. Gives
/// every plant its one id.
class SegmentationStage {
 public:
  SegmentationStage(ros::NodeHandle nh, ros::NodeHandle pnh, const std::string& name);
  ~SegmentationStage();

 private:
  using Stage = BlockStage<Block, SegmentedBlock, SegmentationConfig, SegmentationParameters>;

  /// What is known of the finished blocks before the first plant.
  struct Fruitless {
    std::size_t blocks = 0U;
    std::size_t with_soil = 0U;
    std::size_t points = 0U;          ///< above the soil
    std::size_t points_in_band = 0U;  ///< at heights where seeds are looked for
    double area = 0.0;                ///< [m^2]
  };

  std::vector<Stage::OutputPtr> work(const Block& block, const SegmentationParameters& parameters);
  void keepProvisional(const boost::shared_ptr<const SegmentedBlock>& block, std::size_t ids);
  boost::shared_ptr<const SegmentedBlock> takeBack(const PlantRegistry::TakenBack& wrong);
  void noteOutcome(const Block& block, std::size_t plants,
                   const SegmentationParameters& parameters);
  std::string whyNoPlant(const SegmentationParameters& parameters) const;

  Stage stage_;
  NamedRevisions revisions_;
  std::mutex mutex_;  // of all below
  const std::shared_ptr<PlantRegistry> registry_;
  /// Last reports with ids that may be taken back, the oldest first.
  std::deque<boost::shared_ptr<const SegmentedBlock>> provisional_;
  Fruitless fruitless_;
  BlockHistory<SegmentedBlock> done_;
  DisplayTopic<SegmentedBlock> stems_;
  DisplayTopic<SegmentedBlock> plants_;
};

}  // namespace field_phenotyping
