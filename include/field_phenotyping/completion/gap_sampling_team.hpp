#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/completion/surface_index.hpp"

// Where a stretch of an unrolled stem has gaps, and the points in them (Eq 22), by a team of
// threads (see team.hpp), with the same bits whatever the team. Each member works on rows of cells
// of its own, then on gaps of its own; what joins runs of cells to gaps is left to one, for there
// are few.

namespace field_phenotyping {

/// Cells of the unrolled stem, about square; odd rows are shifted by half a cell, so that the
/// centres form an even pattern. A cell's number goes by rows, then along the row.
struct GapGrid {
  double begin = 0.0;         ///< arc length of the lowest row's lower edge [m]
  double row_height = 0.0;    ///< [m]
  double column_angle = 0.0;  ///< [rad]
  int rows = 0;
  int columns = 0;      ///< 3 or more
  bool is_odd = false;  ///< whether the lowest row is one of the shifted

  FIELD_PHENOTYPING_HD int cells() const { return rows * columns; }
  FIELD_PHENOTYPING_HD double shiftOf(int row) const {
    return (row % 2 != 0) != is_odd ? 0.75 : 0.25;
  }
  FIELD_PHENOTYPING_HD SurfacePosition center(int row, int column) const {
    constexpr double kPi = 3.14159265358979323846;
    return {-kPi + (column + shiftOf(row)) * column_angle, begin + (row + 0.5) * row_height};
  }
};

/// Radius and curvature of the cross-section where its mean radius is 1.
struct GapOutline {
  double radius = 1.0;
  double curvature = 1.0;
};

/// What gaps are looked for in. The memory is the caller's.
struct GapTask {
  const SurfacePosition* places;  ///< of measured points
  int count;                      ///< of those
  GapGrid grid;
  double reach;                ///< a cell with no place so near to its centre is missing [m]
  double mean_radius;          ///< of the whole stem [m]
  double density;              ///< that is asked for [1/m^2]
  const double* radii;         ///< of the stem at the centre of each row [m]
  const unsigned char* fills;  ///< of each row: whether it may be filled
  const GapOutline* outlines;  ///< of each column

  /// Most runs of missing cells that there can be.
  FIELD_PHENOTYPING_HD int mostRuns() const { return grid.rows * ((grid.columns + 1) / 2); }
};

/// A hole in the measured surface (the regions m of Eq 22).
struct Gap {
  double area;                ///< A_m [m^2]
  double volume;              ///< V_m, between the axis and the surface [m^3]
  double curvature;           ///< mean curvature of the cross-section, kappa_m [1/m]
  int first_cell;             ///< where its cells, in their order, begin among those of all gaps
  int cells;                  ///< how many they are
  std::int64_t samples;       ///< how many points it gets
  std::int64_t first_sample;  ///< where they begin among those of all gaps
};

/// How many points a gap gets (Eq 22 with N_0 = density * A_0):
///     N_m = density * A_m * (1/4 (V_m/A_m)/(V_0/A_0) + 1/2 + 1/4 kappa_m/kappa_0),
/// the reference being a cylinder of the stem's mean radius [m].
FIELD_PHENOTYPING_HD inline double expectedPoints(const Gap& gap, double density,
                                                  double mean_radius) {
  constexpr double kVolumeWeight = 0.25;  // they add up to 1
  constexpr double kAreaWeight = 0.5;
  constexpr double kCurvatureWeight = 0.25;
  const double relative_volume = gap.volume / gap.area / (0.5 * mean_radius);
  const double relative_curvature = gap.curvature * mean_radius;
  return density * gap.area *
         (kVolumeWeight * relative_volume + kAreaWeight + kCurvatureWeight * relative_curvature);
}

/// What the gaps of one task are in all.
struct GapTotals {
  int gaps = 0;
  int cells = 0;
  std::int64_t samples = 0;
  bool may_have_holes = false;  ///< a gap gets so few points that they leave holes
};

/// Missing cells side by side in one row.
struct GapRun {
  int first;  ///< cell
  int end;    ///< behind the last
  int gap;    ///< number of its gap
};

/// Rows of cells.
struct GapRows {
  int low;
  int high;  ///< the last
};

/// Memory for one GapTask, of which nothing need be set; all members of a team see the same.
struct GapScratch {
  int* run_begins;         ///< GapGrid::rows + 1
  GapRun* runs;            ///< GapTask::mostRuns()
  GapRows* rows;           ///< one for each member
  unsigned char* missing;  ///< GapGrid::cells()
};

template <class Team>
class GapFinder {
 public:
  FIELD_PHENOTYPING_HD GapFinder(const Team& team, const GapTask& task, const GapScratch& scratch)
      : team_(team),
        task_(task),
        grid_(task.grid),
        scratch_(scratch),
        rank_(static_cast<int>(team.rank())),
        size_(static_cast<int>(team.size())) {}

  /// Finds the gaps, in the order of their lowest cells; they are connected, also across theta =
  /// +-pi and over corners.
  /// @param gaps  room for GapTask::mostRuns()
  /// @param cells room for GapGrid::cells(): the cells of each gap, in their order
  /// @param totals all members may read them and the above afterwards
  FIELD_PHENOTYPING_HD void find(Gap* gaps, int* cells, GapTotals* totals) const {
    findMissing();
    findRuns();
    if (rank_ == 0) totals->gaps = joinRuns();
    team_.sync();
    measure(gaps, totals->gaps);
    team_.sync();
    if (rank_ == 0) addUp(gaps, *totals);
    team_.sync();
    listCells(gaps, totals->gaps, cells);
    team_.sync();
  }

 private:
  /// The first row at `low` or above that is this member's.
  FIELD_PHENOTYPING_HD int ownFrom(int low) const {
    if constexpr (Team::kAlone) return low;
    return low + (rank_ + size_ - low % size_) % size_;
  }

  /// Rows with cells that may have their centre within reach of a place.
  FIELD_PHENOTYPING_HD GapRows rowsAbout(const SurfacePosition& place) const {
    const auto low =
        static_cast<int>(std::floor((place.s - task_.reach - grid_.begin) / grid_.row_height));
    const auto high =
        static_cast<int>(std::floor((place.s + task_.reach - grid_.begin) / grid_.row_height)) + 1;
    return {low > 0 ? low : 0, high < grid_.rows - 1 ? high : grid_.rows - 1};
  }

  FIELD_PHENOTYPING_HD void findMissing() const {
    for (int row = rank_; row < grid_.rows; row += size_) {
      unsigned char* missing = scratch_.missing + row * grid_.columns;
      for (int column = 0; column < grid_.columns; ++column) missing[column] = task_.fills[row];
    }
    for (int first = 0; first < task_.count; first += size_) {
      const int end = first + size_ < task_.count ? first + size_ : task_.count;
      if (first + rank_ < end) scratch_.rows[rank_] = rowsAbout(task_.places[first + rank_]);
      team_.sync();
      for (int k = first; k < end; ++k) {
        const GapRows rows = scratch_.rows[k - first];
        for (int row = ownFrom(rows.low); row <= rows.high; row += size_) {
          cover(row, task_.places[k]);
        }
      }
      team_.sync();  // the rows are free again
    }
  }

  /// Takes the cells of a row that have their centre within reach of a place out of the missing.
  FIELD_PHENOTYPING_HD void cover(int row, const SurfacePosition& place) const {
    constexpr double kPi = 3.14159265358979323846;
    const double along = place.s - grid_.begin - (row + 0.5) * grid_.row_height;
    const double left = task_.reach * task_.reach - along * along;
    if (left < 0.0) return;
    const double half = std::sqrt(left) / (task_.mean_radius * grid_.column_angle);
    const double column = (place.theta + kPi) / grid_.column_angle - grid_.shiftOf(row);
    const auto low = static_cast<int>(std::ceil(column - half));
    const auto high = static_cast<int>(std::floor(column + half));
    const int most = high < low + grid_.columns - 1 ? high : low + grid_.columns - 1;
    unsigned char* missing = scratch_.missing + row * grid_.columns;
    for (int c = low; c <= most; ++c) {
      missing[(c % grid_.columns + grid_.columns) % grid_.columns] = 0U;
    }
  }

  /// visit(first, end) for the runs of missing cells of a row.
  template <class Visit>
  FIELD_PHENOTYPING_HD void forRunsOf(int row, const Visit& visit) const {
    const int end = (row + 1) * grid_.columns;
    for (int cell = row * grid_.columns; cell < end; ++cell) {
      if (scratch_.missing[cell] == 0U) continue;
      const int first = cell;
      while (cell < end && scratch_.missing[cell] != 0U) ++cell;
      visit(first, cell);
    }
  }

  FIELD_PHENOTYPING_HD void findRuns() const {
    int* begins = scratch_.run_begins;
    for (int row = rank_; row < grid_.rows; row += size_) {
      int count = 0;
      forRunsOf(row, [&](int, int) { ++count; });
      begins[row + 1] = count;
    }
    team_.sync();
    if (rank_ == 0) {
      begins[0] = 0;
      for (int row = 0; row < grid_.rows; ++row) begins[row + 1] += begins[row];
    }
    team_.sync();
    for (int row = rank_; row < grid_.rows; row += size_) {
      int at = begins[row];
      forRunsOf(row, [&](int first, int end) {
        scratch_.runs[at] = {first, end, at};
        ++at;
      });
    }
    team_.sync();
  }

  /// The lowest run that a run is known to be connected with.
  FIELD_PHENOTYPING_HD int lowestOf(int run) const {
    GapRun* runs = scratch_.runs;
    while (runs[run].gap != run) {
      runs[run].gap = runs[runs[run].gap].gap;
      run = runs[run].gap;
    }
    return run;
  }
  FIELD_PHENOTYPING_HD void join(int a, int b) const {
    const int low_a = lowestOf(a);
    const int low_b = lowestOf(b);
    if (low_a < low_b) {
      scratch_.runs[low_b].gap = low_a;
    } else {
      scratch_.runs[low_a].gap = low_b;
    }
  }

  /// Joins what is connected; numbers the gaps. By one member. @return how many there are
  FIELD_PHENOTYPING_HD int joinRuns() const {
    GapRun* runs = scratch_.runs;
    const int columns = grid_.columns;
    for (int row = 0; row < grid_.rows; ++row) {
      const int begin = scratch_.run_begins[row];
      const int end = scratch_.run_begins[row + 1];
      if (begin == end) continue;
      const bool at_left = runs[begin].first == row * columns;
      const bool at_right = runs[end - 1].end == (row + 1) * columns;
      if (at_left && at_right) join(begin, end - 1);
      if (row == 0) continue;
      const int below = scratch_.run_begins[row - 1];
      if (below == begin) continue;
      if (at_left && runs[begin - 1].end == row * columns) join(begin, begin - 1);
      if (at_right && runs[below].first == (row - 1) * columns) join(end - 1, below);
      for (int a = begin, b = below; a < end && b < begin;) {
        const int from = runs[b].first + columns - 1;  // over corners too
        const int to = runs[b].end + columns + 1;
        if (runs[a].first < to && runs[a].end > from) join(a, b);
        if (runs[a].end < runs[b].end + columns) {
          ++a;
        } else {
          ++b;
        }
      }
    }
    int gaps = 0;
    for (int run = 0; run < scratch_.run_begins[grid_.rows]; ++run) {
      // Those before it have the number of their gap already.
      const int known = runs[run].gap;
      runs[run].gap = known == run ? gaps++ : runs[known].gap;
    }
    return gaps;
  }

  FIELD_PHENOTYPING_HD bool isOwn(int gap) const {
    if constexpr (Team::kAlone) return true;
    return gap % size_ == rank_;
  }

  FIELD_PHENOTYPING_HD void measure(Gap* gaps, int count) const {
    for (int k = rank_; k < count; k += size_) gaps[k] = Gap();
    for (int row = 0; row < grid_.rows; ++row) {
      for (int k = scratch_.run_begins[row]; k < scratch_.run_begins[row + 1]; ++k) {
        const GapRun run = scratch_.runs[k];
        if (isOwn(run.gap)) add(row, run, gaps[run.gap]);
      }
    }
    for (int k = rank_; k < count; k += size_) {
      Gap& gap = gaps[k];
      gap.curvature /= gap.area;
      const double points = expectedPoints(gap, task_.density, task_.mean_radius);
      if (!(points > 0.0)) continue;
      const double whole = std::floor(points);
      const auto rounded = static_cast<std::int64_t>(points - whole < 0.5 ? whole : whole + 1.0);
      gap.samples = rounded > 1 ? rounded : 1;
    }
  }

  /// Adds a run's cells to its gap, whose curvature is summed up over the area.
  FIELD_PHENOTYPING_HD void add(int row, const GapRun& run, Gap& gap) const {
    const double radius = task_.radii[row];
    Gap sum = gap;
    for (int cell = run.first; cell < run.end; ++cell) {
      const GapOutline outline = task_.outlines[cell - row * grid_.columns];
      const double r = radius * outline.radius;
      const double area = r * grid_.column_angle * grid_.row_height;
      sum.area += area;
      sum.volume += 0.5 * r * area;
      sum.curvature += area * outline.curvature / radius;
    }
    sum.cells += run.end - run.first;
    gap = sum;
  }

  /// Says where each gap's cells and points begin. By one member.
  FIELD_PHENOTYPING_HD void addUp(Gap* gaps, GapTotals& totals) const {
    constexpr double kLeaky = 0.95;  // of the density: fewer points leave holes
    totals.cells = 0;
    totals.samples = 0;
    totals.may_have_holes = false;
    for (int k = 0; k < totals.gaps; ++k) {
      Gap& gap = gaps[k];
      gap.first_cell = totals.cells;
      gap.first_sample = totals.samples;
      totals.cells += gap.cells;
      totals.samples += gap.samples;
      const double points = expectedPoints(gap, task_.density, task_.mean_radius);
      if (points < kLeaky * task_.density * gap.area) totals.may_have_holes = true;
    }
  }

  FIELD_PHENOTYPING_HD void listCells(Gap* gaps, int count, int* cells) const {
    for (int k = 0; k < scratch_.run_begins[grid_.rows]; ++k) {
      const GapRun run = scratch_.runs[k];
      if (!isOwn(run.gap)) continue;
      Gap& gap = gaps[run.gap];
      int at = gap.first_cell;
      for (int cell = run.first; cell < run.end; ++cell) cells[at++] = cell;
      gap.first_cell = at;
    }
    for (int k = rank_; k < count; k += size_) gaps[k].first_cell -= gaps[k].cells;
  }

  const Team team_;
  const GapTask task_;
  const GapGrid grid_;
  const GapScratch scratch_;
  const int rank_;
  const int size_;
};

/// The points of all gaps, spread evenly over the cells of each.
/// @param samples room for GapTotals::samples
template <class Team>
FIELD_PHENOTYPING_HD void spreadOverGaps(const Team& team, const GapGrid& grid, const Gap* gaps,
                                         const int* cells, std::int64_t count,
                                         SurfacePosition* samples) {
  int k = 0;
  for (auto i = static_cast<std::int64_t>(team.rank()); i < count; i += team.size()) {
    while (i >= gaps[k].first_sample + gaps[k].samples) ++k;
    const Gap& gap = gaps[k];
    const double place = (static_cast<double>(i - gap.first_sample) + 0.5) * gap.cells /
                         static_cast<double>(gap.samples);
    const int at =
        static_cast<int>(place) < gap.cells - 1 ? static_cast<int>(place) : gap.cells - 1;
    const int cell = cells[gap.first_cell + at];
    SurfacePosition position = grid.center(cell / grid.columns, cell % grid.columns);
    position.theta += (place - at - 0.5) * grid.column_angle;
    samples[i] = position;
  }
}

}  // namespace field_phenotyping
