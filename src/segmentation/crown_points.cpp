#include "field_phenotyping/segmentation/crown_points.hpp"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <utility>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"

namespace field_phenotyping {
namespace {

/// How far from what is known of a plant points may be its own [m]: farther in a stand of which
/// hardly anything is seen from some height on.
struct Reach {
  float aside;  // of its stem's line
  float lone;   // the same, of what is no plant's, where no other line is nearly as near
  float gap;    // along the line, without a point of the plant
};
constexpr Reach kSeen = {0.06F, 0.06F, 0.25F};
constexpr Reach kSparse = {0.10F, 0.20F, 0.60F};  // a tassel's branches, and what it leans
constexpr float kHighest = 1.5F;                  // [m] above a stem's end

/// A stem's line above its end.
struct Line {
  Eigen::Vector3f end = Eigen::Vector3f::Zero();
  Eigen::Vector3f direction = Eigen::Vector3f::UnitZ();
  bool known = false;

  explicit Line(const StemAxis& axis) {
    constexpr float kUpper = 0.75F;  // share of the stem, above which it shows where it points
    if (axis.empty()) return;
    known = true;
    end = axis.pointAt(axis.length());
    direction = (end - axis.pointAt(kUpper * axis.length())).normalized();
  }
  float along(const Eigen::Vector3f& point) const { return (point - end).dot(direction); }
  float aside(const Eigen::Vector3f& point) const {
    return (point - end - along(point) * direction).norm();
  }
};

/// A point that may go to another plant.
struct Candidate {
  Eigen::Vector3f place;
  std::int32_t* owner;
  bool isolated = false;
  std::int32_t nearest = -1;  // plant whose line is nearest, if it is within the tube
  float aside = std::numeric_limits<float>::infinity();   // [m] of that line
  float second = std::numeric_limits<float>::infinity();  // [m] of the next line
};

std::vector<Candidate> findCandidates(const Block& block, double sparse_from, PointOwners& owners,
                                      PointOwners& isolated) {
  const auto is_sparse = [&](const Eigen::Vector3f& point) {
    return static_cast<double>(block.ground.heightAbove(point)) >= sparse_from;
  };
  const std::vector<std::uint32_t> may_go = indicesWhere(owners.plant.size(), [&](std::size_t i) {
    return owners.stem[i] < 0 && (owners.plant[i] < 0 || is_sparse(block.cloud.points[i]));
  });
  std::vector<Candidate> candidates;
  for (const std::uint32_t i : may_go)
    candidates.push_back({block.cloud.points[i], &owners.plant[i]});
  for (std::size_t i = 0; i < isolated.plant.size(); ++i) {
    const Eigen::Vector3f& point = block.isolated.points[i];
    if (isolated.stem[i] < 0 && is_sparse(point)) {
      candidates.push_back({point, &isolated.plant[i], true});
    }
  }
  return candidates;
}

/// How many times as far the next line is from what may go to a line that is not near.
constexpr float kClear = 1.6F;

void findNearestLines(const std::vector<Line>& lines, const Reach& reach,
                      std::vector<Candidate>& candidates) {
  const float tube = kClear * reach.lone;  // [m] about a line
  std::vector<Eigen::Vector3f> places;
  for (const Candidate& candidate : candidates) places.push_back(candidate.place);
  const NeighborGrid grid(places, tube);
  for (std::size_t plant = 0; plant < lines.size(); ++plant) {
    const Line& line = lines[plant];
    if (!line.known) continue;
    grid.forEachWithinOfLine(line.end, line.end + kHighest * line.direction, tube,
                             [&](std::uint32_t k) {
                               Candidate& candidate = candidates[k];
                               const float aside = line.aside(candidate.place);
                               if (line.along(candidate.place) < 0.0F) return;
                               if (!(aside < candidate.second)) return;
                               candidate.second = aside;
                               if (!(aside < candidate.aside)) return;
                               std::swap(candidate.aside, candidate.second);
                               candidate.nearest = static_cast<std::int32_t>(plant);
                             });
  }
  for (Candidate& candidate : candidates) {
    const bool is_lone = *candidate.owner < 0 && candidate.second >= kClear * candidate.aside;
    if (!(candidate.aside < (is_lone ? reach.lone : reach.aside))) candidate.nearest = -1;
  }
}

/// How many times as many points dust has within the tubes as beside them, in a box about a stand.
/// @param middles of the tubes, at height 0
float dustWithinTubes(const std::vector<Eigen::Vector3f>& middles,
                      const Eigen::AlignedBox2f& stand) {
  constexpr float kStep = 0.05F;  // [m]
  const NeighborGrid grid(middles, kSparse.aside);
  float within = 0.0F;
  float beside = 0.0F;
  for (float x = stand.min().x(); x < stand.max().x(); x += kStep) {
    for (float y = stand.min().y(); y < stand.max().y(); y += kStep) {
      (grid.hasWithin({x, y, 0.0F}, kSparse.aside, 1U) ? within : beside) += 1.0F;
    }
  }
  return within / std::max(beside, 1.0F);
}

/// Takes isolated points out of the tubes at heights where they may well be dust, which is
/// everywhere, while tassels are above their stems.
void dropDust(const Block& block, const std::vector<Line>& lines, double sparse_from,
              std::vector<Candidate>& candidates) {
  constexpr float kLayer = 0.20F;   // [m]
  constexpr float kAround = 0.30F;  // [m] beside the outermost lines
  constexpr float kTimes = 3.0F;    // as many as dust would have
  struct Layer {
    float within = 0.0F;
    float beside = 0.0F;
  };
  std::map<int, Layer> layers;
  const auto layerOf = [&](const Candidate& candidate) -> Layer& {
    const double above =
        static_cast<double>(block.ground.heightAbove(candidate.place)) - sparse_from;
    return layers[static_cast<int>(above / static_cast<double>(kLayer))];
  };
  Eigen::AlignedBox2f stand;
  std::vector<Eigen::Vector3f> middles;  // of the tubes
  for (const Line& line : lines) {
    if (!line.known) continue;
    stand.extend(line.end.head<2>());
    middles.emplace_back(line.end.x(), line.end.y(), 0.0F);
  }
  stand.min().array() -= kAround;
  stand.max().array() += kAround;
  for (const Candidate& candidate : candidates) {
    if (!candidate.isolated || !stand.contains(candidate.place.head<2>())) continue;
    Layer& layer = layerOf(candidate);
    (candidate.aside < kSparse.aside ? layer.within : layer.beside) += 1.0F;
  }
  if (layers.empty()) return;
  const float of_dust = dustWithinTubes(middles, stand);
  for (Candidate& candidate : candidates) {
    if (!candidate.isolated || candidate.nearest < 0) continue;
    const Layer& layer = layerOf(candidate);
    if (layer.within < kTimes * of_dust * layer.beside) candidate.nearest = -1;
  }
}

/// Whether a point's owner has as good a claim to it as the plant with the nearest line.
bool isNearOwner(const Candidate& candidate, const std::vector<Line>& lines) {
  constexpr float kNearly = 2.0F;  // times the distance of the nearest line
  if (*candidate.owner < 0 || *candidate.owner == candidate.nearest) return false;
  const Line& line = lines[static_cast<std::size_t>(*candidate.owner)];
  return line.along(candidate.place) > 0.0F &&
         line.aside(candidate.place) < kNearly * candidate.aside;
}

/// Candidates that a plant may get: how far along its line, and which; upwards.
using Crown = std::vector<std::pair<float, std::size_t>>;

/// Whether a candidate is far nearer to its line than to the next one.
bool isClear(const Candidate& candidate) {
  constexpr float kTimes = 3.0F;
  return candidate.second >= kTimes * candidate.aside;
}

/// The widest gap that plants of this stand may have between points that are clearly theirs [m]:
/// beyond a wider one others are a branch of a taller neighbour.
float usualGap(const std::vector<Candidate>& candidates, const std::vector<Crown>& crowns,
               const std::vector<float>& reached) {
  constexpr float kLeast = 0.12F;  // [m]
  constexpr float kTimes = 1.5F;   // the median
  std::vector<float> gaps;
  for (std::size_t plant = 0; plant < crowns.size(); ++plant) {
    float from = reached[plant];
    float widest = -1.0F;
    for (const auto& [along, k] : crowns[plant]) {
      if (!isClear(candidates[k])) continue;
      widest = std::max(widest, along - from);
      from = std::max(from, along);
    }
    if (widest >= 0.0F) gaps.push_back(widest);
  }
  return gaps.empty() ? kLeast : std::max(kTimes * medianOf(std::move(gaps)), kLeast);
}

/// Whether hardly another one stands with it so far above what is known of the plant. A point or
/// two of another plant's are the tip of one of its leaves there.
/// @param reached along the line [m]
bool standsAlone(const Crown& crown, Crown::const_iterator at, float reached) {
  constexpr float kFar = 0.10F;   // [m]
  constexpr float kTuft = 0.15F;  // [m]
  constexpr std::ptrdiff_t kFew = 3;
  const float along = at->first;
  const auto end = std::lower_bound(at, crown.end(), std::pair(along + kTuft, std::size_t{0}));
  return along > reached + kFar && end - at < kFew;
}

}  // namespace

void giveCrownPoints(const Block& block, const std::vector<StemAxis>& axes, double sparse_from,
                     PointOwners& owners, PointOwners& isolated) {
  std::vector<Candidate> candidates = findCandidates(block, sparse_from, owners, isolated);
  if (candidates.empty() || axes.empty()) return;
  std::vector<Line> lines;
  for (const StemAxis& axis : axes) lines.emplace_back(axis);
  const Reach reach = std::isfinite(sparse_from) ? kSparse : kSeen;
  findNearestLines(lines, reach, candidates);
  dropDust(block, lines, sparse_from, candidates);

  std::vector<float> reached(lines.size(), 0.0F);  // along each line, by points of its plant
  for (std::size_t i = 0; i < owners.plant.size(); ++i) {
    if (owners.plant[i] < 0) continue;
    const auto plant = static_cast<std::size_t>(owners.plant[i]);
    reached[plant] = std::max(reached[plant], lines[plant].along(block.cloud.points[i]));
  }
  std::vector<Crown> crowns(lines.size());
  for (std::size_t k = 0; k < candidates.size(); ++k) {
    const Candidate& candidate = candidates[k];
    if (candidate.nearest < 0 || isNearOwner(candidate, lines)) continue;
    const auto plant = static_cast<std::size_t>(candidate.nearest);
    crowns[plant].emplace_back(lines[plant].along(candidate.place), k);
  }
  for (Crown& crown : crowns) std::sort(crown.begin(), crown.end());
  const float usual_gap = usualGap(candidates, crowns, reached);
  for (std::size_t plant = 0; plant < lines.size(); ++plant) {
    for (auto at = crowns[plant].cbegin(); at != crowns[plant].cend(); ++at) {
      const auto [along, k] = *at;
      if (along > reached[plant] + reach.gap) break;
      if (along > reached[plant] + usual_gap && !isClear(candidates[k])) continue;
      if (*candidates[k].owner >= 0 && standsAlone(crowns[plant], at, reached[plant])) continue;
      reached[plant] = std::max(reached[plant], along);
      *candidates[k].owner = static_cast<std::int32_t>(plant);
    }
  }
}

}  // namespace field_phenotyping
