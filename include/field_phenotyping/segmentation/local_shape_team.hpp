#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/segmentation/principal_axes.hpp"

namespace field_phenotyping {

// What computeLocalShapes() does, for a team of threads (see team.hpp), on the CPU and on the GPU.

/// LocalShape, in plain numbers.
struct LocalShapeNumbers {
  Place direction = {0.0F, 0.0F, 1.0F};
  Place normal = {1.0F, 0.0F, 0.0F};
  float linearity = 0.0F;
  float curvature = 0.0F;
  std::uint32_t neighbors = 0U;
};

/// Fewer points show no shape.
constexpr float kLeastShapePoints = 5.0F;

/// What the axes of the points' covariance say of their shape.
template <class Float>
struct ShapeOfAxes {
  Float known;  ///< not 0 where there is one
  principal_axes::Vector<Float> direction;
  principal_axes::Vector<Float> normal;
  Float linearity;
  Float curvature;
};

template <class Lanes, class Float = typename Lanes::Float>
FIELD_PHENOTYPING_HD ShapeOfAxes<Float> shapeOfAxes(
    const principal_axes::Matrix<Float>& covariance) {
  const principal_axes::Axes<Float> axes = principal_axes::axesOf<Lanes>(covariance);
  const Float none = Lanes::all(0.0F);
  const Float least = Lanes::larger(axes.values[0], none);
  const Float middle = Lanes::larger(axes.values[1], none);
  const Float most = axes.values[2];
  const principal_axes::Vector<Float>& along = axes.axes[2];
  const principal_axes::Vector<Float> opposite{-along.x, -along.y, -along.z};
  return {Lanes::choose(most > 0.0F, Lanes::all(1.0F), none),
          principal_axes::chosen<Lanes>(along.z < 0.0F, opposite, along), axes.axes[0],
          (most - middle) / most, least / (least + (middle + most))};
}

FIELD_PHENOTYPING_HD inline LocalShapeNumbers localShapeOf(const Moments& moments) {
  LocalShapeNumbers shape;
  shape.neighbors = static_cast<std::uint32_t>(moments.count);
  if (moments.count < kLeastShapePoints) return shape;
  const Symmetric3 m = moments.covariance();
  const ShapeOfAxes<float> found = shapeOfAxes<ThreadLanes>({m.xx, m.yy, m.zz, m.xy, m.yz, m.zx});
  if (!(found.known > 0.0F)) return shape;
  shape.direction = {found.direction.x, found.direction.y, found.direction.z};
  shape.normal = {found.normal.x, found.normal.y, found.normal.z};
  shape.linearity = found.linearity;
  shape.curvature = found.curvature;
  return shape;
}

/// Where a team keeps the candidates for neighbours. All members see the same memory.
struct CandidateTile {
  float* x;
  float* y;
  float* z;
  std::uint32_t capacity;  ///< a multiple of kLanes; kLanes values beyond it can be read
};

/// Sorted points number `begin` ... `end` - 1 lie in one cell of the grid.
struct CellOfPoints {
  std::uint32_t begin;
  std::uint32_t end;
};

/// The box of a cell's points.
FIELD_PHENOTYPING_HD inline void boxOf(const GridView& grid, const CellOfPoints& cell, Place& low,
                                       Place& high) {
  low = {grid.x[cell.begin], grid.y[cell.begin], grid.z[cell.begin]};
  high = low;
  for (std::uint32_t k = cell.begin + 1U; k < cell.end; ++k) {
    low.x = grid.x[k] < low.x ? grid.x[k] : low.x;
    low.y = grid.y[k] < low.y ? grid.y[k] : low.y;
    low.z = grid.z[k] < low.z ? grid.z[k] : low.z;
    high.x = grid.x[k] > high.x ? grid.x[k] : high.x;
    high.y = grid.y[k] > high.y ? grid.y[k] : high.y;
    high.z = grid.z[k] > high.z ? grid.z[k] : high.z;
  }
}

/// Copies the candidates number `first` ... of all that lie near the box to the tile, as many as it
/// holds; returns how many.
template <class Team>
FIELD_PHENOTYPING_HD std::uint32_t loadCandidates(const Team& team, const GridView& grid,
                                                  const Place& low, const Place& high, float radius,
                                                  std::uint32_t first, const CandidateTile& tile) {
  std::uint32_t before = 0U;  // candidates of the runs before
  const std::uint32_t last = first + tile.capacity;
  grid.forEachRun(low, high, radius, [&](const GridView::Run& run) {
    const std::uint32_t count = run.end - run.begin;
    const std::uint32_t from = before < first ? first - before : 0U;
    const std::uint32_t to = before + count > last ? last - before : count;
    for (std::uint32_t i = from + team.rank(); i < to; i += team.size()) {
      const std::uint32_t at = before + i - first;
      tile.x[at] = grid.x[run.begin + i];
      tile.y[at] = grid.y[run.begin + i];
      tile.z[at] = grid.z[run.begin + i];
    }
    before += count;
    return before < last;
  });
  return (before < last ? before : last) - first;
}

/// Moments for the shapes of the points of one cell, which have their candidates in common: the
/// team fetches them, then each of its groups takes one point after the other.
/// @param candidates how many there are near the cell
/// @param tile has room for all of them where the team is alone
/// @param store store(k, moments) of the neighbours of each sorted point k, by one member of the
/// team
template <class Team, class Store>
FIELD_PHENOTYPING_HD void shapeMomentsOfCell(const Team& team, const GridView& grid,
                                             const CellOfPoints& cell, const Place& low,
                                             const Place& high, std::uint32_t candidates,
                                             float radius, const CandidateTile& tile,
                                             Store&& store) {
  if constexpr (Team::kAlone) {  // its tile holds them all
    const std::uint32_t all = loadCandidates(team, grid, low, high, radius, 0U, tile);
    const typename Team::Pair pair{};
    for (std::uint32_t k = cell.begin; k < cell.end; k += 2U) {
      const std::uint32_t next = k + 1U < cell.end ? k + 1U : k;
      LaneMoments<typename Team::Pair> sums;
      sums.addAround(pair, tile.x, tile.y, tile.z, all,
                     {pair.pair(grid.x[k], grid.x[next]), pair.pair(grid.y[k], grid.y[next]),
                      pair.pair(grid.z[k], grid.z[next])},
                     radius);
      for (std::uint32_t of = k; of <= next; ++of) {
        store(of, sums.totalBy([&](const auto& value) {
          return team.lanes().total(pair.half(value, of - k));
        }));
      }
    }
    return;
  }
  const auto lanes = team.lanes();
  std::uint32_t loaded = 0U;
  for (std::uint32_t first = cell.begin; first < cell.end; first += team.groups()) {
    const std::uint32_t k = first + team.group();
    const bool has_point = k < cell.end;
    LaneMoments<std::decay_t<decltype(lanes)>> sums;
    for (std::uint32_t at = 0U; at < candidates; at += tile.capacity) {
      if (first == cell.begin || candidates > tile.capacity) {
        team.sync();  // the tile is still being read
        loaded = loadCandidates(team, grid, low, high, radius, at, tile);
        team.sync();
      }
      if (!has_point) continue;
      sums.add(lanes, tile.x, tile.y, tile.z, loaded, {grid.x[k], grid.y[k], grid.z[k]}, radius);
    }
    if (!has_point) continue;
    const Moments moments = sums.total(lanes);
    if (lanes.first()) store(k, moments);
  }
}

/// The same of all points of the cells whose first point is one of the sorted points number `begin`
/// ... `end` - 1.
/// @param tileFor tileFor(candidates) gives the tile for so many
template <class Team, class TileFor, class Store>
FIELD_PHENOTYPING_HD void shapeMomentsOfChunk(const Team& team, const GridView& grid,
                                              std::uint32_t begin, std::uint32_t end, float radius,
                                              TileFor&& tileFor, Store&& store) {
  std::uint32_t k = begin;
  while (k > 0U && k < end && grid.inOneCell(k - 1U, k)) ++k;
  while (k < end) {
    CellOfPoints cell{k, k + 1U};
    while (cell.end < grid.size && grid.inOneCell(k, cell.end)) ++cell.end;
    Place low;
    Place high;
    boxOf(grid, cell, low, high);
    std::uint32_t candidates = 0U;
    grid.forEachRun(low, high, radius, [&](const GridView::Run& run) {
      candidates += run.end - run.begin;
      return true;
    });
    shapeMomentsOfCell(team, grid, cell, low, high, candidates, radius, tileFor(candidates), store);
    k = cell.end;
  }
}

}  // namespace field_phenotyping
