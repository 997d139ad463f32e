#include "field_phenotyping/segmentation/organ_assignment.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>
#include <utility>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/minimum_cut.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/leaf_form.hpp"
#include "field_phenotyping/segmentation/leaf_pieces.hpp"
#include "field_phenotyping/segmentation/leaf_planes.hpp"
#include "field_phenotyping/segmentation/organ_cells.hpp"
#include "field_phenotyping/segmentation/organ_rivals.hpp"
#include "field_phenotyping/segmentation/stem_continuation.hpp"

namespace field_phenotyping {
namespace {

struct Entry {
  float cost;
  std::uint32_t node;
  bool operator>(const Entry& other) const {
    return cost != other.cost ? cost > other.cost : node > other.node;
  }
};
using Queue = std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>>;

/// For every plant the pieces that stand near enough to be its own. What no plant explains well,
/// because it is bent or small, is so held against none of them, nor against what hangs on it.
/// @param planes nothing where not known yet
std::vector<std::vector<Misfit>> compareForms(const OrganCells& cells, const LeafPieces& pieces,
                                              const std::vector<LeafHost>& hosts,
                                              const LeafForm& form, float weight,
                                              const LeafPlanes* planes) {
  constexpr float kFarthest = 1.2F;  // [m] a leaf, and what its stem leans
  constexpr float kPlaneWeight = 6.0F;
  constexpr std::size_t kSamples = 64U;  // cells that show the form of a piece
  const auto level = [](const Eigen::Vector3f& p) { return Eigen::Vector3f(p.x(), p.y(), 0.0F); };
  std::vector<std::uint8_t> has_stem(hosts.size(), 0U);
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (cells.is_stem[n] != 0U) has_stem[static_cast<std::size_t>(cells.owner[n])] = 1U;
  }
  std::vector<Eigen::Vector3f> feet;
  for (const LeafHost& host : hosts) feet.push_back(level(host.axis->nodes().front().position));
  const NeighborGrid grid(feet, 0.5F * kFarthest);
  const std::size_t count = pieces.cells.size();
  std::vector<std::vector<std::pair<std::uint32_t, float>>> of_plants(count);  // for each piece
  parallelFor(count, [&](std::size_t piece) {
    const std::vector<std::uint32_t>& members = pieces.cells[piece];
    const std::size_t stride = (members.size() + kSamples - 1U) / kSamples;
    PieceSamples samples;
    samples.take(cells, members, stride);
    const float say = sayOfPiece(static_cast<float>(members.size()));
    const float share = weight * say / static_cast<float>(samples.size());
    grid.forEachWithin(level(cells.centers[members[members.size() / 2U]]), kFarthest,
                       [&](std::uint32_t plant, float) {
                         if (has_stem[plant] == 0U) return;
                         const LeafHost& host = hosts[plant];
                         samples.lookFrom(*host.axis);
                         // However small, what stands too high or far cannot be the plant's.
                         float off = form.tooFar(samples, host);
                         for (std::size_t k = 0; k < members.size(); k += stride) {
                           off += form.tooHigh(cells.centers[members[k]], host);
                         }
                         float cost = share * form.misfit(samples, host) +
                                      weight * off / static_cast<float>(samples.size());
                         if (planes != nullptr) {
                           cost += kPlaneWeight * say *
                                   planes->misfit(samples, static_cast<std::uint32_t>(piece), plant,
                                                  host);
                         }
                         of_plants[piece].emplace_back(plant, cost);
                       });
  });
  std::vector<std::vector<Misfit>> misfits(hosts.size());
  for (std::uint32_t piece = 0; piece < count; ++piece) {
    float least = std::numeric_limits<float>::max();
    for (const auto& [plant, cost] : of_plants[piece]) least = std::min(least, cost);
    for (const auto& [plant, cost] : of_plants[piece])
      misfits[plant].push_back({piece, cost - least});
  }
  return misfits;
}

/// Where every plant in turn takes what makes the sum of all costs least, until nothing changes: a
/// piece costs what it costs the plant that has it, and a link between pieces of two plants costs
/// the more the likelier it is that one continues the other.
///
/// @param costs    of each plant: the pieces that it can get at
/// @param plant_of of each piece: a first choice among them, or -1 where no plant gets at it
void settlePieces(const std::vector<std::vector<Misfit>>& costs,
                  const std::vector<std::vector<PieceLink>>& links,
                  std::vector<std::int32_t>& plant_of) {
  // Log odds that the pieces of a link are of one plant, roughly.
  constexpr float kSure = 4.0F;
  constexpr float kLinkScale = 2.0F;  // link cost that makes them e times less
  constexpr float kLeastOdds = 0.05F;
  constexpr int kMostRounds = 3;
  const auto whole = [](float cost) {
    constexpr float kUnit = 1000.0F;
    return static_cast<std::int64_t>(cost * kUnit);
  };
  const std::size_t count = plant_of.size();
  std::vector<std::vector<std::pair<std::uint32_t, std::int64_t>>> parting(count);
  for (std::size_t piece = 0; piece < count; ++piece) {
    for (const PieceLink& link : links[piece]) {
      const float odds = kSure * std::exp(-link.cost / kLinkScale);
      if (odds > kLeastOdds && plant_of[link.piece] >= 0) {
        parting[piece].emplace_back(link.piece, whole(odds));
      }
    }
  }
  std::vector<float> cost(count, 0.0F);  // to the plant that has it
  for (std::size_t plant = 0; plant < costs.size(); ++plant) {
    for (const Misfit& of : costs[plant]) {
      if (plant_of[of.piece] == static_cast<std::int32_t>(plant)) cost[of.piece] = of.cost;
    }
  }
  constexpr std::size_t kNoNode = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> node(count, kNoNode);
  std::vector<Misfit> others;  // pieces that the plant may take
  bool changed = true;
  for (int round = 0; round < kMostRounds && changed; ++round) {
    changed = false;
    for (std::size_t plant = 0; plant < costs.size(); ++plant) {
      const auto taker = static_cast<std::int32_t>(plant);
      others.clear();
      for (const Misfit& of : costs[plant]) {
        if (plant_of[of.piece] == taker) continue;
        node[of.piece] = others.size();
        others.push_back(of);
      }
      MinimumCut cut(others.size());
      for (std::size_t n = 0; n < others.size(); ++n) {
        const std::uint32_t piece = others[n].piece;
        cut.addCost(n, whole(others[n].cost - cost[piece]));
        for (const auto& [next, odds] : parting[piece]) {
          const bool together = plant_of[next] == plant_of[piece];
          if (node[next] == kNoNode) {
            cut.addCost(n, odds * ((plant_of[next] == taker ? 0 : 1) - (together ? 0 : 1)));
          } else if (piece < next) {
            // What was parted stays so unless both are taken.
            cut.addPairCost(n, node[next], odds);
            if (together) {
              cut.addPairCost(node[next], n, odds);
            } else {
              cut.addCost(node[next], -odds);
            }
          }
        }
      }
      const std::vector<bool> taken = cut.solve();
      for (std::size_t n = 0; n < others.size(); ++n) {
        const Misfit& of = others[n];
        node[of.piece] = kNoNode;
        if (!taken[n]) continue;
        plant_of[of.piece] = taker;
        cost[of.piece] = of.cost;
        changed = true;
      }
    }
  }
}

/// Gives whole pieces to plants. A plant gets at a piece from its stem or through pieces that this
/// one continues; every piece on the way costs as much as its form does not fit that plant. The
/// plant with the cheapest way has it; once the planes are known, pieces that continue one another
/// are then given away together.
/// @param planes nothing where the form is not known yet either
std::vector<Rival> assignPieces(OrganCells& cells, const LeafPieces& pieces,
                                const std::vector<std::vector<PieceLink>>& links,
                                const std::vector<LeafHost>& hosts, float reach,
                                const LeafForm& form, float misfit_weight,
                                const LeafPlanes* planes) {
  constexpr float kMostCost = 60.0F;
  constexpr float kGapScale = 0.04F;  // [m] of gap between a stem and its leaf that costs 1
  constexpr float kNone = std::numeric_limits<float>::max();
  const std::size_t count = pieces.cells.size();
  const std::vector<std::vector<Misfit>> misfits_of =
      compareForms(cells, pieces, hosts, form, misfit_weight, planes);
  const NeighborGrid grid(cells.centers, reach);
  std::vector<std::vector<Misfit>> ways(hosts.size());  // costs of the cheapest of each plant
  std::vector<std::vector<Misfit>> costs_of(hosts.size());
  constexpr std::size_t kTogether = 2U;  // plants of a task
  parallelChunks(hosts.size(), kTogether, [&](std::size_t begin, std::size_t end) {
    std::vector<float> cost(count, kNone);
    std::vector<float> start(count, kNone);    // at the stem
    std::vector<float> misfits(count, kNone);  // of pieces near the plant
    for (std::size_t plant = begin; plant < end; ++plant) {
      const StemAxis& axis = *hosts[plant].axis;
      if (misfits_of[plant].empty()) continue;
      for (const Misfit& misfit : misfits_of[plant]) misfits[misfit.piece] = misfit.cost;

      constexpr float kBeyondTop = 0.4F;  // [m] to where whorls open, and leaves come into sight
      constexpr float kFreely = 0.15F;    // [m] beyond the end, where many leaves begin
      constexpr float kBeyondScale = 0.025F;  // [m] farther on that costs 1
      const float slab = 0.5F * reach;
      for (float s = 0.0F; s <= axis.length() + kBeyondTop; s += slab) {
        const Eigen::Vector3f middle = axis.pointAt(s);
        const float radius = axis.radiusAt(s);
        // Not along what carries the stem on.
        const float farther = std::max(0.0F, s - axis.length() - kFreely);
        const float beyond =
            std::clamp(middle.z() - hosts[plant].top, 0.0F, farther) / kBeyondScale;
        grid.forEachWithin(middle, reach, [&](std::uint32_t n, float) {
          if (pieces.of_cell[n] < 0) return;
          const Eigen::Vector3f& center = cells.centers[n];
          if (std::abs(center.z() - middle.z()) > 0.5F * slab) return;
          const auto piece = static_cast<std::uint32_t>(pieces.of_cell[n]);
          if (misfits[piece] == kNone) return;
          const float away = (center - axis.pointAtHeight(center.z())).head<2>().norm();
          const float gap = std::max(0.0F, away - radius);
          const float from_stem = beyond + gap / kGapScale;
          if (from_stem >= start[piece]) return;
          if (gap > kOrganStep && cells.is_low[n] != 0U) return;
          start[piece] = std::min(start[piece],
                                  from_stem + form.misfit(cells.shapes[n], center, hosts[plant]));
        });
      }

      Queue open;
      const auto offer = [&](std::uint32_t piece, float through) {
        if (misfits[piece] == kNone) return;
        through += misfits[piece];
        if (through >= std::min(cost[piece], kMostCost)) return;
        cost[piece] = through;
        open.push({through, piece});
      };
      for (const Misfit& misfit : misfits_of[plant]) {
        if (start[misfit.piece] < kMostCost) offer(misfit.piece, start[misfit.piece]);
      }
      while (!open.empty()) {
        const Entry entry = open.top();
        open.pop();
        if (entry.cost > cost[entry.node]) continue;
        for (const PieceLink& link : links[entry.node]) offer(link.piece, entry.cost + link.cost);
      }
      for (const Misfit& misfit : misfits_of[plant]) {
        if (cost[misfit.piece] < kMostCost) {
          ways[plant].push_back({misfit.piece, cost[misfit.piece]});
          // What the way costs says less of a piece than its own form does.
          constexpr float kWayShare = 0.65F;
          costs_of[plant].push_back(
              {misfit.piece, misfit.cost + kWayShare * (cost[misfit.piece] - misfit.cost)});
        }
        cost[misfit.piece] = start[misfit.piece] = misfits[misfit.piece] = kNone;
      }
    }
  });
  std::vector<float> least(count, kNone);
  std::vector<std::int32_t> plant_of(count, -1);
  for (std::size_t plant = 0; plant < hosts.size(); ++plant) {
    for (const Misfit& way : ways[plant]) {
      if (way.cost >= least[way.piece]) continue;
      least[way.piece] = way.cost;
      plant_of[way.piece] = static_cast<std::int32_t>(plant);
    }
  }
  if (planes != nullptr) settlePieces(costs_of, links, plant_of);
  for (std::size_t piece = 0; piece < count; ++piece) {
    for (const std::uint32_t n : pieces.cells[piece]) cells.owner[n] = plant_of[piece];
  }
  return findRivals(costs_of, plant_of);
}

/// Cost of a step: its squared length, times more the less it follows the organs at both ends, and
/// more where the organ itself turns.
float stepCost(const OrganCells& cells, std::uint32_t from, std::uint32_t to, float squared) {
  constexpr float kAcrossCost = 60.0F;  // how much dearer a step across an organ is than along it
  constexpr float kTurnCost = 0.02F;    // [m^2] of a turn by a right angle
  if (!(squared > 0.0F)) return 0.0F;
  const Eigen::Vector3f step = cells.centers[to] - cells.centers[from];
  const LocalShape& a = cells.shapes[from];
  const LocalShape& b = cells.shapes[to];
  const auto across = [&](const LocalShape& shape) {
    const float along = step.dot(shape.direction);
    return shape.linearity * (1.0F - along * along / squared);
  };
  const float turn = a.linearity * b.linearity * (1.0F - std::abs(a.direction.dot(b.direction)));
  return squared * (1.0F + kAcrossCost * 0.5F * (across(a) + across(b))) + kTurnCost * turn * turn;
}

/// Shortest paths from all cells with an owner to those without; a path may step `reach` at most.
void growPaths(OrganCells& cells, const std::vector<LeafHost>& hosts, const LeafForm& form,
               float reach, bool only_tall) {
  constexpr float kLeastMisfit = 0.1F;  // what a step costs through an organ that fits its plant
  constexpr float kFar = std::numeric_limits<float>::max();
  /// A cell without an owner.
  struct Way {
    float cost = kFar;
    std::int32_t owner = -1;
    // Paths of one plant come to a cell from many sides.
    std::int32_t compared = -1;  // plant that `misfit` is known for
    float misfit = 0.0F;
  };
  /// Leads a path of a plant that has cost so much on to a cell; false where that is no better.
  const auto lead = [&](std::int32_t plant, float cost, std::uint32_t from, std::uint32_t to,
                        float squared, Way& way) {
    if (way.cost <= cost) return false;
    const float step = stepCost(cells, from, to, squared);
    if (cost + kLeastMisfit * step >= way.cost) return false;
    if (way.compared != plant) {
      const LeafHost& host = hosts[static_cast<std::size_t>(plant)];
      way.compared = plant;
      way.misfit = form.misfit(cells.shapes[to], cells.centers[to], host) +
                   form.tooHigh(cells.centers[to], host) + form.tooFar(cells.centers[to], host);
    }
    const float through = cost + step * (kLeastMisfit + way.misfit);
    if (through >= way.cost) return false;
    way.cost = through;
    way.owner = plant;
    return true;
  };

  std::vector<std::uint32_t> open_cells;
  constexpr std::uint32_t kOwned = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> number(cells.size(), kOwned);  // of each among the open ones
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (cells.owner[n] >= 0 || (only_tall && cells.is_low[n] != 0U)) continue;
    number[n] = static_cast<std::uint32_t>(open_cells.size());
    open_cells.push_back(n);
  }
  // First steps, out of cells that have an owner, and where paths may go on.
  struct Step {
    std::uint32_t way;
    float squared;  // [m^2]
  };
  const NeighborGrid grid(cells.centers, reach);
  std::vector<Way> ways(open_cells.size());
  std::vector<std::vector<Step>> steps(open_cells.size());
  constexpr std::size_t kOpenCells = 64U;  // of a task
  parallelChunks(open_cells.size(), kOpenCells, [&](std::size_t begin, std::size_t end) {
    std::vector<std::pair<std::uint32_t, float>> sources;
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint32_t n = open_cells[k];
      sources.clear();
      grid.forEachWithin(cells.centers[n], reach, [&](std::uint32_t near, float squared) {
        if (cells.owner[near] >= 0) {
          sources.emplace_back(near, squared);
        } else if (number[near] != kOwned && near != n) {
          steps[k].push_back({number[near], squared});
        }
      });
      std::sort(sources.begin(), sources.end());  // of equals the first
      for (const auto& [near, squared] : sources) {
        lead(cells.owner[near], 0.0F, near, n, squared, ways[k]);
      }
    }
  });
  Queue open;
  for (std::uint32_t k = 0; k < ways.size(); ++k) {
    if (ways[k].owner >= 0) open.push({ways[k].cost, k});
  }
  while (!open.empty()) {
    const auto [cost, from] = open.top();
    open.pop();
    if (cost > ways[from].cost) continue;
    for (const Step& step : steps[from]) {
      Way& way = ways[step.way];
      if (lead(ways[from].owner, cost, open_cells[from], open_cells[step.way], step.squared, way)) {
        open.push({way.cost, step.way});
      }
    }
  }
  for (std::size_t k = 0; k < ways.size(); ++k) {
    if (ways[k].owner >= 0) cells.owner[open_cells[k]] = ways[k].owner;
  }
}

/// Standard deviation of the points across a surface [m], which the stems show.
float noiseOf(const Block& block, const std::vector<StemAxis>& axes,
              const std::vector<std::int32_t>& owner) {
  const std::vector<std::uint32_t> of_stems =
      indicesWhere(owner.size(), [&](std::size_t i) { return owner[i] >= 0; });
  std::vector<float> off(of_stems.size());
  constexpr std::size_t kPoints = 4096U;  // of a task
  parallelChunks(of_stems.size(), kPoints, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint32_t i = of_stems[k];
      const StemAxis::Projection at =
          axes[static_cast<std::size_t>(owner[i])].project(block.cloud.points[i]);
      off[k] = std::abs(at.distance - at.radius);
    }
  });
  return off.empty() ? 0.0F : static_cast<float>(kMadToSigma) * medianOf(std::move(off));
}

/// @param owner of each point: the plant whose stem, or what carries that on, holds it, or -1
std::vector<LeafHost> hostsOf(const Block& block, const std::vector<StemAxis>& axes,
                              const std::vector<OrganEnd>& ends,
                              const std::vector<std::int32_t>& owner) {
  std::vector<LeafHost> hosts;
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    const StemAxis& axis = axes[plant];
    hosts.push_back({&axis, axis.empty() ? 0.0F : axis.nodes().back().position.z(), ends[plant]});
  }
  for (std::size_t i = 0; i < owner.size(); ++i) {
    if (owner[i] < 0) continue;
    float& top = hosts[static_cast<std::size_t>(owner[i])].top;
    top = std::max(top, block.cloud.points[i].z());
  }
  return hosts;
}

}  // namespace

OrganOwners assignOrgans(const Block& block, const std::vector<StemAxis>& axes,
                         std::vector<std::int32_t> owner, const SegmentationParameters& parameters,
                         const ComputeDevice& device) {
  if (block.cloud.empty()) return {std::move(owner), std::vector<float>(axes.size(), 0.0F)};
  const auto reach = static_cast<float>(parameters.organ_reach);
  const float noise = noiseOf(block, axes, owner);
  const std::vector<OrganEnd> ends = followStemsUp(block, axes, noise, owner);
  const std::vector<LeafHost> hosts = hostsOf(block, axes, ends, owner);
  OrganCells cells = gatherOrganCells(block, owner, device);
  const LeafPieces pieces = findLeafPieces(cells);
  constexpr float kStraightOn = 1.6F;  // of the reach, along a leaf
  const std::vector<std::vector<PieceLink>> links =
      linkLeafPieces(cells, pieces, kStraightOn * reach);
  // First with leaves as they usually are, then with what that shows of these ones.
  constexpr float kLooseWeight = 5.0F;
  constexpr float kFirmWeight = 15.0F;
  LeafForm form;
  assignPieces(cells, pieces, links, hosts, 2.0F * reach, form, kLooseWeight, nullptr);
  form = LeafForm::learn(cells, hosts);
  const LeafPlanes planes = LeafPlanes::learn(cells, pieces, hosts);
  const std::vector<Rival> rivals =
      assignPieces(cells, pieces, links, hosts, 2.0F * reach, form, kFirmWeight, &planes);
  // Crossings, margins and what is too small or rough to be a piece.
  growPaths(cells, hosts, form, std::min(kOrganStep, reach), false);
  // Gaps that leaves in front have torn; not near the soil, where weeds stand as close.
  if (reach > kOrganStep) growPaths(cells, hosts, form, reach, true);
  constexpr std::size_t kPoints = 16384U;  // of a task
  parallelChunks(owner.size(), kPoints, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (owner[i] < 0) owner[i] = cells.owner[cells.of_point[i]];
    }
  });
  return {std::move(owner), topStddevsOf(cells, pieces, rivals, hosts)};
}

}  // namespace field_phenotyping
