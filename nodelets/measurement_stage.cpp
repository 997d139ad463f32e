#include "measurement_stage.hpp"

#include <algorithm>
#include <boost/make_shared.hpp>

#include "conversions.hpp"
#include "field_phenotyping/measurement/measurement.hpp"

namespace field_phenotyping {
namespace {

const ros::WallDuration kRowsInterval(3.0);
constexpr double kRowsReach = 30.0;  // [m]

/// @param wall_ns wall time
double secondsSince(std::uint64_t wall_ns) {
  return (ros::WallTime::now() - ros::WallTime().fromNSec(wall_ns)).toSec();
}

}  // namespace

MeasurementStage::MeasurementStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh,
                                   const std::string& name)
    : stage_(nh, pnh, name), plants_(stage_.privateHandle(), stage_.health()) {
  markers_ = stage_.privateHandle().advertise<visualization_msgs::MarkerArray>(
      "markers", 10, [this](const ros::SingleSubscriberPublisher&) { new_listener_ = true; });
  using Outputs = std::vector<Stage::OutputPtr>;
  stage_.start([this](const auto& block, const auto& p) { return Outputs{work(*block, p)}; },
               [this] {
                 const std::lock_guard<std::mutex> lock(mutex_);
                 plants_.retry();
                 showMarkers();
               },
               Stage::Drafts::kBeside);
}

MeasurementStage::~MeasurementStage() {
  markers_.shutdown();
  stage_.stop();
}

boost::shared_ptr<const PlantPhenotypeArray> MeasurementStage::work(
    const CompletedBlock& block, const MeasurementParameters& parameters) {
  const BlockHeader& header = headerOf(block);
  const std::vector<Phenotype> measured = measureBlock(block, parameters, stage_.device());
  const std::lock_guard<std::mutex> lock(mutex_);
  const PlantTable::Change change = plants_.update(header, measured);
  showDeviceUse(stage_.device(), stage_.health());
  const std::vector<Phenotype> plants = plants_.recent().plantsOf(header.index);
  header_ = messageHeader(header);
  noteFirstValues(header, change);
  noteLastValues(header);
  if (change.accepted) {
    removed_.insert(removed_.end(), change.removed.begin(), change.removed.end());
    fresh_.insert(fresh_.end(), plants.begin(), plants.end());
    rows_outdated_ = true;
    last_place_ = header.lowCorner();
  }
  stage_.health().show("plants known", static_cast<double>(plants_.size()));
  stage_.health().show("plants in the last block", static_cast<double>(plants.size()));
  return boost::make_shared<PlantPhenotypeArray>(toMessage(plants, header));
}

/// How long the rover's people have to wait for the first values of a plant.
void MeasurementStage::noteFirstValues(const BlockHeader& header,
                                       const PlantTable::Change& change) {
  const std::size_t first = first_values_.countIn(change);
  stage_.health().count("plants seen again that a revision had not", change.added.size() - first);
  if (header.due_ns == 0U) return;
  const double seconds = secondsSince(header.due_ns);
  for (std::size_t k = 0; k < first; ++k) {
    stage_.health().took("plant, from when its block is due until its first values", seconds);
  }
}

/// How long they have to wait until no value of a block changes any more.
void MeasurementStage::noteLastValues(const BlockHeader& header) {
  if (header.due_ns == 0U || !header.final) return;
  stage_.health().took("block, from when it is final until its last values",
                       secondsSince(header.due_ns));
}

void MeasurementStage::showMarkers() {
  if (markers_.getNumSubscribers() > 0U && plants_.size() + removed_.size() > 0U) {
    if (new_listener_.exchange(false)) {
      markers_.publish(noMarkers(header_));
      rows_outdated_ = true;
      markers_.publish(plantMarkers(plants_.allPlants(), header_));
    } else {
      if (!removed_.empty()) markers_.publish(removedMarkers(removed_, header_));
      if (!fresh_.empty()) markers_.publish(plantMarkers(fresh_, header_));
    }
  }
  removed_.clear();
  fresh_.clear();
  showRows();
}

/// Those about the last block, for rows are taken for straight.
void MeasurementStage::showRows() {
  if (!rows_outdated_ || markers_.getNumSubscribers() == 0U) return;
  const ros::SteadyTime now = ros::SteadyTime::now();
  if (now - rows_time_ < kRowsInterval) return;
  rows_time_ = now;
  rows_outdated_ = false;
  std::vector<Phenotype> near = plants_.recent().plants();
  near.erase(std::remove_if(near.begin(), near.end(),
                            [this](const Phenotype& plant) {
                              return (plant.base.head<2>() - last_place_).norm() > kRowsReach;
                            }),
             near.end());
  const visualization_msgs::MarkerArray rows = rowMarkers(near, rows_shown_, header_);
  rows_shown_ = static_cast<std::size_t>(std::count_if(
      rows.markers.begin(), rows.markers.end(), [](const visualization_msgs::Marker& row) {
        return row.action == visualization_msgs::Marker::ADD;
      }));
  if (!rows.markers.empty()) markers_.publish(rows);
}

}  // namespace field_phenotyping
