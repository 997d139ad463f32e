#include "field_phenotyping/segmentation/organ_cells.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr float kCell = 0.015F;       // [m] points this close are one cell
constexpr float kWeedHeight = 0.25F;  // [m] below it an organ must touch its plant

}  // namespace

OrganCells gatherOrganCells(const Block& block, const std::vector<std::int32_t>& owner,
                            float shape_radius, const ComputeDevice& device) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  Eigen::Array3f low = points.front().array();
  for (const Eigen::Vector3f& p : points) low = low.min(p.array());
  constexpr unsigned kLevelBits = 42U;  // of a cell's number: its level, 21 bits each for y and x
  std::vector<std::uint64_t> number(points.size());  // of each point's cell
  constexpr std::size_t kPoints = 16384U;            // of a task
  parallelChunks(points.size(), kPoints, [&](std::size_t begin_point, std::size_t end_point) {
    for (std::size_t i = begin_point; i < end_point; ++i) {
      const Eigen::Array3i cell = ((points[i].array() - low) / kCell).cast<int>();
      number[i] = static_cast<std::uint64_t>(cell.z()) << kLevelBits |
                  static_cast<std::uint64_t>(cell.y()) << 21U |
                  static_cast<std::uint64_t>(cell.x());
    }
  });
  std::vector<std::size_t> begin;  // of each level
  for (const std::uint64_t of_point : number) {
    const std::size_t level = of_point >> kLevelBits;
    if (begin.size() < level + 2U) begin.resize(level + 2U, 0U);
    ++begin[level + 1U];
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order(points.size());  // by cell, point
  std::vector<std::size_t> next = begin;
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    order[next[number[i] >> kLevelBits]++] = {number[i], i};
  }
  const std::size_t levels = begin.size() - 1U;
  std::vector<std::uint32_t> first_cell(levels + 1U, 0U);  // of each level
  const auto beginsCell = [&](std::size_t level, std::size_t k) {
    return k == begin[level] || order[k].first != order[k - 1U].first;
  };
  parallelFor(levels, [&](std::size_t level) {
    std::sort(order.begin() + static_cast<std::ptrdiff_t>(begin[level]),
              order.begin() + static_cast<std::ptrdiff_t>(begin[level + 1U]));
    for (std::size_t k = begin[level]; k < begin[level + 1U]; ++k) {
      if (beginsCell(level, k)) ++first_cell[level + 1U];
    }
  });
  std::partial_sum(first_cell.begin(), first_cell.end(), first_cell.begin());

  OrganCells cells;
  cells.shape_radius = shape_radius;
  cells.of_point.resize(points.size());
  cells.centers.assign(first_cell.back(), Eigen::Vector3f::Zero());
  cells.owner.assign(cells.size(), -1);
  std::vector<float> counts(cells.size(), 0.0F);
  parallelFor(levels, [&](std::size_t level) {
    std::uint32_t after = first_cell[level];  // the cell that is being filled
    for (std::size_t k = begin[level]; k < begin[level + 1U]; ++k) {
      if (beginsCell(level, k)) ++after;
      const std::uint32_t cell = after - 1U;
      const std::uint32_t i = order[k].second;
      cells.of_point[i] = cell;
      cells.centers[cell] += points[i];
      counts[cell] += 1.0F;
      if (cells.owner[cell] < 0) cells.owner[cell] = owner[i];
    }
  });
  cells.is_stem.resize(cells.size());
  cells.is_low.resize(cells.size());
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin_cell, std::size_t end_cell) {
    for (std::size_t n = begin_cell; n < end_cell; ++n) {
      cells.centers[n] /= counts[n];
      cells.is_stem[n] = cells.owner[n] >= 0 ? 1U : 0U;
      cells.is_low[n] = block.ground.heightAbove(cells.centers[n]) < kWeedHeight ? 1U : 0U;
    }
  });
  // Stems would pull the shape of what passes them towards their own.
  std::vector<Eigen::Vector3f> organs;
  for (std::size_t n = 0; n < cells.size(); ++n) {
    if (cells.is_stem[n] == 0U) organs.push_back(cells.centers[n]);
  }
  const NeighborGrid grid(organs, shape_radius);
  const std::vector<LocalShape> shapes = computeLocalShapes(organs, grid, shape_radius, device);
  LocalShape upright;
  upright.linearity = 1.0F;
  cells.shapes.assign(cells.size(), upright);
  for (std::size_t n = 0, organ = 0; n < cells.size(); ++n) {
    if (cells.is_stem[n] == 0U) cells.shapes[n] = shapes[organ++];
  }
  return cells;
}

}  // namespace field_phenotyping
