#include "field_phenotyping/segmentation/plant_registry.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace field_phenotyping {
namespace {

constexpr double kCell = 1.0;  // [m] of the registry's drawers

std::pair<std::int64_t, std::int64_t> cellOf(const Eigen::Vector2d& base) {
  return {static_cast<std::int64_t>(std::floor(base.x() / kCell)),
          static_cast<std::int64_t>(std::floor(base.y() / kCell))};
}

/// How well the bases fit what is known if the map has moved by `shift`: about the number of those
/// that have a known one where they are.
double agreement(const std::vector<Eigen::Vector2d>& bases,
                 const std::vector<Eigen::Vector2d>& earlier, const Eigen::Vector2d& shift) {
  constexpr double kSpread = 0.01;  // [m] of most bases from pass to pass
  constexpr double kWide = 0.03;    // [m] of the others
  constexpr double kFar = 4.0 * kWide * kWide;
  double sum = 0.0;
  for (const Eigen::Vector2d& base : bases) {
    double nearest = kFar;
    for (const Eigen::Vector2d& known : earlier) {
      nearest = std::min(nearest, (base - shift - known).squaredNorm());
    }
    if (nearest >= kFar) continue;
    sum += 0.7 * std::exp(-0.5 * nearest / (kSpread * kSpread)) +
           0.3 * std::exp(-0.5 * nearest / (kWide * kWide));
  }
  return sum;
}

}  // namespace

PlantRegistry::PlantRegistry(double match_radius) : match_radius_(match_radius) {}

void PlantRegistry::file(const Entry& entry) {
  const Cell cell = cellOf(entry.base);
  if (entry.claimed) claims_[entry.owner].insert(cell);
  entries_.emplace(cell, entry);
}

void PlantRegistry::restore(const std::vector<KnownPlant>& plants) {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const KnownPlant& plant : plants) {
    Entry entry;
    entry.id = plant.id;
    entry.base = plant.base;
    entry.stamp_ns = plant.stamp_ns;
    file(entry);
    next_id_ = std::max(next_id_, plant.id + 1);
  }
}

void PlantRegistry::releaseClaims(const BlockIndex& block) {
  const auto claims = claims_.find(block);
  if (claims == claims_.end()) return;
  for (const Cell& cell : claims->second) {
    const auto [begin, end] = entries_.equal_range(cell);
    for (auto entry = begin; entry != end; ++entry) {
      if (entry->second.owner == block) entry->second.claimed = false;
    }
  }
  claims_.erase(claims);
}

/// Every entry within `reach` of the rectangle that holds the bases.
PlantRegistry::Found PlantRegistry::findNear(const std::vector<Eigen::Vector2d>& bases,
                                             double reach) {
  Found found;
  if (bases.empty()) return found;
  Eigen::Vector2d low = bases.front();
  Eigen::Vector2d high = bases.front();
  for (const Eigen::Vector2d& base : bases) {
    low = low.cwiseMin(base);
    high = high.cwiseMax(base);
  }
  const Cell first = cellOf(low - Eigen::Vector2d::Constant(reach));
  const Cell last = cellOf(high + Eigen::Vector2d::Constant(reach));
  for (std::int64_t x = first.first; x <= last.first; ++x) {
    const auto end = entries_.upper_bound({x, last.second});
    for (auto entry = entries_.lower_bound({x, first.second}); entry != end; ++entry) {
      found.push_back(entry);
    }
  }
  return found;
}

/// The map moves as a whole: what was found for the block before is to be expected for this one.
PlantRegistry::ExpectedShift PlantRegistry::expectedShift(std::uint64_t stamp_ns) const {
  constexpr std::uint64_t kHolds = 60'000'000'000U;  // [ns]
  constexpr double kAnything = 0.05;                 // [m] standard deviations
  constexpr double kSimilar = 0.02;
  const std::uint64_t apart = stamp_ns > last_shift_.stamp_ns ? stamp_ns - last_shift_.stamp_ns
                                                              : last_shift_.stamp_ns - stamp_ns;
  if (last_shift_.stamp_ns == 0U || apart > kHolds) return {Eigen::Vector2d::Zero(), kAnything};
  return {last_shift_.shift, kSimilar};
}

/// Every difference of a base and a known one is tried; nothing where none is convincing.
std::optional<PlantRegistry::FoundShift> PlantRegistry::findShift(
    const std::vector<Eigen::Vector2d>& bases, const std::vector<Eigen::Vector2d>& earlier,
    std::uint64_t stamp_ns) const {
  constexpr double kLeast = 3.0;       // plants must agree
  constexpr double kElsewhere = 0.04;  // [m] apart, two shifts give plants to others
  constexpr double kAhead = 3.0;       // plants more must agree than elsewhere to be sure
  const ExpectedShift expected = expectedShift(stamp_ns);
  const auto score = [&](const Eigen::Vector2d& shift) {
    return agreement(bases, earlier, shift) -
           0.5 * (shift - expected.shift).squaredNorm() / (expected.stddev * expected.stddev);
  };
  std::vector<std::pair<double, Eigen::Vector2d>> scored{{score(expected.shift), expected.shift}};
  for (const Eigen::Vector2d& base : bases) {
    for (const Eigen::Vector2d& known : earlier) {
      const Eigen::Vector2d shift = base - known;
      if (shift.norm() <= kMostShift) scored.emplace_back(score(shift), shift);
    }
  }
  const auto first = std::max_element(
      scored.begin(), scored.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  const Eigen::Vector2d best = first->second;
  const double agreeing = agreement(bases, earlier, best);
  if (agreeing < kLeast) return std::nullopt;
  double second = 0.0;
  for (const auto& [found, shift] : scored) {
    if ((shift - best).norm() > kElsewhere) second = std::max(second, found);
  }
  // One pair chose it; all that agree make it exact.
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double pairs = 0.0;
  for (const Eigen::Vector2d& base : bases) {
    for (const Eigen::Vector2d& known : earlier) {
      if ((base - best - known).norm() > match_radius_) continue;
      sum += base - known;
      pairs += 1.0;
    }
  }
  return FoundShift{pairs > 0.0 ? Eigen::Vector2d(sum / pairs) : best,
                    first->first > second + kAhead};
}

PlantRegistry::Outcome PlantRegistry::identify(SegmentedBlock& block) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const BlockHeader& header = block.header;
  std::vector<Plant*> plants;
  std::vector<Eigen::Vector2d> bases;      // of those
  std::vector<Eigen::Vector2d> all_bases;  // and of its neighbours' plants in the margin
  for (Plant& plant : block.plants) {
    all_bases.emplace_back(block.cloud.origin.head<2>() + plant.base.head<2>().cast<double>());
    if (!plant.owned) continue;
    plants.push_back(&plant);
    bases.push_back(all_bases.back());
  }
  releaseClaims(header.index);

  // 1. What was seen before this pass began is where it was in the map of then.
  const Found near = findNear(all_bases, kMostShift + match_radius_);
  const auto seenEarlier = [&](const Entry& entry) { return entry.stamp_ns < header.began_ns; };
  std::vector<Eigen::Vector2d> earlier;
  for (const auto& entry : near) {
    if (seenEarlier(entry->second)) earlier.push_back(entry->second.base);
  }
  Outcome outcome;
  const auto shift = findShift(all_bases, earlier, header.stamp_ns);
  if (shift && shift->sure) last_shift_ = {shift->shift, header.stamp_ns};
  if (!earlier.empty()) outcome.shift = shift ? shift->shift : expectedShift(header.stamp_ns).shift;

  // 2. Nearest pairs first, each plant and each entry once.
  std::vector<std::tuple<double, std::size_t, std::size_t>> pairs;  // distance, plant, entry
  for (std::size_t p = 0; p < bases.size(); ++p) {
    for (std::size_t e = 0; e < near.size(); ++e) {
      const Entry& entry = near[e]->second;
      Eigen::Vector2d expected = entry.base;
      if (seenEarlier(entry)) expected += outcome.shift;
      const double distance = (bases[p] - expected).norm();
      if (distance < match_radius_) pairs.emplace_back(distance, p, e);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> entry_of(bases.size(), kNone);
  std::vector<bool> given(near.size(), false);
  for (const auto& [distance, p, e] : pairs) {
    if (entry_of[p] != kNone || given[e]) continue;
    entry_of[p] = e;
    given[e] = true;
  }

  // 3. Filed anew under their newest bases.
  for (std::size_t p = 0; p < bases.size(); ++p) {
    Entry entry;
    entry.base = bases[p];
    entry.stamp_ns = header.stamp_ns;
    entry.owner = header.index;
    entry.claimed = true;
    if (entry_of[p] == kNone) {
      entry.id = next_id_++;
      ++outcome.added;
    } else {
      const auto known = near[entry_of[p]];
      entry.id = known->second.id;
      ++outcome.known;
      if (known->second.claimed) {
        plants[p]->owned = false;
        continue;
      }
      entries_.erase(known);
    }
    plants[p]->id = entry.id;
    file(entry);
  }

  // 4. In the end, plants that are hidden in this pass have moved with the rest.
  if (!shift || !shift->sure || !header.final) return outcome;
  for (std::size_t e = 0; e < near.size(); ++e) {
    if (given[e] || !seenEarlier(near[e]->second)) continue;
    Entry moved = near[e]->second;
    moved.base += shift->shift;
    moved.stamp_ns = header.began_ns;
    entries_.erase(near[e]);
    file(moved);
  }
  return outcome;
}

std::size_t PlantRegistry::size() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return entries_.size();
}

}  // namespace field_phenotyping
