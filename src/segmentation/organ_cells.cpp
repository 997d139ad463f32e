#include "field_phenotyping/segmentation/organ_cells.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "field_phenotyping/common/bounds.hpp"
#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/order_statistic.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/partitioned.hpp"

namespace field_phenotyping {
namespace {

constexpr float kCell = 0.015F;       // [m] points this close are one cell
constexpr float kWeedHeight = 0.25F;  // [m] below it an organ must touch its plant

/// Standard deviation of points across the surfaces of organs [m], by how thick the thinner ones
/// are. Stems do not tell: what lies far off their surface is not believed to be theirs.
/// @param centers of cells that are no stem's
/// @param grid over them
float noiseAcross(const std::vector<Eigen::Vector3f>& centers, const NeighborGrid& grid) {
  constexpr std::size_t kSamples = 2000U;
  constexpr std::uint32_t kLeastNeighbors = 6U;
  constexpr float kThinner = 0.25F;  // share of the cells: the others bend, or touch others
  constexpr float kBend = 0.0025F;   // curvature that leaves have of themselves
  const std::size_t stride = std::max<std::size_t>(1U, centers.size() / kSamples);
  std::vector<LocalShape> shapes(centers.size() / stride);
  parallelChunks(shapes.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      shapes[k] = computeLocalShape(centers[k * stride], grid, kOrganShape);
    }
  });
  std::vector<float> curvatures;
  for (const LocalShape& shape : shapes) {
    if (shape.neighbors >= kLeastNeighbors) curvatures.push_back(shape.curvature);
  }
  if (curvatures.empty()) return 0.0F;
  const auto thinner = static_cast<std::size_t>(kThinner * static_cast<float>(curvatures.size()));
  const float curvature = nthOf(curvatures, thinner);
  // What is as wide as the neighbourhood, or narrower, has about this sum of variances there.
  constexpr float kVariances = kOrganShape * kOrganShape / 3.0F;
  return std::sqrt(std::max(0.0F, curvature - kBend) * kVariances);
}

}  // namespace

OrganCells gatherOrganCells(const Block& block, const std::vector<std::int32_t>& owner,
                            const ComputeDevice& device) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  const Bounds bounds = boundsOf(points);
  const auto cellOf = [&](const Eigen::Vector3f& point) -> Eigen::Array3i {
    return ((point.array() - bounds.low.array()) / kCell).cast<int>();
  };
  using Numbered = std::pair<std::uint64_t, std::uint32_t>;  // by cell of the level, point
  const auto levels = static_cast<std::size_t>(cellOf(bounds.high).z()) + 1U;
  const Partitioned<Numbered> by_level(
      points.size(), levels, [&](std::size_t begin, std::size_t end, const auto& give) {
        for (std::size_t i = begin; i < end; ++i) {
          const Eigen::Array3i cell = cellOf(points[i]);
          const std::uint64_t number =
              static_cast<std::uint64_t>(cell.y()) << 32U | static_cast<std::uint64_t>(cell.x());
          give(static_cast<std::size_t>(cell.z()), {number, static_cast<std::uint32_t>(i)});
        }
      });
  std::vector<std::vector<Numbered>> order(levels);
  std::vector<std::uint32_t> first_cell(levels + 1U, 0U);  // of each level
  const auto beginsCell = [&](std::size_t level, std::size_t k) {
    return k == 0U || order[level][k].first != order[level][k - 1U].first;
  };
  parallelFor(levels, [&](std::size_t level) {
    order[level].reserve(by_level.sizeOf(level));
    by_level.forEachOf(level, [&](const Numbered& point) { order[level].push_back(point); });
    std::sort(order[level].begin(), order[level].end());
    for (std::size_t k = 0; k < order[level].size(); ++k) {
      if (beginsCell(level, k)) ++first_cell[level + 1U];
    }
  });
  std::partial_sum(first_cell.begin(), first_cell.end(), first_cell.begin());

  OrganCells cells;
  cells.of_point.resize(points.size());
  cells.centers.assign(first_cell.back(), Eigen::Vector3f::Zero());
  cells.owner.assign(cells.size(), -1);
  std::vector<float> counts(cells.size(), 0.0F);
  parallelFor(levels, [&](std::size_t level) {
    std::uint32_t after = first_cell[level];  // the cell that is being filled
    for (std::size_t k = 0; k < order[level].size(); ++k) {
      if (beginsCell(level, k)) ++after;
      const std::uint32_t cell = after - 1U;
      const std::uint32_t i = order[level][k].second;
      cells.of_point[i] = cell;
      cells.centers[cell] += points[i];
      counts[cell] += 1.0F;
      if (cells.owner[cell] < 0) cells.owner[cell] = owner[i];
    }
  });
  cells.is_stem.resize(cells.size());
  cells.is_low.resize(cells.size());
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      cells.centers[n] /= counts[n];
      cells.is_stem[n] = cells.owner[n] >= 0 ? 1U : 0U;
      cells.is_low[n] = block.ground.heightAbove(cells.centers[n]) < kWeedHeight ? 1U : 0U;
    }
  });
  // Stems would pull the shape of what passes them towards their own.
  const std::vector<std::uint32_t> organs =
      indicesWhere(cells.size(), [&](std::size_t n) { return cells.is_stem[n] == 0U; });
  const std::vector<Eigen::Vector3f> centers = valuesAt(cells.centers, organs);
  const NeighborGrid grid(centers, kOrganShape);
  cells.noise = noiseAcross(centers, grid);
  const std::vector<LocalShape> shapes = computeLocalShapes(centers, grid, kOrganShape, device);
  LocalShape upright;
  upright.linearity = 1.0F;
  cells.shapes.assign(cells.size(), upright);
  parallelChunks(organs.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) cells.shapes[organs[k]] = shapes[k];
  });
  return cells;
}

}  // namespace field_phenotyping
