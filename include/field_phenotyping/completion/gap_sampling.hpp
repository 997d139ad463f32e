#pragma once

#include <array>
#include <functional>
#include <utility>
#include <vector>

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

/// A hole in the measured surface (the regions m of paper Eq 22).
struct GapRegion {
  std::vector<SurfacePosition> cells;  ///< centres of its cells, row by row
  double cell_angle = 0.0;             ///< width of a cell [rad]
  double area = 0.0;                   ///< A_m [m^2]
  double volume = 0.0;                 ///< V_m, between the axis and the surface [m^3]
  double curvature = 0.0;              ///< mean curvature of the cross-section, kappa_m [1/m]
};

/// The stem's own density: median of k / (pi r_k^2) over the measured points [1/m^2]; 0 when there
/// are too few of them.
double medianDensity(const SurfaceIndex& measured, const std::vector<SurfacePosition>& positions);

/// The stem's surface as far as areas and curvatures need it:
/// r(theta, s) = radius(s) (1 + ellipse[0] cos 2 theta + ellipse[1] sin 2 theta).
struct StemShape {
  std::function<double(double s)> radius;  ///< [m]
  std::array<double, 2> ellipse{0.0, 0.0};
};

/// Connected parts of the unrolled stem, periodic in theta, where measured points are farther apart
/// than `density` [1/m^2] asks for. In order of their lowest cell.
/// @param measured those of and round the range, any order
/// @param mean_radius of the whole stem [m]
/// @param first_row number of the lowest row of cells: odd rows are shifted by half a cell
std::vector<GapRegion> findGaps(const std::vector<SurfacePosition>& measured,
                                const FillRange& range, double density, const StemShape& shape,
                                double mean_radius, long first_row = 0);

/// Height of a row of cells: a whole number of them in `length` [m].
double rowHeight(double length, double density);

/// How many points a region gets (Eq 22 with N_0 = density * A_0):
///     N_m = density * A_m * (1/4 (V_m/A_m)/(V_0/A_0) + 1/2 + 1/4 kappa_m/kappa_0),
/// the reference being a cylinder of the stem's mean radius [m].
double expectedPoints(const GapRegion& region, double density, double mean_radius);

/// Spreads round(count) positions evenly over the cells of the region.
void sampleRegion(const GapRegion& region, double count, std::vector<SurfacePosition>& samples);

}  // namespace field_phenotyping
