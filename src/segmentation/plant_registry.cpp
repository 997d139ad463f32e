#include "field_phenotyping/segmentation/plant_registry.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <tuple>

namespace field_phenotyping {
namespace {

constexpr double kCell = 4.0;  // [m] about a block: entries of one cell lie together

std::pair<std::int64_t, std::int64_t> cellOf(const Eigen::Vector2d& base) {
  return {static_cast<std::int64_t>(std::floor(base.x() / kCell)),
          static_cast<std::int64_t>(std::floor(base.y() / kCell))};
}

Eigen::Vector2d cornerOf(const std::pair<std::int64_t, std::int64_t>& cell) {
  return kCell * Eigen::Vector2d(static_cast<double>(cell.first), static_cast<double>(cell.second));
}

bool isFartherWest(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return std::tie(a.x(), a.y()) < std::tie(b.x(), b.y());
}

/// How well the bases fit what is known if the map has moved by `shift`: about the number of those
/// that have a known one where they are.
/// @param earlier from west to east
double agreement(const std::vector<Eigen::Vector2d>& bases,
                 const std::vector<Eigen::Vector2d>& earlier, const Eigen::Vector2d& shift) {
  constexpr double kSpread = 0.01;  // [m] of most bases from pass to pass
  constexpr double kWide = 0.03;    // [m] of the others
  constexpr double kFar = 2.0 * kWide;
  double sum = 0.0;
  for (const Eigen::Vector2d& base : bases) {
    const Eigen::Vector2d expected = base - shift;
    double nearest = kFar * kFar;
    const Eigen::Vector2d west(expected.x() - kFar, expected.y());
    for (auto known = std::lower_bound(earlier.begin(), earlier.end(), west, isFartherWest);
         known != earlier.end() && known->x() <= expected.x() + kFar; ++known) {
      nearest = std::min(nearest, (expected - *known).squaredNorm());
    }
    if (nearest >= kFar * kFar) continue;
    sum += 0.7 * std::exp(-0.5 * nearest / (kSpread * kSpread)) +
           0.3 * std::exp(-0.5 * nearest / (kWide * kWide));
  }
  return sum;
}

}  // namespace

PlantRegistry::PlantRegistry(double match_radius) : match_radius_(match_radius) {}

void PlantRegistry::file(std::int32_t id, const Eigen::Vector2d& base, std::uint64_t stamp_ns) {
  constexpr std::size_t kRoom = 8U;  // as vectors grow by themselves, half of them would be empty
  const Cell cell = cellOf(base);
  std::pmr::vector<Entry>& entries = entries_[cell];
  if (entries.size() == entries.capacity()) entries.reserve(entries.size() + kRoom);
  entries.push_back({stamp_ns, (base - cornerOf(cell)).cast<float>(), id});
  ++size_;
}

void PlantRegistry::takeOut(const Known& known) {
  std::pmr::vector<Entry>& entries = entries_.at(known.cell);
  entries.erase(std::find_if(entries.begin(), entries.end(),
                             [&](const Entry& entry) { return entry.id == known.id; }));
  --size_;
}

void PlantRegistry::restore(const std::vector<KnownPlant>& plants) {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const KnownPlant& plant : plants) {
    next_id_ = std::max(next_id_, plant.id + 1);
    if (plant.reported) file(plant.id, plant.base, plant.stamp_ns);
  }
  for (const KnownPlant& plant : plants) {
    if (plant.reported) continue;
    const std::vector<Known> near = findNear({plant.base}, match_radius_);
    const bool is_anothers = std::any_of(near.begin(), near.end(), [&](const Known& known) {
      return (known.base - plant.base).norm() < match_radius_;
    });
    if (!is_anothers) file(plant.id, plant.base, plant.stamp_ns);
  }
}

/// What the block has reported in this pass stays its own where the base has wandered out of its
/// reach since: the neighbour, which left it to the block, may have spoken for the last time.
void PlantRegistry::keepOwnPlants(SegmentedBlock& block) const {
  const BlockHeader& header = block.header;
  const auto before = claims_.find(header.index);
  if (before == claims_.end() || before->second.stamp_ns < header.began_ns) return;
  const std::vector<std::int32_t>& ids = before->second.ids;
  const auto baseOf = [&](const Plant& plant) -> Eigen::Vector2d {
    return block.cloud.origin.head<2>() + plant.base.head<2>().cast<double>();
  };
  for (Plant& plant : block.plants) {
    const Eigen::Vector2d base = baseOf(plant);
    const bool is_near = header.holds(base.x(), base.y(), kBorderTolerance + match_radius_);
    if (plant.owned || !is_near) continue;
    for (const Known& known : findNear({base}, match_radius_)) {
      const double distance = (known.base - base).norm();
      const bool is_own = std::find(ids.begin(), ids.end(), known.id) != ids.end();
      const bool is_anothers =
          std::any_of(block.plants.begin(), block.plants.end(), [&](const Plant& other) {
            return &other != &plant && (known.base - baseOf(other)).norm() <= distance;
          });
      if (distance < match_radius_ && is_own && !is_anothers) plant.owned = true;
    }
  }
}

/// What a draft of a part of its tile leaves as it is: plants that are claimed by the block and
/// stand out of the part's reach, and others that do unless they turn out to be one of its own.
PlantRegistry::Untouched PlantRegistry::untouchedBy(const BlockHeader& header) const {
  Untouched untouched;
  const auto claims = claims_.find(header.index);
  if (!header.isPart() || claims == claims_.end()) return untouched;
  std::map<std::int32_t, Eigen::Vector2d> in_reach;
  for (const Known& known :
       findNear({header.part.min(), header.part.max()}, kBorderTolerance + match_radius_)) {
    in_reach.emplace(known.id, known.base);
  }
  for (const std::int32_t id : claims->second.ids) {
    const auto found = in_reach.find(id);
    if (found == in_reach.end()) {
      untouched.far.push_back(id);
    } else if (!header.holds(found->second.x(), found->second.y())) {
      untouched.near.push_back(id);
    }
  }
  return untouched;
}

/// The block goes on claiming these, if nothing else has become of them.
void PlantRegistry::keepClaims(const std::vector<std::int32_t>& ids, const BlockIndex& index,
                               Claims& claims) {
  for (const std::int32_t id : ids) {
    if (!claimed_.emplace(id, index).second) continue;
    claims.ids.push_back(id);
    claims.seen.insert(id);
  }
}

/// Those of the block, and those that hold no longer.
void PlantRegistry::releaseClaims(const BlockHeader& header) {
  for (auto claims = claims_.begin(); claims != claims_.end();) {
    const std::uint64_t then = claims->second.stamp_ns;
    const std::uint64_t apart =
        header.stamp_ns > then ? header.stamp_ns - then : then - header.stamp_ns;
    if (!(claims->first == header.index) && apart <= kClaimHolds) {
      ++claims;
      continue;
    }
    for (const std::int32_t id : claims->second.ids) claimed_.erase(id);
    claims = claims_.erase(claims);
  }
  for (auto doubt = in_doubt_.begin(); doubt != in_doubt_.end();) {
    const bool old = header.stamp_ns > doubt->second + kClaimHolds;
    doubt = old ? in_doubt_.erase(doubt) : std::next(doubt);
  }
}

/// Those of the block that has claimed a plant; null where none has.
const PlantRegistry::Claims* PlantRegistry::claimsOn(std::int32_t id) const {
  const auto owner = claimed_.find(id);
  return owner == claimed_.end() ? nullptr : &claims_.at(owner->second);
}

/// The block that has claimed a plant reports it no more.
void PlantRegistry::releaseClaim(std::int32_t id) {
  const auto owner = claimed_.find(id);
  std::vector<std::int32_t>& ids = claims_.at(owner->second).ids;
  ids.erase(std::find(ids.begin(), ids.end(), id));
  claimed_.erase(owner);
}

/// Takes a plant that stands in the block's tile from another block that might not report it again:
/// one that claimed it before this pass began, out of whose reach the map may have carried it, or
/// one that is not final when this one is, for this tile's points may soon be forgotten.
void PlantRegistry::takeOver(std::int32_t id, const Eigen::Vector2d& base,
                             const BlockHeader& header) {
  const Claims* claims = claimsOn(id);
  if (claims == nullptr || !header.holds(base.x(), base.y())) return;
  const bool of_earlier_pass = claims->stamp_ns < header.began_ns;
  if (of_earlier_pass || (header.final && !claims->final)) releaseClaim(id);
}

/// Whether another block reports the plant under another id: where it is one that this block does
/// not see beside it, nor the other block this one. Else of such ids none is left but this one.
bool PlantRegistry::isSameAsAnothers(std::int32_t id, const Eigen::Vector2d& base,
                                     const std::vector<Known>& near, std::vector<bool>& given,
                                     std::vector<TakenBack>& taken_back) {
  for (std::size_t e = 0; e < near.size(); ++e) {
    const Known& other = near[e];
    if (given[e] || !((base - other.now).norm() < match_radius_)) continue;
    const Claims* claims = claimsOn(other.id);
    if (claims == nullptr || claims->seen.count(id) > 0U) continue;
    // The older id stays, unless the other block has spoken for the last time and was sure.
    if (other.id < id || (claims->final && in_doubt_.count(other.id) == 0U)) return true;
    if (in_doubt_.erase(other.id) > 0U) taken_back.push_back({other.id, -1});
    releaseClaim(other.id);
    takeOut(other);
    given[e] = true;
  }
  return false;
}

/// Every plant within `reach` of the rectangle that holds the bases.
std::vector<PlantRegistry::Known> PlantRegistry::findNear(const std::vector<Eigen::Vector2d>& bases,
                                                          double reach) const {
  std::vector<Known> found;
  if (bases.empty()) return found;
  Eigen::Vector2d low = bases.front();
  Eigen::Vector2d high = bases.front();
  for (const Eigen::Vector2d& base : bases) {
    low = low.cwiseMin(base);
    high = high.cwiseMax(base);
  }
  low.array() -= reach;
  high.array() += reach;
  const Cell first = cellOf(low);
  const Cell last = cellOf(high);
  for (std::int64_t x = first.first; x <= last.first; ++x) {
    const auto end = entries_.upper_bound({x, last.second});
    for (auto cell = entries_.lower_bound({x, first.second}); cell != end; ++cell) {
      const Eigen::Vector2d corner = cornerOf(cell->first);
      for (const Entry& entry : cell->second) {
        const Eigen::Vector2d base = corner + entry.offset.cast<double>();
        if ((base.array() < low.array()).any() || (base.array() > high.array()).any()) continue;
        found.push_back({cell->first, entry.id, entry.stamp_ns, base, base});
      }
    }
  }
  return found;
}

/// The map moves as a whole: what was found for the block before is to be expected for this one.
bool PlantRegistry::lastShiftHolds(std::uint64_t stamp_ns) const {
  constexpr std::uint64_t kHolds = 60'000'000'000U;  // [ns]
  const std::uint64_t apart = stamp_ns > last_shift_.stamp_ns ? stamp_ns - last_shift_.stamp_ns
                                                              : last_shift_.stamp_ns - stamp_ns;
  return last_shift_.stamp_ns != 0U && apart <= kHolds;
}

PlantRegistry::ExpectedShift PlantRegistry::expectedShift(std::uint64_t stamp_ns) const {
  constexpr double kAnything = 0.05;  // [m] standard deviations
  constexpr double kSimilar = 0.02;
  if (!lastShiftHolds(stamp_ns)) return {Eigen::Vector2d::Zero(), kAnything};
  return {last_shift_.shift, kSimilar};
}

/// @param since_known whether plants are near that were seen since the last shift that holds
void PlantRegistry::noteShift(const BlockHeader& header, const Eigen::Vector2d& shift,
                              bool since_known) {
  constexpr double kSame = 0.03;  // [m]
  if (lastShiftHolds(header.stamp_ns) && (shift - last_shift_.shift).norm() < kSame) {
    last_shift_ = {shift, header.stamp_ns, std::min(last_shift_.began_ns, header.began_ns)};
    return;
  }
  const Eigen::Vector2d before = since_known ? last_shift_.shift : Eigen::Vector2d(0.0, 0.0);
  last_shift_ = {shift - before, header.stamp_ns, header.began_ns};
}

/// Every difference of a base and a known one is tried; nothing where none is convincing.
/// @param earlier from west to east
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

/// Whether an id was given before it was known how the map has moved, and no block claims it now.
bool PlantRegistry::isInDoubt(std::int32_t id) const {
  return in_doubt_.count(id) > 0U && claimed_.count(id) == 0U;
}

/// Which of the known plants for whose numbers mayBe(e) is true is at that place, or kNone.
template <class MayBe>
std::size_t PlantRegistry::oneAt(const Eigen::Vector2d& place, const std::vector<Known>& near,
                                 const MayBe& mayBe) const {
  double nearest = match_radius_;
  std::size_t found = kNone;
  for (std::size_t e = 0; e < near.size(); ++e) {
    if (!mayBe(e)) continue;
    const double distance = (place - near[e].now).norm();
    if (!(distance < nearest)) continue;
    nearest = distance;
    found = e;
  }
  return found;
}

/// Plants that were named anew before it was known how the map has moved have their older ids back.
void PlantRegistry::giveOlderIdsBack(const std::vector<Eigen::Vector2d>& bases,
                                     const std::vector<Known>& near, std::uint64_t began_ns,
                                     Matches& matches, std::vector<TakenBack>& taken_back) {
  for (std::size_t p = 0; p < bases.size(); ++p) {
    std::size_t& match = matches.of_plant[p];
    if (match == kNone || !isInDoubt(near[match].id)) continue;
    const std::size_t older = oneAt(bases[p], near, [&](std::size_t e) {
      return !matches.given[e] && near[e].stamp_ns < began_ns;
    });
    if (older == kNone) continue;
    taken_back.push_back({near[match].id, near[older].id});
    matches.given[match] = false;  // and goes, below
    matches.given[older] = true;
    match = older;
  }
  for (std::size_t e = 0; e < near.size(); ++e) {
    if (matches.given[e] || !isInDoubt(near[e].id)) continue;
    const bool of_another = std::any_of(bases.begin(), bases.end(), [&](const auto& base) {
      return (base - near[e].now).norm() < match_radius_;
    });
    if (!of_another) continue;
    takeOut(near[e]);
    in_doubt_.erase(near[e].id);
    taken_back.push_back({near[e].id, -1});
    matches.given[e] = true;
  }
}

/// The same for plants of another block, that saw too little: it hears of them when it reports
/// next, if ever.
void PlantRegistry::giveOthersOlderIdsBack(std::vector<Known>& near, std::uint64_t began_ns,
                                           Matches& matches, std::vector<TakenBack>& taken_back) {
  for (std::size_t d = 0; d < near.size(); ++d) {
    Known& doubted = near[d];
    const auto claimed = claimed_.find(doubted.id);
    const bool is_own = claimed == claimed_.end() && matches.given[d];
    if (in_doubt_.count(doubted.id) == 0U || is_own) continue;
    const std::size_t o = oneAt(doubted.now, near, [&](std::size_t e) {
      return !matches.given[e] && near[e].stamp_ns < began_ns && claimed_.count(near[e].id) == 0U &&
             in_doubt_.count(near[e].id) == 0U;
    });
    if (o == kNone) continue;
    const std::int32_t older = near[o].id;
    taken_back.push_back({doubted.id, older});
    if (claimed != claimed_.end()) {
      const BlockIndex block = claimed->second;
      Claims& claims = claims_.at(block);
      std::replace(claims.ids.begin(), claims.ids.end(), doubted.id, older);
      claims.seen.insert(older);
      claimed_.erase(claimed);
      claimed_.emplace(older, block);
    }
    in_doubt_.erase(doubted.id);
    takeOut(doubted);
    takeOut(near[o]);
    matches.given[o] = true;
    doubted.id = older;
    file(older, doubted.base, doubted.stamp_ns);
  }
}

/// What was seen before this pass began is where it was in the map of then: `now` of such plants
/// becomes where the map of this pass has them.
/// @return whether it is known for sure by how much the map has moved
bool PlantRegistry::layOver(const BlockHeader& header, const std::vector<Eigen::Vector2d>& bases,
                            std::vector<Known>& near, Eigen::Vector2d& shift) {
  const bool last_holds = lastShiftHolds(header.stamp_ns);
  std::vector<Eigen::Vector2d> earlier;
  bool since_known = false;
  for (Known& known : near) {
    if (known.stamp_ns >= header.began_ns) continue;
    if (last_holds && known.stamp_ns >= last_shift_.began_ns) {
      known.now -= last_shift_.shift;  // where it was before the map moved
      since_known = true;
    }
    earlier.push_back(known.now);
  }
  if (earlier.empty()) return false;
  std::sort(earlier.begin(), earlier.end(), isFartherWest);
  const auto found = findShift(bases, earlier, header.stamp_ns);
  const bool sure = found && found->sure;
  shift = found ? found->shift : expectedShift(header.stamp_ns).shift;
  if (sure) noteShift(header, shift, since_known);
  for (Known& known : near) {
    if (known.stamp_ns < header.began_ns) known.now += shift;
  }
  return sure;
}

/// Nearest pairs first, each plant and each known one once.
PlantRegistry::Matches PlantRegistry::match(const std::vector<Eigen::Vector2d>& bases,
                                            const std::vector<Known>& near) const {
  std::vector<std::tuple<double, std::size_t, std::size_t>> pairs;  // distance, plant, known one
  for (std::size_t p = 0; p < bases.size(); ++p) {
    for (std::size_t e = 0; e < near.size(); ++e) {
      const double distance = (bases[p] - near[e].now).norm();
      if (distance < match_radius_) pairs.emplace_back(distance, p, e);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  Matches matches{std::vector<std::size_t>(bases.size(), kNone),
                  std::vector<bool>(near.size(), false)};
  for (const auto& [distance, p, e] : pairs) {
    if (matches.of_plant[p] != kNone || matches.given[e]) continue;
    matches.of_plant[p] = e;
    matches.given[e] = true;
  }
  return matches;
}

/// A plant that was not known.
/// @param sure whether it is known by how much the map has moved since an earlier pass
std::int32_t PlantRegistry::nameAnew(const Eigen::Vector2d& base, const std::vector<Known>& near,
                                     const BlockHeader& header, bool sure) {
  const std::int32_t id = next_id_++;
  const bool may_be_an_earlier_one = std::any_of(near.begin(), near.end(), [&](const Known& known) {
    return known.stamp_ns < header.began_ns &&
           (base - known.base).norm() < kMostShift + match_radius_;
  });
  if (!sure && may_be_an_earlier_one) in_doubt_[id] = header.stamp_ns;
  return id;
}

/// Whether this block, and no other, reports a plant that was known. It is then taken out, to be
/// filed anew; as it is, for good, where another block reports it under another id.
bool PlantRegistry::claim(const Known& known, const Eigen::Vector2d& base,
                          const std::vector<Known>& near, const BlockHeader& header,
                          Matches& matches, std::vector<TakenBack>& taken_back) {
  takeOver(known.id, base, header);
  if (claimed_.count(known.id) > 0U) return false;
  takeOut(known);
  return !isSameAsAnothers(known.id, base, near, matches.given, taken_back);
}

PlantRegistry::Outcome PlantRegistry::identify(SegmentedBlock& block) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const BlockHeader& header = block.header;
  std::vector<Plant*> plants;
  std::vector<Eigen::Vector2d> bases;      // of those
  std::vector<Eigen::Vector2d> all_bases;  // and of its neighbours' plants in the margin
  keepOwnPlants(block);
  for (Plant& plant : block.plants) {
    all_bases.emplace_back(block.cloud.origin.head<2>() + plant.base.head<2>().cast<double>());
    if (!plant.owned) continue;
    plants.push_back(&plant);
    bases.push_back(all_bases.back());
  }
  Untouched untouched = untouchedBy(header);
  releaseClaims(header);
  Claims claims;
  claims.stamp_ns = header.stamp_ns;
  claims.final = header.final;
  keepClaims(untouched.far, header.index, claims);
  claims_[header.index] = claims;

  // 1. Which of the known plants its own are.
  Outcome outcome;
  std::vector<Known> near = findNear(all_bases, kMostShift + match_radius_);
  const bool sure = layOver(header, all_bases, near, outcome.shift);
  Matches matches = match(bases, near);
  if (sure) {
    giveOlderIdsBack(bases, near, header.began_ns, matches, outcome.taken_back);
    giveOthersOlderIdsBack(near, header.began_ns, matches, outcome.taken_back);
  }

  // 2. Filed anew under their newest bases.
  for (std::size_t p = 0; p < bases.size(); ++p) {
    const bool is_known = matches.of_plant[p] != kNone;
    ++(is_known ? outcome.known : outcome.added);
    if (is_known) {
      const Known& known = near[matches.of_plant[p]];
      claims.seen.insert(known.id);
      if (!claim(known, bases[p], near, header, matches, outcome.taken_back)) {
        plants[p]->owned = false;
        continue;
      }
    }
    const std::int32_t id =
        is_known ? near[matches.of_plant[p]].id : nameAnew(bases[p], near, header, sure);
    plants[p]->id = id;
    file(id, bases[p], header.stamp_ns);
    claims.ids.push_back(id);
    claims.seen.insert(id);
    claimed_.emplace(id, header.index);
    if (in_doubt_.count(id) > 0U) ++outcome.provisional;
  }
  for (std::size_t e = 0; e < near.size(); ++e) {
    if (!matches.given[e]) continue;
    untouched.near.erase(std::remove(untouched.near.begin(), untouched.near.end(), near[e].id),
                         untouched.near.end());
  }
  keepClaims(untouched.near, header.index, claims);
  claims_[header.index] = std::move(claims);

  // 3. In the end, plants of its own that are hidden in this pass have moved with the rest.
  if (!sure || !header.final) return outcome;
  for (std::size_t e = 0; e < near.size(); ++e) {
    if (matches.given[e] || near[e].stamp_ns >= header.began_ns) continue;
    if (!header.holds(near[e].now.x(), near[e].now.y())) continue;
    takeOut(near[e]);
    file(near[e].id, near[e].now, header.stamp_ns);
  }
  return outcome;
}

std::size_t PlantRegistry::size() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return size_;
}

}  // namespace field_phenotyping
