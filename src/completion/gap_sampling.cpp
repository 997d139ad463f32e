#include "field_phenotyping/completion/gap_sampling.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr std::size_t kDensityNeighbors = 8;
constexpr std::size_t kDensitySamples = 400;
// A cell is missing when no measured point is nearer to its centre than this share of the spacing:
// in a surface seen at the target density, 4 in 5 cells have one.
constexpr double kCoverage = 0.75;

// Weights of volume, area and curvature in Eq 22; they add up to 1.
constexpr double kVolumeWeight = 0.25;
constexpr double kAreaWeight = 0.5;
constexpr double kCurvatureWeight = 0.25;

/// Cells of the unrolled stem, about square; odd rows are shifted by half a cell, so that the
/// centres form an even pattern.
class CellGrid {
 public:
  CellGrid(const FillRange& range, double cell, double radius, long first_row)
      : begin_(range.begin),
        columns_(std::max(3, static_cast<int>(std::lround(2.0 * kPi * radius / cell)))),
        rows_(std::max(1, static_cast<int>(std::lround((range.end - range.begin) / cell)))),
        row_height_((range.end - range.begin) / rows_),
        is_odd_(first_row % 2 != 0) {}

  int rows() const { return rows_; }
  int columns() const { return columns_; }
  double columnAngle() const { return 2.0 * kPi / columns_; }
  double rowHeight() const { return row_height_; }
  std::size_t size() const {
    return static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_);
  }
  std::size_t cellAt(int row, int column) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>((column % columns_ + columns_) % columns_);
  }
  SurfacePosition center(int row, int column) const {
    return {-kPi + (column + shiftOf(row)) * columnAngle(), begin_ + (row + 0.5) * row_height_};
  }
  /// Calls visit(cell, row, column) for the cells whose centre is within `reach` [m] of a place.
  template <class Visit>
  void forEachWithin(const SurfacePosition& place, double reach, double radius,
                     Visit&& visit) const {
    const auto low = static_cast<int>(std::floor((place.s - reach - begin_) / row_height_));
    const auto high = static_cast<int>(std::floor((place.s + reach - begin_) / row_height_)) + 1;
    for (int row = std::max(low, 0); row <= std::min(high, rows_ - 1); ++row) {
      const double along = place.s - begin_ - (row + 0.5) * row_height_;
      const double left = reach * reach - along * along;
      if (left < 0.0) continue;
      const double half = std::sqrt(left) / (radius * columnAngle());
      const double column = (place.theta + kPi) / columnAngle() - shiftOf(row);
      const int most = std::min(static_cast<int>(std::floor(column + half)),
                                static_cast<int>(std::ceil(column - half)) + columns_ - 1);
      for (int c = static_cast<int>(std::ceil(column - half)); c <= most; ++c) {
        visit(cellAt(row, c));
      }
    }
  }

 private:
  double shiftOf(int row) const { return (row % 2 != 0) != is_odd_ ? 0.75 : 0.25; }

  double begin_;
  int columns_;
  int rows_;
  double row_height_;
  bool is_odd_;
};

/// Radius and curvature of the cross-section where its mean radius is 1.
struct Outline {
  double radius = 1.0;
  double curvature = 1.0;
};

Outline outlineAt(double theta, const std::array<double, 2>& ellipse) {
  const double cosine = std::cos(2.0 * theta);
  const double sine = std::sin(2.0 * theta);
  const double r = 1.0 + ellipse[0] * cosine + ellipse[1] * sine;
  const double first = 2.0 * (ellipse[1] * cosine - ellipse[0] * sine);
  const double second = 4.0 * (1.0 - r);
  return {r, (r * r + 2.0 * first * first - r * second) / std::pow(r * r + first * first, 1.5)};
}

/// Numbers the connected parts of the missing cells from 1, in order of their lowest cell; 0: not
/// missing. Returns how many there are.
int labelRegions(const CellGrid& grid, const std::vector<char>& missing, std::vector<int>& label) {
  label.assign(grid.size(), 0);
  int regions = 0;
  std::vector<std::size_t> open;
  const int last_column = grid.columns() - 1;
  for (std::size_t seed = 0; seed < grid.size(); ++seed) {
    if (missing[seed] == 0 || label[seed] != 0) continue;
    label[seed] = ++regions;
    open.assign(1, seed);
    while (!open.empty()) {
      const std::size_t cell = open.back();
      open.pop_back();
      const auto row = static_cast<int>(cell / static_cast<std::size_t>(grid.columns()));
      const auto column = static_cast<int>(cell % static_cast<std::size_t>(grid.columns()));
      const std::array<int, 3> columns{column > 0 ? column - 1 : last_column, column,
                                       column < last_column ? column + 1 : 0};
      for (int r = std::max(row - 1, 0); r <= std::min(row + 1, grid.rows() - 1); ++r) {
        const std::size_t first =
            static_cast<std::size_t>(r) * static_cast<std::size_t>(grid.columns());
        for (const int c : columns) {
          const std::size_t neighbor = first + static_cast<std::size_t>(c);
          if (missing[neighbor] == 0 || label[neighbor] != 0) continue;
          label[neighbor] = regions;
          open.push_back(neighbor);
        }
      }
    }
  }
  return regions;
}

/// Adds one cell to a region; its curvature is summed up over the area.
void addCell(const CellGrid& grid, const SurfacePosition& center, double mean_radius,
             const Outline& outline, GapRegion& region) {
  const double r = mean_radius * outline.radius;
  const double area = r * grid.columnAngle() * grid.rowHeight();
  region.cells.push_back(center);
  region.area += area;
  region.volume += 0.5 * r * area;
  region.curvature += area * outline.curvature / mean_radius;
}

}  // namespace

bool FillRange::contains(double s) const {
  if (s < begin || s > end) return false;
  return std::none_of(open.begin(), open.end(), [&](const std::pair<double, double>& gap) {
    return s > gap.first && s < gap.second;
  });
}

FillRange findFillRange(std::vector<double> arc_lengths, double max_gap) {
  if (arc_lengths.empty()) return {};
  std::sort(arc_lengths.begin(), arc_lengths.end());
  FillRange range;
  range.begin = arc_lengths.front();
  range.end = arc_lengths.back();
  for (std::size_t i = 1; i < arc_lengths.size(); ++i) {
    if (arc_lengths[i] - arc_lengths[i - 1] > max_gap) {
      range.open.emplace_back(arc_lengths[i - 1], arc_lengths[i]);
    }
  }
  return range;
}

double medianDensity(const SurfaceIndex& measured, const std::vector<SurfacePosition>& positions) {
  if (positions.size() <= kDensityNeighbors) return 0.0;
  const std::size_t stride = 1 + positions.size() / kDensitySamples;
  std::vector<double> densities;
  for (std::size_t i = 0; i < positions.size(); i += stride) {
    const auto nearest = measured.nearest<kDensityNeighbors + 1>(positions[i]);  // and itself
    const double squared_reach = nearest.squared_distance[kDensityNeighbors];
    densities.push_back(static_cast<double>(kDensityNeighbors) /
                        (kPi * std::max(squared_reach, 1e-12)));
  }
  return medianOf(std::move(densities));
}

double rowHeight(double length, double density) {
  return length / std::max(1.0, std::round(length * std::sqrt(density)));
}

std::vector<GapRegion> findGaps(const std::vector<SurfacePosition>& measured,
                                const FillRange& range, double density, const StemShape& shape,
                                double mean_radius, long first_row) {
  if (!(density > 0.0) || !(range.end > range.begin)) return {};
  const double spacing = 1.0 / std::sqrt(density);
  const CellGrid grid(range, spacing, mean_radius, first_row);
  std::vector<char> missing(grid.size(), 1);
  for (const SurfacePosition& place : measured) {
    grid.forEachWithin(place, kCoverage * spacing, mean_radius,
                       [&](std::size_t cell) { missing[cell] = 0; });
  }
  std::vector<double> radii;
  std::vector<Outline> outlines;
  for (int column = 0; column < grid.columns(); ++column) {
    outlines.push_back(outlineAt(grid.center(0, column).theta, shape.ellipse));
  }
  for (int row = 0; row < grid.rows(); ++row) {
    const double s = grid.center(row, 0).s;
    radii.push_back(shape.radius(s));
    if (range.contains(s)) continue;
    for (int column = 0; column < grid.columns(); ++column) missing[grid.cellAt(row, column)] = 0;
  }
  std::vector<int> label;
  GapRegion none;
  none.cell_angle = grid.columnAngle();
  std::vector<GapRegion> regions(static_cast<std::size_t>(labelRegions(grid, missing, label)),
                                 none);
  std::size_t cell = 0;
  for (int row = 0; row < grid.rows(); ++row) {
    for (int column = 0; column < grid.columns(); ++column, ++cell) {
      if (label[cell] == 0) continue;
      addCell(grid, grid.center(row, column), radii[static_cast<std::size_t>(row)],
              outlines[static_cast<std::size_t>(column)],
              regions[static_cast<std::size_t>(label[cell] - 1)]);
    }
  }
  for (GapRegion& region : regions) region.curvature /= region.area;
  return regions;
}

double expectedPoints(const GapRegion& region, double density, double mean_radius) {
  const double relative_volume = region.volume / region.area / (0.5 * mean_radius);
  const double relative_curvature = region.curvature * mean_radius;
  return density * region.area *
         (kVolumeWeight * relative_volume + kAreaWeight + kCurvatureWeight * relative_curvature);
}

void sampleRegion(const GapRegion& region, double count, std::vector<SurfacePosition>& samples) {
  if (region.cells.empty() || !(count > 0.0)) return;
  const auto number = std::max(1L, std::lround(count));
  const double cells = static_cast<double>(region.cells.size());
  for (long i = 0; i < number; ++i) {
    const double place = (static_cast<double>(i) + 0.5) * cells / static_cast<double>(number);
    const auto cell = std::min(static_cast<std::size_t>(place), region.cells.size() - 1);
    SurfacePosition position = region.cells[cell];
    position.theta += (place - static_cast<double>(cell) - 0.5) * region.cell_angle;
    samples.push_back(position);
  }
}

}  // namespace field_phenotyping
