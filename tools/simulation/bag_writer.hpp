#pragma once

#include <string>

#include "simulation/simulation.hpp"

namespace field_phenotyping::simulation {

/// How a simulation is put into a bag.
struct BagSettings {
  double start_time = 1700000000.0;  ///< stamp of the first scan [s]; fixed: same seed, same bytes
  bool registered = false;           ///< scans in the frame `map` instead of `lidar`
};

/// @brief Writes a ROS 1 bag.
///
/// - `/points` (sensor_msgs/PointCloud2, one per turn): x y z intensity, float32, in frame `lidar`
///   at the stamp of the turn's first pulse, written when the turn is over. With `registered` in
///   frame `map`; x y z are then float64 where needsDoublePrecision.
/// - `/tf` at 50 Hz and at each scan's stamp: `map` -> `base_link`, and `mast` -> `lidar` where the
///   head turns.
/// - `/tf_static`, latched: `base_link` -> `mast`, and `mast` -> `lidar` where the head stands
/// still.
/// @throws std::runtime_error When the file cannot be written.
void writeBag(const Simulation& simulation, const BagSettings& settings, const std::string& path,
              const ProgressCallback& progress);

}  // namespace field_phenotyping::simulation
