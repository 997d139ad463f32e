#include "field_phenotyping/measurement/plant_height.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/gpu_streams.hpp"
#include "common/xyz.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "measurement/outermost_heights_gpu.hpp"

namespace field_phenotyping {
namespace {

constexpr int kSpacings = 3;  // of an end's outermost points

/// An end of a plant, upwards or downwards.
struct End {
  double z = 0.0;        ///< of the outermost point
  double spacing = 0.0;  ///< mean spacing in height of the outermost points; 0 of a single point
  float last = 0.0F;     ///< height of the last of these
  double outer = 0.0;    ///< from the outermost point to the third [m]
  double inner = 0.0;    ///< from there to the eighth; 0 of fewer points
};

End endOf(const OutermostHeights& outermost, float upwards) {
  constexpr int kThird = 2;
  constexpr int kEighth = OutermostHeights::kMost - 1;
  End end;
  if (outermost.count == 0) return end;
  const auto between = [&](int from, int to) {
    return static_cast<double>(outermost.heights[from] - outermost.heights[to]);
  };
  const int last = std::min(outermost.count - 1, kSpacings);
  end.z = static_cast<double>(upwards * outermost.heights[0]);
  end.last = upwards * outermost.heights[last];
  if (last > 0) end.spacing = between(0, last) / static_cast<double>(last);
  if (outermost.count > kEighth) {
    end.outer = between(0, kThird);
    end.inner = between(kThird, kEighth);
  }
  return end;
}

/// How points thin out towards an end: their number grows as a power of the distance from it. 1
/// where they go on as they are up to it, as along the branches of a tassel; 2 where there are ever
/// fewer, as towards the tip of a leaf.
class Thinning {
 public:
  explicit Thinning(double power) : power_(power) {}

  /// By the spacings of the outermost points, outer ones relative to inner ones.
  static Thinning of(double outer, double inner) {
    constexpr int kSteps = 40;
    double low = 0.5;
    double high = 2.0;
    for (int step = 0; step < kSteps; ++step) {
      const double middle = 0.5 * (low + high);
      const Thinning thinning(middle);
      const double of_middle =
          (thinning.toPoint(3) - thinning.toPoint(1)) / (thinning.toPoint(8) - thinning.toPoint(3));
      (of_middle * inner < outer ? low : high) = middle;
    }
    return Thinning(0.5 * (low + high));
  }

  /// From the end to the outermost point, in mean spacings of the outermost points: mean and
  /// standard deviation.
  Trait toOutermost() const {
    const double first = toPoint(1);
    const double spacing = (toPoint(1 + kSpacings) - first) / static_cast<double>(kSpacings);
    return {first / spacing, std::sqrt(std::tgamma(1.0 + 2.0 / power_) - first * first) / spacing};
  }

 private:
  /// Mean distance of the k-th outermost point, but for a factor.
  double toPoint(int k) const {
    // Not by lgamma(), which writes a global.
    return std::tgamma(k + 1.0 / power_) / std::tgamma(static_cast<double>(k));
  }

  double power_;
};

/// False where they are to be looked for on the CPU.
bool findOnGpu(const PointCloud& cloud, const std::vector<PlantEndTask>& tasks,
               const ComputeDevice& device, std::vector<OutermostHeights>& found) {
  if constexpr (kWithCuda) {
    return !tasks.empty() && device.attempt([&](GpuStream& stream) {
      const OutermostHeights* result =
          outermostHeightsOnGpu(stream, xyzOf(cloud.points), cloud.points.size(), tasks);
      found.assign(result, result + tasks.size());
    });
  }
  return false;
}

/// That end of each plant. @param upwards 1: its top; -1: its bottom
std::vector<End> endsOf(const SegmentedBlock& block, float upwards, const ComputeDevice& device) {
  std::vector<PlantEndTask> tasks;
  for (const Plant& plant : block.plants) {
    tasks.push_back({plant.points.begin, plant.points.end, upwards});
  }
  std::vector<OutermostHeights> found(tasks.size());
  if (!findOnGpu(block.cloud, tasks, device, found)) {
    const float* xyz = xyzOf(block.cloud.points);
    parallelFor(tasks.size(), [&](std::size_t i) {
      findOutermostHeights(SerialTeam(), tasks[i], xyz, &found[i]);
    });
  }
  std::vector<End> ends;
  for (const OutermostHeights& outermost : found) ends.push_back(endOf(outermost, upwards));
  return ends;
}

/// How far plants of a stand go on beyond their outermost points.
class Overhang {
 public:
  /// @param ends  of the block's plants, in their order
  /// @param noise of a point [m]
  Overhang(const SegmentedBlock& block, const std::vector<End>& ends, double noise) {
    constexpr std::size_t kFewest = 5U;
    std::vector<double> spacings;
    for (std::size_t i = 0; i < ends.size(); ++i) {
      if (block.plants[i].points.size() > static_cast<std::size_t>(kSpacings))
        spacings.push_back(ends[i].spacing);
    }
    if (spacings.size() < kFewest) return;
    // A point of a neighbour above a plant is no spacing: nearly no mean of three exponentially
    // distributed ones is so far above the median.
    constexpr double kMost = 4.0;
    most_ = kMost * medianOf(spacings);
    double count = 0.0, sum = 0.0, squares = 0.0;
    for (const double spacing : spacings) {
      if (spacing > most_) continue;
      count += 1.0;
      sum += spacing;
      squares += spacing * spacing;
    }
    mean_ = sum / count;
    const double by_chance = mean_ * mean_ / static_cast<double>(kSpacings);
    const double between = std::max(0.0, squares / count - mean_ * mean_ - by_chance);
    own_weight_ = between > 0.0 ? between / (between + by_chance) : 0.0;

    if (!(mean_ > 0.0)) return;

    // So many plants are taken as seen whose points do not thin out. Where the noise is thicker
    // than the spacings are, it is what spreads them; where they are longer than a tip, what is
    // hidden.
    constexpr double kEvenPlants = 20.0;
    constexpr double kTip = 0.03;   // [m]
    constexpr double kOuter = 2.0;  // spacings
    constexpr double kInner = 5.0;
    double outer = kEvenPlants * kOuter * mean_;
    double inner = kEvenPlants * kInner * mean_;
    for (const End& end : ends) {
      if (end.spacing > most_) continue;
      outer += end.outer;
      inner += end.inner;
    }
    const Trait thinning = Thinning::of(outer, inner).toOutermost();
    const double variance = mean_ * mean_;
    const double seen =
        variance / (variance + noise * noise) * kTip * kTip / (kTip * kTip + variance);
    beyond_ = {1.0 + seen * (thinning.value - 1.0), 1.0 + seen * (thinning.stddev - 1.0)};
  }

  /// Expected of a plant [m].
  Trait of(const End& end) const {
    const double spacing = own_weight_ * std::min(end.spacing, most_) + (1.0 - own_weight_) * mean_;
    return {beyond_.value * spacing,
            beyond_.stddev * (end.spacing > most_ ? end.spacing : spacing)};
  }

 private:
  double mean_ = 0.0;
  double own_weight_ = 1.0;
  double most_ = std::numeric_limits<double>::infinity();
  Trait beyond_{1.0, 1.0};  ///< the outermost point, in spacings
};

/// How few points are seen about the top of each plant: 1 where there are none but those that it
/// has itself, 0 where they lead from one to the next.
std::vector<double> sparsenessOfTops(const SegmentedBlock& block, const std::vector<End>& tops) {
  constexpr float kAround = 0.04F;  // [m]
  constexpr double kEnough = 10.0;  // neighbours
  float lowest = std::numeric_limits<float>::infinity();
  for (std::size_t plant = 0; plant < tops.size(); ++plant) {
    if (!block.plants[plant].points.empty()) lowest = std::min(lowest, tops[plant].last);
  }
  std::vector<Eigen::Vector3f> high;
  for (const Eigen::Vector3f& point : block.cloud.points) {
    if (point.z() >= lowest - kAround) high.push_back(point);
  }
  const NeighborGrid grid(high, kAround);
  std::vector<double> sparseness(tops.size(), 0.0);
  parallelFor(tops.size(), [&](std::size_t plant) {
    double highest = 0.0;
    double neighbors = 0.0;
    const IndexSpan& own = block.plants[plant].points;
    for (std::uint32_t i = own.begin; i < own.end; ++i) {
      const Eigen::Vector3f& point = block.cloud.points[i];
      if (point.z() < tops[plant].last) continue;
      highest += 1.0;
      neighbors -= 1.0;  // itself
      grid.forEachWithin(point, kAround, [&](std::uint32_t, float) { neighbors += 1.0; });
    }
    if (highest > 0.0) sparseness[plant] = std::max(0.0, 1.0 - neighbors / (kEnough * highest));
  });
  return sparseness;
}

}  // namespace

std::vector<PlantHeight> measurePlantHeights(const SegmentedBlock& block,
                                             const MeasurementParameters& parameters, double noise,
                                             const ComputeDevice& device) {
  const bool soil = block.ground.observed();
  const std::vector<End> tops = endsOf(block, 1.0F, device);
  const Overhang above(block, tops, noise);
  // Where there is soil it says where plants begin.
  const std::vector<End> bottoms = soil ? std::vector<End>() : endsOf(block, -1.0F, device);
  const Overhang below(block, bottoms, noise);
  const std::vector<double> sparseness = sparsenessOfTops(block, tops);
  const double corrected = parameters.mode == "paper" ? 0.0 : 1.0;

  std::vector<PlantHeight> heights(block.plants.size());
  for (std::size_t i = 0; i < heights.size(); ++i) {
    const Plant& plant = block.plants[i];
    PlantHeight& result = heights[i];
    if (!soil) {
      result.flags |= kGroundMissing;
    } else if (!block.ground.seenAt(plant.base.x(), plant.base.y())) {
      result.flags |= kGroundExtrapolated;
    }
    if (plant.points.empty()) continue;
    const Trait above_top = above.of(tops[i]);
    const double top = tops[i].z + corrected * above_top.value;
    if (soil) {
      result.height.value = top - block.ground.heightAt(plant.base.x(), plant.base.y());
      // Between the plants soil looks smoother than it is known under one.
      constexpr double kLeastSoilError = 0.008;  // [m]
      const auto soil_error =
          static_cast<double>(block.ground.stddevAt(plant.base.x(), plant.base.y()));
      result.height.stddev = std::hypot(above_top.stddev, std::max(soil_error, kLeastSoilError));
    } else {
      const Trait below_bottom = below.of(bottoms[i]);
      result.height.value = top - bottoms[i].z + corrected * below_bottom.value;
      result.height.stddev = std::hypot(above_top.stddev, below_bottom.stddev);
    }
    // Of a plant's height: a tassel's branches, or the tip of a leaf.
    constexpr double kTopShare = 0.05;
    const double sparse = kTopShare * sparseness[i] * std::max(result.height.value, 0.0);
    result.height.stddev =
        std::hypot(result.height.stddev, sparse, static_cast<double>(plant.top_stddev));
  }
  return heights;
}

}  // namespace field_phenotyping
