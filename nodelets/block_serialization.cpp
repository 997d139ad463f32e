#include "block_serialization.hpp"

#include <stdexcept>
#include <string>

namespace field_phenotyping {
namespace {

void require(bool condition, const char* what) {
  if (!condition) throw std::runtime_error(std::string("a block from the wire is broken: ") + what);
}

bool within(const IndexSpan& span, std::size_t size) {
  return span.begin <= span.end && span.end <= size;
}

}  // namespace

std_msgs::Header messageHeader(const BlockHeader& header) {
  std_msgs::Header message;
  message.stamp.fromNSec(header.stamp_ns);
  message.frame_id = header.frame_id;
  return message;
}

void checkConsistency(const PointCloud& cloud) {
  require(cloud.colors.empty() || cloud.colors.size() == cloud.points.size(),
          "colors are neither empty nor one a point");
  require(cloud.scan_origin.empty() || cloud.scan_origin.size() == cloud.points.size(),
          "scan_origin is neither empty nor one a point");
  for (const std::uint16_t origin : cloud.scan_origin) {
    require(origin == kNoScanOrigin || origin < cloud.scan_origins.size(),
            "scan_origin names a place that is not in scan_origins");
  }
}

void checkConsistency(const Block& block) {
  checkConsistency(block.cloud);
  for (const PointCloud* beside : {&block.feet, &block.isolated}) {
    checkConsistency(*beside);
    require(beside->empty() || (beside->hasColors() == block.cloud.hasColors() &&
                                beside->hasScanOrigins() == block.cloud.hasScanOrigins() &&
                                beside->scan_origins.size() == block.cloud.scan_origins.size()),
            "the feet or the isolated points know less or more of their points than the cloud");
  }
}

void checkConsistency(const SegmentedBlock& block) {
  checkConsistency(block.cloud);
  require(block.source_index.size() == block.cloud.size(), "source_index is not one a point");
  for (const Plant& plant : block.plants) {
    require(!plant.axis.empty(), "a plant has no axis");
    require(within(plant.points, block.cloud.size()),
            "the points of a plant lie outside the cloud");
    require(within(plant.stem, block.cloud.size()), "the stem of a plant lies outside the cloud");
    require(plant.stem.begin >= plant.points.begin && plant.stem.end <= plant.points.end,
            "a stem lies outside its plant");
  }
}

void checkConsistency(const CompletedBlock& block) {
  checkConsistency(block.synthetic);
  require(block.synthetic_stddev.size() == block.synthetic.size(),
          "synthetic_stddev is not one a point");
  require(block.synthetic_span.size() == block.segmented->plants.size(),
          "synthetic_begin and synthetic_end are not one a plant");
  require(block.stems.empty() || block.stems.size() == block.segmented->plants.size(),
          "completion_flags is not one a plant");
  for (const IndexSpan& span : block.synthetic_span) {
    require(within(span, block.synthetic.size()), "synthetic points lie outside the cloud");
  }
}

SoilArrays::SoilArrays(const GroundModel& ground)
    : corner_x(ground.corner().x()),
      corner_y(ground.corner().y()),
      spacing(ground.spacing()),
      columns(static_cast<std::uint32_t>(ground.columns())),
      rows(static_cast<std::uint32_t>(ground.rows())),
      observed(ground.observed()) {
  for (const GroundModel::Node& node : ground.nodes()) {
    height.push_back(node.height);
    stddev.push_back(node.stddev);
    seen.push_back(node.seen);
  }
}

GroundModel SoilArrays::model() const {
  if (height.empty()) return GroundModel();
  require(std::uint64_t{columns} * rows == height.size(), "the soil's heights do not fit its grid");
  require(stddev.size() == height.size() && seen.size() == height.size(),
          "the soil's arrays differ in length");
  require(spacing > 0.0F, "the spacing of the soil's nodes is not positive");
  std::vector<GroundModel::Node> nodes(height.size());
  for (std::size_t i = 0; i < nodes.size(); ++i) nodes[i] = {height[i], stddev[i], seen[i]};
  return GroundModel({corner_x, corner_y}, spacing, static_cast<int>(columns),
                     static_cast<int>(rows), std::move(nodes), observed);
}

AxisArrays::AxisArrays(const StemAxis& axis) {
  for (const StemAxis::Node& node : axis.nodes()) {
    position.push_back(node.position);
    radius.push_back(node.radius);
  }
}

StemAxis AxisArrays::axis() const {
  require(position.size() == radius.size(), "axis_radius is not one a node");
  if (position.empty()) return StemAxis();
  std::vector<StemAxis::Node> nodes(position.size());
  for (std::size_t i = 0; i < nodes.size(); ++i) nodes[i] = {position[i], radius[i]};
  return StemAxis(std::move(nodes));
}

}  // namespace field_phenotyping
