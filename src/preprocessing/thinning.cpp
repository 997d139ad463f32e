#include "field_phenotyping/preprocessing/thinning.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/key_map.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/preprocessing/voxel_groups.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kChunk = 65536U;  // points of a task

/// Ground that points lie above [m^2].
double coveredArea(const std::vector<Eigen::Vector3f>& points) {
  constexpr float kCell = 0.1F;  // [m] leaves hide the gaps between their points
  std::vector<std::vector<std::uint64_t>> found(chunksOf(points.size(), kChunk));
  parallelChunks(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    KeyMap<bool> own;
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint64_t cell = voxelKeyOf({points[i].x(), points[i].y(), 0.0F}, kCell);
      if (own.tryEmplace(cell, true).second) found[begin / kChunk].push_back(cell);
    }
  });
  KeyMap<bool> cells;
  for (const std::vector<std::uint64_t>& of_chunk : found) {
    for (const std::uint64_t cell : of_chunk) cells.tryEmplace(cell, true);
  }
  return static_cast<double>(cells.size()) * static_cast<double>(kCell * kCell);
}

/// Puts into the place of a cloud what stands for its points, the first of each voxel or its
/// centroid, and notes both in `dense`: in the place of point `first_point` and those that follow.
void replace(const VoxelGroups& voxels, bool averaged, PointCloud& cloud, DensePoints& dense,
             std::size_t first_point, std::uint32_t first_number) {
  PointCloud thinned = taken(cloud, voxels.first());
  if (averaged) {
    const std::vector<VoxelMean> means = voxels.means();
    parallelChunks(means.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        thinned.points[k] = {means[k].mean.x, means[k].mean.y, means[k].mean.z};
      }
    });
  }
  const std::vector<std::uint32_t> voxel_of = voxels.ofPoints();
  parallelChunks(cloud.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      dense.points[first_point + i] = cloud.points[i];
      dense.thinned[first_point + i] = first_number + voxel_of[i];
    }
  });
  cloud = std::move(thinned);
}

}  // namespace

DensePoints thin(PointCloud& cloud, PointCloud& feet, PointCloud& isolated, double density,
                 double edge) {
  // Widths in steps, so that blocks that are about as dense are thinned alike.
  constexpr double kFirst = 2.0;           // of the cloud's voxels
  constexpr double kStep = M_SQRT2;        // from width to width
  constexpr double kWidest = 0.03;         // [m] stems are hardly seen among wider ones
  constexpr double kMostAveraged = 0.012;  // [m] centroids of wider ones lie inside of stems
  constexpr double kLeastGround = 4.0;     // [m^2] a few plants, which take little time in any case
  const auto all = static_cast<double>(cloud.size());
  if (all <= density * kLeastGround) return {};
  const double most = density * std::max(coveredArea(cloud.points), kLeastGround);
  if (all <= most) return {};
  // What lies on surfaces is at best divided by the square of the width.
  const double least = std::max(kFirst, std::sqrt(all / most)) * edge;
  double width = kFirst * edge;
  while (width < least) width *= kStep;
  const auto tooMany = [&](std::size_t voxels) {
    return static_cast<double>(voxels) > most && kStep * width <= kWidest;
  };
  std::optional<VoxelGroups> voxels(std::in_place, cloud.points, static_cast<float>(width));
  while (tooMany(voxels->size())) {
    // One point of each voxel lies in nearly as many wider ones as all do, never in more.
    std::vector<Eigen::Vector3f> of_each = valuesAt(cloud.points, voxels->first());
    while (tooMany(of_each.size())) {
      width *= kStep;
      of_each = valuesAt(of_each, VoxelGroups(of_each, static_cast<float>(width)).first());
    }
    voxels.emplace(cloud.points, static_cast<float>(width));
  }
  const bool averaged = width <= kMostAveraged;
  DensePoints dense;
  const std::size_t count = cloud.size() + feet.size() + isolated.size();
  dense.points.resize(count);
  dense.thinned.resize(count);
  std::size_t noted = cloud.size();
  replace(*voxels, averaged, cloud, dense, 0U, 0U);
  auto kept = static_cast<std::uint32_t>(cloud.size());
  for (PointCloud* beside : {&feet, &isolated}) {
    const std::size_t points = beside->size();
    replace(VoxelGroups(beside->points, static_cast<float>(width)), averaged, *beside, dense, noted,
            kept);
    noted += points;
    kept += static_cast<std::uint32_t>(beside->size());
  }
  return dense;
}

}  // namespace field_phenotyping
