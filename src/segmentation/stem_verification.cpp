#include "field_phenotyping/segmentation/stem_verification.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/nearest_distances.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/row_model.hpp"
#include "field_phenotyping/segmentation/stem_foot.hpp"
#include "field_phenotyping/segmentation/stem_sight.hpp"

namespace field_phenotyping {
namespace {

std::pair<int, int> columnOf(const Eigen::Vector3f& point) {
  constexpr float kColumn = 0.25F;  // [m]
  return {static_cast<int>(std::floor(point.x() / kColumn)),
          static_cast<int>(std::floor(point.y() / kColumn))};
}

/// Layer of a column that a height above the soil falls in.
std::size_t layerOf(float height) {
  constexpr float kLayer = 0.10F;  // [m]
  constexpr float kMostLayers = 1000.0F;
  return static_cast<std::size_t>(std::clamp(height / kLayer, 0.0F, kMostLayers));
}

/// How much of a stem's length, from the soil up, shows it where the canopy lets it be seen.
struct Visibility {
  float filled = 0.0F;  ///< share of the bands with points of the stem
  float clear = 0.0F;   ///< share where points crowd in its skin rather than all round
};

Visibility visibilityOf(const Block& block, const NeighborGrid& grid, const Canopy& canopy,
                        const StemCandidate& stem, float band_height) {
  const StemAxis& axis = stem.midline.axis;
  const auto bands =
      std::max<std::size_t>(static_cast<std::size_t>(std::ceil(axis.length() / band_height)), 1U);
  std::vector<std::uint32_t> counts(bands, 0U);
  const auto bandOf = [&](float s) {
    return std::min(static_cast<std::size_t>(std::max(s, 0.0F) / band_height), bands - 1U);
  };
  for (const std::uint32_t i : stem.points) {
    ++counts[bandOf(axis.project(block.cloud.points[i]).arc_length)];
  }
  constexpr std::uint32_t kLeastPoints = 2U;
  constexpr float kCrowded = 0.67F;  // twice what the areas of disc and ring would give
  Visibility visible;
  constexpr float kLeastLight = 0.25F;  // of the bands, to judge a stem by
  float light = 0.0F;
  for (std::size_t band = 0; band < bands; ++band) {
    const float middle = (static_cast<float>(band) + 0.5F) * band_height;
    const BandSight sight = seeBand(block.cloud.points, grid, stem.midline, middle, band_height);
    const float lit = canopy.lightAround(axis.pointAt(middle));
    light += lit;
    if (counts[band] >= kLeastPoints) visible.filled += lit;
    if (sight.inside >= static_cast<float>(kLeastPoints) &&
        sight.inside > kCrowded * sight.around) {
      visible.clear += lit;
    }
  }
  light = std::max(light, kLeastLight * static_cast<float>(bands));
  visible.filled /= light;
  visible.clear /= light;
  return visible;
}

/// Bands in which a stem of this block shows some points, whatever the density of the cloud.
float bandHeight(const std::vector<StemCandidate>& candidates) {
  constexpr float kShortest = 0.05F;  // [m]
  constexpr float kLongest = 0.20F;
  constexpr float kPoints = 6.0F;
  std::vector<float> densities;
  for (const StemCandidate& stem : candidates) {
    densities.push_back(static_cast<float>(stem.points.size()) / stem.midline.axis.length());
  }
  if (densities.empty()) return kShortest;
  return std::clamp(kPoints / medianOf(std::move(densities)), kShortest, kLongest);
}

/// Whether two candidates stand too near to one another to be two plants: nearer than plants at the
/// soil, or half as near, there or where both are seen, if a foot is guessed.
bool tooNear(const Midline& a, const Midline& b, const Eigen::Vector3f& base_a,
             const Eigen::Vector3f& base_b, float least_distance) {
  constexpr float kGuessed = 0.5F;
  const float apart = (base_a - base_b).head<2>().norm();
  if (!(a.hidden > 0.0F) && !(b.hidden > 0.0F)) return apart < least_distance;
  if (apart < kGuessed * least_distance) return true;
  const float low = std::max(a.axis.pointAt(a.hidden).z(), b.axis.pointAt(b.hidden).z());
  const float high =
      std::min(a.axis.nodes().back().position.z(), b.axis.nodes().back().position.z());
  const float middle = 0.5F * (low + std::max(low, high));
  return (a.axis.pointAtHeight(middle) - b.axis.pointAtHeight(middle)).head<2>().norm() <
         kGuessed * least_distance;
}

/// How much more a candidate is like a stem than like leaves and noise.
float meritOf(const Block& block, const NeighborGrid& grid, const Canopy& canopy,
              const StemCandidate& stem, float canopy_height, float band_height) {
  const Visibility visible = visibilityOf(block, grid, canopy, stem, band_height);
  const std::vector<StemAxis::Node>& nodes = stem.midline.axis.nodes();
  const float upright = (nodes.back().position - nodes.front().position).normalized().z();
  constexpr float kShortest = 0.1F;  // of the canopy's height: no stem
  constexpr float kLow = 0.4F;       // a low one
  const float length = stem.midline.axis.length() / canopy_height;
  const float tall = std::clamp((length - kShortest) / (kLow - kShortest), 0.0F, 1.0F);
  return tall * upright * upright * visible.filled * visible.clear * stem.midline.evidence /
         canopy_height;
}

/// The stems of one stand are about as thick as one another; what grows along leaves often is not.
float thicknessFit(const StemCandidate& stem, float typical) {
  constexpr float kSpread = 0.35F;  // of the logarithm
  constexpr float kError = 0.003F;  // [m] of either radius
  const float off =
      std::log((stem.midline.axis.radiusAt(0.0F) + kError) / (typical + kError)) / kSpread;
  return std::exp(-0.5F * off * off);
}

/// Plants of one stand keep their distance: what stands far nearer to a better stem than the others
/// do to one another must be nearly as good. `stems` come best first.
std::vector<std::size_t> withoutCrowding(const std::vector<StemCandidate>& candidates,
                                         const std::vector<std::size_t>& stems,
                                         const std::vector<Eigen::Vector3f>& bases,
                                         const std::vector<float>& merits) {
  constexpr std::size_t kLeastStems = 4U;
  if (stems.size() < kLeastStems) return stems;
  std::vector<Eigen::Vector2f> places;
  for (const std::size_t s : stems) places.emplace_back(bases[s].head<2>());
  const float typical = medianOf(nearestDistances(places));
  constexpr float kCrowded = 0.5F;  // of the median spacing
  constexpr float kAsGood = 0.6F;   // as the better one
  std::vector<std::size_t> kept;
  for (const std::size_t c : stems) {
    const bool crowds = std::any_of(kept.begin(), kept.end(), [&](std::size_t better) {
      return tooNear(candidates[c].midline, candidates[better].midline, bases[c], bases[better],
                     kCrowded * typical) &&
             merits[c] < kAsGood * merits[better];
    });
    if (!crowds) kept.push_back(c);
  }
  return kept;
}

/// Stems of one stand lean about as little as one another; steps from the foot of one to the top of
/// the next lean more.
float leanFit(const StemCandidate& stem, const StandLean& stand) {
  constexpr float kUsual = 4.0F;        // squared deviation that most stay within
  constexpr float kTail = 0.3F;         // per squared deviation beyond
  constexpr float kAxisError = 0.015F;  // [m] of either end
  const float off =
      stand.deviation(slopeOf(stem.midline.axis), kAxisError / stem.midline.axis.length());
  constexpr float kLodged = 0.4F;  // no stem is ruled out by its lean alone
  return std::max(1.0F / (1.0F + kTail * std::max(off * off - kUsual, 0.0F)), kLodged);
}

float typicalRadius(const std::vector<StemCandidate>& candidates,
                    const std::vector<float>& merits) {
  const float best = *std::max_element(merits.begin(), merits.end());
  std::vector<float> radii;
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    constexpr float kGood = 0.4F;
    if (merits[c] >= kGood * best) radii.push_back(candidates[c].midline.axis.radiusAt(0.0F));
  }
  return medianOf(std::move(radii));
}

/// The best candidates that share neither points nor a place, best first, of those that `worthy`
/// lets pass beside what is kept already.
template <class Worthy>
std::vector<std::size_t> distinctStems(const std::vector<StemCandidate>& candidates,
                                       const std::vector<Eigen::Vector3f>& bases,
                                       const std::vector<float>& merits, std::size_t points_in_all,
                                       float least_distance, Worthy&& worthy) {
  std::vector<std::size_t> order(candidates.size());
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return merits[a] != merits[b] ? merits[a] > merits[b] : a < b;
  });
  std::vector<std::size_t> kept;
  std::vector<std::uint8_t> taken(points_in_all, 0U);
  for (const std::size_t c : order) {
    const std::vector<std::uint32_t>& points = candidates[c].points;
    const bool too_near = std::any_of(kept.begin(), kept.end(), [&](std::size_t other) {
      return tooNear(candidates[c].midline, candidates[other].midline, bases[c], bases[other],
                     least_distance);
    });
    if (too_near || !worthy(c, kept)) continue;
    const auto shared = static_cast<std::size_t>(std::count_if(
        points.begin(), points.end(), [&](std::uint32_t i) { return taken[i] != 0U; }));
    constexpr std::size_t kMostShared = 3U;  // one in three
    if (shared * kMostShared > points.size()) continue;
    for (const std::uint32_t i : points) taken[i] = 1U;
    kept.push_back(c);
  }
  return kept;
}

}  // namespace

void Canopy::Column::add(const Column& other) {
  height = std::max(height, other.height);
  if (other.counts.size() > counts.size()) counts.resize(other.counts.size(), 0U);
  for (std::size_t k = 0; k < other.counts.size(); ++k) counts[k] += other.counts[k];
}

Canopy::Canopy(const Block& block) : ground_(block.ground) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  constexpr std::size_t kPoints = 16384U;  // of a task
  std::vector<Columns> of_chunks(chunksOf(points.size(), kPoints));
  parallelChunks(points.size(), kPoints, [&](std::size_t begin, std::size_t end) {
    Columns& columns = of_chunks[begin / kPoints];
    auto at = columns.end();  // most points follow another one of their column
    for (std::size_t i = begin; i < end; ++i) {
      const float height = ground_.heightAbove(points[i]);
      const std::pair<int, int> place = columnOf(points[i]);
      if (at == columns.end() || at->first != place) at = columns.try_emplace(place).first;
      Column& column = at->second;
      column.height = std::max(column.height, height);
      const std::size_t layer = layerOf(height);
      if (layer >= column.counts.size()) column.counts.resize(layer + 1U, 0U);
      ++column.counts[layer];
    }
  });
  for (const Columns& columns : of_chunks) {
    for (const auto& [place, column] : columns) columns_[place].add(column);
  }
}

template <class Visit>
void Canopy::forEachAround(const Eigen::Vector3f& point, Visit&& visit) const {
  const auto [x, y] = columnOf(point);
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const auto column = columns_.find({x + dx, y + dy});
      if (column != columns_.end()) visit(column->second);
    }
  }
}

float Canopy::heightAround(const Eigen::Vector3f& point) const {
  float height = 0.0F;
  forEachAround(point, [&](const Column& column) { height = std::max(height, column.height); });
  return height;
}

float Canopy::lightAround(const Eigen::Vector3f& point) const {
  Column all;
  forEachAround(point, [&](const Column& column) { all.add(column); });
  const std::vector<std::uint32_t>& counts = all.counts;
  const std::size_t layer = layerOf(ground_.heightAbove(point));
  if (layer >= counts.size()) return 1.0F;
  constexpr float kLit = 0.03F;  // of the fullest layer: bare stems give no more
  const auto most = static_cast<float>(*std::max_element(counts.begin(), counts.end()));
  return std::min(static_cast<float>(counts[layer]) / (kLit * most), 1.0F);
}

float meritOfOdds(double odds) {
  constexpr double kPower = 0.25;
  constexpr double kMost = 2.0;
  return static_cast<float>(std::clamp(std::pow(odds, kPower), 1.0 / kMost, kMost));
}

float usualOf(const std::vector<float>& merits) {
  constexpr float kGood = 0.3F;  // of the best
  const auto good = std::partition_point(
      merits.begin(), merits.end(), [&](float merit) { return merit >= kGood * merits.front(); });
  return merits[static_cast<std::size_t>(good - merits.begin() - 1) / 2U];  // the better of two
}

Eigen::Vector2f slopeOf(const StemAxis& axis) {
  const Eigen::Vector3f chord = axis.nodes().back().position - axis.nodes().front().position;
  return chord.head<2>() / chord.z();
}

StandLean leanOf(const std::vector<StemAxis>& stems) {
  constexpr std::size_t kLeastStems = 6U;
  constexpr float kLeastScatter = 0.03F;  // of the slope
  StandLean lean;
  if (stems.size() < kLeastStems) return lean;
  std::vector<float> x;
  std::vector<float> y;
  for (const StemAxis& axis : stems) {
    x.push_back(slopeOf(axis).x());
    y.push_back(slopeOf(axis).y());
  }
  lean.slope = {medianOf(x), medianOf(y)};
  std::vector<float> off;
  for (const StemAxis& axis : stems) {
    off.push_back(std::abs(slopeOf(axis).x() - lean.slope.x()));
    off.push_back(std::abs(slopeOf(axis).y() - lean.slope.y()));
  }
  lean.scatter =
      std::max(static_cast<float>(kMadToSigma) * medianOf(std::move(off)), kLeastScatter);
  return lean;
}

StemSelection::StemSelection(const Block& block, const NeighborGrid& grid,
                             const SegmentationParameters& parameters)
    : block_(block), grid_(grid), parameters_(parameters), canopy_(block) {}

std::vector<std::size_t> StemSelection::stemsAmong(
    const std::vector<StemCandidate>& candidates) const {
  if (candidates.empty()) return {};
  const float band_height = bandHeight(candidates);
  std::vector<float> merits(candidates.size());
  std::vector<Eigen::Vector3f> bases(candidates.size());
  parallelFor(candidates.size(), [&](std::size_t c) {
    const StemCandidate& stem = candidates[c];
    bases[c] = baseOf(block_, stem.midline.axis);
    constexpr float kLowestCanopy = 0.1F;  // [m]
    const float height =
        std::max({canopy_.heightAround(bases[c]),
                  canopy_.heightAround(stem.midline.axis.nodes().back().position), kLowestCanopy});
    merits[c] = meritOf(block_, grid_, canopy_, stem, height, band_height);
  });
  const float typical = typicalRadius(candidates, merits);
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    merits[c] *= thicknessFit(candidates[c], typical);
  }
  const float least_distance = static_cast<float>(parameters_.min_plant_spacing);
  constexpr float kLeastMerit = 3.0F;
  const std::vector<std::size_t> distinct =
      distinctStems(candidates, bases, merits, block_.cloud.size(), least_distance,
                    [&](std::size_t c, const auto&) { return merits[c] >= kLeastMerit; });
  if (distinct.empty()) return {};

  // Measured against what good ones have.
  std::vector<float> of_distinct;
  for (const std::size_t c : distinct) of_distinct.push_back(merits[c]);
  const float usual = usualOf(of_distinct);
  constexpr float kLeastShare = 0.25F;
  std::vector<std::size_t> stems;
  for (const std::size_t c : distinct) {
    if (merits[c] >= kLeastShare * usual) stems.push_back(c);
  }
  stems = withoutCrowding(candidates, stems, bases, merits);

  // Those show how the stand leans and its rows, which say where a stem needs less merit, and where
  // it needs more.
  std::vector<PlantPlace> places;
  std::vector<StemAxis> axes;
  for (const std::size_t c : stems) {
    places.push_back(
        {bases[c].head<2>().cast<double>(), std::min(static_cast<double>(merits[c] / usual), 1.0)});
    axes.push_back(candidates[c].midline.axis);
  }
  const std::optional<RowModel> rows =
      RowModel::find(places, {parameters_.row_spacing, parameters_.plant_spacing});
  const StandLean lean = leanOf(axes);
  if (!rows && !lean.known()) {
    std::sort(stems.begin(), stems.end());
    return stems;
  }
  std::vector<float> likely = merits;
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    if (lean.known()) likely[c] *= leanFit(candidates[c], lean);
    if (rows) likely[c] *= meritOfOdds(rows->rowOdds(bases[c].head<2>().cast<double>()));
  }
  stems = distinctStems(
      candidates, bases, likely, block_.cloud.size(), least_distance,
      [&](std::size_t c, const std::vector<std::size_t>& kept) {
        float merit = likely[c];
        if (rows) {
          std::vector<Eigen::Vector2d> others;
          for (const std::size_t k : kept) others.push_back(bases[k].head<2>().cast<double>());
          merit *= meritOfOdds(rows->spacingOdds(bases[c].head<2>().cast<double>(), others));
        }
        return merit >= std::max(kLeastMerit, kLeastShare * usual);
      });
  stems = withoutCrowding(candidates, stems, bases, likely);
  std::sort(stems.begin(), stems.end());
  return stems;
}

}  // namespace field_phenotyping
