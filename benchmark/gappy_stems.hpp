#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/preprocessing/ground_model.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping::benchmark {

/// Of a point from a surface [m].
struct SurfaceDistance {
  double value = 0.0;   ///< positive outside; NaN where nobody knows
  double stddev = 0.0;  ///< of the surface itself, where it was measured
};

/// The surface of a stem as it truly is. Metres, in the local frame of the stem's cloud.
struct TrueSurface {
  std::vector<Eigen::Vector3d> samples;  ///< all over it, about every 2 mm
  std::vector<std::uint32_t> cell;       ///< of each sample: a piece of about 1 cm x 1 cm
  std::vector<double> cell_area;         ///< [m^2]
  std::function<SurfaceDistance(const Eigen::Vector3d&)> distance;
};

/// What completion is given of a stem, and the truth about it.
struct GappyStem {
  std::string name;
  PointCloud cloud;
  StemAxis axis;  ///< as a segmentation gives it: some millimetres off
  GroundModel ground;
  TrueSurface truth;
};

/// What is missing of a stem.
struct Damage {
  std::string name;
  double gap = 0.0;            ///< length without any point [m]
  double shadow = 0.0;         ///< length of which only one half is seen [m]; 1e9: all of it
  double thinned_share = 0.0;  ///< of the points, at random
  double bend = 0.0;           ///< turn of the axis from base to top, beside its own [rad]
  double fork = 0.0;           ///< angle between two branches of the upper half [rad]
  int points = -1;             ///< of the whole stem, where not as the settings say
};

/// The damages that the figures are for: none, gaps of 5, 10 and 20 cm, a half-circle shadow of 40
/// cm, half of the points.
std::vector<Damage> standardDamages();

/// Stems that can hardly be completed, or not at all: one side, few points, bent, forked, nothing.
std::vector<Damage> oddStems();

/// How simulated stems are seen.
struct SimulatedStems {
  std::uint64_t seed = 1U;
  int points = 600;      ///< of a whole stem, spread evenly over its surface
  double noise = 0.003;  ///< standard deviation in x, in y and in z [m]
};

/// Stem `index` of a stand of maize at three stages: of the simulator, whose surface is exact.
GappyStem simulatedStem(const SimulatedStems& settings, int index, const Damage& damage);

/// A stem of the plant in a cloud of one real plant, as our own segmentation finds it; the
/// undamaged stem stands for the true surface, known where points were cut out.
/// @throws std::runtime_error when the file cannot be read or shows no stem
GappyStem realStem(const std::string& path, std::uint64_t seed, const Damage& damage);

}  // namespace field_phenotyping::benchmark
