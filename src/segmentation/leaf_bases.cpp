#include "field_phenotyping/segmentation/leaf_bases.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/wide_lanes.hpp"
#include "segmentation/leaf_search_gpu.hpp"

namespace field_phenotyping {
namespace {

using leaf::kLongest;
using leaf::kPi;
using leaf::turned;

constexpr std::array<float, 6> kSlopes{0.18F, 0.27F, 0.40F, 0.58F, 0.84F, 1.2F};

using StemPlace = leaf::Places<float>;

StemPlace placeOf(const Eigen::Vector3f& point, const StemAxis::Projection& at) {
  const Eigen::Vector3f away = point - at.foot;
  return {at.arc_length, std::atan2(away.y(), away.x()), at.distance, at.radius};
}

/// What is known of the points round a stem before any leaf is, by arc length, coordinate by
/// coordinate; padded so that the last lanes can be loaded.
struct Surroundings {
  std::size_t count = 0U;
  std::vector<float> arc_lengths, azimuths, distances, radii;
  std::vector<float> stem;  ///< density of the stem's points, with no leaf in front
  std::vector<LeafBase> guesses;
  float spread = 0.003F;
  float stem_density = 0.0F;  // [1/m^2] of the surface
  float clutter = 0.0F;       // [1/m^3] beside it

  void setPlaces(const std::vector<StemPlace>& places) {
    count = places.size();
    for (std::vector<float>* values : {&arc_lengths, &azimuths, &distances, &radii, &stem}) {
      values->assign(count + kLanes, 0.0F);
    }
    for (std::size_t i = 0; i < count; ++i) {
      arc_lengths[i] = places[i].arc_length;
      azimuths[i] = places[i].azimuth;
      distances[i] = places[i].distance;
      radii[i] = places[i].radius;
    }
  }

  LeafSearchTask task() const {
    return {arc_lengths.data(),
            azimuths.data(),
            distances.data(),
            radii.data(),
            stem.data(),
            guesses.data(),
            static_cast<int>(count),
            static_cast<int>(guesses.size()),
            spread,
            stem_density,
            clutter};
  }
};

/// Votes of points outside the surface for where the leaf that they are of leaves the stem.
class Votes {
 public:
  Votes(float lowest, float highest)
      : lowest_(lowest),
        rows_(static_cast<std::size_t>((highest - lowest) / kStep) + 2U),
        votes_(rows_ * kDirections) {}

  static constexpr std::size_t kDirections = leaf::kDirections;
  static constexpr float kStep = leaf::kVoteStep;

  void clear() { std::fill(votes_.begin(), votes_.end(), 0.0F); }

  /// For that place, one step up and down, and directions up to a quarter turn aside.
  void add(float arc_length, float azimuth) {
    const float steps = (arc_length - lowest_) / kStep;
    if (steps < 0.0F) return;
    const auto row = static_cast<std::size_t>(steps);
    const auto direction =
        static_cast<std::size_t>((azimuth + kPi) / (2.0F * kPi) * static_cast<float>(kDirections));
    constexpr std::array<float, 5> kWeights{0.5F, 1.0F, 1.0F, 1.0F, 0.5F};
    for (std::size_t r = row - std::min<std::size_t>(row, 1U); r <= row + 1U && r < rows_; ++r) {
      for (std::size_t k = 0; k < kWeights.size(); ++k) {
        votes_[r * kDirections + (direction + kDirections + k - 2U) % kDirections] += kWeights[k];
      }
    }
  }

  /// Calls visit(arc length, azimuth) where more meet than anywhere near.
  template <class Visit>
  void forEachPeak(float least, Visit&& visit) const {
    for (std::size_t row = 0; row < rows_; ++row) {
      for (std::size_t d = 0; d < kDirections; ++d) {
        if (!(at(row, d) >= least && isPeak(row, d))) continue;
        visit(lowest_ + (static_cast<float>(row) + 0.5F) * kStep,
              (static_cast<float>(d) + 0.5F) * 2.0F * kPi / static_cast<float>(kDirections) - kPi);
      }
    }
  }

 private:
  float at(std::size_t row, std::size_t direction) const {
    return votes_[row * kDirections + direction];
  }

  bool isPeak(std::size_t row, std::size_t direction) const {
    constexpr std::size_t kRows = 2U;
    const float here = at(row, direction);
    for (std::size_t r = row - std::min(row, kRows); r <= row + kRows && r < rows_; ++r) {
      for (std::size_t turn = kDirections - 1U; turn <= kDirections + 1U; ++turn) {
        if (r == row && turn == kDirections) continue;
        const float there = at(r, (direction + turn) % kDirections);
        // Of equals the first.
        const bool later = r > row || (r == row && turn > kDirections);
        if (there > here || (there == here && !later)) return false;
      }
    }
    return true;
  }

  float lowest_;
  std::size_t rows_;
  std::vector<float> votes_;
};

/// Where many points outside the surface, carried back along one slope, meet it in one place.
std::vector<LeafBase> guess(const Surroundings& around) {
  std::vector<LeafBase> guesses;
  if (around.count == 0U) return guesses;
  constexpr float kClear = 2.0F;  // spreads beyond the surface
  constexpr float kLeastVotes = 2.5F;
  Votes votes(around.arc_lengths[0] - kLongest, around.arc_lengths[around.count - 1U]);
  for (const float slope : kSlopes) {
    votes.clear();
    for (std::size_t i = 0; i < around.count; ++i) {
      const float beyond = around.distances[i] - around.radii[i];
      if (beyond < kClear * around.spread || beyond > slope * kLongest) continue;
      votes.add(around.arc_lengths[i] - beyond / slope, around.azimuths[i]);
    }
    votes.forEachPeak(kLeastVotes, [&](float arc_length, float azimuth) {
      LeafBase base;
      base.arc_length = arc_length;
      base.azimuth = azimuth;
      base.slope = slope;
      guesses.push_back(base);
    });
  }
  return guesses;
}

Surroundings lookAround(const std::vector<Eigen::Vector3f>& points,
                        const std::vector<std::uint32_t>& members, const Midline& midline) {
  Surroundings around;
  constexpr float kThinnest = 0.002F;  // [m] skin
  around.spread = std::max(midline.spread, kThinnest);
  const float length = midline.axis.length();
  constexpr float kBand = 0.05F;  // [m]
  std::vector<float> counts(static_cast<std::size_t>(length / kBand) + 1U, 0.0F);
  float beside = 0.0F;
  std::vector<StemPlace> places;
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    if (at.arc_length < 0.0F || at.arc_length > length + kLongest) continue;
    const StemPlace place = placeOf(points[i], at);
    const float beyond = place.distance - place.radius;
    if (beyond > LeafBases::kReach) continue;
    places.push_back(place);
    if (at.arc_length > length) continue;
    if (beyond < 2.0F * around.spread) {
      const float band_area = 2.0F * kPi * place.radius * kBand;
      counts[static_cast<std::size_t>(at.arc_length / kBand)] += 1.0F / band_area;
    } else {
      beside += 1.0F;
    }
  }
  std::sort(places.begin(), places.end(), [](const StemPlace& a, const StemPlace& b) {
    return a.arc_length != b.arc_length ? a.arc_length < b.arc_length : a.azimuth < b.azimuth;
  });
  around.setPlaces(places);
  std::vector<float> seen;
  for (const float count : counts) {
    if (count > 0.0F) seen.push_back(count);
  }
  if (!seen.empty()) around.stem_density = medianOf(std::move(seen));
  const float radius = midline.axis.radiusAt(0.5F * length);
  const float outer = radius + LeafBases::kReach;
  const float inner = radius + 2.0F * around.spread;
  constexpr float kScattered = 0.15F;  // of what lies beside a stem is no leaf of its own
  around.clutter = kScattered * (beside + 1.0F) /
                   (kPi * (outer * outer - inner * inner) * std::max(length, kBand));
  if (!(around.stem_density > 0.0F)) return around;
  for (std::size_t i = 0; i < around.count; ++i) {
    around.stem[i] = around.stem_density *
                     leaf::stemDensity(around.distances[i], around.radii[i], around.spread);
  }
  around.guesses = guess(around);
  return around;
}

std::vector<LeafBase> findAlone(const Surroundings& around) {
  if (around.guesses.empty()) return {};
  std::vector<float> hidden(around.count + kLanes);
  std::vector<float> leaves(hidden.size());
  std::vector<LeafBase> candidates(around.guesses.size());
  std::vector<LeafBase> others(candidates.size());
  std::vector<LeafBase> found(candidates.size());
  std::vector<int> kept(candidates.size());
  int count = 0;
  LeafSearch<SerialTeam> search(SerialTeam(), around.task(),
                                {hidden.data(), leaves.data(), candidates.data(), others.data(),
                                 found.data(), kept.data(), &count});
  found.resize(static_cast<std::size_t>(withWideVectors([&] { return search.find(); })));
  return found;
}

/// Of stems begin ... end - 1 on the GPU; false where they are to be worked on the CPU.
bool findOnGpu(const std::vector<Surroundings>& stems, std::size_t begin, std::size_t end,
               const ComputeDevice& device, std::vector<std::vector<LeafBase>>& found) {
  if constexpr (kWithCuda) {
    return device.attempt([&](GpuStream& stream) {
      std::vector<LeafSearchTask> tasks;
      for (std::size_t s = begin; s < end; ++s) tasks.push_back(stems[s].task());
      const GpuLeafBases result = leafBasesOnGpu(stream, tasks);
      for (std::size_t s = begin; s < end; ++s) {
        const LeafBase* first = result.bases + result.begins[s - begin];
        found[s].assign(first, first + result.counts[s - begin]);
      }
    });
  }
  return false;
}

}  // namespace

LeafBases::LeafBases(const std::vector<Eigen::Vector3f>& points,
                     const std::vector<std::uint32_t>& members, const Midline& midline) {
  const Surroundings around = lookAround(points, members, midline);
  *this = LeafBases(findAlone(around), around.spread);
}

LeafBases::LeafBases(std::vector<LeafBase> bases, float spread)
    : bases_(std::move(bases)), spread_(spread) {
  std::sort(bases_.begin(), bases_.end(),
            [](const LeafBase& a, const LeafBase& b) { return a.arc_length < b.arc_length; });
}

std::vector<LeafBases> findLeafBases(const std::vector<Eigen::Vector3f>& points,
                                     const std::vector<std::vector<std::uint32_t>>& members,
                                     const std::vector<const Midline*>& midlines,
                                     const ComputeDevice& device) {
  std::vector<LeafBases> bases(midlines.size());
  if (!device.hasGpu()) {
    parallelFor(midlines.size(),
                [&](std::size_t s) { bases[s] = LeafBases(points, members[s], *midlines[s]); });
    return bases;
  }
  std::vector<Surroundings> around(midlines.size());
  std::vector<std::vector<LeafBase>> found(midlines.size());
  parallelFor(midlines.size(),
              [&](std::size_t s) { around[s] = lookAround(points, members[s], *midlines[s]); });
  // While some are on the GPU others are made ready for it, and read from it.
  constexpr std::size_t kAtOnce = 32U;
  parallelChunks(midlines.size(), kAtOnce, [&](std::size_t begin, std::size_t end) {
    const bool done = findOnGpu(around, begin, end, device, found);
    for (std::size_t s = begin; s < end; ++s) {
      bases[s] = LeafBases(done ? std::move(found[s]) : findAlone(around[s]), around[s].spread);
    }
  });
  return bases;
}

float LeafBases::reachOf(const Midline& midline) {
  float thickest = 0.0F;
  for (const StemAxis::Node& node : midline.axis.nodes())
    thickest = std::max(thickest, node.radius);
  return thickest + kReach;
}

std::vector<float> LeafBases::arcLengths() const {
  std::vector<float> arc_lengths;
  for (const LeafBase& base : bases_) arc_lengths.push_back(base.arc_length);
  return arc_lengths;
}

float LeafBases::leafShare(const Eigen::Vector3f& point, const StemAxis& axis) const {
  if (bases_.empty()) return 0.0F;
  const StemPlace place = placeOf(point, axis.project(point));
  const VectorLanes lanes;
  const leaf::Places<Floats> places{allOf(place.arc_length), allOf(place.azimuth),
                                    allOf(place.distance), allOf(place.radius)};
  const leaf::Influence<Floats> influence = leaf::influenceOfAll(
      lanes, bases_.data(), static_cast<int>(bases_.size()), places, leaf::blurOf(spread_));
  if (!(influence.leaf[0] > 0.0F)) return 0.0F;
  return leaf::shareOf(influence.leaf[0], influence.hidden[0],
                       leaf::stemDensity(place.distance, place.radius, spread_));
}

}  // namespace field_phenotyping
