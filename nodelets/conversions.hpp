#pragma once

#include <field_phenotyping/PlantPhenotypeArray.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_msgs/Header.h>
#include <visualization_msgs/MarkerArray.h>

#include <boost/shared_ptr.hpp>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

// Everything between ROS messages and the core's values, but for clouds that come in.

namespace field_phenotyping {

/// The array that replaces what earlier revisions of the block said.
PlantPhenotypeArray toMessage(const std::vector<Phenotype>& plants, const BlockHeader& header);
PlantPhenotype toMessage(const Phenotype& plant);
Phenotype fromMessage(const PlantPhenotype& message);
std::vector<Phenotype> fromMessage(const PlantPhenotypeArray& message);

/// The same object under the other library's pointer: nothing is copied.
template <class T>
std::shared_ptr<const T> toStd(const boost::shared_ptr<const T>& pointer) {
  return std::shared_ptr<const T>(pointer.get(), [pointer](const T*) {});
}

/// A cloud for rviz, with the fields `x y z` [m, FLOAT32, the block's frame], `rgb`, `plant_id`
/// (INT32, -1 where none) and `stddev` (of a filled-in point's distance to the surface [m,
/// FLOAT32], NaN where the point was measured). Keeps every `stride`-th point of what is added. Far
/// from the frame's origin rviz's own single precision limits what can be seen (1 mm at 8 km).
class DisplayCloud {
 public:
  explicit DisplayCloud(std::size_t stride = 1U);

  void add(const Eigen::Vector3d& point, std::uint32_t rgb, std::int32_t plant_id,
           float stddev = std::numeric_limits<float>::quiet_NaN());
  std::size_t size() const { return points_; }
  sensor_msgs::PointCloud2 message(const std_msgs::Header& header) const;

 private:
  std::size_t stride_;
  std::size_t offered_ = 0U;
  std::size_t points_ = 0U;
  std::vector<std::uint8_t> data_;
};

/// Easily told apart from the colours of neighbouring ids; 0x00RRGGBB.
std::uint32_t plantColor(std::int32_t plant_id);

/// Nodes of the soil model in the block's own tile, grey; darker where extrapolated.
void addGround(const Block& block, DisplayCloud& cloud);
/// Denoised points above the soil in the block's own tile, in their own colours if known.
void addAboveGround(const Block& block, DisplayCloud& cloud);
/// Stems of the block's own plants, each plant in its colour.
void addStems(const SegmentedBlock& block, DisplayCloud& cloud);
/// All points of the block's own plants, organs other than the stem in green.
void addPlants(const SegmentedBlock& block, DisplayCloud& cloud);
/// Filled-in stem points of the block's own plants, red.
void addSynthetic(const CompletedBlock& block, DisplayCloud& cloud);

/// Borders of the block's tiles on the soil: orange while scans may reach them, green once final.
visualization_msgs::MarkerArray blockMarker(const Block& block);

/// Axis (namespace "axis"; red to green by its score), height as a bar beside it ("height";
/// upright, from the soil up, in the same colour) and label with height and stem diameter ("label";
/// those of neighbours at heights of their own, so that one can read them) of each plant; the
/// marker's id is the plant's.
visualization_msgs::MarkerArray plantMarkers(const std::vector<Phenotype>& plants,
                                             const std_msgs::Header& header);
/// Takes the markers of plants that are no longer believed in away.
visualization_msgs::MarkerArray removedMarkers(const std::vector<std::int32_t>& plant_ids,
                                               const std_msgs::Header& header);
/// A line for each row of plants ("row"), 5 cm above their bases, numbered from 0; takes away those
/// up to `shown`, where more were shown before.
visualization_msgs::MarkerArray rowMarkers(const std::vector<Phenotype>& plants, std::size_t shown,
                                           const std_msgs::Header& header);
/// Takes all markers away.
visualization_msgs::MarkerArray noMarkers(const std_msgs::Header& header);

}  // namespace field_phenotyping
