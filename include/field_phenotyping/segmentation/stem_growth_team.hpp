#pragma once

#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/common/team_order.hpp"
#include "field_phenotyping/segmentation/growing_surface.hpp"
#include "field_phenotyping/segmentation/growth_adaptation.hpp"
#include "field_phenotyping/segmentation/region_growth_team.hpp"
#include "field_phenotyping/segmentation/region_merging_team.hpp"
#include "field_phenotyping/segmentation/region_quality_team.hpp"

// Steps 2 to 4 of one stem (paper 2.4.1, 2.4.2) for a team of threads (see team.hpp), on the CPU
// and on the GPU: growth, merging, pruning, quality and the adaptive cycle. Sums over the points
// are either a group's, whose lanes add them in one order, or one member's, who adds them in their
// order: the same bits whatever the team.

namespace field_phenotyping {

/// Grows one stem. All members of the team make one, and come to every call.
template <class Team>
class StemGrowth : public RegionGrowth<Team> {
 public:
  using RegionGrowth<Team>::RegionGrowth;

  /// Steps 2 and 3 once, of what may be no stem: nothing is merged, all that has grown is pruned.
  FIELD_PHENOTYPING_HD void growCandidate() {
    this->placePoints();
    this->growRegions(task_.first);
    if (team_.rank() == 0U) {
      for (int r = 0; r < task_.region_count; ++r) memory_.regions[r].merged = true;
    }
    team_.sync();
    gather();
    prune();
    if (team_.rank() == 0U) {
      growth::Outcome outcome{};
      outcome.settings = task_.first;
      outcome.points = kept_;
      scratch_.shared->outcome = outcome;
    }
    keepAsBest();
    team_.sync();
  }

  /// Steps 2 to 4 whole: while the quality is below the target the parameters are adapted and the
  /// stem is grown again. The best growth is kept.
  FIELD_PHENOTYPING_HD void growStem() {
    this->placePoints();
    growth::Outcome best{};
    best.settings = task_.first;
    GrowthSettings settings = task_.first;
    float threshold = 0.0F;
    while (best.cycles < task_.most_cycles) {
      const float quality = growOnce(settings, threshold);
      ++best.cycles;
      if (best.cycles == 1 || quality > best.quality) {
        best.quality = quality;
        best.settings = settings;
        best.points = kept_;
        keepAsBest();
      }
      if (quality >= task_.target || best.cycles == task_.most_cycles) break;

      // Step 3d: adapt, and grow again (Step 4).
      constexpr float kDifference = 0.1F;
      GrowthSettings changed = settings;
      changed.alpha += kDifference;
      QualityGradient gradient;
      gradient.alpha = (growOnce(changed, threshold) - quality) / kDifference;
      changed = settings;
      changed.beta += kDifference;
      gradient.beta = (growOnce(changed, threshold) - quality) / kDifference;
      settings = adaptSettings(settings, task_.first, quality, task_.target, gradient);
      threshold = adaptMergingThreshold(threshold, quality, task_.target);
    }
    if (team_.rank() == 0U) scratch_.shared->outcome = best;
    team_.sync();
  }

 private:
  using Base = RegionGrowth<Team>;
  using Base::count_;
  using Base::memory_;
  using Base::scratch_;
  using Base::task_;
  using Base::team_;
  using typename Base::Float;
  using typename Base::Lanes;

  /// Steps 2 and 3: growth, merging, and the removal of what was over-segmented.
  /// @param threshold of merging [m]; chosen from the regions' distances where it is not positive
  /// @return Q
  FIELD_PHENOTYPING_HD float growOnce(const GrowthSettings& settings, float& threshold) {
    this->growRegions(settings);
    survey();
    if (team_.rank() == 0U) {
      if (!(threshold > 0.0F)) threshold = firstThreshold();
      mergeRegions(memory_.regions, task_.regions, task_.region_count, threshold);
      scratch_.shared->sums[0] = threshold;
    }
    team_.sync();
    threshold = scratch_.shared->sums[0];
    gather();
    prune();
    return evaluate();
  }

  FIELD_PHENOTYPING_HD float firstThreshold() const {
    constexpr float kLeastGap = 0.5F;  // of max_gap: leaves hide as much of a sound stem
    int count = 0;
    bool is_lowest = true;
    for (int r = 0; r < task_.region_count; ++r) {
      const growth::Region& region = memory_.regions[r];
      if (region.count == 0) continue;
      if (!is_lowest) memory_.values[count++] = static_cast<double>(region.distance);
      is_lowest = false;
    }
    return initialMergingThreshold(memory_.values, count, kLeastGap * task_.max_gap, task_.max_gap);
  }

  /// From the base up: what the surface that was completed below says of each region, which then
  /// brings it up to date (2.6.1); where its points lie, and how far from those of the region
  /// below. The team's first member knows it at once.
  FIELD_PHENOTYPING_HD void survey() {
    growth::Shared& shared = *scratch_.shared;
    const bool is_first = team_.rank() == 0U;
    if (is_first) shared.surface = GrowingSurface(task_.surface_noise);
    float reached = 0.0F;
    int below = -1;  // the next region with points
    int count_below = 0;
    for (int r = 0; r < task_.region_count; ++r) {
      const GrowthRegionTask& task = task_.regions[r];
      growth::Region& region = memory_.regions[r];
      if (is_first) shared.surface.advance(task.middle - reached);
      reached = task.middle;
      const int begin = region.begin;
      const unsigned char* const marks = this->marksOf(r) + begin;
      const int count = teamPick(
          team_, region.end - begin, [&](int i) { return marks[i] != 0U; },
          [&](int i, int n) { memory_.list[n] = begin + i; }, scratch_.counts);
      if (count == 0) continue;
      float* const swapped = memory_.near[0];
      memory_.near[0] = memory_.near[1];
      memory_.near[1] = swapped;
      const bool has_common = sumUp(task, count, below);
      if (is_first) {
        region.count = count;
        region.evidence = static_cast<float>(shared.evidence.evidence());
        shared.surface.update(shared.evidence);
        setExtent(task, count, shared.extents, region);
      }
      if (below >= 0) {
        const float apart = has_common ? 0.0F : pointDistance(count_below, count);
        if (is_first) {
          region.distance = regionDistance(memory_.regions[below], region,
                                           task_.regions[below].start, task.end, apart);
        }
      }
      below = r;
      count_below = count;
    }
  }

  /// Sums over the points of a region, which are in the list: what they say of the surface, and
  /// where they lie; copies of them to near[1].
  /// @param below the region with points below, or -1
  /// @return whether they have some in common
  FIELD_PHENOTYPING_HD bool sumUp(const GrowthRegionTask& task, int count, int below) const {
    const int padded = growth::paddedOf(task_.count);
    growth::Shared& shared = *scratch_.shared;
    float* const x = memory_.near[1];
    float* const y = x + padded;
    float* const z = y + padded;
    const GrowingSurface surface = shared.surface;
    const unsigned char* const marks_below = below >= 0 ? this->marksOf(below) : nullptr;
    bool has_common = false;
    this->forOwn(0, count, [&](int i) {
      const int k = memory_.list[i];
      memory_.residuals[i] =
          surface.compare({memory_.cosine[k], memory_.sine[k], memory_.departure[k]});
      x[i] = memory_.x[k];
      y[i] = memory_.y[k];
      z[i] = memory_.z[k];
      has_common = has_common || (below >= 0 && marks_below[k] != 0U);
    });
    scratch_.counts[team_.rank()] = has_common ? 1 : 0;
    team_.sync();
    for (unsigned member = 0U; member < team_.size(); ++member) {
      has_common = has_common || scratch_.counts[member] != 0;
    }
    addUp(team_, memory_.residuals, count, shared.evidence);
    const Place along = unitOf(differenceOf(task.end, task.start));
    constexpr int kExtents = 5;
    this->forOwn(SurfaceEvidence::kSums, SurfaceEvidence::kSums + kExtents, [&](int e) {
      const int which = e - SurfaceEvidence::kSums;
      shared.extents[which] = which < 3 ? sumOf(which == 0   ? x
                                                : which == 1 ? y
                                                             : z,
                                                count)
                                        : endOf(along, x, y, z, count, which == 4);
    });
    team_.sync();
    return has_common;
  }

  FIELD_PHENOTYPING_HD static double sumOf(const float* values, int count) {
    double sum = 0.0;
    for (int i = 0; i < count; ++i) sum += static_cast<double>(values[i]);
    return sum;
  }

  /// Least or most that points lie along a line.
  FIELD_PHENOTYPING_HD static double endOf(const Place& along, const float* x, const float* y,
                                           const float* z, int count, bool most) {
    float end = dotOf(along, {x[0], y[0], z[0]});
    for (int i = 1; i < count; ++i) {
      const float at = dotOf(along, {x[i], y[i], z[i]});
      if (most ? at > end : at < end) end = at;
    }
    return static_cast<double>(end);
  }

  /// Smallest distance between the points of near[0] and those of near[1] [m].
  FIELD_PHENOTYPING_HD float pointDistance(int count_below, int count) const {
    const Lanes lanes = team_.lanes();
    const int padded = growth::paddedOf(task_.count);
    const float* const x = memory_.near[0];
    const float* const y = x + padded;
    const float* const z = y + padded;
    const float* const own = memory_.near[1];
    const auto of = static_cast<std::size_t>(count_below);
    const Float far = lanes.all(3.402823466e+38F);
    Float least = far;
    for (int i = static_cast<int>(team_.group()); i < count;
         i += static_cast<int>(team_.groups())) {
      for (std::size_t k = 0U; k < of; k += kLanes) {
        const Float off_x = lanes.load(x, k, of) - own[i];
        const Float off_y = lanes.load(y, k, of) - own[padded + i];
        const Float off_z = lanes.load(z, k, of) - own[2 * padded + i];
        const Float squared = off_x * off_x + (off_y * off_y + off_z * off_z);
        least = lanes.smaller(least, lanes.choose(lanes.before(k, of), squared, far));
      }
    }
    const float of_group = -lanes.greatest(-least);
    if (lanes.first()) scratch_.values[team_.group()] = of_group;
    team_.sync();
    float nearest = scratch_.values[0];
    for (unsigned group = 1U; group < team_.groups(); ++group) {
      if (scratch_.values[group] < nearest) nearest = scratch_.values[group];
    }
    return std::sqrt(nearest);
  }

  static constexpr unsigned kGrown = 1U;   // flags of points
  static constexpr unsigned kMerged = 2U;  // their region belongs to the stem
  static constexpr unsigned kKept = 4U;

  FIELD_PHENOTYPING_HD bool has(int k, unsigned flag) const {
    return (memory_.flags[k] & flag) != 0U;
  }

  /// Flags the points of all regions, and those of the merged ones.
  FIELD_PHENOTYPING_HD void gather() {
    this->forOwn(0, count_, [&](int k) { memory_.flags[k] = 0U; });
    for (int r = 0; r < task_.region_count; ++r) {
      const growth::Region& region = memory_.regions[r];
      const unsigned flags = region.merged ? kGrown | kMerged : kGrown;
      const unsigned char* const marks = this->marksOf(r);
      this->forOwn(region.begin, region.end, [&](int k) {
        if (marks[k] != 0U) {
          memory_.flags[k] = static_cast<unsigned char>(memory_.flags[k] | flags);
        }
      });
    }
    team_.sync();
  }

  /// Removes over-segmented points (2.4.2, Steps 2-4): those farther from the midline than
  /// prune_factor times the median distance of their band (Eq 16), and those above its end.
  FIELD_PHENOTYPING_HD void prune() {
    this->forOwn(0, task_.bands, [&](int band) {
      const int begin = firstOfBand(band);
      const int end = firstOfBand(band + 1);
      double* const distances = memory_.values + begin;
      int count = 0;
      for (int k = begin; k < end; ++k) {
        if (has(k, kMerged)) distances[count++] = static_cast<double>(memory_.distance[k]);
      }
      memory_.thresholds[band] =
          count == 0
              ? 0.0F
              : task_.prune_factor * static_cast<float>(selectAlone(distances, count, count / 2));
    });
    team_.sync();
    const float length = task_.axis.length();
    kept_ = teamPick(
        team_, count_,
        [&](int k) {
          return has(k, kMerged) && memory_.arc_length[k] <= length &&
                 memory_.distance[k] <= memory_.thresholds[bandOf(memory_.arc_length[k])];
        },
        [&](int k, int n) { memory_.kept[n] = k; }, scratch_.counts);
    this->forOwn(0, kept_, [&](int i) {
      unsigned char& flags = memory_.flags[memory_.kept[i]];
      flags = static_cast<unsigned char>(flags | kKept);
    });
    team_.sync();
    teamPick(
        team_, count_, [&](int i) { return has(memory_.by_index[i], kKept); },
        [&](int i, int n) { memory_.kept_by_index[n] = memory_.by_index[i]; }, scratch_.counts);
  }

  FIELD_PHENOTYPING_HD int bandOf(float arc_length) const {
    return static_cast<int>(growth::within(arc_length / task_.band_height, 0.0F,
                                           static_cast<float>(task_.bands) - 0.5F));
  }
  /// The first point that is of that band or of one after it.
  FIELD_PHENOTYPING_HD int firstOfBand(int band) const {
    int first = 0;
    for (int left = band < task_.bands ? count_ : 0; left > 0;) {
      const int half = left / 2;
      if (bandOf(memory_.arc_length[first + half]) < band) {
        first += half + 1;
        left -= half + 1;
      } else {
        left = half;
      }
    }
    return band < task_.bands ? first : count_;
  }

  /// Q of Eq 9 of what was kept.
  FIELD_PHENOTYPING_HD float evaluate() const {
    const int grown = teamPick(
        team_, count_, [&](int k) { return has(k, kGrown); }, [](int, int) {}, scratch_.counts);
    if (kept_ == 0 || grown == 0) return 0.0F;
    float* const sums = scratch_.shared->sums;
    const auto offOf = [&](int k) {
      return growth::absolute(memory_.distance[k] - memory_.radius[k]);
    };
    this->forOwn(0, 4, [&](int e) {
      const float* const values = e == 0 ? memory_.curvature : memory_.density;
      float sum = 0.0F;
      for (int i = 0; i < kept_; ++i) {
        const int k = memory_.kept_by_index[i];
        if (e < 2) sum += values[k];
        if (e == 2) sum += offOf(k);
        if (e == 3) sum = offOf(k) > sum ? offOf(k) : sum;
      }
      sums[e] = sum;
    });
    team_.sync();
    const auto count = static_cast<float>(kept_);
    const float curvature = sums[0] / count;
    const float density = sums[1] / count;
    const float distances = sums[2];
    const float farthest = sums[3];
    // The terms of Eq 7: the nearest of a point's region are those next to it along the axis.
    this->forOwn(0, kept_, [&](int i) {
      const int k = memory_.kept[i];
      memory_.of_curvature[k] = termOf(i, memory_.curvature, curvature);
      memory_.of_density[k] = termOf(i, memory_.density, density);
    });
    team_.sync();
    this->forOwn(0, 2, [&](int e) {
      const float* const terms = e == 0 ? memory_.of_curvature : memory_.of_density;
      float sum = 0.0F;
      for (int i = 0; i < kept_; ++i) sum += terms[memory_.kept_by_index[i]];
      sums[e] = sum;
    });
    team_.sync();
    return quality::qualityOf(quality::consistency(curvature, sums[0], kept_),
                              quality::consistency(density, sums[1], kept_), distances, farthest,
                              grown, kept_, task_.crowd)
        .overall;
  }

  FIELD_PHENOTYPING_HD float termOf(int i, const float* values, float mean) const {
    if (!(mean > 0.0F)) return 0.0F;
    const auto valueAt = [&](int j) { return values[memory_.kept[j]]; };
    return quality::consistencyTerm(valueAt(i), quality::neighborMean(i, kept_, valueAt), mean);
  }

  /// Remembers what has grown.
  FIELD_PHENOTYPING_HD void keepAsBest() const {
    this->forOwn(0, kept_, [&](int i) {
      memory_.best[i] = static_cast<std::uint32_t>(memory_.member[memory_.kept_by_index[i]]);
    });
    this->forOwn(0, task_.region_count, [&](int r) {
      const growth::Region& region = memory_.regions[r];
      memory_.results[r] = {static_cast<std::uint32_t>(region.count), region.merged};
    });
  }

  int kept_ = 0;  // points that pruning has left
};

}  // namespace field_phenotyping
