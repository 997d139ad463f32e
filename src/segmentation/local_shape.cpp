#include "field_phenotyping/segmentation/local_shape.hpp"

#include <algorithm>
#include <array>

#include "common/gpu_streams.hpp"
#include "common/wide_vectors.hpp"
#include "common/xyz.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/wide_lanes.hpp"
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

/// Shapes of kLanes points at once.
class ShapeBatch {
 public:
  explicit ShapeBatch(std::vector<LocalShape>& shapes) : shapes_(shapes) {}

  /// @param i the point
  void add(std::size_t i, const Moments& moments) {
    shapes_[i].neighbors = static_cast<std::uint32_t>(moments.count);
    if (moments.count < kLeastShapePoints) return;
    points_[filled_] = i;
    const std::array<float, kNumbers> numbers{
        moments.count,      moments.sum.x,      moments.sum.y,      moments.sum.z,
        moments.squares.xx, moments.squares.yy, moments.squares.zz, moments.squares.xy,
        moments.squares.yz, moments.squares.zx};
    for (std::size_t k = 0; k < kNumbers; ++k) numbers_[k][filled_] = numbers[k];
    if (++filled_ == kLanes) flush();
  }

  /// To be called at the end.
  void flush() {
    const std::array<Floats, kNumbers>& n = numbers_;
    const ShapeOfAxes<Floats> found = shapeOfAxes<VectorLanes>(principal_axes::covarianceOf<Floats>(
        n[0], {n[1], n[2], n[3]}, {n[4], n[5], n[6], n[7], n[8], n[9]}));
    for (std::size_t lane = 0; lane < filled_; ++lane) {
      if (!(found.known[lane] > 0.0F)) continue;
      LocalShape& shape = shapes_[points_[lane]];
      shape.direction = {found.direction.x[lane], found.direction.y[lane], found.direction.z[lane]};
      shape.normal = {found.normal.x[lane], found.normal.y[lane], found.normal.z[lane]};
      shape.linearity = found.linearity[lane];
      shape.curvature = found.curvature[lane];
    }
    filled_ = 0U;
  }

 private:
  static constexpr std::size_t kNumbers = 10U;  // that Moments are made of

  std::vector<LocalShape>& shapes_;
  std::array<std::size_t, kLanes> points_{};
  std::array<Floats, kNumbers> numbers_{};
  std::size_t filled_ = 0U;
};

}  // namespace

LocalShape computeLocalShape(const Eigen::Vector3f& point, const NeighborGrid& grid, float radius) {
  const Place place = NeighborGrid::placeOf(point);
  const GridView view = grid.view();
  const VectorLanes lanes;
  LaneMoments<VectorLanes> sums;
  view.forEachRun(place, place, radius, [&](const GridView::Run& run) {
    sums.add(lanes, view.x + run.begin, view.y + run.begin, view.z + run.begin, run.end - run.begin,
             place, radius);
    return true;
  });
  return toLocalShape(localShapeOf(sums.total(lanes)));
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
      constexpr std::size_t kCopied = 16384U;  // of a task
      parallelChunks(shapes.size(), kCopied, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) shapes[i] = toLocalShape(found[i]);
      });
    });
    if (done) return shapes;
  }
  constexpr std::size_t kChunk = 1024U;
  parallelChunks(view.size, kChunk, [&](std::size_t begin, std::size_t end) {
    GrowingTile tile;
    ShapeBatch batch(shapes);
    withWideVectors([&] {
      shapeMomentsOfChunk(
          SerialTeam(), view, static_cast<std::uint32_t>(begin), static_cast<std::uint32_t>(end),
          radius, [&](std::uint32_t candidates) { return tile.of(candidates); },
          [&](std::uint32_t k, const Moments& moments) { batch.add(view.order[k], moments); });
      batch.flush();
    });
  });
  return shapes;
}

}  // namespace field_phenotyping
