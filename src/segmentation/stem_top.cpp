#include "field_phenotyping/segmentation/stem_top.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

struct Place {
  double arc_length;
  double distance;
  double core;           // [m] radius within which hardly anything but the stem has points
  double skin;           // [m] radius within which points may be the stem's
  Eigen::Vector2d away;  // [m] horizontally from the axis
};

std::vector<Place> placesOf(const std::vector<Eigen::Vector3f>& points,
                            const std::vector<std::uint32_t>& members, const Midline& midline) {
  std::vector<Place> places;
  places.reserve(members.size());
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    if (at.arc_length < 0.0F) continue;
    const Eigen::Vector3f away = points[i] - at.foot;
    places.push_back({static_cast<double>(at.arc_length), static_cast<double>(at.distance),
                      static_cast<double>(at.radius + 0.5F * midline.spread),
                      static_cast<double>(at.radius + 2.0F * midline.spread),
                      away.head<2>().cast<double>()});
  }
  return places;
}

/// How much likelier a count is under one negative binomial than under another: stems hide behind
/// leaves, so counts vary far more than by chance alone.
class LogOdds {
 public:
  LogOdds(double shape, double other_shape) : shape_(shape), other_shape_(other_shape) {}

  double operator()(double count, double mean, double other_mean) {
    const auto whole = static_cast<std::size_t>(count);
    // The quotients of gamma functions grow by one factor per count.
    while (of_gamma_.size() <= whole) {
      const auto below = static_cast<double>(of_gamma_.size() - 1U);
      of_gamma_.push_back(of_gamma_.back() + std::log((below + shape_) / (below + other_shape_)));
    }
    const double share = mean / (mean + shape_);
    const double other_share = other_mean / (other_mean + other_shape_);
    return of_gamma_[whole] + count * std::log(share / other_share) + shape_ * std::log1p(-share) -
           other_shape_ * std::log1p(-other_share);
  }

 private:
  double shape_;
  double other_shape_;
  std::vector<double> of_gamma_{0.0};  // by count
};

/// Points in the core of every band, and how many leaves as dense as those in the ring just outside
/// the skin would put there; the first band begins at `start`.
struct BandCounts {
  std::vector<double> core;
  std::vector<double> by_leaves;
};

BandCounts countBands(const std::vector<Place>& places, double start, double length,
                      double band_height) {
  constexpr double kRing = 1.0;  // width of the ring, in radii of the core
  const auto bands = static_cast<std::size_t>(std::ceil((length - start) / band_height)) + 1U;
  BandCounts counts{std::vector<double>(bands, 0.0), std::vector<double>(bands, 0.0)};
  for (const Place& place : places) {
    if (place.arc_length < start || place.arc_length >= length) continue;
    const auto band = static_cast<std::size_t>((place.arc_length - start) / band_height);
    const double outer = place.skin + kRing * place.core;
    if (place.distance < place.core) {
      counts.core[band] += 1.0;
    } else if (place.distance > place.skin && place.distance < outer) {
      counts.by_leaves[band] += place.core * place.core / (outer * outer - place.skin * place.skin);
    }
  }
  return counts;
}

/// Median of the counts of bands that are not empty, as they would be where sampling is best.
double medianSeen(const std::vector<double>& counts, double band_height,
                  const SamplingProfile& sampling) {
  std::vector<double> seen;
  for (std::size_t k = 0; k < counts.size(); ++k) {
    if (counts[k] > 0.0) {
      seen.push_back(counts[k] / sampling.ofStems((static_cast<double>(k) + 0.5) * band_height));
    }
  }
  if (seen.empty()) return 0.0;
  return medianOf(std::move(seen));
}

/// How far the young leaves of a whorl clasp one another above the stem's end, until they have left
/// the core of the axis.
double claspBelow(double occupied, const StemAxis& axis) {
  constexpr double kClasp = 3.0;  // radii
  return std::min(kClasp * static_cast<double>(axis.radiusAt(static_cast<float>(occupied))),
                  0.5 * occupied);
}

/// The cuts that may part bands with a stem from bands without, each with what speaks for it.
class StemCuts {
 public:
  /// @param leaf_density of leaves that may stand in the core, to those beside it
  StemCuts(const std::vector<Place>& places, double length, const SamplingProfile& sampling,
           double leaf_density)
      : length_(length) {
    // Bands so high that a stem shows some points in each.
    constexpr double kShortest = 0.05;  // [m], or a share of a short axis
    constexpr double kShare = 0.1;
    constexpr double kHighest = 0.20;
    constexpr double kPoints = 5.0;
    const double seen =
        medianSeen(countBands(places, 0.0, length, kHighest).core, kHighest, sampling);
    if (!(seen > 0.0)) return;
    const double band_height =
        std::clamp(kHighest * kPoints / seen, std::min(kShortest, kShare * length), kHighest);
    constexpr double kOtherShare = 0.12;
    const bool is_dense = seen >= kPoints;  // fewer points say nothing of how leaves stand
    constexpr double kStemShape = 0.8;
    constexpr double kOtherShape = 0.5;

    LogOdds log_odds(kStemShape, kOtherShape);

    double stem_mean = 1.0;
    constexpr int kPhases = 4;  // cuts closer than a band apart
    for (int phase = 0; phase < kPhases; ++phase) {
      const double start = band_height * phase / kPhases;
      const BandCounts counts = countBands(places, start, length, band_height);
      if (phase == 0) {
        stem_mean = std::max(medianSeen(counts.core, band_height, sampling), stem_mean);
      }
      double sum = 0.0;
      for (std::size_t k = 0; k < counts.core.size(); ++k) {
        const double leaves = is_dense ? leaf_density * counts.by_leaves[k] : 0.0;
        const double cut = start + static_cast<double>(k + 1U) * band_height;
        const double stem = stem_mean * sampling.ofStems(cut - 0.5 * band_height);
        sum += log_odds(counts.core[k], stem + leaves, kOtherShare * stem + leaves);
        cuts_.push_back({cut, sum});
      }
    }
  }

  /// Where the axis stops being one: the best cut; its length where nothing shows an end.
  /// @param log_prior of an axis that stops there
  template <typename LogPrior>
  double best(const LogPrior& log_prior) const {
    double most = log_prior(0.0);
    double end = 0.0;
    for (const Cut& cut : cuts_) {
      const double score = cut.log_odds + log_prior(cut.at);
      if (score <= most) continue;
      most = score;
      end = cut.at;
    }
    return end > 0.0 ? std::min(end, length_) : length_;
  }
  double best() const {
    return best([](double) { return 0.0; });
  }

 private:
  struct Cut {
    double at;        // [m]
    double log_odds;  // of a stem below it and none above
  };

  double length_;
  std::vector<Cut> cuts_;
};

/// Whether leaves stand all round where the core ends: the whorl opens there. A tassel's tip stands
/// alone.
bool opensAsWhorl(const std::vector<Place>& places, double occupied) {
  constexpr double kAbove = 0.10;     // [m]
  constexpr double kReach = 0.06;     // [m]
  constexpr double kLeafShare = 2.5;  // points of leaves there, to those of as much stem
  double above = 0.0;
  double stem = 0.0;
  for (const Place& place : places) {
    if (place.arc_length < occupied) {
      if (place.distance < place.skin) stem += 1.0;
    } else if (place.arc_length < occupied + kAbove && place.distance < kReach) {
      above += 1.0;
    }
  }
  return above > kLeafShare * stem * kAbove / occupied;
}

constexpr double kRingStep = 0.0125;  // [m] of the axis
constexpr std::size_t kSectors = 8U;
constexpr std::size_t kWindow = 8U;     // steps compared
constexpr double kEmergence = 0.015;    // [m] of stem that branches need to leave its skin
constexpr double kLongest = 0.55;       // [m] of a tassel
constexpr double kLeastContrast = 2.5;  // of the points where branches begin to those below

/// Points of the ring just outside the skin, step by step along the axis.
struct Rings {
  std::vector<double> counts;
  std::vector<double> sampling;   ///< at the lower end of each step
  std::vector<double> densities;  ///< the counts, as they would be where sampling is best
  std::vector<std::array<double, kSectors>> sectors;  ///< the same, by azimuth
};

Rings countRings(const std::vector<Place>& places, double length, const SamplingProfile& sampling) {
  constexpr double kReach = 0.025;  // [m] of side branches beyond the stem's skin
  const auto steps = static_cast<std::size_t>(std::ceil(length / kRingStep)) + 1U;
  Rings rings{std::vector<double>(steps, 0.0),
              {},
              {},
              std::vector<std::array<double, kSectors>>(steps, {{0.0}})};
  for (const Place& place : places) {
    if (place.arc_length >= length || place.distance < place.skin ||
        place.distance > place.skin + kReach) {
      continue;
    }
    const auto step = static_cast<std::size_t>(place.arc_length / kRingStep);
    const double turn = (std::atan2(place.away.y(), place.away.x()) + M_PI) / (2.0 * M_PI);
    rings.counts[step] += 1.0;
    rings.sectors[step][std::min(static_cast<std::size_t>(turn * kSectors), kSectors - 1U)] += 1.0;
  }
  for (std::size_t step = 0; step < steps; ++step) {
    const double at = static_cast<double>(step) * kRingStep;
    rings.sampling.push_back(sampling.at(at));
    rings.densities.push_back(rings.counts[step] / sampling.at(at + 0.5 * kRingStep));
  }
  return rings;
}

/// Whether a window of the rings shows points all round the axis.
bool branchesAllRound(const Rings& rings, std::size_t from, std::size_t to, double points) {
  constexpr std::size_t kLeastSectors = 5U;
  constexpr std::size_t kFewSectors = 4U;  // where few points show them
  constexpr double kManyPoints = 60.0;
  constexpr double kSectorShare = 0.02;  // of the points, for a sector to count
  constexpr double kStray = 1.0;         // points that noise may put there
  std::size_t seen = 0U;
  for (std::size_t a = 0; a < kSectors; ++a) {
    double count = 0.0;
    for (std::size_t step = from; step < to; ++step) count += rings.sectors[step][a];
    if (count > std::max(kSectorShare * points, kStray)) ++seen;
  }
  return seen >= (points < kManyPoints ? kFewSectors : kLeastSectors);
}

double sumOf(const std::vector<double>& counts, std::size_t from, std::size_t to) {
  return std::accumulate(counts.begin() + static_cast<std::ptrdiff_t>(from),
                         counts.begin() + static_cast<std::ptrdiff_t>(to), 0.0);
}

/// Points that the window from a step on would have, were it sampled as densely as step `as`.
double pointsFrom(const Rings& rings, std::size_t from, std::size_t as) {
  return rings.sampling[as] * sumOf(rings.densities, from, from + kWindow);
}

/// Where a tassel's side branches begin, and the logarithm of how many more points there are in
/// the ring above that place than below.
struct TasselBase {
  double at;
  double log_contrast;
};

double logContrast(const Rings& rings, std::size_t step) {
  const double below = pointsFrom(rings, step - kWindow, step);
  const double above = pointsFrom(rings, step, step);
  return std::log((above + 1.0) / (below + 1.0));
}

/// A bare stretch of stem below, and above it points all round; none if there is no such place near
/// the end of the axis.
std::optional<TasselBase> clearTasselBase(const Rings& rings, double occupied) {
  constexpr double kLeastStem = 0.6;           // of stem and tassel together
  constexpr double kShortest = 0.13;           // [m] of a tassel
  constexpr std::size_t kBranchedSteps = 16U;  // that side branches come out of the skin in
  constexpr double kMostBeyond = 0.35;         // points above them, of what the branches show
  constexpr double kSamePlace = 0.10;          // [m]
  constexpr double kLeastPoints = 6.0;
  const std::size_t steps = rings.counts.size();
  // From the top down: the last such place is the tassel's, those below are ears' and leaves'.
  std::optional<TasselBase> base;
  for (std::size_t k = steps - std::min(steps, kWindow); k >= kWindow; --k) {
    const double at = static_cast<double>(k) * kRingStep;
    if (at > occupied - kShortest) continue;
    if (at < std::max(occupied - kLongest, kLeastStem * occupied)) break;
    if (base && at < base->at - kSamePlace) break;
    const double above = sumOf(rings.counts, k, k + kWindow);
    if (above < kLeastPoints || !branchesAllRound(rings, k, k + kWindow, above)) continue;
    // Beyond its branches the tassel is a bare spike; leaves go on.
    double most_beyond = 0.0;
    for (std::size_t j = k + kBranchedSteps; j + kWindow <= steps; ++j) {
      most_beyond = std::max(most_beyond, pointsFrom(rings, j, k));
    }
    if (most_beyond > kMostBeyond * above) continue;
    const double log_contrast = logContrast(rings, k);
    if (log_contrast > (base ? base->log_contrast : std::log(kLeastContrast))) {
      base = TasselBase{at - kEmergence, log_contrast};
    }
  }
  return base;
}

/// Where the stand would have such a place: hidden side branches show on one side only, and leaves
/// reach up to them.
TasselBase likelyTasselBase(const Rings& rings, double occupied, const StandLength& stand) {
  constexpr double kShortest = 0.06;  // [m] of a tassel, of which little may show
  TasselBase base{occupied, std::log(kLeastContrast)};
  double best = base.log_contrast + stand.logPrior(occupied);
  for (std::size_t k = kWindow; k + kWindow <= rings.counts.size(); ++k) {
    const double at = static_cast<double>(k) * kRingStep - kEmergence;
    if (at < occupied - kLongest || at > occupied - kShortest) continue;
    const double log_contrast = logContrast(rings, k);
    const double score = log_contrast + stand.logPrior(at);
    if (score <= best) continue;
    best = score;
    base = {at, log_contrast};
  }
  return base;
}

/// Where the tassel begins; `occupied` where nothing shows one.
double tasselBase(const std::vector<Place>& places, double occupied,
                  const SamplingProfile& sampling, const StandLength& stand) {
  const Rings rings = countRings(places, occupied, sampling);
  const std::optional<TasselBase> clear = clearTasselBase(rings, occupied);
  if (!stand.known()) return clear ? clear->at : occupied;
  const TasselBase likely = likelyTasselBase(rings, occupied, stand);
  // What is all round a stem is rarely but a tassel; where no stem of the stand ends, ears or
  // leaves.
  constexpr double kAllRound = 1.0;  // log odds
  const auto score = [&](const TasselBase& base) {
    return base.log_contrast + stand.logPrior(base.at);
  };
  if (clear && score(*clear) + kAllRound > score(likely)) return clear->at;
  return stand.likelyLength(likely.at);
}

/// As findStemTop().
double topAmong(const std::vector<Place>& places, const StemAxis& axis,
                const SamplingProfile& sampling, const StandLength& stand, double leaf_density) {
  const StemCuts cuts(places, static_cast<double>(axis.length()), sampling, leaf_density);
  const double occupied = cuts.best();
  if (opensAsWhorl(places, occupied)) {
    const double likely =
        cuts.best([&](double end) { return stand.logPrior(end - claspBelow(end, axis)); });
    return stand.likelyLength(likely - claspBelow(likely, axis));
  }
  // Where nothing can be seen of a stem's end, it is as high as others are.
  const double reaches =
      stand.known() ? cuts.best([&](double end) { return stand.logPriorWithin(end); }) : occupied;
  return tasselBase(places, reaches, sampling, stand);
}

}  // namespace

float findStemTop(const std::vector<Eigen::Vector3f>& points,
                  const std::vector<std::uint32_t>& members, const Midline& midline,
                  const SamplingProfile& sampling, const StandLength& stand, double leaf_density) {
  return static_cast<float>(
      topAmong(placesOf(points, members, midline), midline.axis, sampling, stand, leaf_density));
}

float findOccupiedEnd(const std::vector<Eigen::Vector3f>& points,
                      const std::vector<std::uint32_t>& members, const Midline& midline,
                      const SamplingProfile& sampling) {
  return static_cast<float>(StemCuts(placesOf(points, members, midline),
                                     static_cast<double>(midline.axis.length()), sampling, 1.0)
                                .best());
}

}  // namespace field_phenotyping
