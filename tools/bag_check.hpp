#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// What is asked of a bag.
struct BagCheckRequest {
  std::string bag;           ///< as BagFiles takes it
  std::string points_topic;  ///< empty: the PointCloud2 topic with the most messages
  std::string target_frame = "map";
  Parameters parameters;  ///< of preprocessing, which the density is found with
};

enum class Severity {
  kWarning,  ///< plants can be measured, but fewer or worse ones than could be
  kError,    ///< nothing, or nothing right, will be measured
};

/// Something that is wrong with a bag, why, and what can be done.
struct Finding {
  Severity severity;
  std::string about;  ///< topics, fields, frames, time, tf, points, density
  std::string what;
  std::string cure;
};

/// What was found in a bag; NaN and 0 where something could not be found.
struct BagReport {
  std::string points_topic;
  double duration_s = 0.0;  ///< from the first scan to the last one
  std::size_t scans = 0U;
  double rate_hz = 0.0;           ///< of scans, by the median of their distances
  double points_per_scan = 0.0;   ///< median
  double non_finite_share = 0.0;  ///< of all points
  std::string sensor_frame;
  bool registered = false;            ///< the scans are in the target frame
  std::size_t scans_placed = 0U;      ///< whose sensor's pose is known
  std::vector<std::string> tf_chain;  ///< frames from the sensor's to the target frame
  double longest_tf_gap_s = 0.0;      ///< during the scans, of the chain's transforms
  double latest_tf_s = 0.0;           ///< 99 % of transforms are recorded so long after their stamp
  double density = 0.0;  ///< [1/m^2] median over the field, of points at stem height, see below
  double plant_height = 0.0;  ///< [m] median of the blocks with plants
  double area_m2 = 0.0;       ///< of field with points at stem height
  double soil_share = 0.0;    ///< of the blocks that show soil
  std::vector<Finding> findings;
};

/// Points count as at stem height between these shares of the height of a block's plants (0.3
/// to 1.2 m in maize of 2 m), ...
constexpr double kStemBandLow = 0.15;
constexpr double kStemBandHigh = 0.6;
/// ... and are counted, denoised and one a voxel, in squares of this size [m]. What is lower than
/// kLeastPlantHeight [m] is no plant that could be measured.
constexpr double kDensityCell = 0.5;
constexpr double kLeastPlantHeight = 0.2;

/// Reads a bag as the nodelets would. Places every scan; shows on stderr how far it is.
/// @throws std::runtime_error when it cannot be read as a bag at all
BagReport checkBag(const BagCheckRequest& request);

}  // namespace field_phenotyping
