#include "segmentation_stage.hpp"

#include <algorithm>
#include <boost/make_shared.hpp>
#include <utility>

#include "durable_table.hpp"
#include "field_phenotyping/segmentation/joined_tiles.hpp"
#include "field_phenotyping/segmentation/segmentation.hpp"

namespace field_phenotyping {
namespace {

// So many finished blocks without a plant in any of them are worth a warning.
constexpr std::size_t kFruitlessBlocks = 3U;
// Last reports that are kept to be put right: a rover that has left them by more is elsewhere.
constexpr std::size_t kMostProvisional = 8U;
const char* const kOvertaken = "revisions overtaken by newer ones";

}  // namespace

SegmentationStage::SegmentationStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh,
                                     const std::string& name)
    : stage_(nh, pnh, name),
      registry_(registryFor(stage_.privateHandle(), stage_.health())),
      done_(historyOf(pnh)),
      stems_(stage_.privateHandle(), "stems", addStems),
      plants_(stage_.privateHandle(), "plants", addPlants) {
  stage_.start([this](const auto& block, const auto& p) { return work(*block, p); },
               [this] {
                 const std::lock_guard<std::mutex> lock(mutex_);
                 stems_.update(done_);
                 plants_.update(done_);
               },
               Stage::Drafts::kBeside);
}

SegmentationStage::~SegmentationStage() {
  stage_.stop();
}

std::vector<SegmentationStage::Stage::OutputPtr> SegmentationStage::work(
    const Block& block, const SegmentationParameters& parameters) {
  const NamedRevisions::Work at_work(revisions_);
  const std::vector<BlockHeader> headers = block.tiles();
  const auto overtaken = [this](const BlockHeader& tile) { return revisions_.isOvertaken(tile); };
  if (std::all_of(headers.begin(), headers.end(), overtaken)) {
    stage_.health().count(kOvertaken, headers.size());
    return {};
  }
  std::vector<SegmentedBlock> tiles =
      splitIntoTiles(segmentBlock(block, parameters, stage_.device()), block.joined);
  const std::lock_guard<std::mutex> lock(mutex_);
  showDeviceUse(stage_.device(), stage_.health());
  std::vector<Stage::OutputPtr> outputs;
  std::size_t plants = 0U;
  for (SegmentedBlock& tile : tiles) {
    if (overtaken(tile.header)) {  // by one that was beside it
      stage_.health().count(kOvertaken);
      continue;
    }
    revisions_.name(tile.header);
    const auto segmented = boost::make_shared<SegmentedBlock>(std::move(tile));
    const PlantRegistry::Outcome outcome = registry_->identify(*segmented);
    stage_.health().show("map shift since the last pass [m]", outcome.shift.norm());
    plants += segmented->plants.size();
    outputs.push_back(segmented);
    // First, for what the block itself has said before in this pass is replaced anyway.
    keepProvisional(segmented, outcome.provisional);
    for (const PlantRegistry::TakenBack& wrong : outcome.taken_back) {
      if (auto revised = takeBack(wrong)) outputs.push_back(std::move(revised));
    }
  }
  if (outputs.empty()) return outputs;
  noteOutcome(block, plants, parameters);
  for (const Stage::OutputPtr& output : outputs) done_.add(output);
  stems_.changed();
  plants_.changed();
  return outputs;
}

/// @param ids how many of the block's may be taken back
void SegmentationStage::keepProvisional(const boost::shared_ptr<const SegmentedBlock>& block,
                                        std::size_t ids) {
  const BlockHeader& header = block->header;
  const auto replaced = [&](const auto& other) {
    return other->header.index == header.index && other->header.began_ns == header.began_ns;
  };
  provisional_.erase(std::remove_if(provisional_.begin(), provisional_.end(), replaced),
                     provisional_.end());
  if (ids == 0U || !header.final) return;
  provisional_.push_back(block);
  if (provisional_.size() > kMostProvisional) provisional_.pop_front();
}

/// One more revision of what a block has said for the last time, without an id that turned out to
/// be wrong; nothing where none has said it, or that is not kept any more.
boost::shared_ptr<const SegmentedBlock> SegmentationStage::takeBack(
    const PlantRegistry::TakenBack& wrong) {
  const auto is_wrong = [&](const Plant& plant) { return plant.owned && plant.id == wrong.id; };
  for (auto& kept : provisional_) {
    const auto found = std::find_if(kept->plants.begin(), kept->plants.end(), is_wrong);
    if (found == kept->plants.end()) continue;
    const auto revised = boost::make_shared<SegmentedBlock>(*kept);
    ++revised->header.revision;
    Plant& plant = revised->plants[static_cast<std::size_t>(found - kept->plants.begin())];
    plant.id = wrong.older;
    plant.owned = wrong.older >= 0;
    kept = revised;
    stage_.health().count("ids taken back");
    return revised;
  }
  return nullptr;
}

/// @param plants of all its tiles
void SegmentationStage::noteOutcome(const Block& block, std::size_t plants,
                                    const SegmentationParameters& parameters) {
  StageHealth& health = stage_.health();
  health.show("plants known", static_cast<double>(registry_->size()));
  health.show("plants in the last block", static_cast<double>(plants));
  health.show("points in the last block", static_cast<double>(block.cloud.size()));
  // Soil between and beside the plants is no trouble, nor are blocks that are still being filled.
  if (registry_->size() > 0U || !block.header.final) return;
  fruitless_.add(block.header, block.cloud.points, block.ground, parameters, block.tiles().size());
  if (fruitless_.count() >= kFruitlessBlocks) {
    health.trouble("no plant", fruitless_.reason(parameters));
  }
}

}  // namespace field_phenotyping
