#include "field_phenotyping/segmentation/local_shape.hpp"

#include <algorithm>

#include "common/gpu_streams.hpp"
#include "common/xyz.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/segmentation/local_shape_team.hpp"
#include "segmentation/local_shape_gpu.hpp"

namespace field_phenotyping {
namespace {

LocalShape toLocalShape(const LocalShapeNumbers& numbers) {
  LocalShape shape;
  shape.direction = {numbers.direction.x, numbers.direction.y, numbers.direction.z};
  shape.normal = {numbers.normal.x, numbers.normal.y, numbers.normal.z};
  shape.linearity = numbers.linearity;
  shape.curvature = numbers.curvature;
  shape.neighbors = numbers.neighbors;
  return shape;
}

/// Candidates for as many points as a cell has about it.
class GrowingTile {
 public:
  CandidateTile of(std::uint32_t candidates) {
    const auto capacity = static_cast<std::uint32_t>((candidates / kLanes + 1U) * kLanes);
    if (capacity + kLanes > x_.size()) {
      for (std::vector<float>* values : {&x_, &y_, &z_}) values->resize(2U * capacity + kLanes);
    }
    return {x_.data(), y_.data(), z_.data(), capacity};
  }

 private:
  std::vector<float> x_;
  std::vector<float> y_;
  std::vector<float> z_;
};

}  // namespace

LocalShape computeLocalShape(const Eigen::Vector3f& point, const NeighborGrid& grid, float radius) {
  Moments moments;
  grid.forEachOffsetWithin(point, radius, [&](std::uint32_t, const Eigen::Vector3f& offset, float) {
    moments.add(NeighborGrid::placeOf(offset));
  });
  return toLocalShape(localShapeOf(moments));
}

std::vector<LocalShape> computeLocalShapes(const std::vector<Eigen::Vector3f>& points,
                                           const NeighborGrid& grid, float radius,
                                           const ComputeDevice& device) {
  std::vector<LocalShape> shapes(points.size());
  const GridView view = grid.view();
  if constexpr (kWithCuda) {
    const bool done = device.attempt([&](GpuStream& stream) {
      const LocalShapeNumbers* found =
          localShapesOnGpu(stream, xyzOf(points), view.size, view.geometry, radius);
      for (std::size_t i = 0; i < shapes.size(); ++i) shapes[i] = toLocalShape(found[i]);
    });
    if (done) return shapes;
  }
  constexpr std::size_t kChunk = 1024U;
  parallelChunks(view.size, kChunk, [&](std::size_t begin, std::size_t end) {
    GrowingTile tile;
    localShapesOfChunk(
        SerialTeam(), view, static_cast<std::uint32_t>(begin), static_cast<std::uint32_t>(end),
        radius, [&](std::uint32_t candidates) { return tile.of(candidates); },
        [&](std::uint32_t k, const LocalShapeNumbers& shape) {
          shapes[view.order[k]] = toLocalShape(shape);
        });
  });
  return shapes;
}

}  // namespace field_phenotyping
