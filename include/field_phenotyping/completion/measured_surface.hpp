#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"

namespace field_phenotyping {

constexpr double kSliceLength = 0.06;  ///< [m] of stem; slices are numbered along its given axis

/// The measured points of one stem on its coarse model (paper Eq 17), averaged over small cells of
/// the unrolled surface: however many points there are, what is made of them is made of a bounded
/// number of cells. Read-only after construction, so safe to read from any thread.
class MeasuredSurface {
 public:
  /// One measured point.
  struct Point {
    SurfacePosition position;
    Eigen::Vector3f outward = Eigen::Vector3f::UnitX();  ///< unit vector from the axis
    float deviation = 0.0F;   ///< from the prior surface, noise bias taken off [m]
    float noise_bias = 0.0F;  ///< that was taken off [m]
    bool on_surface = false;  ///< not a leaf's, and within the coarse model's length
  };

  /// Mean of the points on the surface within a cell.
  struct Cell {
    SurfacePosition position;
    double deviation = 0.0;                         ///< [m]
    double weight = 0.0;                            ///< how many points, each by how well it fits
    Eigen::Vector3f rgb = Eigen::Vector3f::Zero();  ///< 0 ... 255
  };

  struct Slice {
    std::uint64_t hash = 0U;      ///< of its points and their colours, whatever their order
    std::size_t points = 0U;      ///< all
    std::size_t on_surface = 0U;  ///< of them
    std::size_t cells_end = 0U;   ///< its cells end there
    std::size_t places_end = 0U;  ///< its places, likewise
  };

  /// Points in a piece of the surface of 2 cm by a sixth of the circumference, on the surface or
  /// not: what they say about how well the coarse model describes the stem there.
  struct Patch {
    double points = 0.0;
    double sum = 0.0;      ///< of the deviations, limited to one radius [m]
    double squares = 0.0;  ///< of their squares [m^2]
  };
  static constexpr int kPatchRows = 3;  ///< of a slice
  static constexpr int kPatchColumns = 6;

  /// @param cell about how long and wide cells are [m]
  MeasuredSurface(const PointCloud& cloud, IndexSpan stem, const SurfacePrior& prior, double cell);

  const std::vector<Point>& points() const { return points_; }  ///< in the order of the cloud
  bool hasColors() const { return has_colors_; }
  /// Points on the surface.
  std::size_t size() const { return places_.size(); }

  /// By slice, by row and round the stem.
  const std::vector<Cell>& cells() const { return cells_; }
  /// Where the points on the surface are, by slice.
  const std::vector<SurfacePosition>& places() const { return places_; }

  /// Slice `number`; an empty one where nothing was measured.
  Slice slice(long number) const;
  /// Indices of the cells of slices [first, last).
  std::pair<std::size_t, std::size_t> cellsOf(long first, long last) const;
  /// Indices of the places of slices [first, last).
  std::pair<std::size_t, std::size_t> placesOf(long first, long last) const;

  /// @param row from the slice's lower end; may lie in another slice
  /// @param column from theta = -pi; any number
  Patch patch(long slice, int row, int column) const;

  /// Squared standard deviation of one point that is the sensor's alone: by which points that lie
  /// next to one another differ, the coarse model being right or wrong [m^2].
  double noiseVariance() const { return noise_variance_; }
  /// Standard error of that [m^2].
  double noiseVarianceError() const { return noise_variance_error_; }
  /// All patches as one.
  const Patch& whole() const { return whole_; }

  double rowHeight() const { return kSliceLength / rows_; }  ///< of the cells [m]
  int rowsPerSlice() const { return rows_; }
  int columns() const { return columns_; }

  /// Arc lengths [m] of the lowest and the highest point, on the surface or not.
  double lowest() const { return lowest_; }
  double highest() const { return highest_; }
  /// Arc lengths of the lowest and the highest point on the surface in each row of cells that has
  /// some, ascending.
  const std::vector<double>& rowEnds() const { return row_ends_; }

 private:
  struct CellSums;

  /// @param i, p number of the point in the cloud, and what it becomes
  void addPoint(const PointCloud& cloud, std::uint32_t i, const SurfacePrior& prior, Point& p,
                CellSums& sums);
  void averageCells(const SurfacePrior& prior, const CellSums& sums);
  void sortPlaces(const SurfacePrior& prior);
  std::size_t indexOf(long slice) const;
  /// By how much pairs of points in cells of a width [m] that lie side by side differ.
  std::vector<float> differencesWithin(double width, const SurfacePrior& prior) const;
  void estimateNoise(const SurfacePrior& prior);

  std::vector<Point> points_;
  std::vector<Cell> cells_;
  std::vector<SurfacePosition> places_;
  std::vector<Slice> slices_;
  std::vector<double> row_ends_;
  std::vector<Patch> patches_;
  Patch whole_;
  double noise_variance_ = 0.0;
  double noise_variance_error_ = 0.0;
  bool has_colors_ = false;
  long first_slice_ = 0;
  int rows_ = 1;
  int columns_ = 3;
  double lowest_ = 0.0;
  double highest_ = 0.0;
};

/// Number of the slice at an arc length of the prior's frame [m].
long sliceAt(const SurfacePrior& prior, double s);
/// Where a slice begins: arc length of the prior's frame [m].
double sliceBegin(const SurfacePrior& prior, long slice);

/// 0x00RRGGBB as three numbers from 0 to 255, and back.
Eigen::Vector3f rgbOf(std::uint32_t color);
std::uint32_t packed(const Eigen::Vector3f& rgb);

}  // namespace field_phenotyping
