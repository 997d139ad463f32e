#include "field_phenotyping/segmentation/organ_assignment.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <queue>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"

namespace field_phenotyping {
namespace {

constexpr float kCell = 0.012F;        // [m] points this close are one node of the graph
constexpr float kNearReach = 0.04F;    // [m] steps within one organ
constexpr float kTurnCost = 0.02F;     // [m^2] of a turn by a right angle
constexpr float kShapeRadius = 0.06F;  // [m] neighbourhood that shows which way an organ runs
constexpr float kAcrossCost = 60.0F;   // how much dearer a step across an organ is than along it
constexpr float kLeastMisfit = 0.1F;  // what a step costs through an organ that fits its plant well
constexpr float kWeedHeight = 0.25F;  // [m] below it an organ must touch its plant

/// Points gathered into cells: far fewer nodes than points, and the same paths.
struct CellGraph {
  std::vector<std::uint32_t> node_of_point;
  std::vector<Eigen::Vector3f> centers;
  std::vector<std::int32_t> owner;
  std::vector<std::uint8_t> is_stem;
  std::vector<LocalShape> shapes;
};

CellGraph buildCells(const Block& block, const std::vector<std::int32_t>& owner) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  Eigen::Array3f low = points.front().array();
  for (const Eigen::Vector3f& p : points) low = low.min(p.array());
  std::vector<std::uint64_t> keys(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Array3i cell = ((points[i].array() - low) / kCell).cast<int>();
    keys[i] = static_cast<std::uint64_t>(cell.z()) << 42U |
              static_cast<std::uint64_t>(cell.y()) << 21U | static_cast<std::uint64_t>(cell.x());
  }
  std::vector<std::uint32_t> order(points.size());
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return keys[a] != keys[b] ? keys[a] < keys[b] : a < b;
  });

  CellGraph graph;
  graph.node_of_point.resize(points.size());
  std::vector<float> counts;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const std::uint32_t i = order[k];
    if (k == 0 || keys[i] != keys[order[k - 1]]) {
      graph.centers.emplace_back(Eigen::Vector3f::Zero());
      graph.owner.push_back(-1);
      counts.push_back(0.0F);
    }
    graph.node_of_point[i] = static_cast<std::uint32_t>(graph.centers.size() - 1U);
    graph.centers.back() += points[i];
    counts.back() += 1.0F;
    if (graph.owner.back() < 0) graph.owner.back() = owner[i];
  }
  for (std::size_t n = 0; n < graph.centers.size(); ++n) graph.centers[n] /= counts[n];
  for (const std::int32_t plant : graph.owner) graph.is_stem.push_back(plant >= 0 ? 1U : 0U);
  // Stems would pull the shape of what passes them towards their own.
  std::vector<Eigen::Vector3f> organs;
  for (std::size_t n = 0; n < graph.centers.size(); ++n) {
    if (graph.is_stem[n] == 0U) organs.push_back(graph.centers[n]);
  }
  const NeighborGrid grid(organs, 0.5F * kShapeRadius);
  const std::vector<LocalShape> shapes = computeLocalShapes(organs, grid, kShapeRadius);
  LocalShape upright;
  upright.linearity = 1.0F;
  graph.shapes.assign(graph.centers.size(), upright);
  for (std::size_t n = 0, organ = 0; n < graph.centers.size(); ++n) {
    if (graph.is_stem[n] == 0U) graph.shapes[n] = shapes[organ++];
  }
  return graph;
}

/// Cost of a step: its squared length, times more the less it follows the organs at both ends, and
/// more where the organ itself turns. A leaf that passes a foreign stem or leaf is nearest to it
/// across its own direction and runs another way, so it is not captured there; at its insertion it
/// rises steeply out of its own stem.
float stepCost(const CellGraph& graph, std::uint32_t from, std::uint32_t to, float squared) {
  if (!(squared > 0.0F)) return 0.0F;
  const Eigen::Vector3f step = graph.centers[to] - graph.centers[from];
  const LocalShape& a = graph.shapes[from];
  const LocalShape& b = graph.shapes[to];
  const auto across = [&](const LocalShape& shape) {
    const float along = step.dot(shape.direction);
    return shape.linearity * (1.0F - along * along / squared);
  };
  const float turn = a.linearity * b.linearity * (1.0F - std::abs(a.direction.dot(b.direction)));
  return squared * (1.0F + kAcrossCost * 0.5F * (across(a) + across(b))) + kTurnCost * turn * turn;
}

/// How little an organ at a node looks like one of the plant with that axis, from 0. Maize leaves
/// stay in a vertical plane through their own stem, rise steeply from it and flatten, then droop,
/// with the distance. Leaves that cross from a neighbour point past the stem and rise the wrong
/// way.
float misfit(const LocalShape& shape, const Eigen::Vector3f& center, const StemAxis& axis) {
  const Eigen::Vector2f away = (center - axis.pointAtHeight(center.z())).head<2>();
  const float distance = away.norm();
  constexpr float kOnStem = 0.025F;  // [m] too near to tell
  const Eigen::Vector2f run = shape.direction.head<2>();
  const float level = run.norm();
  if (distance < kOnStem || !(level > 1e-3F)) return 0.0F;

  const float miss = std::abs(run.x() * away.y() - run.y() * away.x()) / level;
  constexpr float kPlaneWidth = 0.02F;  // [m], and more with the distance
  constexpr float kPlaneSpread = 0.3F;
  const float off_plane =
      miss * std::min(1.0F, 2.0F * level) / (kPlaneWidth + kPlaneSpread * distance);

  const float outward = std::copysign(1.0F, run.dot(away));
  const float slope = std::atan2(outward * shape.direction.z(), std::abs(run.dot(away)) / distance);
  constexpr float kSlopeAtStem = 1.13F;  // [rad]
  constexpr float kSlopeLoss = 2.1F;     // [rad/m]
  constexpr float kSlopeWidth = 0.35F;   // [rad]
  constexpr float kSlopeSpread = 1.0F;   // [rad/m]
  const float off_slope =
      (slope - (kSlopeAtStem - kSlopeLoss * distance)) / (kSlopeWidth + kSlopeSpread * distance);

  constexpr float kMost = 10.0F;
  return shape.linearity * std::min(0.5F * (off_plane * off_plane + off_slope * off_slope), kMost);
}

/// Dijkstra from all owned cells; a path may step `reach` at most.
void growPaths(CellGraph& graph, const Block& block, const std::vector<StemAxis>& axes, float reach,
               bool only_tall) {
  const NeighborGrid grid(graph.centers, reach);
  struct Entry {
    float cost;
    std::uint32_t node;
    bool operator>(const Entry& other) const {
      return cost != other.cost ? cost > other.cost : node > other.node;
    }
  };
  std::vector<float> cost(graph.centers.size(), std::numeric_limits<float>::max());
  std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>> open;
  for (std::uint32_t n = 0; n < graph.centers.size(); ++n) {
    if (graph.owner[n] < 0) continue;
    cost[n] = 0.0F;
    open.push({0.0F, n});
  }
  while (!open.empty()) {
    const Entry entry = open.top();
    open.pop();
    if (entry.cost > cost[entry.node]) continue;
    grid.forEachWithin(graph.centers[entry.node], reach, [&](std::uint32_t next, float squared) {
      if (graph.is_stem[next] != 0U) return;
      const float step = stepCost(graph, entry.node, next, squared);
      if (entry.cost + kLeastMisfit * step >= cost[next]) return;
      const StemAxis& axis = axes[static_cast<std::size_t>(graph.owner[entry.node])];
      const float through = entry.cost + step * (kLeastMisfit + misfit(graph.shapes[next],
                                                                       graph.centers[next], axis));
      if (through >= cost[next]) return;
      if (only_tall && graph.owner[next] < 0 &&
          block.ground.heightAbove(graph.centers[next]) < kWeedHeight) {
        return;
      }
      cost[next] = through;
      graph.owner[next] = graph.owner[entry.node];
      open.push({through, next});
    });
  }
}

}  // namespace

std::vector<std::int32_t> assignOrgans(const Block& block, const std::vector<StemAxis>& axes,
                                       std::vector<std::int32_t> owner,
                                       const SegmentationParameters& parameters) {
  if (block.cloud.empty()) return owner;
  CellGraph graph = buildCells(block, owner);
  const auto far_reach = static_cast<float>(parameters.organ_reach);
  growPaths(graph, block, axes, std::min(kNearReach, far_reach), false);
  // Gaps that leaves in front have torn; not near the soil, where weeds stand as close.
  if (far_reach > kNearReach) growPaths(graph, block, axes, far_reach, true);
  for (std::size_t i = 0; i < owner.size(); ++i) {
    if (owner[i] < 0) owner[i] = graph.owner[graph.node_of_point[i]];
  }
  return owner;
}

}  // namespace field_phenotyping
