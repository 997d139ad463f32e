#pragma once

#include <functional>
#include <string>
#include <vector>

#include "completion_scores.hpp"
#include "gappy_stems.hpp"

namespace field_phenotyping::benchmark {

/// Another way to fill gaps, with one choice of its settings.
struct Rival {
  std::string method;
  std::string settings;
  /// Fills a stem to a density [1/m^2]; counts its own seconds.
  std::function<FilledStem(const GappyStem&, double density)> fill;
};

/// The four others of Table 6 of the paper, each with every choice of its settings that is tried:
///   MLS  pcl::MovingLeastSquares with upsampling; what it makes is thinned to the density
///   kNN  radius at an empty place of the unrolled stem: mean of the k nearest, by inverse distance
///   VGC  voxel grid completion: closing of the occupied voxels by a ball; points are made in the
///        middle of new voxels of the surface
///   NNI  radius at an empty place of the unrolled stem by natural neighbour interpolation (Sibson)
///        over CGAL's Delaunay triangulation; left out where the program was built without CGAL
/// kNN and NNI unroll the stem about the axis that it is given with, and fill the whole range of
/// the measured points.
std::vector<Rival> rivalMethods();

}  // namespace field_phenotyping::benchmark
