#include "field_phenotyping/segmentation/stem_seeds.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "field_phenotyping/common/key_map.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/partitioned.hpp"

namespace field_phenotyping {
namespace {

constexpr float kClusterRadius = 0.6F;  // in max_stem_radius: a stem's points lie this near
constexpr float kClusterSpacing =
    1.5F;                            // in max_stem_radius: clusters of a slab lie this far apart
constexpr float kMaxGap = 0.40F;     // [m] of stem that leaves may hide
constexpr float kGapCost = 0.3F;     // evidence lost per empty slab
constexpr float kFloatCost = 0.15F;  // evidence lost per slab between the soil and the chain
constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

/// Upright points that lie together in one slab.
struct Cluster {
  Eigen::Vector3f center = Eigen::Vector3f::Zero();
  Eigen::Vector2f slope = Eigen::Vector2f::Zero();  // horizontal shift per metre of height
  float weight = 0.0F;
  float evidence = 0.0F;  // weight, saturating at 1
  int slab = 0;
  bool used = false;
};

/// One point of the cloud with the stem evidence that it carries.
struct Vote {
  Eigen::Vector3f position;
  Eigen::Vector2f slope;
  float weight;
};

/// Whether the surface at a point is a flat sheet: a stem curves round within its own radius. Noise
/// as large as that curve hides the difference, and then nothing counts as a leaf.
bool isFlat(const Eigen::Vector3f& point, const NeighborGrid& grid, float radius) {
  constexpr std::uint32_t kMinNeighbors = 12U;
  constexpr float kFlat = 0.012F;
  const LocalShape fine = computeLocalShape(point, grid, radius);
  return fine.neighbors >= kMinNeighbors && fine.curvature < kFlat;
}

/// The points that speak for stems, slab by slab, ascending.
std::vector<std::vector<std::uint32_t>> collectVoters(const Block& block,
                                                      const std::vector<float>& upright,
                                                      const SegmentationParameters& p,
                                                      SeedEvidence evidence,
                                                      const std::vector<std::uint8_t>& explained) {
  constexpr std::size_t kMostSlabs = 2000U;
  const auto slabOf = [&](std::size_t i) -> std::size_t {
    if (!explained.empty() && explained[i] != 0U) return kMostSlabs;
    if (evidence == SeedEvidence::kUpright && !(upright[i] > 0.0F)) return kMostSlabs;
    const float height = block.ground.heightAbove(block.cloud.points[i]);
    if (height < static_cast<float>(p.seed_min_height)) return kMostSlabs;
    const float slab =
        (height - static_cast<float>(p.seed_min_height)) / static_cast<float>(p.seed_slab);
    return slab < static_cast<float>(kMostSlabs) ? static_cast<std::size_t>(slab) : kMostSlabs;
  };
  const Partitioned<std::uint32_t> by_slab(
      block.cloud.size(), kMostSlabs + 1U,  // and all others
      [&](std::size_t begin, std::size_t end, const auto& give) {
        for (std::size_t i = begin; i < end; ++i) give(slabOf(i), static_cast<std::uint32_t>(i));
      });
  std::size_t slabs = kMostSlabs;
  while (slabs > 0U && by_slab.sizeOf(slabs - 1U) == 0U) --slabs;
  std::vector<std::vector<std::uint32_t>> voters(slabs);
  parallelFor(slabs, [&](std::size_t slab) {
    voters[slab].reserve(by_slab.sizeOf(slab));
    by_slab.forEachOf(slab, [&](std::uint32_t i) { voters[slab].push_back(i); });
  });
  return voters;
}

/// Votes of one slab that lie together in a column `width` [m] wide, as one.
/// @param voteOf gives the vote of a point
template <class VoteOf>
std::vector<Vote> mergeVotes(const std::vector<std::uint32_t>& voters, const VoteOf& voteOf,
                             float width) {
  std::vector<Vote> merged;
  KeyMap<std::uint32_t> column_at;
  column_at.reserve(voters.size());
  for (const std::uint32_t voter : voters) {
    const Vote vote = voteOf(voter);
    constexpr std::int64_t kHalfRange = 1 << 30;  // columns on either side
    const auto numberOf = [&](float at) {
      return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(at / width)) +
                                        kHalfRange);
    };
    const std::uint64_t key = numberOf(vote.position.x()) << 32U | numberOf(vote.position.y());
    const auto [column, is_new] =
        column_at.tryEmplace(key, static_cast<std::uint32_t>(merged.size()));
    if (is_new) merged.push_back({Eigen::Vector3f::Zero(), Eigen::Vector2f::Zero(), 0.0F});
    Vote& sum = merged[*column];
    sum.weight += vote.weight;
    const float share = vote.weight / sum.weight;
    sum.position += share * (vote.position - sum.position);
    sum.slope += share * (vote.slope - sum.slope);
  }
  return merged;
}

/// A vote with the weight of all votes round it.
struct Peak {
  float density = 0.0F;
  std::uint32_t vote = 0U;
};

/// @param grid over the votes' places
std::vector<Peak> densities(const std::vector<Vote>& votes, const NeighborGrid& grid,
                            float radius) {
  const GridView view = grid.view();
  std::vector<float> weights(votes.size() + kLanes, 0.0F);  // by cells, as the grid has its points
  for (std::size_t k = 0; k < votes.size(); ++k) weights[k] = votes[view.order[k]].weight;
  std::vector<Peak> peaks(votes.size());
  const VectorLanes lanes;
  for (std::size_t i = 0; i < votes.size(); ++i) {
    const Place center{view.x[i], view.y[i], view.z[i]};
    Floats sum{};
    view.forEachRun(center, center, radius, [&](const GridView::Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; k += kLanes) {
        sum += VectorLanes::where(nearAmong(lanes, view, center, radius, run, k),
                                  loadFloats(&weights[k]));
      }
      return true;
    });
    peaks[i] = {total(sum), view.order[i]};
  }
  return peaks;
}

/// Peaks of the density of votes in one slab, strongest first.
template <class VoteOf>
void clusterSlab(const std::vector<std::uint32_t>& voters, const VoteOf& voteOf, int slab,
                 float max_stem_radius, std::vector<Cluster>& clusters) {
  const float radius = kClusterRadius * max_stem_radius;
  const float spacing = kClusterSpacing * max_stem_radius;
  constexpr float kColumn = 0.2F;  // of the clusters' radius
  const std::vector<Vote> votes = mergeVotes(voters, voteOf, kColumn * radius);
  if (votes.empty()) return;
  std::vector<Eigen::Vector3f> flat(votes.size());
  for (std::size_t i = 0; i < votes.size(); ++i) {
    flat[i] = {votes[i].position.x(), votes[i].position.y(), 0.0F};
  }
  const NeighborGrid grid(flat, radius);
  std::vector<Peak> peaks = densities(votes, grid, radius);
  std::sort(peaks.begin(), peaks.end(), [](const Peak& a, const Peak& b) {
    return a.density != b.density ? a.density > b.density : a.vote < b.vote;
  });
  std::vector<std::uint8_t> taken(votes.size(), 0U);
  for (const Peak& at : peaks) {
    const std::uint32_t peak = at.vote;
    if (taken[peak] != 0U) continue;
    Cluster cluster;
    cluster.slab = slab;
    Eigen::Vector3f center = flat[peak];
    for (int round = 0; round < 3; ++round) {
      Eigen::Vector3f position = Eigen::Vector3f::Zero();
      Eigen::Vector2f slope = Eigen::Vector2f::Zero();
      float weight = 0.0F;
      grid.forEachWithin(center, radius, [&](std::uint32_t k, float) {
        position += votes[k].weight * votes[k].position;
        slope += votes[k].weight * votes[k].slope;
        weight += votes[k].weight;
      });
      if (!(weight > 0.0F)) break;
      cluster.center = position / weight;
      cluster.slope = slope / weight;
      cluster.weight = weight;
      center = {cluster.center.x(), cluster.center.y(), 0.0F};
    }
    grid.forEachWithin(center, spacing, [&](std::uint32_t k, float) { taken[k] = 1U; });
    taken[peak] = 1U;
    if (cluster.weight > 0.0F) clusters.push_back(cluster);
  }
}

/// Turns weights into evidence in [0, 1), measured against what stems typically collect here, so
/// that dense and sparse clouds are treated alike.
void normaliseEvidence(std::vector<Cluster>& clusters) {
  if (clusters.empty()) return;
  std::vector<float> weights;
  for (const Cluster& cluster : clusters) weights.push_back(cluster.weight);
  constexpr double kStrongShare = 0.85;
  const auto strong =
      weights.begin() +
      static_cast<std::ptrdiff_t>(kStrongShare * static_cast<double>(weights.size() - 1U));
  std::nth_element(weights.begin(), strong, weights.end());
  constexpr float kHalfShare = 0.25F;
  const float half = std::max(kHalfShare * *strong, 1.0F);
  for (Cluster& cluster : clusters) cluster.evidence = cluster.weight / (cluster.weight + half);
}

/// Shift from cluster to cluster beside what their slopes foretell, at most [m].
float toleranceOver(float rise) {
  constexpr float kTolerance = 0.02F;
  constexpr float kTolerancePerMetre = 0.20F;
  return kTolerance + kTolerancePerMetre * rise;
}

/// How badly `high` continues `low`: 0 is straight on, 1 the most that is accepted; above 1: not.
float misalignment(const Cluster& low, const Cluster& high) {
  const float rise = high.center.z() - low.center.z();
  const Eigen::Vector2f shift = (high.center - low.center).head<2>();
  const Eigen::Vector2f expected = 0.5F * (low.slope + high.slope) * rise;
  return (shift - expected).norm() / toleranceOver(rise);
}

struct Chain {
  std::vector<std::size_t> clusters;  // from low to high
  float score = 0.0F;
};

/// A cluster that another one may continue, with what the step costs.
struct Link {
  std::size_t low;
  float cost;
};

/// For every cluster those below that it may continue.
std::vector<std::vector<Link>> linkClusters(const std::vector<Cluster>& clusters,
                                            const NeighborGrid& grid, float slab_height,
                                            float max_lean, const StandLean& stand) {
  const float reach = std::hypot(kMaxGap, kMaxGap * std::tan(max_lean) + 0.03F);
  float steepest = 0.0F;
  for (const Cluster& cluster : clusters) steepest = std::max(steepest, cluster.slope.norm());
  std::vector<std::vector<Link>> links(clusters.size());
  parallelFor(clusters.size(), [&](std::size_t high) {
    const Eigen::Vector3f& center = clusters[high].center;
    // What lies below and no farther aside than any slopes there could foretell.
    const float aside =
        0.5F * (clusters[high].slope.norm() + steepest) * reach + toleranceOver(reach);
    const Eigen::Vector3f corner(aside, aside, reach);
    const Eigen::Vector3f upper_corner(aside, aside, 0.0F);
    grid.forEachNearBox(center - corner, center + upper_corner, 0.0F,
                        [&](std::uint32_t low, const Eigen::Vector3f& place) {
                          if ((place - center).squaredNorm() > reach * reach) return;
                          const int skipped = clusters[high].slab - clusters[low].slab - 1;
                          if (skipped < 0 || center.z() <= clusters[low].center.z()) return;
                          if (static_cast<float>(skipped) * slab_height > kMaxGap) return;
                          const float bend = misalignment(clusters[low], clusters[high]);
                          if (bend > 1.0F) return;
                          const Eigen::Vector3f step = center - clusters[low].center;
                          constexpr float kCenterError = 0.012F;  // [m]
                          constexpr float kUsual = 4.0F;  // squared deviation that most stay within
                          const float leaning =
                              stand.deviation(step.head<2>() / step.z(), kCenterError / step.z());
                          const float excess = std::max(leaning * leaning - kUsual, 0.0F);
                          links[high].push_back({low, kGapCost * static_cast<float>(skipped) +
                                                          0.5F * bend * bend + 0.5F * excess});
                        });
  });
  return links;
}

/// Chains of clusters, by dynamic programming from low to high. Clusters are ordered by slab.
class Chains {
 public:
  Chains(const std::vector<Cluster>& clusters, const std::vector<std::vector<Link>>& links)
      : clusters_(clusters),
        links_(links),
        score_(clusters.size(), 0.0F),
        below_(clusters.size(), kNone),
        unused_(clusters.size()),
        changed_(clusters.size(), 0U) {
    std::iota(unused_.begin(), unused_.end(), std::size_t{0});
    for (std::size_t high = 0; high < clusters.size(); ++high) extendTo(high);
  }

  /// The chain of unused clusters with the most evidence.
  Chain best() {
    unused_.erase(std::remove_if(unused_.begin(), unused_.end(),
                                 [&](std::size_t c) { return clusters_[c].used; }),
                  unused_.end());
    ++round_;
    std::size_t best = kNone;
    for (const std::size_t high : unused_) {
      leaveUsed(high);
      if (best == kNone || score_[high] > score_[best]) best = high;
    }
    Chain chain;
    if (best == kNone) return chain;
    chain.score = score_[best];
    for (std::size_t c = best; c != kNone; c = below_[c]) chain.clusters.push_back(c);
    std::reverse(chain.clusters.begin(), chain.clusters.end());
    return chain;
  }

 private:
  /// The best chain that ends in a cluster, from those that end below it.
  void extendTo(std::size_t high) {
    float gain = -kFloatCost * static_cast<float>(clusters_[high].slab);
    below_[high] = kNone;
    for (const Link& link : links_[high]) {
      if (clusters_[link.low].used) continue;
      const float through = score_[link.low] - link.cost;
      if (through > gain) {
        gain = through;
        below_[high] = link.low;
      }
    }
    score_[high] = clusters_[high].evidence + gain;
  }

  /// Extends the chain that ends in a cluster anew if it leads through clusters used since. Others
  /// only lost worse ways.
  void leaveUsed(std::size_t high) {
    const std::size_t low = below_[high];
    if (low == kNone || (!clusters_[low].used && changed_[low] != round_)) return;
    extendTo(high);
    changed_[high] = round_;
  }

  const std::vector<Cluster>& clusters_;
  const std::vector<std::vector<Link>>& links_;
  std::vector<float> score_;
  std::vector<std::size_t> below_;
  std::vector<std::size_t> unused_;     // ascending
  std::vector<std::uint32_t> changed_;  // round of best() in which each was extended anew
  std::uint32_t round_ = 0U;
};

/// Draws the seeds that stray on to leaves back to the stem's own gentle curve: a parabola over the
/// height, fitted robustly.
void drawToCurve(std::vector<Eigen::Vector3f>& seeds) {
  constexpr std::size_t kLeastSeeds = 6U;
  if (seeds.size() < kLeastSeeds) return;
  constexpr float kScale = 0.035F;  // [m] seeds farther off count little
  constexpr int kRounds = 10;
  const float middle = 0.5F * (seeds.front().z() + seeds.back().z());
  const float half = 0.5F * (seeds.back().z() - seeds.front().z());
  const auto row = [&](const Eigen::Vector3f& seed) {
    const float t = (seed.z() - middle) / half;
    return Eigen::Vector3f(1.0F, t, t * t);
  };
  std::vector<float> weights(seeds.size(), 1.0F);
  Eigen::Matrix<float, 3, 2> curve = Eigen::Matrix<float, 3, 2>::Zero();
  for (int round = 0; round < kRounds; ++round) {
    constexpr float kLittleBend = 0.3F;  // a weak prior towards straight stems
    Eigen::Matrix3f normal = Eigen::Vector3f(0.0F, 0.0F, kLittleBend).asDiagonal();
    Eigen::Matrix<float, 3, 2> right = Eigen::Matrix<float, 3, 2>::Zero();
    for (std::size_t i = 0; i < seeds.size(); ++i) {
      const Eigen::Vector3f r = row(seeds[i]);
      normal += weights[i] * r * r.transpose();
      right += weights[i] * r * seeds[i].head<2>().transpose();
    }
    curve = normal.ldlt().solve(right);
    for (std::size_t i = 0; i < seeds.size(); ++i) {
      const Eigen::Vector2f off = seeds[i].head<2>() - curve.transpose() * row(seeds[i]);
      weights[i] = 1.0F / (1.0F + off.squaredNorm() / (kScale * kScale));
    }
  }
  for (std::size_t i = 0; i < seeds.size(); ++i) {
    const Eigen::Vector2f on_curve = curve.transpose() * row(seeds[i]);
    seeds[i].head<2>() = weights[i] * seeds[i].head<2>() + (1.0F - weights[i]) * on_curve;
  }
}

}  // namespace

std::vector<float> uprightWeights(const Block& block, const NeighborGrid& grid,
                                  const std::vector<LocalShape>& shapes,
                                  const SegmentationParameters& parameters) {
  constexpr float kMinWeight = 0.25F;
  const auto min_cosine = static_cast<float>(std::cos(parameters.max_lean * M_PI / 180.0));
  const float fine_radius = 0.5F * static_cast<float>(parameters.seed_radius);
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  std::vector<float> weights(points.size(), 0.0F);
  constexpr std::size_t kChunk = 4096U;
  parallelChunks(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const LocalShape& shape = shapes[i];
      if (shape.direction.z() < min_cosine) continue;
      const float upright = (shape.direction.z() - min_cosine) / (1.0F - min_cosine);
      const float weight = shape.linearity * std::sqrt(upright);
      if (weight >= kMinWeight && !isFlat(points[i], grid, fine_radius)) weights[i] = weight;
    }
  });
  return weights;
}

std::vector<StemSeeds> findStemSeeds(const Block& block, const std::vector<LocalShape>& shapes,
                                     const std::vector<float>& upright,
                                     const SegmentationParameters& parameters,
                                     SeedEvidence evidence, const StandLean& lean,
                                     const std::vector<std::uint8_t>& explained, std::size_t most) {
  // 1. Upright clusters in every slab over the local soil.
  const auto max_stem_radius = static_cast<float>(parameters.max_stem_radius);
  const auto voters = collectVoters(block, upright, parameters, evidence, explained);
  const auto voteOf = [&](std::uint32_t i) -> Vote {
    const Eigen::Vector3f& point = block.cloud.points[i];
    if (evidence == SeedEvidence::kDensity) return {point, Eigen::Vector2f::Zero(), 1.0F};
    const Eigen::Vector3f& direction = shapes[i].direction;
    return {point, direction.head<2>() / direction.z(), upright[i]};
  };
  std::vector<std::vector<Cluster>> of_slab(voters.size());
  std::vector<std::size_t> fullest_first(voters.size());  // which take the longest
  std::iota(fullest_first.begin(), fullest_first.end(), 0U);
  std::stable_sort(fullest_first.begin(), fullest_first.end(), [&](std::size_t a, std::size_t b) {
    return voters[a].size() > voters[b].size();
  });
  parallelFor(voters.size(), [&](std::size_t k) {
    const std::size_t slab = fullest_first[k];
    clusterSlab(voters[slab], voteOf, static_cast<int>(slab), max_stem_radius, of_slab[slab]);
  });
  std::vector<Cluster> clusters;
  for (const std::vector<Cluster>& of_one : of_slab) {
    clusters.insert(clusters.end(), of_one.begin(), of_one.end());
  }
  normaliseEvidence(clusters);
  if (clusters.empty()) return {};

  std::vector<Eigen::Vector3f> centers;
  for (const Cluster& cluster : clusters) centers.push_back(cluster.center);
  const NeighborGrid grid(centers, 0.2F);

  // 2. The best chain of clusters, again and again, until what is left is too short or too weak.
  const auto links = linkClusters(clusters, grid, static_cast<float>(parameters.seed_slab),
                                  static_cast<float>(parameters.max_lean * M_PI / 180.0), lean);
  Chains chains(clusters, links);
  std::vector<StemSeeds> stems;
  while (stems.size() < most) {
    const Chain chain = chains.best();
    if (chain.score < static_cast<float>(parameters.seed_min_score)) break;
    StemSeeds stem;
    stem.score = chain.score;
    for (const std::size_t c : chain.clusters) {
      stem.points.push_back(clusters[c].center);
      clusters[c].used = true;
      // What else lies on this stem in the slab is spent with it.
      grid.forEachWithin(clusters[c].center, kClusterSpacing * max_stem_radius,
                         [&](std::uint32_t k, float) {
                           if (clusters[k].slab == clusters[c].slab) clusters[k].used = true;
                         });
    }
    const float length = stem.points.back().z() - stem.points.front().z();
    if (stem.points.size() < 2U || length < static_cast<float>(parameters.seed_min_length) ||
        block.ground.heightAbove(stem.points.front()) >
            static_cast<float>(parameters.seed_max_height)) {
      continue;
    }
    drawToCurve(stem.points);
    stems.push_back(std::move(stem));
  }
  return stems;
}

}  // namespace field_phenotyping
