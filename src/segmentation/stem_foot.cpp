#include "field_phenotyping/segmentation/stem_foot.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "field_phenotyping/segmentation/stem_sight.hpp"

namespace field_phenotyping {
namespace {

constexpr float kBand = 0.05F;  // [m] along the axis
// Of Student's distribution of slopes: a few plants lean far more than most of their stand.
constexpr float kFreedom = 4.0F;

/// What is seen of a stem, band by band from its base.
struct Sight {
  std::vector<float> weights;  // points in the skin where they crowd there; 0 where leaves do
  float total = 0.0F;
};

Sight sightOf(const Block& block, const NeighborGrid& grid, const Midline& midline) {
  const StemAxis& axis = midline.axis;
  Sight sight;
  for (float s = 0.5F * kBand; s < axis.length(); s += kBand) {
    if (s < midline.hidden) {
      sight.weights.push_back(0.0F);
      continue;
    }
    const BandSight band = seeBand(block.cloud.points, grid, midline, s, kBand);
    constexpr float kMostOfBand = 12.0F;  // points of one band err together
    sight.weights.push_back(band.inside > band.around ? std::min(band.inside, kMostOfBand) : 0.0F);
    sight.total += sight.weights.back();
  }
  return sight;
}

/// Whether the lowest part of the stem shows enough to know where it stands.
bool footIsSeen(const Sight& sight) {
  constexpr float kLowest = 0.2F;   // of the length: where more is hidden a bend may be too
  constexpr float kLeast = 0.25F;   // [m]
  constexpr float kEnough = 0.04F;  // of what is seen in all
  const auto bands = static_cast<float>(sight.weights.size());
  const float lowest = std::min(std::max(kLowest * bands, kLeast / kBand), bands);
  float low = 0.0F;
  for (std::size_t band = 0; band < static_cast<std::size_t>(lowest); ++band) {
    low += sight.weights[band];
  }
  return low >= kEnough * sight.total;
}

/// A point below the middle of what is seen of a stem.
struct Drop {
  Eigen::Vector2f shift;  // from the middle, horizontally [m]
  float depth;            // [m]
};

/// The slopes that a stem may go down with, row by row: a square of feet round the likeliest one.
class SlopeGrid {
 public:
  static constexpr float kStep = 0.005F;  ///< [m] from foot to foot
  static constexpr int kSteps = 24;       ///< to either side
  static constexpr float kReach = kSteps * kStep;

  /// @param height of the middle of what is seen above the soil [m]
  SlopeGrid(const Eigen::Vector2f& likeliest, float height)
      : corner_(likeliest - kReach / height * Eigen::Vector2f::Ones()), step_(kStep / height) {}

  static constexpr std::size_t size() { return kSide * kSide; }
  Eigen::Vector2f at(std::size_t k) const {
    return corner_ +
           step_ * Eigen::Vector2f(static_cast<float>(k % kSide), static_cast<float>(k / kSide));
  }

  /// Adds to each slope how near the point lies to an axis that goes down from the middle with it.
  void addNear(const Drop& drop, std::vector<float>& near) const {
    const Column x = columnOf(drop.shift.x() + drop.depth * corner_.x(), drop.depth * step_);
    const Column y = columnOf(drop.shift.y() + drop.depth * corner_.y(), drop.depth * step_);
    for (std::size_t row = y.begin; row < y.end; ++row) {
      const float share = y.shares[row];
      float* const sums = near.data() + row * kSide;
      for (std::size_t k = x.begin; k < x.end; ++k) sums[k] += share * x.shares[k];
    }
  }

 private:
  static constexpr std::size_t kSide = 2U * kSteps + 1U;
  struct Column {
    std::array<float, kSide> shares;  // of nearness, from begin to end
    std::size_t begin;
    std::size_t end;
  };

  /// Nearness of offsets first, first + step, ... along one coordinate.
  static Column columnOf(float first, float step) {
    constexpr float kWidth = 0.010F;       // [m] of a stem's points about its axis
    constexpr float kFar = 5.0F * kWidth;  // what is farther off changes nothing
    const auto last = static_cast<float>(kSide);
    Column column;
    column.begin =
        static_cast<std::size_t>(std::clamp(std::ceil((-kFar - first) / step), 0.0F, last));
    column.end =
        static_cast<std::size_t>(std::clamp(std::floor((kFar - first) / step) + 1.0F, 0.0F, last));
    for (std::size_t k = column.begin; k < column.end; ++k) {
      const float off = (first + static_cast<float>(k) * step) / kWidth;
      column.shares[k] = std::exp(-0.5F * off * off);
    }
    return column;
  }

  Eigen::Vector2f corner_;
  float step_;
};

}  // namespace

Eigen::Vector3f baseOf(const Block& block, const StemAxis& axis) {
  const Eigen::Vector3f low = axis.nodes().front().position;
  return axis.pointAtHeight(block.ground.heightAt(low.x(), low.y()));
}

std::optional<SettledFoot> settleFoot(const Block& block, const NeighborGrid& grid,
                                      const Midline& midline, const Stand& stand) {
  const StandLean& lean = stand.lean;
  if (!lean.known()) return std::nullopt;
  const StemAxis& axis = midline.axis;
  const Sight sight = sightOf(block, grid, midline);
  if (!(sight.total > 0.0F)) return std::nullopt;
  constexpr float kOnSoil = 0.10F;  // [m]
  if (!(midline.hidden > 0.0F) &&
      block.ground.heightAbove(axis.nodes().front().position) < kOnSoil && footIsSeen(sight)) {
    return std::nullopt;
  }

  // 1. The slope of what is seen, and the middle of its lower part.
  const auto middleOf = [&](std::size_t end) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    float weight = 0.0F;
    for (std::size_t band = 0; band < end; ++band) {
      sum += sight.weights[band] * axis.pointAt((static_cast<float>(band) + 0.5F) * kBand);
      weight += sight.weights[band];
    }
    return Eigen::Vector3f(sum / weight);
  };
  const Eigen::Vector3f middle_of_all = middleOf(sight.weights.size());
  float lever = 0.0F;  // mean square height about the middle
  Eigen::Vector2f moment = Eigen::Vector2f::Zero();
  for (std::size_t band = 0; band < sight.weights.size(); ++band) {
    const Eigen::Vector3f off =
        axis.pointAt((static_cast<float>(band) + 0.5F) * kBand) - middle_of_all;
    lever += sight.weights[band] / sight.total * off.z() * off.z();
    moment += sight.weights[band] / sight.total * off.z() * off.head<2>();
  }
  if (!(lever > 0.0F)) return std::nullopt;
  constexpr float kLower = 0.6F;  // of what is seen: stems bend further up
  float seen = 0.0F;
  std::size_t lower = 0U;
  while (seen < kLower * sight.total) seen += sight.weights[lower++];
  const Eigen::Vector3f middle = middleOf(lower);
  const Eigen::Vector2f seen_slope = moment / lever;
  constexpr float kLeafPull = 0.008F;  // [m] by which leaves move either end
  constexpr float kFew = 60.0F;        // points that as easily follow a leaf
  const float seen_error = kLeafPull * std::sqrt((1.0F + kFew / sight.total) / lever);
  // Between that and the stand's, by what is known of either.
  const float unusual = lean.deviation(seen_slope, 0.0F);
  const float scatter =
      lean.scatter * std::sqrt((kFreedom + unusual * unusual) / (kFreedom + 2.0F));
  const float seen_share = scatter * scatter / (scatter * scatter + seen_error * seen_error);
  const Eigen::Vector2f expected_slope = lean.slope + seen_share * (seen_slope - lean.slope);

  constexpr float kStray = 0.05F;  // of what is seen in all
  float below = 0.0F;
  std::size_t lowest = 0U;
  while (below + sight.weights[lowest] < kStray * sight.total) below += sight.weights[lowest++];
  const Eigen::Vector3f seen_from = axis.pointAt(static_cast<float>(lowest) * kBand);

  // 2. The points further down that may be the stem's.
  const float soil = block.ground.heightAt(middle.x(), middle.y());
  const float height = middle.z() - soil;
  constexpr float kLit = 0.15F;  // [m] below the middle: leaves crowd there
  if (!(height > 2.0F * kLit)) return std::nullopt;
  std::vector<std::vector<Drop>> slabs;
  constexpr float kSlab = 0.10F;
  for (float depth = kLit; depth < height; depth += kSlab) {
    slabs.emplace_back();
    const float at = depth + 0.5F * kSlab;
    const Eigen::Vector2f expected = middle.head<2>() - at * expected_slope;
    const Eigen::Vector3f center(expected.x(), expected.y(), middle.z() - at);
    const float reach = SlopeGrid::kReach * at / height + 0.03F;
    grid.forEachWithin(center, std::hypot(reach, 0.5F * kSlab), [&](std::uint32_t i, float) {
      const Eigen::Vector3f off = block.cloud.points[i] - middle;
      if (std::abs(-off.z() - at) > 0.5F * kSlab) return;
      slabs.back().push_back({off.head<2>(), -off.z()});
    });
  }

  // 3. The slope that all agree on best: of a grid of slopes, by what each slab says of all of
  // them.
  const SlopeGrid slopes(expected_slope, height);
  std::vector<double> odds(slopes.size(), 1.0);
  std::vector<float> near;
  for (const std::vector<Drop>& slab : slabs) {
    near.assign(slopes.size(), 0.0F);
    for (const Drop& drop : slab) slopes.addNear(drop, near);
    constexpr float kFew = 1.0F;  // point that chance puts there
    const float share = 1.0F / (kFew + 0.1F * static_cast<float>(slab.size()));
    for (std::size_t k = 0; k < odds.size(); ++k) {
      odds[k] *= 1.0 + static_cast<double>(near[k] * share);
    }
  }
  std::vector<double> scores(slopes.size());
  for (std::size_t k = 0; k < scores.size(); ++k) {
    const Eigen::Vector2f slope = slopes.at(k);
    const float standing = lean.deviation(slope, 0.0F);
    const float usual = (kFreedom + 2.0F) * std::log1p(standing * standing / kFreedom);
    const float seen = (slope - seen_slope).squaredNorm() / (seen_error * seen_error);
    scores[k] = std::log(odds[k]) - 0.5 * static_cast<double>(usual + seen);
  }
  const auto likeliest = std::max_element(scores.begin(), scores.end());
  auto best = static_cast<std::size_t>(likeliest - scores.begin());
  if (stand.rows) {
    // Only those are asked for that the best place in the best row could make the best.
    const double most_row_gain = std::log(stand.rows->mostRowOdds());
    const double most_interval_gain = std::log(stand.rows->mostIntervalOdds());
    double most = -std::numeric_limits<double>::infinity();
    const auto offer = [&](std::size_t k) {
      if (scores[k] + most_row_gain + most_interval_gain <= most) return;
      const Eigen::Vector2d foot = (middle.head<2>() - height * slopes.at(k)).cast<double>();
      const double in_row = scores[k] + std::log(stand.rows->rowOdds(foot));
      if (in_row + most_interval_gain <= most) return;
      const double score = in_row + std::log(stand.rows->intervalOdds(foot, stand.plants));
      if (score <= most) return;
      most = score;
      best = k;
    };
    offer(best);
    for (std::size_t k = 0; k < scores.size(); ++k) offer(k);
  }
  const Eigen::Vector2f slope = slopes.at(best);

  // 4. Straight down from the middle; above it as it was.
  constexpr float kNodeSpacing = 0.05F;  // [m]
  std::vector<StemAxis::Node> nodes;
  const auto count = static_cast<int>(std::ceil(height / kNodeSpacing));
  for (int k = count; k >= 0; --k) {
    const float depth = height * static_cast<float>(k) / static_cast<float>(count);
    Eigen::Vector3f position = middle;
    position.head<2>() -= depth * slope;
    position.z() -= depth;
    nodes.push_back({position, axis.radiusAt(axis.project(position).arc_length)});
  }
  constexpr float kLeastStep = 0.01F;
  for (const StemAxis::Node& node : axis.nodes()) {
    if (node.position.z() > nodes.back().position.z() + kLeastStep) nodes.push_back(node);
  }
  SettledFoot settled;
  settled.axis = StemAxis(std::move(nodes));
  settled.hidden = settled.axis.project(seen_from).arc_length;
  return settled;
}

}  // namespace field_phenotyping
