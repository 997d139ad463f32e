#include "field_phenotyping/segmentation/leaf_form.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr float kLeastSpread = 0.03F;  // [m] of plants

OrganLanes lanesOf(const LocalShape& shape, const Eigen::Vector3f& center) {
  return {allOf(center.x()),          allOf(center.y()),          allOf(center.z()),
          allOf(shape.direction.x()), allOf(shape.direction.y()), allOf(shape.direction.z()),
          allOf(shape.linearity)};
}

/// How places on organs lie to an axis.
struct Pose {
  Integers known;   // does not hold where it is too near to the axis to tell
  Floats distance;  // [m] level distance from the axis
  Floats miss;      // [m] by which the organ points past the axis
  Floats slope;     // [rad] of the organ outwards, upwards positive
};

/// @param segment of the axis, where to look first
AwayLanes awayOf(const OrganLanes& organ, const StemAxis& axis, std::size_t& segment) {
  AwayLanes away{organ.x, organ.y};
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    const Eigen::Vector3f foot = axis.pointAtHeight(organ.z[lane], segment);
    away.x[lane] -= foot.x();
    away.y[lane] -= foot.y();
  }
  return away;
}

Pose poseOf(const OrganLanes& organ, const AwayLanes& away) {
  constexpr float kOnStem = 0.025F;  // [m]
  constexpr float kUpright = 1e-3F;  // level share of a direction that points nowhere
  const Floats& run_x = organ.direction_x;
  const Floats& run_y = organ.direction_y;
  Pose pose;
  pose.distance = squareRootOf(away.x * away.x + away.y * away.y);
  const Floats level = squareRootOf(run_x * run_x + run_y * run_y);
  pose.known = (pose.distance >= kOnStem) & (level > kUpright);
  // What stands upright points nowhere.
  const Floats share = smallerOf(allOf(1.0F), 2.0F * level) / largerOf(level, allOf(kUpright));
  pose.miss = magnitudeOf(run_x * away.y - run_y * away.x) * share;
  const Floats outward = run_x * away.x + run_y * away.y;
  const Floats angle = arctangentOf(organ.direction_z * pose.distance, magnitudeOf(outward));
  pose.slope = outward < 0.0F ? -angle : angle;
  return pose;
}

/// [m]
float heightAboveBase(const Eigen::Vector3f& place, const LeafHost& host) {
  return std::max(0.0F, place.z() - host.axis->nodes().front().position.z());
}

/// [m], level.
float distanceFromLine(const Eigen::Vector3f& place, const LeafHost& host) {
  return (place - host.axis->pointAtHeight(place.z())).head<2>().norm();
}

/// [m] above which there are tassels and the upper leaves of whorls, but no stems.
float heightOfCrowns(const std::vector<LeafHost>& hosts) {
  constexpr float kAboveStems = 1.1F;  // times their height
  std::vector<float> heights;
  for (const LeafHost& host : hosts) {
    if (!host.axis->empty()) heights.push_back(host.height() - host.tip());
  }
  return heights.empty() ? 0.0F : kAboveStems * medianOf(heights);
}

/// Whether a place is too far from the stem to be its own spike, found or not.
/// @param distance from its line [m]
bool isBeside(float distance) {
  constexpr float kSpike = 0.08F;  // [m] with its bend
  return distance > kSpike;
}

/// Whether a place is where the organ may go on that was followed.
bool goesOn(const OrganEnd& end, const Eigen::Vector3f& place) {
  constexpr float kTube = 0.02F;     // [m]
  constexpr float kFarther = 0.08F;  // [m]
  const Eigen::Vector3f away = place - end.place;
  const float along = away.dot(end.direction);
  return along < kFarther && (away - along * end.direction).squaredNorm() < kTube * kTube;
}

}  // namespace

void PieceSamples::take(const OrganCells& cells, const std::vector<std::uint32_t>& members,
                        std::size_t stride) {
  count_ = (members.size() + stride - 1U) / stride;
  // Lanes beyond the last one repeat it, with no say.
  for (std::vector<float>& values : values_) values.resize(count_ + kLanes);
  for (std::size_t k = 0; k < count_ + kLanes; ++k) {
    const std::uint32_t n = members[std::min(k, count_ - 1U) * stride];
    const LocalShape& shape = cells.shapes[n];
    for (std::size_t axis = 0; axis < 3U; ++axis) {
      values_[axis][k] = cells.centers[n][static_cast<Eigen::Index>(axis)];
      values_[axis + 3U][k] = shape.direction[static_cast<Eigen::Index>(axis)];
    }
    values_[6][k] = k < count_ ? shape.linearity : 0.0F;
  }
}

void PieceSamples::lookFrom(const StemAxis& axis) {
  for (std::vector<float>& values : away_) values.resize(count_ + kLanes);
  std::size_t segment = 0U;
  for (std::size_t k = 0; k < count_; k += kLanes) {
    const AwayLanes away = awayOf(lanesFrom(k), axis, segment);
    store(away.x, &away_[0][k]);
    store(away.y, &away_[1][k]);
  }
}

AwayLanes PieceSamples::awayFrom(std::size_t k) const {
  return {loadFloats(&away_[0][k]), loadFloats(&away_[1][k])};
}

OrganLanes PieceSamples::lanesFrom(std::size_t k) const {
  const auto load = [&](std::size_t value) { return loadFloats(&values_[value][k]); };
  return {load(0U), load(1U), load(2U), load(3U), load(4U), load(5U), load(6U)};
}

LeafForm::LeafForm() {
  constexpr float kSlopeAtStem = 1.13F;  // [rad]
  constexpr float kSlopeLoss = 2.1F;     // [rad/m]
  Profile& usual = bands_.front();
  for (std::size_t k = 0; k < kBins; ++k) {
    const float distance = kBin * (static_cast<float>(k) + 0.5F);
    usual[k].slope = kSlopeAtStem - kSlopeLoss * distance;
    usual[k].slope_spread = 0.35F + 1.0F * distance;
    usual[k].miss_spread = 0.02F + 0.3F * distance;
  }
  bands_.fill(Profile(usual));
}

LeafForm LeafForm::learn(const OrganCells& cells, const std::vector<LeafHost>& hosts) {
  constexpr float kLeastLinearity = 0.3F;
  struct Look {
    bool beside = false;  // the stem
    std::size_t layer = 0U;
    std::size_t far_bin = 0U;
    bool shown = false;  // the form, by what follows
    std::size_t bin = 0U;
    std::size_t band = 0U;
    float slope = 0.0F;
    float miss = 0.0F;
  };
  std::vector<Look> looks(cells.size());
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      if (cells.is_stem[n] != 0U || cells.owner[n] < 0) continue;
      const LeafHost& host = hosts[static_cast<std::size_t>(cells.owner[n])];
      Look& look = looks[n];
      const float distance = distanceFromLine(cells.centers[n], host);
      look.beside = isBeside(distance);
      look.layer = static_cast<std::size_t>(heightAboveBase(cells.centers[n], host) / kLayer);
      look.far_bin = std::min(static_cast<std::size_t>(distance / kBin), kFarBins - 1U);
      if (cells.shapes[n].linearity < kLeastLinearity) continue;
      std::size_t segment = 0U;
      const OrganLanes organ = lanesOf(cells.shapes[n], cells.centers[n]);
      const Pose pose = poseOf(organ, awayOf(organ, *host.axis, segment));
      look.bin = static_cast<std::size_t>(pose.distance[0] / kBin);
      look.band = static_cast<std::size_t>(bandsOf(organ.z, *host.axis)[0]);
      look.slope = pose.slope[0];
      look.miss = pose.miss[0];
      look.shown = pose.known[0] != 0 && look.bin < kBins;
    }
  });
  std::vector<std::vector<float>> rises(hosts.size());  // [m]
  Samples whole;
  std::array<Samples, kBands> samples;
  std::vector<Reach> counts;  // of cells, layer by layer
  for (std::size_t n = 0; n < looks.size(); ++n) {
    if (cells.is_stem[n] != 0U || cells.owner[n] < 0) continue;
    const Look& look = looks[n];
    if (look.layer >= counts.size()) counts.resize(look.layer + 1U, Reach{});
    counts[look.layer][look.far_bin] += 1.0F;
    if (look.beside) {
      const auto plant = static_cast<std::size_t>(cells.owner[n]);
      rises[plant].push_back(cells.centers[n].z() - hosts[plant].top);
    }
    if (!look.shown) continue;
    for (Samples* of : {&whole, &samples[look.band]}) {
      of->slopes[look.bin].push_back(look.slope);
      of->misses[look.bin].push_back(look.miss);
    }
  }
  LeafForm form;
  const Profile usual = profileOf(whole, form.bands_.front());
  parallelFor(kBands,
              [&](std::size_t band) { form.bands_[band] = profileOf(samples[band], usual); });
  form.learnCeiling(std::move(rises));
  form.learnTips(hosts);
  form.learnReaches(counts, hosts);
  return form;
}

float LeafForm::misfit(const LocalShape& shape, const Eigen::Vector3f& center,
                       const LeafHost& host) const {
  std::size_t segment = 0U;
  const OrganLanes organ = lanesOf(shape, center);
  return misfitOf(organ, awayOf(organ, *host.axis, segment), *host.axis)[0];
}

float LeafForm::misfit(const PieceSamples& samples, const LeafHost& host) const {
  Floats sum{};
  for (std::size_t k = 0; k < samples.size(); k += kLanes) {
    sum += misfitOf(samples.lanesFrom(k), samples.awayFrom(k), *host.axis);
  }
  return total(sum);
}

float LeafForm::tooHigh(const Eigen::Vector3f& place, const LeafHost& host) const {
  constexpr float kWeight = 2.0F;       // of a squared standard deviation
  constexpr float kTail = 0.5F;         // a top that was not found is no more than odd
  constexpr float kTipStddev = 0.015F;  // [m]
  if (!ceiling_ || place.z() <= host.top + std::min(*ceiling_, 0.0F)) return 0.0F;
  float off = 0.0F;
  if (isBeside(distanceFromLine(place, host)))
    off = (place.z() - host.top - *ceiling_) / rise_spread_;
  if (hasTip(host) && !goesOn(host.end, place)) {
    off = std::max(off, (place.z() - host.top) / kTipStddev);
  }
  if (off <= 0.0F) return 0.0F;
  return kWeight * off * off / (1.0F + kTail * off * off);
}

float LeafForm::tooFar(const Eigen::Vector3f& place, const LeafHost& host) const {
  if (reaches_.empty()) return 0.0F;
  return tooFar(heightAboveBase(place, host), distanceFromLine(place, host));
}

float LeafForm::tooFar(const PieceSamples& samples, const LeafHost& host) const {
  if (reaches_.empty()) return 0.0F;
  const float base = host.axis->nodes().front().position.z();
  float sum = 0.0F;
  for (std::size_t k = 0; k < samples.size(); k += kLanes) {
    const AwayLanes away = samples.awayFrom(k);
    const Floats distances = squareRootOf(away.x * away.x + away.y * away.y);
    const Floats heights = largerOf(samples.lanesFrom(k).z - base, Floats{});
    for (std::size_t lane = 0; lane < std::min(kLanes, samples.size() - k); ++lane) {
      sum += tooFar(heights[lane], distances[lane]);
    }
  }
  return sum;
}

/// @param height   above the plant's base [m]
/// @param distance from its line [m]
float LeafForm::tooFar(float height, float distance) const {
  const auto layer = static_cast<std::size_t>(height / kLayer);
  const Reach& reach = reaches_[std::min(layer, reaches_.size() - 1U)];
  if (reach.back() == 0.0F) return 0.0F;  // it tells nothing
  const float at = std::clamp(distance / kBin - 0.5F, 0.0F, static_cast<float>(kFarBins) - 1.001F);
  const auto k = static_cast<std::size_t>(at);
  const float share = at - static_cast<float>(k);
  return (1.0F - share) * reach[k] + share * reach[k + 1U];
}

/// @param counts of cells, layer by layer
void LeafForm::learnReaches(const std::vector<Reach>& counts, const std::vector<LeafHost>& hosts) {
  constexpr float kLeastCells = 50.0F;  // that show where organs of a layer stand
  constexpr float kAnywhere = 0.02F;    // share of cells that may be any plant's
  // Of the log ratio, since cells of one organ stand together. Below the crowns a leaf's direction
  // and plane tell more.
  constexpr float kSay = 0.5F;
  constexpr float kSayBelow = 0.2F;
  const float crowns = heightOfCrowns(hosts);
  reaches_.assign(counts.size(), Reach{});
  for (std::size_t layer = 0; layer < counts.size(); ++layer) {
    const float say = static_cast<float>(layer) * kLayer > crowns ? kSay : kSayBelow;
    Reach sum{};
    float whole = 0.0F;
    for (std::size_t k = std::max<std::size_t>(layer, 1U) - 1U;
         k < std::min(layer + 2U, counts.size()); ++k) {
      for (std::size_t bin = 0; bin < kFarBins; ++bin) {
        sum[bin] += counts[k][bin];
        whole += counts[k][bin];
      }
    }
    if (whole < kLeastCells) continue;
    Reach density{};  // nowhere less than farther off
    float most = 0.0F;
    for (std::size_t bin = kFarBins; bin-- > 0U;) {
      const float area = 2.0F * static_cast<float>(bin) + 1.0F;  // of the ring
      constexpr auto kWholeArea = static_cast<float>(kFarBins * kFarBins);
      density[bin] = most = std::max(most, sum[bin] / whole / area + kAnywhere / kWholeArea);
    }
    for (std::size_t bin = 0; bin < kFarBins; ++bin) {
      reaches_[layer][bin] = say * std::log(most / density[bin]);
    }
  }
}

/// Whether the tip of what carries the stem on is known: it was seen well, and is not lower than
/// others are, as where another organ was followed.
bool LeafForm::hasTip(const LeafHost& host) const {
  constexpr float kTipStddevs = 2.0F;
  constexpr float kHeightStddevs = 2.3F;
  return host.end.is_clear && host.tip() > tips_.middle - kTipStddevs * tips_.stddev &&
         host.height() > heights_.middle - kHeightStddevs * heights_.stddev;
}

void LeafForm::learnTips(const std::vector<LeafHost>& hosts) {
  std::vector<float> tips;
  std::vector<float> heights;
  for (const LeafHost& host : hosts) {
    if (host.axis->empty()) continue;
    tips.push_back(host.tip());
    heights.push_back(host.height());
  }
  if (tips.empty()) return;
  tips_ = robustSpreadOf(tips, kLeastSpread);
  heights_ = robustSpreadOf(heights, kLeastSpread);
}

/// @param rises of each plant's organs beside the stem above its top [m]
void LeafForm::learnCeiling(std::vector<std::vector<float>> rises) {
  constexpr std::size_t kStray = 3U;    // cells of a plant that may be another's
  constexpr std::size_t kLeaves = 50U;  // cells of a plant that shows its leaves
  constexpr std::size_t kPlants = 5U;   // that make a stand
  std::vector<float> highest;
  for (std::vector<float>& of_plant : rises) {
    if (of_plant.size() < kLeaves) continue;
    const auto high = of_plant.begin() + kStray;
    std::nth_element(of_plant.begin(), high, of_plant.end(), std::greater<>());
    highest.push_back(*high);
  }
  if (highest.size() < kPlants) return;
  const auto [typical, spread] = robustSpreadOf(highest, kLeastSpread);
  rise_spread_ = spread;
  // Without tassels the top is no more than the leaf that was followed highest.
  constexpr float kSpreads = 2.0F;  // that hardly a plant's leaves exceed
  if (typical < -rise_spread_) ceiling_ = typical + kSpreads * rise_spread_;
}

Floats LeafForm::misfitOf(const OrganLanes& organ, const AwayLanes& away,
                          const StemAxis& axis) const {
  const Pose pose = poseOf(organ, away);
  if (!anyOf(pose.known)) return Floats{};
  const Floats at = clampedTo(pose.distance * (1.0F / kBin) - 0.5F, 0.0F, kBins - 1.001F);
  Floats slope{};
  Floats slope_spread{};
  Floats miss_spread{};
  const Integers bands = bandsOf(organ.z, axis);
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    const Profile& profile = bands_[static_cast<std::size_t>(bands[lane])];
    const auto k = static_cast<std::size_t>(at[lane]);
    const float share = at[lane] - static_cast<float>(k);
    const auto between = [&](float Bin::*value) {
      return (1.0F - share) * profile[k].*value + share * profile[k + 1U].*value;
    };
    slope[lane] = between(&Bin::slope);
    slope_spread[lane] = between(&Bin::slope_spread);
    miss_spread[lane] = between(&Bin::miss_spread);
  }
  const Floats off_plane = pose.miss / miss_spread;
  const Floats off_slope = (pose.slope - slope) / slope_spread;
  // Not its square, since a leaf that is bent or torn is odd all along.
  constexpr float kTail = 2.0F;
  const Floats odd =
      logarithmOf(1.0F + 0.5F / kTail * (off_plane * off_plane + off_slope * off_slope));
  return pose.known ? organ.linearity * kTail * odd : Floats{};
}

Integers LeafForm::bandsOf(const Floats& z, const StemAxis& axis) {
  const float low = axis.nodes().front().position.z();
  const float height = std::max(axis.nodes().back().position.z() - low, kBin);
  const Floats bands = (z - low) * (static_cast<float>(kStemBands) / height);
  return __builtin_convertvector(clampedTo(bands, 0.0F, static_cast<float>(kBands) - 0.5F),
                                 Integers);
}

/// Where a distance has few samples: `usual`, or what is known nearer to the stem.
LeafForm::Profile LeafForm::profileOf(Samples& samples, const Profile& usual) {
  constexpr std::size_t kEnough = 100U;
  constexpr float kLeastSlopeSpread = 0.15F;  // [rad]
  constexpr float kLeastMissSpread = 0.015F;  // [m]
  constexpr float kStddevOfMad = 1.48F;
  Profile profile = usual;
  parallelFor(kBins, [&](std::size_t k) {
    std::vector<float>& slopes = samples.slopes[k];
    if (slopes.size() < kEnough) return;
    Bin& bin = profile[k];
    bin.slope = medianOf(slopes);
    for (float& slope : slopes) slope = std::abs(slope - bin.slope);
    bin.slope_spread = std::max(kLeastSlopeSpread, kStddevOfMad * medianOf(slopes));
    bin.miss_spread = std::max(kLeastMissSpread, kStddevOfMad * medianOf(samples.misses[k]));
  });
  return profile;
}

}  // namespace field_phenotyping
