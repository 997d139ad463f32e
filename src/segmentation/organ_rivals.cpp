#include "field_phenotyping/segmentation/organ_rivals.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

/// [m] up to which a plant's points are its stem's.
float endOfStem(const LeafHost& host) {
  return host.axis->empty() ? host.top : host.axis->nodes().back().position.z();
}

/// Chance that each cell is of another plant than its owner: of a piece its rival's. What is in no
/// piece, and what carries a stem on, is judged by the pieces round it.
std::vector<float> chancesOfOthers(const OrganCells& cells, const LeafPieces& pieces,
                                   const std::vector<Rival>& rivals,
                                   const std::vector<LeafHost>& hosts) {
  constexpr float kAround = 0.06F;  // [m]
  // Of tops wholly among another plant's pieces about half were its own.
  constexpr float kAmongOthers = 0.5F;
  const NeighborGrid grid(cells.centers, kAround);
  std::vector<float> chances(cells.size(), 0.0F);
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      const std::int32_t plant = cells.owner[n];
      if (plant < 0) continue;
      if (pieces.of_cell[n] >= 0) {
        chances[n] = rivals[static_cast<std::size_t>(pieces.of_cell[n])].chance;
        continue;
      }
      if (cells.centers[n].z() <= endOfStem(hosts[static_cast<std::size_t>(plant)])) continue;
      float sum = 0.0F;
      float count = 0.0F;
      grid.forEachWithin(cells.centers[n], kAround, [&](std::uint32_t near, float) {
        if (pieces.of_cell[near] < 0 || cells.owner[near] < 0) return;
        count += 1.0F;
        sum += cells.owner[near] == plant
                   ? rivals[static_cast<std::size_t>(pieces.of_cell[near])].chance
                   : kAmongOthers;
      });
      if (count > 0.0F) chances[n] = sum / count;
    }
  });
  return chances;
}

}  // namespace

std::vector<Rival> findRivals(const std::vector<std::vector<Misfit>>& costs,
                              const std::vector<std::int32_t>& plant_of) {
  constexpr float kNone = std::numeric_limits<float>::max();
  // Costs overstate how sure they are, since a piece that is odd is so all along: of tops whose
  // piece was dearer for any other plant by so much, every fifth was another's.
  constexpr float kScale = 10.0F;
  std::vector<float> own(plant_of.size(), kNone);
  std::vector<float> least(plant_of.size(), kNone);  // of others
  std::vector<Rival> rivals(plant_of.size());
  for (std::size_t plant = 0; plant < costs.size(); ++plant) {
    for (const Misfit& of : costs[plant]) {
      if (plant_of[of.piece] == static_cast<std::int32_t>(plant)) {
        own[of.piece] = of.cost;
      } else if (of.cost < least[of.piece]) {
        least[of.piece] = of.cost;
        rivals[of.piece].plant = static_cast<std::int32_t>(plant);
      }
    }
  }
  for (std::size_t piece = 0; piece < rivals.size(); ++piece) {
    if (rivals[piece].plant < 0 || own[piece] == kNone) continue;
    const float dearer = std::max(0.0F, least[piece] - own[piece]);
    rivals[piece].chance = 0.5F * std::exp(-dearer / kScale);
  }
  return rivals;
}

std::vector<float> topStddevsOf(const OrganCells& cells, const LeafPieces& pieces,
                                const std::vector<Rival>& rivals,
                                const std::vector<LeafHost>& hosts) {
  constexpr float kSure = 0.05F;  // chance of what is not doubted
  std::vector<float> top;         // of each plant, and of what of it is sure
  for (const LeafHost& host : hosts) top.push_back(endOfStem(host));
  std::vector<float> sure = top;
  std::vector<float> chance(hosts.size(), 0.0F);  // that the highest cell is another's
  const std::vector<float> chances = chancesOfOthers(cells, pieces, rivals, hosts);
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (cells.owner[n] < 0) continue;
    const auto plant = static_cast<std::size_t>(cells.owner[n]);
    const float z = cells.centers[n].z();
    if (z > top[plant]) {
      top[plant] = z;
      chance[plant] = chances[n];
    }
    if (chances[n] < kSure) sure[plant] = std::max(sure[plant], z);
  }
  std::vector<float> variance(hosts.size());
  for (std::size_t plant = 0; plant < hosts.size(); ++plant) {
    const float drop = top[plant] - sure[plant];
    variance[plant] = chance[plant] * drop * drop;
  }
  std::vector<float> rise_variance(hosts.size(), 0.0F);
  for (std::size_t piece = 0; piece < rivals.size(); ++piece) {
    const Rival& rival = rivals[piece];
    if (rival.chance < kSure) continue;
    float high = std::numeric_limits<float>::lowest();
    for (const std::uint32_t n : pieces.cells[piece]) high = std::max(high, cells.centers[n].z());
    const auto plant = static_cast<std::size_t>(rival.plant);
    const float rise = std::max(0.0F, high - top[plant]);
    rise_variance[plant] = std::max(rise_variance[plant], rival.chance * rise * rise);
  }
  std::vector<float> stddevs;
  for (std::size_t plant = 0; plant < hosts.size(); ++plant) {
    stddevs.push_back(std::sqrt(variance[plant] + rise_variance[plant]));
  }
  return stddevs;
}

}  // namespace field_phenotyping
