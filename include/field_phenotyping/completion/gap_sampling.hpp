#pragma once

#include <array>
#include <functional>
#include <utility>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/gap_sampling_team.hpp"
#include "field_phenotyping/completion/surface_index.hpp"

namespace field_phenotyping {

/// Part of the stem that may be filled.
struct FillRange {
  double begin = 0.0;  ///< arc length [m]
  double end = 0.0;
  std::vector<std::pair<double, double>> open;  ///< gaps inside it that are too long to fill

  bool contains(double s) const;
};

/// The range between the first and the last measured point, without the gaps along the stem that
/// are longer than `max_gap` [m]. Empty for no points.
/// @param arc_lengths of the measured points [m], any order
FillRange findFillRange(std::vector<double> arc_lengths, double max_gap);

/// The stem's own density: median of k / (pi r_k^2) over the measured points [1/m^2]; 0 when there
/// are too few of them.
double medianDensity(const SurfaceIndex& measured, const std::vector<SurfacePosition>& positions);

/// The stem's surface as far as areas and curvatures need it:
/// r(theta, s) = radius(s) (1 + ellipse[0] cos 2 theta + ellipse[1] sin 2 theta).
struct StemShape {
  std::function<double(double s)> radius;  ///< [m]
  std::array<double, 2> ellipse{0.0, 0.0};
};

/// Where gaps are looked for, and what is to fill them.
struct GapsToFill {
  std::vector<SurfacePosition> measured;  ///< of and round the range, any order
  FillRange range;
  double density = 0.0;  ///< [1/m^2] of points that is asked for
  StemShape shape;
  double mean_radius = 0.0;  ///< of the whole stem [m]
  long first_row = 0;  ///< number of the lowest row of cells: odd rows are shifted by half a cell
};

/// A hole in the measured surface (the regions m of paper Eq 22).
struct GapRegion {
  Gap gap;
  std::vector<SurfacePosition> cells;  ///< centres of its cells, row by row
};

/// Connected parts of the unrolled stem, periodic in theta, where measured points are farther apart
/// than the density asks for. In order of their lowest cell.
std::vector<GapRegion> findGaps(const GapsToFill& given);

/// Points that fill gaps.
struct GapSamples {
  std::vector<SurfacePosition> places;  ///< gap by gap
  bool may_have_holes = false;          ///< Eq 22 asks for so few in a gap that they leave holes
};

/// As many points in each gap as Eq 22 asks for, see expectedPoints(), spread evenly.
GapSamples sampleGaps(const GapsToFill& given);

/// The same of many stretches at once, a thread block each, on the GPU; with the same bits. What
/// the GPU cannot do the CPU does, on all cores. Thread-safe.
/// @param given not null
std::vector<GapSamples> sampleGaps(const std::vector<const GapsToFill*>& given,
                                   const ComputeDevice& device);

/// Height of a row of cells: a whole number of them in `length` [m].
double rowHeight(double length, double density);

}  // namespace field_phenotyping
