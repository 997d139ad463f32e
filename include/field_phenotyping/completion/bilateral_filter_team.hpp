#pragma once

#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/completion/surface_index.hpp"

// The bilateral filter of Eq 25 at the nodes of its grid, by a team of threads (see team.hpp), with
// the same bits whatever the team.

namespace field_phenotyping {

/// rgb in [0, 1].
struct FilterColor {
  float r = 0.0F;
  float g = 0.0F;
  float b = 0.0F;

  FIELD_PHENOTYPING_HD double squaredDistance(const FilterColor& o) const {
    return static_cast<double>((r - o.r) * (r - o.r) +
                               ((g - o.g) * (g - o.g) + (b - o.b) * (b - o.b)));
  }
};

/// One or more points of the completed stem in about one place, as the filter sees them.
struct FilterPoint {
  SurfacePosition position;
  double deviation = 0.0;  ///< from the stem's prior surface, along its normal [m]
  double weight = 1.0;     ///< how many points they are
  FilterColor color;
  bool is_read = true;  ///< whether the filter will be read in its cell of the grid
};

/// Cells of a stretch of the unrolled stem: rows begin at s = 0, columns at theta = -pi.
struct FilterGrid {
  double row_height = 0.0;  ///< [m]
  int rows = 0;
  int columns = 0;

  /// From one row below the stretch to one above it.
  FIELD_PHENOTYPING_HD int nodes() const { return (rows + 2) * columns; }
};

/// What the filter says in the middle of a cell.
struct FilterNode {
  float deviation = 0.0F;  ///< [m]
  float weight = 0.0F;     ///< 0: unknown
};

/// Shares of the four nodes round a place.
struct FilterCorners {
  int row;     ///< of the lower two
  int column;  ///< of the left two
  int next_column;
  double share[4];  ///< lower left, lower right, upper left, upper right

  FIELD_PHENOTYPING_HD FilterCorners(const FilterGrid& grid, const SurfacePosition& place) {
    constexpr double kPi = 3.14159265358979323846;
    const double up = place.s / grid.row_height - 0.5;
    const double turn = (place.theta + kPi) / (2.0 * kPi);
    const double round = (turn - std::floor(turn)) * grid.columns - 0.5;
    row = static_cast<int>(std::floor(up));
    const auto left = static_cast<int>(std::floor(round));
    const double b = up - row;
    const double a = round - left;
    column = left < 0 ? left + grid.columns : left;
    next_column = left + 1 >= grid.columns ? 0 : left + 1;
    share[0] = (1.0 - a) * (1.0 - b);
    share[1] = a * (1.0 - b);
    share[2] = (1.0 - a) * b;
    share[3] = a * b;
  }
};

/// What is to be filtered, and how. The memory is the caller's.
struct FilterTask {
  const FilterPoint* points;
  int count;
  FilterGrid grid;
  const double* along;   ///< kernel of the nodes 0, 1, ... to one side, along the stem
  const double* around;  ///< likewise, round it
  int reach_along;       ///< the last of these nodes
  int reach_around;      ///< likewise; less than half of the columns
  bool by_color;
  double per_attribute;  ///< of squared differences of colours

  /// Rows that sums are kept of beyond the stretch, on either side.
  FIELD_PHENOTYPING_HD int beyond() const { return reach_along + 1; }
  /// Nodes that sums are kept of.
  FIELD_PHENOTYPING_HD int sums() const { return (grid.rows + 2 * beyond()) * grid.columns; }
  /// A row with what follows it round the stem on either side.
  FIELD_PHENOTYPING_HD int wideRow() const { return grid.columns + 2 * reach_around; }
};

/// Memory for one FilterTask, of which nothing need be set; all members of a team see the same.
struct FilterScratch {
  double* weight;          ///< FilterTask::sums()
  double* value;           ///< likewise
  FilterColor* color;      ///< likewise; by colour only
  unsigned char* is_read;  ///< likewise
  double* rows;            ///< FilterTask::wideRow() for each group of the team
};

template <class Team>
class FilterSolver {
 public:
  FIELD_PHENOTYPING_HD FilterSolver(const Team& team, const FilterTask& task,
                                    const FilterScratch& scratch)
      : team_(team), task_(task), grid_(task.grid), scratch_(scratch) {}

  /// @param nodes FilterGrid::nodes(); complete after the next sync()
  /// @param colors likewise, of the nodes; by colour only
  FIELD_PHENOTYPING_HD void run(FilterNode* nodes, FilterColor* colors) {
    addPoints();
    team_.sync();
    if (task_.by_color) {
      for (int i = rank(); i < task_.sums(); i += size()) {
        if (!(scratch_.weight[i] > 0.0)) continue;
        const auto weight = static_cast<float>(scratch_.weight[i]);
        FilterColor& color = scratch_.color[i];
        color = {color.r / weight, color.g / weight, color.b / weight};
      }
    } else {
      blurAround(scratch_.weight);
      blurAround(scratch_.value);
    }
    team_.sync();
    if (task_.by_color) {
      for (int node = rank(); node < grid_.nodes(); node += size()) {
        const int row = node / grid_.columns - 1;
        const int column = node % grid_.columns;
        const int here = at(row, column);
        nodes[node] = scratch_.is_read[here] != 0U ? nodeOfColor(row, column) : FilterNode{};
        colors[node] = nodes[node].weight > 0.0F ? scratch_.color[here] : FilterColor{};
      }
      return;
    }
    const int pieces = (grid_.columns + kTogether - 1) / kTogether;
    for (int piece = rank(); piece < (grid_.rows + 2) * pieces; piece += size()) {
      const int row = piece / pieces;
      const int column = piece % pieces * kTogether;
      FilterNode* const first = nodes + row * grid_.columns + column;
      if (column + kTogether <= grid_.columns) {
        blurAlong<kTogether>(row - 1, column, first);
      } else {
        for (int k = 0; column + k < grid_.columns; ++k)
          blurAlong<1>(row - 1, column + k, first + k);
      }
    }
  }

 private:
  static constexpr int kTogether = Team::kAlone ? 4 : 1;  // nodes of a row that a member sums

  FIELD_PHENOTYPING_HD int rank() const { return static_cast<int>(team_.rank()); }
  FIELD_PHENOTYPING_HD int size() const { return static_cast<int>(team_.size()); }
  FIELD_PHENOTYPING_HD int at(int row, int column) const {
    return (row + task_.beyond()) * grid_.columns + column;
  }
  /// A column at most one turn beside those of the grid.
  FIELD_PHENOTYPING_HD int turned(int column) const {
    return column < 0                ? column + grid_.columns
           : column >= grid_.columns ? column - grid_.columns
                                     : column;
  }
  /// Whether this member is the one that adds to a node: so every sum is made in one order.
  FIELD_PHENOTYPING_HD bool isOwn(int node) const {
    if constexpr (Team::kAlone) return true;
    return node % size() == rank();
  }

  /// What lies about each node.
  FIELD_PHENOTYPING_HD void addPoints() const {
    for (int i = rank(); i < task_.sums(); i += size()) {
      scratch_.weight[i] = 0.0;
      scratch_.value[i] = 0.0;
      scratch_.is_read[i] = 0U;
      if (task_.by_color) scratch_.color[i] = {};
    }
    team_.sync();
    for (int i = 0; i < task_.count; ++i) {
      const FilterPoint& point = task_.points[i];
      const FilterCorners corners(grid_, point.position);
      if (corners.row < -task_.beyond() || corners.row + 1 >= grid_.rows + task_.beyond()) continue;
      addTo(at(corners.row, corners.column), corners.share[0], point);
      addTo(at(corners.row, corners.next_column), corners.share[1], point);
      addTo(at(corners.row + 1, corners.column), corners.share[2], point);
      addTo(at(corners.row + 1, corners.next_column), corners.share[3], point);
      if (point.is_read) noteRead(point.position);
    }
  }

  FIELD_PHENOTYPING_HD void addTo(int node, double share, const FilterPoint& point) const {
    if (!isOwn(node)) return;
    const double w = share * point.weight;
    scratch_.weight[node] += w;
    scratch_.value[node] += w * point.deviation;
    if (!task_.by_color) return;
    const auto by = static_cast<float>(w);
    FilterColor& color = scratch_.color[node];
    color = {color.r + by * point.color.r, color.g + by * point.color.g,
             color.b + by * point.color.b};
  }

  /// What lies in a cell is read off the nodes of that cell and of those round it.
  FIELD_PHENOTYPING_HD void noteRead(const SurfacePosition& place) const {
    constexpr double kPi = 3.14159265358979323846;
    const int beyond = task_.beyond();
    const auto row = static_cast<int>(std::floor(place.s / grid_.row_height));
    const double turn = (place.theta + kPi) / (2.0 * kPi);
    const auto column = static_cast<int>((turn - std::floor(turn)) * grid_.columns);
    const int first = row - 1 > -beyond ? row - 1 : -beyond;
    const int last = row + 1 < grid_.rows + beyond - 1 ? row + 1 : grid_.rows + beyond - 1;
    for (int r = first; r <= last; ++r) {
      for (int c = column - 1; c <= column + 1; ++c) {
        const int node = at(r, turned(c));
        if (isOwn(node)) scratch_.is_read[node] = 1U;
      }
    }
  }

  /// Sums round the stem, in place, a row by each group of the team.
  FIELD_PHENOTYPING_HD void blurAround(double* values) const {
    const int groups = static_cast<int>(team_.groups());
    const int group = static_cast<int>(team_.group());
    const int lanes = size() / groups;
    const int lane = rank() - group * lanes;
    const int columns = grid_.columns;
    const int reach = task_.reach_around;
    double* wide = scratch_.rows + group * task_.wideRow();
    for (int row = group; row < grid_.rows + 2 * task_.beyond(); row += groups) {
      double* of_row = values + row * columns;
      for (int c = lane; c < columns; c += lanes) wide[reach + c] = of_row[c];
      for (int c = lane; c < reach; c += lanes) {
        wide[c] = of_row[columns - reach + c];
        wide[reach + columns + c] = of_row[c];
      }
      team_.lanes().meet();
      int c = lane * kTogether;
      for (; c + kTogether <= columns; c += lanes * kTogether) {
        sumAround<kTogether>(wide + reach + c, of_row + c);
      }
      for (; c < columns; ++c) sumAround<1>(wide + reach + c, of_row + c);
      team_.lanes().meet();
    }
  }
  template <int kNodes>
  FIELD_PHENOTYPING_HD void sumAround(const double* middle, double* result) const {
    double sum[kNodes];
    for (int j = 0; j < kNodes; ++j) sum[j] = task_.around[0] * middle[j];
    for (int k = 1; k <= task_.reach_around; ++k) {
      const double around = task_.around[k];
      for (int j = 0; j < kNodes; ++j) sum[j] += around * (middle[j + k] + middle[j - k]);
    }
    for (int j = 0; j < kNodes; ++j) result[j] = sum[j];
  }

  /// Sums along the stem: some nodes of a row.
  template <int kNodes>
  FIELD_PHENOTYPING_HD void blurAlong(int row, int column, FilterNode* nodes) const {
    double weight[kNodes] = {};
    double value[kNodes] = {};
    const int here = at(row, column);
    bool is_read = false;
    for (int j = 0; j < kNodes; ++j) is_read = is_read || scratch_.is_read[here + j] != 0U;
    for (int up = -task_.reach_along; is_read && up <= task_.reach_along; ++up) {
      const double along = task_.along[up < 0 ? -up : up];
      const double* weights = scratch_.weight + here + up * grid_.columns;
      const double* values = scratch_.value + here + up * grid_.columns;
      for (int j = 0; j < kNodes; ++j) {
        weight[j] += along * weights[j];
        value[j] += along * values[j];
      }
    }
    for (int j = 0; j < kNodes; ++j) {
      const bool known = scratch_.is_read[here + j] != 0U && weight[j] > 0.0;
      nodes[j] = known ? FilterNode{static_cast<float>(value[j] / weight[j]), 1.0F} : FilterNode{};
    }
  }

  FIELD_PHENOTYPING_HD FilterNode nodeOfColor(int row, int column) const {
    double weight = 0.0;
    double value = 0.0;
    const FilterColor& color = scratch_.color[at(row, column)];
    for (int up = -task_.reach_along; up <= task_.reach_along; ++up) {
      const double along = task_.along[up < 0 ? -up : up];
      for (int side = -task_.reach_around; side <= task_.reach_around; ++side) {
        const int i = at(row + up, turned(column + side));
        if (!(scratch_.weight[i] > 0.0)) continue;
        const double w =
            along * task_.around[side < 0 ? -side : side] *
            exponential(-task_.per_attribute * scratch_.color[i].squaredDistance(color));
        weight += w * scratch_.weight[i];
        value += w * scratch_.value[i];
      }
    }
    if (!(weight > 0.0)) return {};
    return {static_cast<float>(value / weight), 1.0F};
  }

  const Team& team_;
  const FilterTask& task_;
  FilterGrid grid_;
  FilterScratch scratch_;
};

}  // namespace field_phenotyping
