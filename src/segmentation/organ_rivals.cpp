#include "field_phenotyping/segmentation/organ_rivals.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

namespace field_phenotyping {

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
  for (const LeafHost& host : hosts) top.push_back(host.top);
  std::vector<float> sure = top;
  std::vector<float> chance(hosts.size(), 0.0F);  // that the highest piece is another's
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (cells.owner[n] < 0) continue;
    const auto plant = static_cast<std::size_t>(cells.owner[n]);
    const std::int32_t piece = pieces.of_cell[n];
    const float of_rival = piece < 0 ? 0.0F : rivals[static_cast<std::size_t>(piece)].chance;
    const float z = cells.centers[n].z();
    if (z > top[plant]) {
      top[plant] = z;
      chance[plant] = of_rival;
    }
    if (of_rival < kSure) sure[plant] = std::max(sure[plant], z);
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
