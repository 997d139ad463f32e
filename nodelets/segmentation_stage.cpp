#include "segmentation_stage.hpp"

#include <boost/make_shared.hpp>
#include <cmath>
#include <sstream>

#include "durable_table.hpp"
#include "field_phenotyping/segmentation/segmentation.hpp"

namespace field_phenotyping {
namespace {

// So many finished blocks without a plant in any of them are worth a warning.
constexpr std::size_t kFruitlessBlocks = 3U;
// A stem needs about so many points per square metre of field to be told from noise.
constexpr double kSparse = 200.0;

}  // namespace

SegmentationStage::SegmentationStage(ros::NodeHandle nh, ros::NodeHandle pnh,
                                     const std::string& name)
    : stage_(nh, pnh, name),
      done_(historyOf(pnh)),
      stems_(stage_.privateHandle(), "stems", addStems),
      plants_(stage_.privateHandle(), "plants", addPlants) {
  restorePlants(stage_.privateHandle(), stage_.health(), registry_);
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

boost::shared_ptr<const SegmentedBlock> SegmentationStage::work(
    const Block& block, const SegmentationParameters& parameters) {
  const auto segmented =
      boost::make_shared<SegmentedBlock>(segmentBlock(block, parameters, stage_.device()));
  const std::lock_guard<std::mutex> lock(mutex_);
  showDeviceUse(stage_.device(), stage_.health());
  if (isOvertaken(block.header)) return nullptr;
  const PlantRegistry::Outcome outcome = registry_.identify(*segmented);
  stage_.health().show("map shift since the last pass [m]", outcome.shift.norm());
  noteOutcome(block, *segmented, parameters);
  done_.add(segmented);
  stems_.changed();
  plants_.changed();
  return segmented;
}

/// Whether a newer revision, a draft beside this one, has been named meanwhile.
bool SegmentationStage::isOvertaken(const BlockHeader& header) {
  NewestNamed& newest = newest_[header.index];
  if (newest.began_ns == header.began_ns && newest.revision > header.revision) return true;
  newest = {header.began_ns, header.revision};
  if (header.final) newest_.erase(header.index);
  return false;
}

void SegmentationStage::noteOutcome(const Block& block, const SegmentedBlock& segmented,
                                    const SegmentationParameters& parameters) {
  StageHealth& health = stage_.health();
  health.show("plants known", static_cast<double>(registry_.size()));
  health.show("plants in the last block", static_cast<double>(segmented.plants.size()));
  health.show("points in the last block", static_cast<double>(block.cloud.size()));
  // Soil between and beside the plants is no trouble, nor are blocks that are still being filled.
  if (registry_.size() > 0U || !block.header.final) return;
  ++fruitless_.blocks;
  if (block.ground.observed()) ++fruitless_.with_soil;
  fruitless_.points += block.cloud.size();
  for (const Eigen::Vector3f& point : block.cloud.points) {
    const float height = block.ground.heightAbove(point);
    const bool in_band =
        height >= parameters.seed_min_height && height <= parameters.seed_max_height;
    if (in_band) ++fruitless_.points_in_band;
  }
  fruitless_.area += std::pow(block.header.tile_size + 2.0 * block.header.margin, 2);
  if (fruitless_.blocks >= kFruitlessBlocks) health.trouble("no plant", whyNoPlant(parameters));
}

std::string SegmentationStage::whyNoPlant(const SegmentationParameters& parameters) const {
  std::ostringstream text;
  const double density = static_cast<double>(fruitless_.points_in_band) / fruitless_.area;
  text << "no plant found in " << fruitless_.blocks << " blocks (soil seen in "
       << fruitless_.with_soil << " of them): ";
  if (fruitless_.points == 0U) {
    text << "no point is left above the soil. Scattered single points count as noise "
         << "(outlier_radius, outlier_min_neighbors): is the field near enough to the sensor?";
  } else if (density < kSparse) {
    text << "only " << std::lround(density) << " points per square metre at the heights where "
         << "stems are looked for (" << parameters.seed_min_height << " to "
         << parameters.seed_max_height << " m), a stem needs hundreds. Is this a field seen from "
         << "near, are coordinates in metres with z up, does the transform fit?";
  } else {
    text << std::lround(density) << " points per square metre, but nothing as upright and thin as "
         << "a stem. If there are plants, lower seed_min_score (now " << parameters.seed_min_score
         << ") or seed_min_length (now " << parameters.seed_min_length << " m)";
  }
  return text.str();
}

}  // namespace field_phenotyping
