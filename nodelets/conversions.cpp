#include "conversions.hpp"

#include <sensor_msgs/PointField.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "cloud_decoder.hpp"
#include "field_phenotyping/completion/completion_flags.hpp"
#include "field_phenotyping/measurement/stand_summary.hpp"

namespace field_phenotyping {
namespace {

using sensor_msgs::PointCloud2;
using sensor_msgs::PointField;

constexpr std::uint32_t kGrey = 0x969696U;
constexpr std::uint32_t kDarkGrey = 0x5a5a5aU;
constexpr std::uint32_t kGreen = 0x4ca64cU;
constexpr std::uint32_t kRed = 0xff0000U;

static_assert(std::uint32_t{PlantPhenotype::OK} == kOk &&
                  std::uint32_t{PlantPhenotype::TOO_FEW_POINTS} == kTooFewPoints &&
                  std::uint32_t{PlantPhenotype::ARC_BELOW} == kArcBelow &&
                  std::uint32_t{PlantPhenotype::POOR_FIT} == kPoorFit &&
                  std::uint32_t{PlantPhenotype::GROUND_EXTRAPOLATED} == kGroundExtrapolated &&
                  std::uint32_t{PlantPhenotype::GROUND_MISSING} == kGroundMissing &&
                  std::uint32_t{PlantPhenotype::HEIGHT_SHIFTED} == kHeightShifted &&
                  std::uint32_t{PlantPhenotype::SHORT_STEM} == kShortStem &&
                  std::uint32_t{PlantPhenotype::TRUNCATED} == kTruncated &&
                  std::uint32_t{PlantPhenotype::LOW_CONFIDENCE} == kLowConfidence &&
                  std::uint32_t{PlantPhenotype::PRIOR_DRIVEN} == kPriorDriven &&
                  std::uint32_t{PlantPhenotype::MERGED_SUSPECT} == kMergedSuspect &&
                  std::uint32_t{PlantPhenotype::UNLIKE_STAND} == kUnlikeStand,
              "the constants of PlantPhenotype.msg must equal QualityFlag");
static_assert(std::uint8_t{PlantPhenotype::COMPLETION_TOO_FEW_POINTS} == kCompletionTooFewPoints &&
                  std::uint8_t{PlantPhenotype::COMPLETION_NO_SURFACE} == kCompletionNoSurface &&
                  std::uint8_t{PlantPhenotype::COMPLETION_OPEN_GAP} == kCompletionOpenGap &&
                  std::uint8_t{PlantPhenotype::COMPLETION_UNCERTAIN} == kCompletionUncertain &&
                  std::uint8_t{PlantPhenotype::COMPLETION_SEEN_EMPTY} == kCompletionSeenEmpty,
              "the constants of PlantPhenotype.msg must equal CompletionFlag");

std::string formatted(const char* format, double value) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), format, value);
  return text.data();
}

std::string labelText(const Phenotype& plant) {
  const std::string height =
      std::isfinite(plant.height.value) ? formatted("%.2f m", plant.height.value) : "height ?";
  const std::string diameter = std::isfinite(plant.stem_diameter.value)
                                   ? formatted("%.1f mm", 1000.0 * plant.stem_diameter.value)
                                   : "diameter ?";
  return height + "\n" + diameter;
}

geometry_msgs::Point toPoint(const Eigen::Vector3d& p) {
  geometry_msgs::Point message;
  message.x = p.x();
  message.y = p.y();
  message.z = p.z();
  return message;
}

visualization_msgs::Marker marker(const std_msgs::Header& header, const char* name_space,
                                  std::int32_t id, std::int32_t action) {
  visualization_msgs::Marker message;
  // Stamp 0 keeps rviz from looking up a transform of the past.
  message.header.frame_id = header.frame_id;
  message.ns = name_space;
  message.id = id;
  message.action = action;
  message.pose.orientation.w = 1.0;
  message.color.a = 1.0F;
  return message;
}

constexpr double kPlate = 0.01;  // [m] thick

/// Above the plant's top [m]: on one of three levels, a label's height apart. Neighbours in a row
/// are nearer to one another than their labels are wide; three in a row are not.
double labelRise(const Phenotype& plant) {
  constexpr double kLabel = 0.16;     // [m] of two lines
  constexpr double kNeighbor = 0.20;  // [m] between plants in a row, about
  const double along = (plant.base.x() + plant.base.y()) / kNeighbor;
  const double level = along - 3.0 * std::floor(along / 3.0);
  return 0.1 + kLabel * std::floor(level);
}

Eigen::Vector3d topOf(const Phenotype& plant) {
  const double rise = std::isfinite(plant.height.value) ? plant.height.value : 0.3;
  const double slope = std::max(plant.axis.z(), 0.1);
  return plant.base + plant.axis * (rise / slope);
}

}  // namespace

PlantPhenotype toMessage(const Phenotype& plant) {
  PlantPhenotype message;
  message.id = plant.id;
  message.revision = plant.revision;
  message.passes = plant.passes;
  message.final = plant.final;
  message.base = toPoint(plant.base);
  message.axis.x = plant.axis.x();
  message.axis.y = plant.axis.y();
  message.axis.z = plant.axis.z();
  message.height = plant.height.value;
  message.height_stddev = plant.height.stddev;
  message.stem_diameter = plant.stem_diameter.value;
  message.stem_diameter_stddev = plant.stem_diameter.stddev;
  message.stem_diameter_minor = plant.stem_diameter_minor.value;
  message.stem_diameter_minor_stddev = plant.stem_diameter_minor.stddev;
  message.stem_diameter_equivalent = plant.stem_diameter_equivalent.value;
  message.stem_diameter_equivalent_stddev = plant.stem_diameter_equivalent.stddev;
  message.diameter_height = plant.diameter_height;
  message.diameter_prior_share = plant.diameter_prior_share;
  message.stem_volume = plant.stem_volume.value;
  message.stem_volume_stddev = plant.stem_volume.stddev;
  message.lean = plant.lean.value;
  message.lean_stddev = plant.lean.stddev;
  message.lean_azimuth = plant.lean_azimuth;
  message.spacing = plant.spacing.value;
  message.spacing_stddev = plant.spacing.stddev;
  message.row_spacing = plant.row_spacing.value;
  message.row_spacing_stddev = plant.row_spacing.stddev;
  message.arc_coverage = plant.arc_coverage;
  message.completeness = plant.completeness;
  message.stem_points = plant.stem_points;
  message.plant_points = plant.plant_points;
  message.diameter_points = plant.diameter_points;
  message.synthetic_points = plant.synthetic_points;
  message.completion_flags = plant.completion_flags;
  message.segmentation_quality = plant.segmentation_quality;
  message.growth_iterations = plant.growth_iterations;
  message.growth_r1 = plant.growth_r1;
  message.growth_M = plant.growth_M;
  message.growth_alpha = plant.growth_alpha;
  message.growth_beta = plant.growth_beta;
  message.flags = plant.flags;
  message.score = plant.score;
  return message;
}

Phenotype fromMessage(const PlantPhenotype& message) {
  Phenotype plant;
  plant.id = message.id;
  plant.revision = message.revision;
  plant.passes = message.passes;
  plant.final = message.final != 0U;
  plant.base = {message.base.x, message.base.y, message.base.z};
  plant.axis = {message.axis.x, message.axis.y, message.axis.z};
  plant.height = {message.height, message.height_stddev};
  plant.stem_diameter = {message.stem_diameter, message.stem_diameter_stddev};
  plant.stem_diameter_minor = {message.stem_diameter_minor, message.stem_diameter_minor_stddev};
  plant.stem_diameter_equivalent = {message.stem_diameter_equivalent,
                                    message.stem_diameter_equivalent_stddev};
  plant.diameter_height = message.diameter_height;
  plant.diameter_prior_share = message.diameter_prior_share;
  plant.stem_volume = {message.stem_volume, message.stem_volume_stddev};
  plant.lean = {message.lean, message.lean_stddev};
  plant.lean_azimuth = message.lean_azimuth;
  plant.spacing = {message.spacing, message.spacing_stddev};
  plant.row_spacing = {message.row_spacing, message.row_spacing_stddev};
  plant.arc_coverage = message.arc_coverage;
  plant.completeness = message.completeness;
  plant.stem_points = message.stem_points;
  plant.plant_points = message.plant_points;
  plant.diameter_points = message.diameter_points;
  plant.synthetic_points = message.synthetic_points;
  plant.completion_flags = message.completion_flags;
  plant.segmentation_quality = message.segmentation_quality;
  plant.growth_iterations = message.growth_iterations;
  plant.growth_r1 = message.growth_r1;
  plant.growth_M = message.growth_M;
  plant.growth_alpha = message.growth_alpha;
  plant.growth_beta = message.growth_beta;
  plant.flags = message.flags;
  plant.score = message.score;
  return plant;
}

PlantPhenotypeArray toMessage(const std::vector<Phenotype>& plants, const BlockHeader& header) {
  PlantPhenotypeArray message;
  message.header.stamp.fromNSec(header.stamp_ns);
  message.header.frame_id = header.frame_id;
  message.block_x = header.index.x;
  message.block_y = header.index.y;
  message.revision = header.revision;
  message.final = header.final;
  message.plants.reserve(plants.size());
  for (const Phenotype& plant : plants) message.plants.push_back(toMessage(plant));
  return message;
}

std::vector<Phenotype> fromMessage(const PlantPhenotypeArray& message) {
  std::vector<Phenotype> plants;
  plants.reserve(message.plants.size());
  for (const PlantPhenotype& plant : message.plants) plants.push_back(fromMessage(plant));
  return plants;
}

namespace {

/// How one point lies in the data of a DisplayCloud.
struct DisplayPoint {
  float x, y, z;
  std::uint32_t rgb;
  std::int32_t plant_id;
  float stddev;
};

PointField displayField(const char* name, std::size_t offset, std::uint8_t datatype) {
  PointField field;
  field.name = name;
  field.offset = static_cast<std::uint32_t>(offset);
  field.datatype = datatype;
  field.count = 1U;
  return field;
}

}  // namespace

DisplayCloud::DisplayCloud(std::size_t stride) : stride_(std::max<std::size_t>(stride, 1U)) {}

void DisplayCloud::add(const Eigen::Vector3d& point, std::uint32_t rgb, std::int32_t plant_id,
                       float stddev) {
  if (offered_++ % stride_ != 0U) return;
  const Eigen::Vector3f p = point.cast<float>();
  const DisplayPoint entry{p.x(), p.y(), p.z(), rgb, plant_id, stddev};
  data_.resize(data_.size() + sizeof(entry));
  std::memcpy(data_.data() + data_.size() - sizeof(entry), &entry, sizeof(entry));
  ++points_;
}

PointCloud2 DisplayCloud::message(const std_msgs::Header& header) const {
  PointCloud2 message;
  message.header = header;
  message.height = 1U;
  message.width = static_cast<std::uint32_t>(points_);
  message.fields = {displayField("x", offsetof(DisplayPoint, x), PointField::FLOAT32),
                    displayField("y", offsetof(DisplayPoint, y), PointField::FLOAT32),
                    displayField("z", offsetof(DisplayPoint, z), PointField::FLOAT32),
                    displayField("rgb", offsetof(DisplayPoint, rgb), PointField::FLOAT32),
                    displayField("plant_id", offsetof(DisplayPoint, plant_id), PointField::INT32),
                    displayField("stddev", offsetof(DisplayPoint, stddev), PointField::FLOAT32)};
  message.is_bigendian = hostIsBigEndian();
  message.point_step = sizeof(DisplayPoint);
  message.row_step = message.point_step * message.width;
  message.is_dense = 1U;
  message.data = data_;
  return message;
}

std::uint32_t plantColor(std::int32_t plant_id) {
  // Hues a golden ratio apart, without the red that completed points have.
  const double turn = 0.618033988749895 * plant_id;
  const double hue = 0.08 + 0.84 * (turn - std::floor(turn));
  std::uint32_t rgb = 0U;
  for (const double shift : {0.0, 2.0 / 3.0, 1.0 / 3.0}) {
    const double wheel = hue + shift - std::floor(hue + shift);
    const double level = std::min(1.0, std::max(0.0, std::abs(6.0 * wheel - 3.0) - 1.0));
    rgb = (rgb << 8U) | static_cast<std::uint32_t>(std::lround(60.0 + 195.0 * level));
  }
  return rgb;
}

void addGround(const Block& block, DisplayCloud& cloud) {
  const GroundModel& ground = block.ground;
  for (std::size_t i = 0; i < ground.nodes().size(); ++i) {
    const GroundModel::Node& node = ground.nodes()[i];
    const auto columns = static_cast<std::size_t>(ground.columns());
    const Eigen::Vector3d p =
        block.cloud.origin +
        Eigen::Vector3d(ground.corner().x() + ground.spacing() * static_cast<float>(i % columns),
                        ground.corner().y() + ground.spacing() * static_cast<float>(i / columns),
                        node.height);
    if (block.holds(p.x(), p.y())) cloud.add(p, node.seen != 0U ? kGrey : kDarkGrey, -1);
  }
}

void addAboveGround(const Block& block, DisplayCloud& cloud) {
  for (std::size_t i = 0; i < block.cloud.size(); ++i) {
    const Eigen::Vector3d p = block.cloud.mapPoint(i);
    if (!block.holds(p.x(), p.y())) continue;
    cloud.add(p, block.cloud.hasColors() ? block.cloud.colors[i] : kGreen, -1);
  }
}

void addStems(const SegmentedBlock& block, DisplayCloud& cloud) {
  for (const Plant& plant : block.plants) {
    if (!plant.owned) continue;
    for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
      cloud.add(block.cloud.mapPoint(i), plantColor(plant.id), plant.id);
    }
  }
}

void addPlants(const SegmentedBlock& block, DisplayCloud& cloud) {
  for (const Plant& plant : block.plants) {
    if (!plant.owned) continue;
    for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
      const bool stem = i >= plant.stem.begin && i < plant.stem.end;
      cloud.add(block.cloud.mapPoint(i), stem ? plantColor(plant.id) : kGreen, plant.id);
    }
  }
}

void addSynthetic(const CompletedBlock& block, DisplayCloud& cloud) {
  for (std::size_t k = 0; k < block.synthetic_span.size(); ++k) {
    const Plant& plant = block.segmented->plants[k];
    if (!plant.owned) continue;
    const IndexSpan& span = block.synthetic_span[k];
    for (std::uint32_t i = span.begin; i < span.end; ++i) {
      cloud.add(block.synthetic.mapPoint(i), kRed, plant.id, block.synthetic_stddev[i]);
    }
  }
}

visualization_msgs::MarkerArray plantMarkers(const std::vector<Phenotype>& plants,
                                             const std_msgs::Header& header) {
  visualization_msgs::MarkerArray array;
  for (const Phenotype& plant : plants) {
    // Red to green by the score.
    const auto red = static_cast<float>(std::min(1.0, 2.0 - 2.0 * plant.score));
    const auto green = static_cast<float>(std::min(1.0, 2.0 * plant.score));

    visualization_msgs::Marker axis =
        marker(header, "axis", plant.id, visualization_msgs::Marker::ADD);
    axis.type = visualization_msgs::Marker::LINE_STRIP;
    axis.scale.x = 0.005;
    axis.color.r = red;
    axis.color.g = green;
    axis.points = {toPoint(plant.base), toPoint(topOf(plant))};
    array.markers.push_back(axis);

    // Where no height is known a plate on the soil stands for the bar.
    const double height = std::isfinite(plant.height.value) ? plant.height.value : kPlate;
    visualization_msgs::Marker bar =
        marker(header, "height", plant.id, visualization_msgs::Marker::ADD);
    bar.type = visualization_msgs::Marker::CUBE;
    bar.scale.x = bar.scale.y = 0.03;
    bar.scale.z = std::max(height, kPlate);
    bar.color.r = red;
    bar.color.g = green;
    bar.color.a = 0.4F;
    bar.pose.position = toPoint(plant.base + Eigen::Vector3d(0.0, 0.0, 0.5 * bar.scale.z));
    array.markers.push_back(bar);

    visualization_msgs::Marker label =
        marker(header, "label", plant.id, visualization_msgs::Marker::ADD);
    label.type = visualization_msgs::Marker::TEXT_VIEW_FACING;
    label.scale.z = 0.06;
    label.color.r = label.color.g = label.color.b = 1.0F;
    label.pose.position = toPoint(topOf(plant) + Eigen::Vector3d(0.0, 0.0, labelRise(plant)));
    label.text = labelText(plant);
    array.markers.push_back(label);
  }
  return array;
}

visualization_msgs::MarkerArray rowMarkers(const std::vector<Phenotype>& plants, std::size_t shown,
                                           const std_msgs::Header& header) {
  constexpr double kAboveSoil = 0.05;  // [m]
  visualization_msgs::MarkerArray array;
  const auto on_soil = [&](const Eigen::Vector2d& place) {
    const auto nearest =
        std::min_element(plants.begin(), plants.end(), [&](const Phenotype& a, const Phenotype& b) {
          return (a.base.head<2>() - place).norm() < (b.base.head<2>() - place).norm();
        });
    return toPoint({place.x(), place.y(), nearest->base.z() + kAboveSoil});
  };
  for (const RowSummary& row : summariseRows(plants)) {
    visualization_msgs::Marker line =
        marker(header, "row", row.row, visualization_msgs::Marker::ADD);
    line.type = visualization_msgs::Marker::LINE_STRIP;
    line.scale.x = 0.02;
    line.color.r = 0.3F;
    line.color.g = 0.6F;
    line.color.b = 1.0F;
    line.points = {on_soil(row.start), on_soil(row.end)};
    array.markers.push_back(line);
  }
  for (std::size_t row = array.markers.size(); row < shown; ++row) {
    array.markers.push_back(
        marker(header, "row", static_cast<std::int32_t>(row), visualization_msgs::Marker::DELETE));
  }
  return array;
}

visualization_msgs::MarkerArray blockMarker(const Block& block) {
  visualization_msgs::MarkerArray array;
  for (const BlockHeader& header : block.tiles()) {
    std_msgs::Header frame;
    frame.frame_id = header.frame_id;
    // One number a tile, for any field that is less than 65536 tiles wide.
    const auto id =
        static_cast<std::int32_t>((static_cast<std::uint32_t>(header.index.x) << 16U) ^
                                  (static_cast<std::uint32_t>(header.index.y) & 0xffffU));
    visualization_msgs::Marker border = marker(frame, "block", id, visualization_msgs::Marker::ADD);
    border.type = visualization_msgs::Marker::LINE_STRIP;
    border.scale.x = 0.02;
    border.color.r = header.final ? 0.2F : 1.0F;
    border.color.g = header.final ? 0.8F : 0.7F;
    border.color.b = header.final ? 0.3F : 0.1F;
    const Eigen::Vector2d low = header.lowCorner();
    using Corner = Eigen::Vector2d;
    for (const Corner& step :
         {Corner(0, 0), Corner(1, 0), Corner(1, 1), Corner(0, 1), Corner(0, 0)}) {
      const Eigen::Vector2d corner = low + header.tile_size * step;
      const Eigen::Vector3d& origin = block.cloud.origin;
      const Eigen::Vector2f local = (corner - origin.head<2>()).cast<float>();
      const float soil = block.ground.heightAt(local.x(), local.y());
      border.points.push_back(toPoint({corner.x(), corner.y(), origin.z() + soil}));
    }
    array.markers.push_back(border);
  }
  return array;
}

visualization_msgs::MarkerArray removedMarkers(const std::vector<std::int32_t>& plant_ids,
                                               const std_msgs::Header& header) {
  visualization_msgs::MarkerArray array;
  for (const std::int32_t id : plant_ids) {
    for (const char* name_space : {"axis", "height", "label"}) {
      array.markers.push_back(marker(header, name_space, id, visualization_msgs::Marker::DELETE));
    }
  }
  return array;
}

visualization_msgs::MarkerArray noMarkers(const std_msgs::Header& header) {
  visualization_msgs::MarkerArray array;
  array.markers.push_back(marker(header, "", 0, visualization_msgs::Marker::DELETEALL));
  return array;
}

}  // namespace field_phenotyping
