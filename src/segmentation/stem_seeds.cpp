#include "field_phenotyping/segmentation/stem_seeds.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <utility>

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
bool isFlat(const Eigen::Vector3f& point, const Block& block, const NeighborGrid& grid,
            float radius) {
  constexpr std::uint32_t kMinNeighbors = 12U;
  constexpr float kFlat = 0.012F;
  const LocalShape fine = computeLocalShape(point, block.cloud.points, grid, radius);
  return fine.neighbors >= kMinNeighbors && fine.curvature < kFlat;
}

std::vector<std::vector<Vote>> collectVotes(const Block& block, const NeighborGrid& grid,
                                            const std::vector<LocalShape>& shapes,
                                            const SegmentationParameters& p) {
  const auto min_height = static_cast<float>(p.seed_min_height);
  const auto slab_height = static_cast<float>(p.seed_slab);
  const auto min_cosine = static_cast<float>(std::cos(p.max_lean * M_PI / 180.0));
  std::vector<std::vector<Vote>> slabs;
  for (std::size_t i = 0; i < block.cloud.size(); ++i) {
    const Eigen::Vector3f& point = block.cloud.points[i];
    const float height = block.ground.heightAbove(point);
    const LocalShape& shape = shapes[i];
    if (height < min_height || shape.direction.z() < min_cosine) continue;
    const float upright = (shape.direction.z() - min_cosine) / (1.0F - min_cosine);
    const float weight = shape.linearity * std::sqrt(upright);
    constexpr float kMinWeight = 0.25F;
    if (weight < kMinWeight) continue;
    const auto slab = static_cast<std::size_t>((height - min_height) / slab_height);
    constexpr std::size_t kMaxSlabs = 2000U;
    if (slab >= kMaxSlabs) continue;
    if (isFlat(point, block, grid, 0.5F * static_cast<float>(p.seed_radius))) continue;
    if (slab >= slabs.size()) slabs.resize(slab + 1U);
    slabs[slab].push_back({point, shape.direction.head<2>() / shape.direction.z(), weight});
  }
  return slabs;
}

/// Peaks of the density of votes in one slab, strongest first.
void clusterSlab(const std::vector<Vote>& votes, int slab, float max_stem_radius,
                 std::vector<Cluster>& clusters) {
  const float radius = kClusterRadius * max_stem_radius;
  const float spacing = kClusterSpacing * max_stem_radius;
  if (votes.empty()) return;
  std::vector<Eigen::Vector3f> flat(votes.size());
  for (std::size_t i = 0; i < votes.size(); ++i) {
    flat[i] = {votes[i].position.x(), votes[i].position.y(), 0.0F};
  }
  const NeighborGrid grid(flat, spacing);
  std::vector<float> density(votes.size(), 0.0F);
  for (std::size_t i = 0; i < votes.size(); ++i) {
    grid.forEachWithin(flat[i], radius,
                       [&](std::uint32_t k, float) { density[i] += votes[k].weight; });
  }
  std::vector<std::uint32_t> order(votes.size());
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return density[a] != density[b] ? density[a] > density[b] : a < b;
  });
  std::vector<std::uint8_t> taken(votes.size(), 0U);
  for (const std::uint32_t peak : order) {
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

/// How badly `high` continues `low`: 0 is straight on, 1 the most that is accepted; above 1: not.
float misalignment(const Cluster& low, const Cluster& high) {
  const float rise = high.center.z() - low.center.z();
  const Eigen::Vector2f shift = (high.center - low.center).head<2>();
  const Eigen::Vector2f expected = 0.5F * (low.slope + high.slope) * rise;
  constexpr float kTolerance = 0.02F;
  constexpr float kTolerancePerMetre = 0.20F;
  return (shift - expected).norm() / (kTolerance + kTolerancePerMetre * rise);
}

struct Chain {
  std::vector<std::size_t> clusters;  // from low to high
  float score = 0.0F;
};

/// The chain of unused clusters with the most evidence, by dynamic programming from low to high.
Chain bestChain(const std::vector<Cluster>& clusters,
                const std::vector<std::vector<std::size_t>>& slabs, const NeighborGrid& grid,
                float slab_height, float max_lean) {
  std::vector<float> score(clusters.size(), 0.0F);
  std::vector<std::size_t> below(clusters.size(), kNone);
  const float max_shift_per_metre = std::tan(max_lean);
  std::size_t best = kNone;
  for (const auto& slab : slabs) {
    for (const std::size_t high : slab) {
      if (clusters[high].used) continue;
      float gain = -kFloatCost * static_cast<float>(clusters[high].slab);
      const Eigen::Vector3f& center = clusters[high].center;
      const float reach = std::hypot(kMaxGap, kMaxGap * max_shift_per_metre + 0.03F);
      grid.forEachWithin(center, reach, [&](std::uint32_t low, float) {
        const int skipped = clusters[high].slab - clusters[low].slab - 1;
        if (clusters[low].used || skipped < 0 || center.z() <= clusters[low].center.z()) return;
        if (static_cast<float>(skipped) * slab_height > kMaxGap) return;
        const float bend = misalignment(clusters[low], clusters[high]);
        if (bend > 1.0F) return;
        const float through =
            score[low] - kGapCost * static_cast<float>(skipped) - 0.5F * bend * bend;
        if (through > gain) {
          gain = through;
          below[high] = low;
        }
      });
      score[high] = clusters[high].evidence + gain;
      if (best == kNone || score[high] > score[best]) best = high;
    }
  }
  Chain chain;
  if (best == kNone) return chain;
  chain.score = score[best];
  for (std::size_t c = best; c != kNone; c = below[c]) chain.clusters.push_back(c);
  std::reverse(chain.clusters.begin(), chain.clusters.end());
  return chain;
}

/// Where the line through the lowest seeds meets the soil.
Eigen::Vector2f baseOf(const std::vector<Eigen::Vector3f>& points, const GroundModel& ground) {
  const Eigen::Vector3f& low = points.front();
  std::size_t i = 1;
  constexpr float kLever = 0.25F;
  while (i + 1 < points.size() && points[i].z() - low.z() < kLever) ++i;
  const Eigen::Vector3f step = points[i] - low;
  const float drop = ground.heightAbove(low);
  const Eigen::Vector2f slope = step.head<2>() / std::max(step.z(), 0.05F);
  return low.head<2>() - drop * slope;
}

float horizontalDistanceAt(const std::vector<Eigen::Vector3f>& chain,
                           const Eigen::Vector3f& point) {
  std::size_t i = 0;
  while (i + 2 < chain.size() && chain[i + 1].z() < point.z()) ++i;
  const Eigen::Vector3f step = chain[i + 1] - chain[i];
  const float share = step.z() > 0.0F ? (point.z() - chain[i].z()) / step.z() : 0.0F;
  return (chain[i] + share * step - point).head<2>().norm();
}

/// A leaf that rises from an accepted stem begins on it; so does a tiller.
bool branchesOff(const std::vector<Eigen::Vector3f>& chain, const std::vector<StemSeeds>& accepted,
                 const GroundModel& ground, float min_spacing) {
  const Eigen::Vector2f base = baseOf(chain, ground);
  for (const StemSeeds& stem : accepted) {
    if ((baseOf(stem.points, ground) - base).norm() < min_spacing) return true;
    constexpr float kSameStem = 0.06F;
    const bool overlaps = chain.front().z() <= stem.points.back().z() + kMaxGap;
    constexpr float kFloating = 0.30F;  // [m] above the soil: too high for a stem of its own
    if (overlaps && ground.heightAbove(chain.front()) > kFloating &&
        horizontalDistanceAt(stem.points, chain.front()) < 2.0F * kSameStem) {
      return true;
    }
    if (overlaps && horizontalDistanceAt(stem.points, chain.front()) < kSameStem) return true;
  }
  return false;
}

/// Height of the canopy round every place: the highest points of coarse cells and their neighbours.
class CanopyHeight {
 public:
  explicit CanopyHeight(const Block& block) {
    for (const Eigen::Vector3f& point : block.cloud.points) {
      float& height = heights_[cellOf(point)];
      height = std::max(height, block.ground.heightAbove(point));
    }
  }

  float around(const Eigen::Vector3f& point) const {
    const auto [x, y] = cellOf(point);
    float height = 0.0F;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const auto cell = heights_.find({x + dx, y + dy});
        if (cell != heights_.end()) height = std::max(height, cell->second);
      }
    }
    return height;
  }

 private:
  static std::pair<int, int> cellOf(const Eigen::Vector3f& point) {
    constexpr float kCell = 0.25F;
    return {static_cast<int>(std::floor(point.x() / kCell)),
            static_cast<int>(std::floor(point.y() / kCell))};
  }

  std::map<std::pair<int, int>, float> heights_;
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

/// Root mean square distance of a chain from the straight line that fits it best.
float deviationFromLine(const std::vector<Eigen::Vector3f>& chain) {
  Eigen::Vector3f mean = Eigen::Vector3f::Zero();
  for (const Eigen::Vector3f& point : chain) mean += point;
  mean /= static_cast<float>(chain.size());
  Eigen::Vector2f slope = Eigen::Vector2f::Zero();
  float squares = 0.0F;
  for (const Eigen::Vector3f& point : chain) {
    slope += (point.z() - mean.z()) * (point - mean).head<2>();
    squares += (point.z() - mean.z()) * (point.z() - mean.z());
  }
  slope /= squares;
  float sum = 0.0F;
  for (const Eigen::Vector3f& point : chain) {
    sum += ((point - mean).head<2>() - (point.z() - mean.z()) * slope).squaredNorm();
  }
  return std::sqrt(sum / static_cast<float>(chain.size()));
}

/// A stem is straight and long for the canopy round it, the longer the more of its foot is hidden.
/// Hanging and upright leaves are not.
bool standsLikeAStem(const std::vector<Eigen::Vector3f>& chain, const GroundModel& ground,
                     const CanopyHeight& canopy, const SegmentationParameters& parameters) {
  if (chain.size() < 2U) return false;
  const float length = chain.back().z() - chain.front().z();
  const float bottom = ground.heightAbove(chain.front());
  if (length < static_cast<float>(parameters.seed_min_length) ||
      bottom > static_cast<float>(parameters.seed_max_height)) {
    return false;
  }
  const float tallest = canopy.around(chain.front());
  constexpr float kLengthShare = 0.25F;  // of the canopy's height
  constexpr float kHiddenShare = 0.8F;   // of what is hidden below
  if (length < kLengthShare * tallest + kHiddenShare * bottom) return false;
  constexpr float kJitter = 0.008F;  // [m] of the clusters' centres
  constexpr float kBend = 0.02F;     // of the length
  return deviationFromLine(chain) <= kJitter + kBend * length;
}

}  // namespace

std::vector<StemSeeds> findStemSeeds(const Block& block, const NeighborGrid& block_grid,
                                     const std::vector<LocalShape>& shapes,
                                     const SegmentationParameters& parameters) {
  // 1. Upright clusters in every slab over the local soil.
  const auto max_stem_radius = static_cast<float>(parameters.max_stem_radius);
  const auto votes = collectVotes(block, block_grid, shapes, parameters);
  std::vector<Cluster> clusters;
  std::vector<std::vector<std::size_t>> slabs(votes.size());
  for (std::size_t slab = 0; slab < votes.size(); ++slab) {
    const std::size_t first = clusters.size();
    clusterSlab(votes[slab], static_cast<int>(slab), max_stem_radius, clusters);
    for (std::size_t c = first; c < clusters.size(); ++c) slabs[slab].push_back(c);
  }
  normaliseEvidence(clusters);
  if (clusters.empty()) return {};

  std::vector<Eigen::Vector3f> centers;
  for (const Cluster& cluster : clusters) centers.push_back(cluster.center);
  const NeighborGrid grid(centers, 0.2F);

  // 2. The best chain of clusters, again and again, until what is left is too short or too weak.
  const auto slab_height = static_cast<float>(parameters.seed_slab);
  const auto max_lean = static_cast<float>(parameters.max_lean * M_PI / 180.0);
  const CanopyHeight canopy(block);
  std::vector<StemSeeds> stems;
  for (;;) {
    const Chain chain = bestChain(clusters, slabs, grid, slab_height, max_lean);
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
    if (!standsLikeAStem(stem.points, block.ground, canopy, parameters)) continue;
    if (branchesOff(stem.points, stems, block.ground,
                    static_cast<float>(parameters.min_plant_spacing))) {
      continue;
    }
    drawToCurve(stem.points);
    stems.push_back(std::move(stem));
  }
  std::sort(stems.begin(), stems.end(), [](const StemSeeds& a, const StemSeeds& b) {
    return a.points.front().x() != b.points.front().x()
               ? a.points.front().x() < b.points.front().x()
               : a.points.front().y() < b.points.front().y();
  });
  return stems;
}

}  // namespace field_phenotyping
