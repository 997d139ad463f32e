#include "field_phenotyping/preprocessing/ground_estimation.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <iterator>
#include <limits>
#include <random>
#include <utility>

#include "common/gpu_streams.hpp"
#include "field_phenotyping/common/bounds.hpp"
#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/order_statistic.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/robust_spread.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/preprocessing/soil_plane_team.hpp"
#include "preprocessing/soil_plane_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr float kCandidateCell = 0.1F;   // [m] one lowest point is taken from each such cell
constexpr float kMinRoughness = 0.002F;  // [m] soil is never smoother than a sensor sees it
constexpr float kRidgeHeight = 0.15F;    // [m] the local soil stays this near to the block's plane
constexpr int kMinNodePoints = 6;
constexpr std::size_t kPointsOfTask = 4096U;  // that are worked together
constexpr std::size_t kNodesOfTask = 64U;     // likewise

using Plane = SoilPlane;

float residualOf(const Plane& plane, const Eigen::Vector3f& p) {
  return p.z() - plane.heightAt(p.x(), p.y());
}

struct Extent {
  Eigen::Vector2f low;
  Eigen::Vector2f high;
};

Extent extentOf(const std::vector<Eigen::Vector3f>& points) {
  const Bounds bounds = boundsOf(points);
  return {bounds.low.head<2>(), bounds.high.head<2>()};
}

/// The lowest point of every occupied cell of a horizontal grid.
std::vector<Eigen::Vector3f> lowestPoints(const PointCloud& cloud, const Extent& extent) {
  const auto columns =
      static_cast<std::size_t>((extent.high.x() - extent.low.x()) / kCandidateCell) + 1U;
  const auto rows =
      static_cast<std::size_t>((extent.high.y() - extent.low.y()) / kCandidateCell) + 1U;
  constexpr float kNone = std::numeric_limits<float>::infinity();
  std::vector<Eigen::Vector3f> lowest(columns * rows, Eigen::Vector3f::Constant(kNone));
  for (const Eigen::Vector3f& p : cloud.points) {
    const auto column = static_cast<std::size_t>((p.x() - extent.low.x()) / kCandidateCell);
    const auto row = static_cast<std::size_t>((p.y() - extent.low.y()) / kCandidateCell);
    Eigen::Vector3f& entry = lowest[row * columns + column];
    if (p.z() < entry.z()) entry = p;
  }
  std::vector<Eigen::Vector3f> candidates;
  for (const Eigen::Vector3f& p : lowest) {
    if (p.z() < kNone) candidates.push_back(p);
  }
  return candidates;
}

/// Scores of planes, on the GPU if there is one, else on the CPU by the same routine.
std::vector<int> scorePlanes(const std::vector<Plane>& planes,
                             const std::vector<Eigen::Vector3f>& candidates, float tolerance,
                             const ComputeDevice& device) {
  std::array<std::vector<float>, 3> coordinates;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<float>& values = coordinates[static_cast<std::size_t>(axis)];
    values.reserve(candidates.size() + kLanes);
    for (const Eigen::Vector3f& p : candidates) values.push_back(p[axis]);
    values.resize(candidates.size() + kLanes);
  }
  const SoilCandidates points{coordinates[0].data(), coordinates[1].data(), coordinates[2].data(),
                              static_cast<std::uint32_t>(candidates.size())};
  std::vector<int> scores(planes.size());
  if constexpr (kWithCuda) {
    const bool done = device.attempt([&](GpuStream& stream) {
      const int* found = planeScoresOnGpu(
          stream, planes.data(), static_cast<std::uint32_t>(planes.size()), points, tolerance);
      std::copy(found, found + planes.size(), scores.begin());
    });
    if (done) return scores;
  }
  int scratch = 0;
  for (std::size_t k = 0; k < planes.size(); ++k) {
    scores[k] = scorePlane(SerialTeam(), planes[k], points, tolerance, &scratch);
  }
  return scores;
}

/// Least squares over the points within `tolerance` of `plane`; `plane` itself when they are too
/// few.
Plane refine(const Plane& plane, const std::vector<Eigen::Vector3f>& points, float tolerance,
             float max_slope) {
  // The sums of the normal equations, whose rows are (x, y, 1) and z.
  double xx = 0.0, xy = 0.0, yy = 0.0, sum_x = 0.0, sum_y = 0.0;
  double xz = 0.0, yz = 0.0, sum_z = 0.0;
  int count = 0;
  for (const Eigen::Vector3f& p : points) {
    if (std::abs(residualOf(plane, p)) > tolerance) continue;
    const Eigen::Vector3d at = p.cast<double>();
    xx += at.x() * at.x();
    xy += at.x() * at.y();
    yy += at.y() * at.y();
    sum_x += at.x();
    sum_y += at.y();
    xz += at.x() * at.z();
    yz += at.y() * at.z();
    sum_z += at.z();
    ++count;
  }
  if (count < kMinNodePoints) return plane;
  Eigen::Matrix3d normal;
  normal << xx, xy, sum_x, xy, yy, sum_y, sum_x, sum_y, count;
  const Eigen::Vector3d right(xz, yz, sum_z);
  // A whisper of regularisation keeps the slope where it was when all points lie on one line.
  const Eigen::Vector3d previous(plane.a, plane.b, plane.c);
  const Eigen::Matrix3d damping = 1e-3 * Eigen::Vector3d(1.0, 1.0, 1e-3).asDiagonal();
  const Eigen::Vector3d solved = (normal + damping).ldlt().solve(right + damping * previous);
  const Plane refined{static_cast<float>(solved.x()), static_cast<float>(solved.y()),
                      static_cast<float>(solved.z())};
  return std::hypot(refined.a, refined.b) <= max_slope ? refined : plane;
}

/// A level plane through the lowest point.
Plane lowestLevel(const std::vector<Eigen::Vector3f>& candidates) {
  const auto lowest = std::min_element(
      candidates.begin(), candidates.end(),
      [](const Eigen::Vector3f& a, const Eigen::Vector3f& b) { return a.z() < b.z(); });
  return {0.0F, 0.0F, lowest->z()};
}

/// The block's soil plane by RANSAC with a gravity prior.
Plane ransacPlane(const std::vector<Eigen::Vector3f>& candidates, float tolerance, float max_slope,
                  const ComputeDevice& device) {
  std::vector<Plane> planes = {lowestLevel(candidates)};
  if (candidates.size() < 3U) return planes.front();

  constexpr int kIterations = 300;
  constexpr unsigned kSeed = 1U;  // fixed: the same cloud always gives the same plane
  std::mt19937 random(kSeed);
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    Eigen::Matrix3f rows;
    Eigen::Vector3f heights;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3f& p = candidates[random() % candidates.size()];
      rows.row(k) << p.x(), p.y(), 1.0F;
      heights[k] = p.z();
    }
    constexpr float kMinTriangle =
        0.02F;  // [m^2] twice the area: smaller ones say nothing of slope
    if (std::abs(rows.determinant()) < kMinTriangle) continue;
    const Eigen::Vector3f solved = rows.inverse() * heights;
    const Plane plane{solved.x(), solved.y(), solved.z()};
    if (std::hypot(plane.a, plane.b) > max_slope) continue;
    planes.push_back(plane);
  }
  const std::vector<int> scores = scorePlanes(planes, candidates, tolerance, device);
  const auto best = std::max_element(scores.begin(), scores.end());  // the first of the best
  return refine(planes[static_cast<std::size_t>(best - scores.begin())], candidates, tolerance,
                max_slope);
}

/// Whether hardly any point lies below the plane: so it is with soil, not with a layer of leaves.
bool liesLowest(const Plane& plane, const PointCloud& cloud, float tolerance) {
  std::size_t near = 0U;
  std::size_t below = 0U;
  for (const Eigen::Vector3f& p : cloud.points) {
    const float residual = residualOf(plane, p);
    near += std::abs(residual) <= tolerance ? 1U : 0U;
    below += residual < -tolerance ? 1U : 0U;
  }
  constexpr double kMostBelow = 0.05;  // of the points on the plane
  return static_cast<double>(below) <= kMostBelow * static_cast<double>(near);
}

/// Whether the plane shows in enough of the seen area, and in more of it than a few leaves cover.
bool isExtended(const Plane& plane, const std::vector<Eigen::Vector3f>& candidates, float tolerance,
                double min_coverage) {
  const auto on_plane = std::count_if(
      candidates.begin(), candidates.end(),
      [&](const Eigen::Vector3f& p) { return std::abs(residualOf(plane, p)) <= tolerance; });
  constexpr std::ptrdiff_t kLeastCells = 25;
  return on_plane >= kLeastCells &&
         static_cast<double>(on_plane) >= min_coverage * static_cast<double>(candidates.size());
}

/// Number of small squares that the points on `plane` are seen in: points round one node, which lie
/// in fewer than kSide squares along each axis.
std::size_t countPatches(const std::vector<Eigen::Vector3f>& nearby, const Plane& plane,
                         float patch) {
  constexpr unsigned kSide = 16U;
  std::bitset<kSide * kSide> seen;
  const auto along = [patch](float coordinate) {
    return static_cast<unsigned>(static_cast<int>(std::floor(coordinate / patch))) % kSide;
  };
  for (const Eigen::Vector3f& p : nearby) {
    if (std::abs(residualOf(plane, p)) <= 0.025F) seen.set(along(p.x()) * kSide + along(p.y()));
  }
  return seen.count();
}

/// Soil round one node: the lower surface of the points near it, as a robust plane.
/// @param residuals scratch
GroundModel::Node fitNode(const Eigen::Vector2f& position, const Plane& block_plane,
                          const std::vector<Eigen::Vector3f>& nearby, float spacing,
                          float max_slope, std::vector<float>& residuals) {
  GroundModel::Node node;
  node.height = block_plane.heightAt(position.x(), position.y());
  node.stddev = kRidgeHeight / 2.0F;
  if (nearby.size() < static_cast<std::size_t>(kMinNodePoints)) return node;

  // Leaves and weeds lie above the soil, so start from a low quantile and let the plane settle.
  residuals.clear();
  for (const Eigen::Vector3f& p : nearby) residuals.push_back(residualOf(block_plane, p));
  Plane plane = block_plane;
  plane.c += nthOf(residuals, residuals.size() / 5U);
  for (const float tolerance : {0.05F, 0.035F, 0.025F}) {
    plane = refine(plane, nearby, tolerance, max_slope);
  }

  double squares = 0.0;
  int count = 0;
  for (const Eigen::Vector3f& p : nearby) {
    const double residual = residualOf(plane, p);
    if (std::abs(residual) > 0.025) continue;
    squares += residual * residual;
    ++count;
  }
  if (count < kMinNodePoints) return node;
  // Soil covers some ground; what covers little is a leaf or a stem's foot, the more so far from
  // the block's plane.
  const float height = plane.heightAt(position.x(), position.y());
  constexpr float kPlain = 0.06F;          // [m]
  constexpr std::size_t kFewPatches = 8U;  // of the 64 that a node's surroundings hold
  constexpr std::size_t kManyPatches = 20U;
  const bool near_plane = std::abs(height - node.height) <= kPlain;
  if (countPatches(nearby, plane, spacing / 4.0F) < (near_plane ? kFewPatches : kManyPatches))
    return node;
  node.height = height;
  const double roughness = std::sqrt(squares / count);
  node.stddev = static_cast<float>(std::max<double>(roughness, kMinRoughness));
  node.seen = 1U;
  return node;
}

/// Points by the square cells between the nodes of a grid, in their order in each.
class CellPoints {
 public:
  /// @param points that lie in the grid's cells
  CellPoints(const std::vector<Eigen::Vector3f>& points, const Eigen::Vector2f& corner,
             float spacing, int columns, int rows)
      : columns_(columns),
        begin_(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows) + 1U, 0U),
        points_(points.size()) {
    std::vector<std::uint32_t> cell_of(points.size());
    parallelChunks(points.size(), kPointsOfTask, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const Eigen::Vector2f at = (points[i].head<2>() - corner) / spacing;
        cell_of[i] = static_cast<std::uint32_t>(
            numberOf(static_cast<int>(at.x()), static_cast<int>(at.y())));
      }
    });
    for (const std::uint32_t cell : cell_of) ++begin_[cell];
    for (std::size_t cell = 1; cell < begin_.size(); ++cell) begin_[cell] += begin_[cell - 1U];
    // Where each cell ends is counted back while it is filled, to where it begins.
    for (std::size_t i = points.size(); i-- > 0U;) points_[--begin_[cell_of[i]]] = points[i];
  }

  const std::vector<Eigen::Vector3f>& points() const { return points_; }

  /// Calls visit(begin, end), numbers of points, for the cells round a node, four at most.
  template <class Visit>
  void forEachCellAround(std::size_t node, const Visit& visit) const {
    const int column = static_cast<int>(node % static_cast<std::size_t>(columns_));
    const int row = static_cast<int>(node / static_cast<std::size_t>(columns_));
    for (int y = std::max(row - 1, 0); y <= row; ++y) {
      for (int x = std::max(column - 1, 0); x <= column; ++x) {
        const std::size_t cell = numberOf(x, y);
        visit(begin_[cell], begin_[cell + 1U]);
      }
    }
  }

 private:
  std::size_t numberOf(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column);
  }

  int columns_;
  std::vector<std::uint32_t> begin_;  // of each cell, with the end of the last
  std::vector<Eigen::Vector3f> points_;
};

/// Nodes without soil of their own take the mean offset (from the block's plane) of seen
/// neighbours, ring by ring, and a standard deviation that grows with the distance.
void fillUnseenNodes(std::vector<GroundModel::Node>& nodes, int columns, int rows) {
  std::vector<std::uint8_t> known(nodes.size());
  for (std::size_t i = 0; i < nodes.size(); ++i) known[i] = nodes[i].seen;
  for (bool changed = true; changed;) {
    changed = false;
    const std::vector<std::uint8_t> before = known;
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) {
        const auto at = [&](int x, int y) {
          return static_cast<std::size_t>(y) * static_cast<std::size_t>(columns) +
                 static_cast<std::size_t>(x);
        };
        if (before[at(i, j)] != 0U) continue;
        float height = 0.0F;
        float stddev = 0.0F;
        int count = 0;
        for (int y = std::max(j - 1, 0); y <= std::min(j + 1, rows - 1); ++y) {
          for (int x = std::max(i - 1, 0); x <= std::min(i + 1, columns - 1); ++x) {
            if (before[at(x, y)] == 0U) continue;
            height += nodes[at(x, y)].height;
            stddev = std::max(stddev, nodes[at(x, y)].stddev);
            ++count;
          }
        }
        if (count == 0) continue;
        nodes[at(i, j)].height = height / static_cast<float>(count);
        nodes[at(i, j)].stddev = stddev + 0.01F;
        known[at(i, j)] = 1U;
        changed = true;
      }
    }
  }
}

/// What soil points round a node say of how far the model is off there.
struct Offset {
  RobustSpread heights{};  ///< of the points above the model [m]; the middle is the offset
  std::size_t points = 0;  ///< 0: too few to tell

  /// Of the offset, where soil usually scatters by `usual`. What scatters more has weeds and low
  /// leaves in it, and is off by about as much.
  float variance(float usual) const {
    constexpr float kOfMedian = 1.57F;  // times as uncertain as a mean
    const float growth = std::max(heights.stddev * heights.stddev - usual * usual, 0.0F);
    return kOfMedian * usual * usual / static_cast<float>(points) + growth;
  }
};

Offset offsetOf(const std::vector<float>& heights) {
  constexpr std::size_t kLeast = 4U;
  if (heights.size() < kLeast) return {};
  return {robustSpreadOf(heights, kMinRoughness), heights.size()};
}

/// The same surface, with a node halfway between any two.
GroundModel withTwiceTheNodes(const GroundModel& ground) {
  const float spacing = 0.5F * ground.spacing();
  const int columns = 2 * ground.columns() - 1;
  const int rows = 2 * ground.rows() - 1;
  std::vector<GroundModel::Node> nodes;
  nodes.reserve(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows));
  for (int row = 0; row < rows; ++row) {
    const float y = ground.corner().y() + spacing * static_cast<float>(row);
    for (int column = 0; column < columns; ++column) {
      const float x = ground.corner().x() + spacing * static_cast<float>(column);
      const std::uint8_t seen = ground.seenAt(x, y) ? 1U : 0U;
      nodes.push_back({ground.heightAt(x, y), ground.stddevAt(x, y), seen});
    }
  }
  return {ground.corner(), spacing, columns, rows, std::move(nodes), ground.observed()};
}

/// Points about as near to the model as soil may be: some tens round each node, which tell as much
/// of it as thousands.
std::vector<Eigen::Vector3f> pointsNear(const GroundModel& ground,
                                        const std::vector<Eigen::Vector3f>& points, float most) {
  constexpr std::size_t kEnough = 16U;  // for each node; four share a point
  const std::vector<std::uint32_t> near = indicesWhere(points.size(), [&](std::size_t i) {
    return !ground.clearlyAbove(points[i], most) && std::abs(ground.heightAbove(points[i])) <= most;
  });
  const std::size_t step =
      std::max<std::size_t>(near.size() / (kEnough * ground.nodes().size()), 1U);
  std::vector<Eigen::Vector3f> some;
  for (std::size_t k = 0; k < near.size(); k += step) some.push_back(points[near[k]]);
  return some;
}

/// Moves the nodes to the middle of the soil points round each, for planes level ridges and
/// furrows. By how much of it is told by how much more such middles differ from the model than by
/// chance: on level soil they move by next to nothing.
GroundModel settled(const GroundModel& ground, const CellPoints& points, float tolerance) {
  std::vector<GroundModel::Node> nodes = ground.nodes();
  const std::vector<float> heights = ground.heightsAbove(points.points());
  std::vector<Offset> offsets(nodes.size());
  parallelChunks(nodes.size(), kNodesOfTask, [&](std::size_t begin, std::size_t end) {
    std::vector<float> nearby;
    for (std::size_t node = begin; node < end; ++node) {
      if (nodes[node].seen == 0U) continue;
      nearby.clear();
      points.forEachCellAround(node, [&](std::uint32_t first, std::uint32_t last) {
        std::copy_if(heights.begin() + first, heights.begin() + last, std::back_inserter(nearby),
                     [tolerance](float height) { return std::abs(height) <= tolerance; });
      });
      offsets[node] = offsetOf(nearby);
    }
  });
  // Medians of the field, for at weeds and stems' feet offsets are none of the soil's.
  const auto usualOf = [&](auto value) {
    std::vector<float> values;
    for (const Offset& offset : offsets) {
      if (offset.points > 0U) values.push_back(value(offset));
    }
    return values.empty() ? 0.0F : medianOf(std::move(values));
  };
  const float spread = usualOf([](const Offset& offset) { return offset.heights.stddev; });
  const float by_chance = usualOf([&](const Offset& offset) { return offset.variance(spread); });
  const float size = static_cast<float>(kMadToSigma) *
                     usualOf([](const Offset& offset) { return std::abs(offset.heights.middle); });
  const float variance = size * size - by_chance;
  if (!(variance > 0.0F)) return ground;
  for (std::size_t node = 0; node < nodes.size(); ++node) {
    const Offset& offset = offsets[node];
    if (offset.points == 0U) continue;
    nodes[node].height += variance / (variance + offset.variance(spread)) * offset.heights.middle;
    nodes[node].stddev = std::min(nodes[node].stddev, std::max(offset.heights.stddev, spread));
  }
  return {ground.corner(), ground.spacing(), ground.columns(),
          ground.rows(),   std::move(nodes), ground.observed()};
}

}  // namespace

GroundModel estimateGround(const PointCloud& cloud, const PreprocessingParameters& parameters,
                           const ComputeDevice& device) {
  if (cloud.empty()) return {};
  const auto max_slope = static_cast<float>(std::tan(parameters.ground_max_tilt * M_PI / 180.0));
  const auto tolerance = static_cast<float>(2.0 * parameters.ground_distance);
  const auto spacing = static_cast<float>(parameters.ground_cell);
  const Extent extent = extentOf(cloud.points);

  // 1. The block's plane through the lowest points.
  const std::vector<Eigen::Vector3f> candidates = lowestPoints(cloud, extent);
  Plane block_plane = ransacPlane(candidates, tolerance, max_slope, device);
  const bool lowest = liesLowest(block_plane, cloud, tolerance);
  if (!lowest) block_plane = lowestLevel(candidates);
  const bool observed =
      lowest && isExtended(block_plane, candidates, tolerance, parameters.ground_min_coverage);

  const int columns = static_cast<int>((extent.high.x() - extent.low.x()) / spacing) + 2;
  const int rows = static_cast<int>((extent.high.y() - extent.low.y()) / spacing) + 2;
  const auto node_count = static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows);

  // 2. Points near that plane.
  const std::vector<std::uint32_t> near = indicesWhere(cloud.size(), [&](std::size_t i) {
    return observed && std::abs(residualOf(block_plane, cloud.points[i])) <= kRidgeHeight;
  });
  const CellPoints near_plane(valuesAt(cloud.points, near), extent.low, spacing, columns, rows);

  // 3. The soil at every node, of those within one spacing.
  std::vector<GroundModel::Node> nodes(node_count);
  parallelChunks(node_count, kNodesOfTask, [&](std::size_t begin, std::size_t end) {
    std::vector<Eigen::Vector3f> nearby;
    std::vector<float> residuals;
    for (std::size_t node = begin; node < end; ++node) {
      const std::size_t row = node / static_cast<std::size_t>(columns);
      const std::size_t column = node % static_cast<std::size_t>(columns);
      const Eigen::Vector2f position =
          extent.low +
          spacing * Eigen::Vector2f(static_cast<float>(column), static_cast<float>(row));
      nearby.clear();
      near_plane.forEachCellAround(node, [&](std::uint32_t first, std::uint32_t last) {
        nearby.insert(nearby.end(), near_plane.points().begin() + first,
                      near_plane.points().begin() + last);
      });
      nodes[node] = fitNode(position, block_plane, nearby, spacing, max_slope, residuals);
    }
  });
  fillUnseenNodes(nodes, columns, rows);
  GroundModel ground(extent.low, spacing, columns, rows, std::move(nodes), observed);
  if (!observed) return ground;

  // 4. Closer to it, where it is no plane.
  constexpr int kRounds = 2;
  const auto soil = static_cast<float>(parameters.ground_distance);
  ground = withTwiceTheNodes(ground);
  const CellPoints points(pointsNear(ground, cloud.points, kRounds * soil), ground.corner(),
                          ground.spacing(), ground.columns(), ground.rows());
  for (int round = 0; round < kRounds; ++round) ground = settled(ground, points, soil);
  return ground;
}

std::vector<std::uint8_t> classifyGround(const PointCloud& cloud, const GroundModel& ground,
                                         const PreprocessingParameters& parameters) {
  std::vector<std::uint8_t> is_ground(cloud.size(), 0U);
  if (!ground.observed()) return is_ground;
  // 1. What lies lower than clods and the model's own error reach is soil...
  constexpr float kUsualRoughness = 0.008F;  // [m] at least, of soil that looks smooth here
  constexpr float kFoot = 0.05F;             // [m] of what stands there, above the soil's points
  const auto most = static_cast<float>(parameters.ground_distance);
  const std::vector<std::uint32_t> low = indicesWhere(cloud.size(), [&](std::size_t i) {
    return !ground.clearlyAbove(cloud.points[i], most + kFoot) &&
           ground.heightAbove(cloud.points[i]) < most + kFoot;
  });
  enum class Kind : std::uint8_t { kOther, kFoot, kSoil, kUncertain };
  std::vector<Kind> kinds(low.size(), Kind::kOther);
  parallelChunks(low.size(), kPointsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const Eigen::Vector3f& p = cloud.points[low[k]];
      const float height = ground.heightAbove(p);
      const float roughness = ground.stddevAt(p.x(), p.y());
      const float highest = std::min(most, 3.0F * std::max(roughness, kUsualRoughness));
      constexpr float kSureSoil = 2.5F;  // standard deviations
      if (height > highest) {
        if (height < highest + kFoot) kinds[k] = Kind::kFoot;
        continue;
      }
      is_ground[low[k]] = 1U;
      kinds[k] = height > kSureSoil * roughness ? Kind::kUncertain : Kind::kSoil;
    }
  });
  std::vector<Eigen::Vector3f> feet;     // of what stands on it, seen from above
  std::vector<std::uint32_t> uncertain;  // soil, unless it is such a foot too
  for (std::size_t k = 0; k < low.size(); ++k) {
    const Eigen::Vector3f& p = cloud.points[low[k]];
    if (kinds[k] == Kind::kFoot) feet.emplace_back(p.x(), p.y(), 0.0F);
    if (kinds[k] == Kind::kUncertain) uncertain.push_back(low[k]);
  }
  // 2. ...but for the feet of what stands on it.
  constexpr float kReach = 0.012F;      // [m] of a foot about what stands on it
  constexpr std::uint32_t kLeast = 2U;  // points that stand on it
  const NeighborGrid grid(feet, kReach);
  parallelChunks(uncertain.size(), kPointsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const Eigen::Vector3f& p = cloud.points[uncertain[k]];
      if (grid.hasWithin({p.x(), p.y(), 0.0F}, kReach, kLeast)) is_ground[uncertain[k]] = 0U;
    }
  });
  return is_ground;
}

std::vector<std::uint8_t> soilAtFeet(const PointCloud& cloud, const GroundModel& ground,
                                     const std::vector<std::uint8_t>& is_ground) {
  constexpr float kStanding = 0.12F;  // [m] of what stands there, from the soil
  constexpr float kReach = 0.035F;    // [m] beside it: a stem's width and some soil to compare with
  std::vector<std::uint8_t> at_feet(cloud.size(), 0U);
  std::vector<Eigen::Vector3f> feet;  // seen from above
  const auto isFoot = [&](std::size_t i) {
    return is_ground[i] == 0U && !ground.clearlyAbove(cloud.points[i], kStanding) &&
           ground.heightAbove(cloud.points[i]) < kStanding;
  };
  for (const std::uint32_t i : indicesWhere(cloud.size(), isFoot)) {
    feet.emplace_back(cloud.points[i].x(), cloud.points[i].y(), 0.0F);
  }
  const NeighborGrid grid(feet, kReach);
  parallelChunks(cloud.size(), kPointsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (is_ground[i] == 0U) continue;
      const Eigen::Vector3f& p = cloud.points[i];
      if (grid.hasWithin({p.x(), p.y(), 0.0F}, kReach, 1U)) at_feet[i] = 1U;
    }
  });
  return at_feet;
}

}  // namespace field_phenotyping
