#include "field_phenotyping/preprocessing/thinning.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "field_phenotyping/common/key_map.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"

namespace field_phenotyping {
namespace {

/// The voxel of each point, numbered as they are met, and the first point of each.
struct Voxels {
  std::vector<std::uint32_t> of_point;
  std::vector<std::uint32_t> first;
};

Voxels voxelsOf(const std::vector<Eigen::Vector3f>& points, float edge) {
  constexpr std::size_t kBatch = 64U;  // of keys whose memory is fetched at once
  Voxels voxels;
  voxels.of_point.reserve(points.size());
  KeyMap<std::uint32_t> numbers;
  std::array<VoxelKey, kBatch> keys;
  for (std::size_t begin = 0; begin < points.size(); begin += kBatch) {
    const std::size_t count = std::min(kBatch, points.size() - begin);
    for (std::size_t k = 0; k < count; ++k) {
      keys[k] = voxelKey(points[begin + k], edge);
      numbers.prefetch(keys[k]);
    }
    for (std::size_t k = 0; k < count; ++k) {
      const auto next = static_cast<std::uint32_t>(voxels.first.size());
      const auto [number, is_new] = numbers.tryEmplace(keys[k], next);
      voxels.of_point.push_back(*number);
      if (is_new) voxels.first.push_back(static_cast<std::uint32_t>(begin + k));
    }
  }
  return voxels;
}

/// Ground that points lie above [m^2].
double coveredArea(const std::vector<Eigen::Vector3f>& points) {
  constexpr float kCell = 0.1F;  // [m] leaves hide the gaps between their points
  KeyMap<bool> cells;
  for (Eigen::Vector3f point : points) {
    point.z() = 0.0F;
    cells.tryEmplace(voxelKey(point, kCell), true);
  }
  return static_cast<double>(cells.size()) * static_cast<double>(kCell * kCell);
}

std::vector<Eigen::Vector3f> pointsAt(const std::vector<Eigen::Vector3f>& points,
                                      const std::vector<std::uint32_t>& indices) {
  std::vector<Eigen::Vector3f> out;
  out.reserve(indices.size());
  for (const std::uint32_t i : indices) out.push_back(points[i]);
  return out;
}

/// The first point of each voxel.
PointCloud firstOf(const PointCloud& cloud, const Voxels& voxels) {
  PointCloud out = cloud.emptyAlike();
  out.reserveLike(cloud, voxels.first.size());
  for (const std::uint32_t i : voxels.first) out.take(cloud, i);
  return out;
}

/// Moves the first point of each voxel to the centroid of all.
void average(const std::vector<Eigen::Vector3f>& points, const Voxels& voxels, PointCloud& first) {
  std::vector<float> counts(first.size(), 0.0F);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::uint32_t voxel = voxels.of_point[i];
    counts[voxel] += 1.0F;
    first.points[voxel] += (points[i] - first.points[voxel]) / counts[voxel];
  }
}

/// Puts into the place of a cloud what stands for its points, and notes both in `dense`.
void replace(const Voxels& voxels, bool averaged, PointCloud& cloud, DensePoints& dense,
             std::uint32_t first_number) {
  PointCloud thinned = firstOf(cloud, voxels);
  if (averaged) average(cloud.points, voxels, thinned);
  dense.points.insert(dense.points.end(), cloud.points.begin(), cloud.points.end());
  for (const std::uint32_t voxel : voxels.of_point) dense.thinned.push_back(first_number + voxel);
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
  Voxels voxels = voxelsOf(cloud.points, static_cast<float>(width));
  const auto tooMany = [&] {
    return static_cast<double>(voxels.first.size()) > most && kStep * width <= kWidest;
  };
  while (tooMany()) {
    // One point of each voxel lies in nearly as many wider ones as all do, never in more.
    std::vector<Eigen::Vector3f> of_each = pointsAt(cloud.points, voxels.first);
    while (tooMany()) {
      width *= kStep;
      voxels = voxelsOf(of_each, static_cast<float>(width));
      of_each = pointsAt(of_each, voxels.first);
    }
    voxels = voxelsOf(cloud.points, static_cast<float>(width));
  }
  const bool averaged = width <= kMostAveraged;
  DensePoints dense;
  const std::size_t count = cloud.size() + feet.size() + isolated.size();
  dense.points.reserve(count);
  dense.thinned.reserve(count);
  replace(voxels, averaged, cloud, dense, 0U);
  auto kept = static_cast<std::uint32_t>(cloud.size());
  for (PointCloud* beside : {&feet, &isolated}) {
    replace(voxelsOf(beside->points, static_cast<float>(width)), averaged, *beside, dense, kept);
    kept += static_cast<std::uint32_t>(beside->size());
  }
  return dense;
}

}  // namespace field_phenotyping
