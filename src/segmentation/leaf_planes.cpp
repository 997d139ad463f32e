#include "field_phenotyping/segmentation/leaf_planes.hpp"

#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr float kNear = 0.04F;  // [m] from the axis: no azimuth to speak of

// Of a von Mises distribution: its mean cosine, and which concentration has that, by the bound of
// Amos (1974), which is off by less than 5 %.
float meanCosineOf(float concentration) {
  return concentration / (0.5F + std::sqrt(concentration * concentration + 2.25F));
}
float concentrationOf(float mean_cosine) {
  const float inverse = 1.0F / mean_cosine;
  const float beyond = inverse * inverse - 1.0F;
  return (inverse + std::sqrt(inverse * inverse + 8.0F * beyond)) / (2.0F * beyond);
}

/// 1 above the end of the stem, where other organs than leaves stand too.
std::size_t layerOf(float z, const LeafHost& host) {
  return z > host.axis->nodes().back().position.z() ? 1U : 0U;
}

}  // namespace

LeafPlanes LeafPlanes::learn(const OrganCells& cells, const LeafPieces& pieces,
                             const std::vector<LeafHost>& hosts) {
  LeafPlanes planes;
  planes.bearings_.resize(pieces.cells.size());
  parallelFor(pieces.cells.size(), [&](std::size_t piece) {
    const std::vector<std::uint32_t>& members = pieces.cells[piece];
    const std::int32_t plant = cells.owner[members.front()];
    if (plant < 0) return;
    planes.bearings_[piece] =
        bearingOf(cells, members, plant, hosts[static_cast<std::size_t>(plant)]);
  });
  std::vector<std::vector<std::uint32_t>> of_plants(hosts.size());
  for (std::uint32_t piece = 0; piece < planes.bearings_.size(); ++piece) {
    const std::int32_t plant = planes.bearings_[piece].plant;
    if (plant >= 0) of_plants[static_cast<std::size_t>(plant)].push_back(piece);
  }
  planes.learnCloseness(of_plants);
  for (const std::vector<std::uint32_t>& of_plant : of_plants) {
    Eigen::Vector2f& pull = planes.pulls_.emplace_back(Eigen::Vector2f::Zero());
    for (const std::uint32_t piece : of_plant) pull += planes.pullOf(planes.bearings_[piece]);
  }
  return planes;
}

LeafPlanes::Bearing LeafPlanes::bearingOf(const OrganCells& cells,
                                          const std::vector<std::uint32_t>& members,
                                          std::int32_t plant, const LeafHost& host) {
  Bearing bearing;
  bearing.plant = plant;
  float height = 0.0F;
  float count = 0.0F;
  for (const std::uint32_t n : members) {
    const Eigen::Vector3f& center = cells.centers[n];
    height += center.z();
    const Eigen::Vector2f away = (center - host.axis->pointAtHeight(center.z())).head<2>();
    const float distance = away.norm();
    if (distance < kNear) continue;
    const Eigen::Vector2f to = away / distance;
    bearing.once += to;
    bearing.doubled += Eigen::Vector2f(to.x() * to.x() - to.y() * to.y(), 2.0F * to.x() * to.y());
    count += 1.0F;
  }
  bearing.layer = layerOf(height / static_cast<float>(members.size()), host);
  if (count == 0.0F) return bearing;
  bearing.say = sayOfPiece(count);
  bearing.once /= count;
  bearing.doubled /= count;
  return bearing;
}

/// From pairs of a plant's pieces on opposite sides of the stem, which cannot be of one leaf: their
/// mean cosine is the square of that between one leaf and the plane.
void LeafPlanes::learnCloseness(const std::vector<std::vector<std::uint32_t>>& of_plants) {
  constexpr float kLeastPairs = 30.0F;
  constexpr float kMost = 0.95F;
  std::array<float, 2> sums{};
  std::array<float, 2> pairs{};
  for (const std::vector<std::uint32_t>& of_plant : of_plants) {
    for (std::size_t i = 0; i < of_plant.size(); ++i) {
      const Bearing& a = bearings_[of_plant[i]];
      for (std::size_t j = 0; j < i; ++j) {
        const Bearing& b = bearings_[of_plant[j]];
        if (a.layer != b.layer || a.once.dot(b.once) >= 0.0F) continue;
        sums[a.layer] += a.say * b.say * a.doubled.dot(b.doubled);
        pairs[a.layer] += a.say * b.say;
      }
    }
  }
  for (std::size_t layer = 0; layer < closeness_.size(); ++layer) {
    if (pairs[layer] < kLeastPairs || sums[layer] <= 0.0F) continue;
    closeness_[layer] = std::min(kMost, std::sqrt(sums[layer] / pairs[layer]));
  }
}

/// Twice the azimuth that a piece gives the plane, as long as how surely it does.
Eigen::Vector2f LeafPlanes::pullOf(const Bearing& bearing) const {
  const float closeness = closeness_[bearing.layer];
  if (closeness == 0.0F) return Eigen::Vector2f::Zero();
  return bearing.say * concentrationOf(closeness) * bearing.doubled;
}

float LeafPlanes::misfit(const PieceSamples& samples, std::uint32_t piece, std::size_t plant,
                         const LeafHost& host) const {
  // A piece is not to bear itself out.
  Eigen::Vector2f pull = pulls_[plant];
  if (bearings_[piece].plant == static_cast<std::int32_t>(plant)) pull -= pullOf(bearings_[piece]);
  const float sureness = pull.norm();
  if (sureness == 0.0F) return 0.0F;
  const Eigen::Vector2f plane = pull / sureness;

  const auto count = static_cast<float>(samples.size());
  Floats heights{};
  for (std::size_t k = 0; k < samples.size(); k += kLanes) {
    heights += samples.areCells(k) ? samples.lanesFrom(k).z : Floats{};
  }
  const float closeness =
      closeness_[layerOf(total(heights) / count, host)] * meanCosineOf(sureness);
  if (closeness <= 0.0F) return 0.0F;
  // A wrapped Cauchy distribution about the plane: a leaf that is bent aside is odd all along, and
  // no more than odd.
  const float in_plane = (1.0F - closeness) * (1.0F - closeness);
  const float scale = 1.0F / in_plane;
  Floats sum{};
  float known = 0.0F;
  for (std::size_t k = 0; k < samples.size(); k += kLanes) {
    const auto [x, y] = samples.awayFrom(k);
    const Floats squared = x * x + y * y;
    const Integers counts = samples.areCells(k) & (squared > kNear * kNear);
    const Floats cosine = ((x * x - y * y) * plane.x() + 2.0F * x * y * plane.y()) /
                          largerOf(squared, allOf(kNear * kNear));
    const Floats rarer = (1.0F + closeness * closeness - 2.0F * closeness * cosine) * scale;
    sum += counts ? logarithmOf(largerOf(rarer, allOf(1.0F))) : Floats{};
    known += total(counts ? allOf(1.0F) : Floats{});
  }
  const float usual = std::log((1.0F + closeness) / (1.0F - closeness));
  return (total(sum) - usual * known) / count;
}

}  // namespace field_phenotyping
