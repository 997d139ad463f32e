#include "field_phenotyping/segmentation/stem_growth.hpp"

#include <algorithm>
#include <utility>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/sorted_indices.hpp"
#include "field_phenotyping/segmentation/growing_surface.hpp"
#include "field_phenotyping/segmentation/growth_adaptation.hpp"
#include "field_phenotyping/segmentation/leaf_bases.hpp"
#include "field_phenotyping/segmentation/region_merging.hpp"
#include "field_phenotyping/segmentation/region_quality.hpp"
#include "field_phenotyping/segmentation/stem_segments.hpp"

namespace field_phenotyping {
namespace {

constexpr float kMostM = 0.95F;

/// M of a segment: a share of the stem's.
float segmentM(const StemSegment& segment, float M, const SegmentationParameters& parameters) {
  const double share = segment.branching ? parameters.M_branching : parameters.M_internode;
  return std::min(static_cast<float>(share) * M, kMostM);
}

/// Regions as they have grown, and whether each goes on from those below.
struct Regions {
  std::vector<GrowthRegion> grown;
  std::vector<float> evidence;  ///< that its points lie where the surface below leads
};

/// Step 2: a region from each start point to its end point, from the base up. The stem's surface is
/// completed as they grow (2.6.1): by what it expects each is judged, and each brings it up to
/// date.
Regions growRegions(const StemScene& scene, const std::vector<StemSegment>& segments,
                    const GrowthSettings& settings, const SegmentationParameters& parameters) {
  const StemAxis& axis = scene.midline().axis;
  GrowingSurface surface(scene.midline().spread / axis.radiusAt(0.5F * axis.length()));
  float reached = 0.0F;
  Regions regions;
  std::vector<SurfaceSighting> joined;
  for (const StemSegment& segment : segments) {
    GrowthSettings own = settings;
    own.M = segmentM(segment, settings.M, parameters);
    regions.grown.push_back(
        growRegion(scene, axis.pointAt(segment.begin), axis.pointAt(segment.end), own));
    joined.clear();
    for (const std::uint32_t i : regions.grown.back().points) joined.push_back(scene.sightingOf(i));
    const float middle = 0.5F * (segment.begin + segment.end);
    surface.advance(middle - reached);
    reached = middle;
    regions.evidence.push_back(surface.evidence(joined));
    surface.update(joined);
  }
  return regions;
}

/// Distances of every region with points from the next one above that has points [m]; none where
/// the surface that was completed below carries across the gap.
std::vector<float> distancesLeft(const StemScene& scene, const Regions& regions,
                                 std::vector<float> distances) {
  constexpr float kDoubt = -1.0F;  // points may speak against it by so much: the midline, which was
                                   // found from all of the stem, speaks for it
  std::size_t next = 0U;
  bool is_lowest = true;
  for (std::size_t r = 0; r < regions.grown.size(); ++r) {
    if (regions.grown[r].points.empty()) continue;
    if (!is_lowest) {
      float& distance = distances[next++];
      const float radius = scene.midline().axis.project(regions.grown[r].start).radius;
      if (distance <= GrowingSurface::longestCarried(radius) && regions.evidence[r] > kDoubt) {
        distance = 0.0F;
      }
    }
    is_lowest = false;
  }
  return distances;
}

/// All points of the regions for which `wanted` is not 0; all regions where it is empty.
std::vector<std::uint32_t> pointsOf(const std::vector<GrowthRegion>& regions,
                                    const std::vector<std::uint8_t>& wanted = {}) {
  std::vector<std::uint32_t> points;
  for (std::size_t r = 0; r < regions.size(); ++r) {
    if (!wanted.empty() && wanted[r] == 0U) continue;
    points.insert(points.end(), regions[r].points.begin(), regions[r].points.end());
  }
  sortUnique(points);
  return points;
}

/// One growth of a stem.
struct Growth {
  std::vector<GrowthRegion> regions;
  std::vector<std::uint8_t> merged;  ///< of each region
  std::vector<std::uint32_t> points;
  float quality = 0.0F;
};

/// Steps 2 and 3: growth, merging, and the removal of what was over-segmented.
/// @param threshold of merging [m]; chosen from the regions' distances where it is not positive
/// @param crowd     of countCrowd()
Growth growOnce(const StemScene& scene, std::size_t crowd, const std::vector<StemSegment>& segments,
                const GrowthSettings& settings, float max_gap, float& threshold,
                const SegmentationParameters& parameters) {
  Growth growth;
  Regions regions = growRegions(scene, segments, settings, parameters);
  const std::vector<Eigen::Vector3f>& points = scene.cloud().points;
  const std::vector<float> distances = neighborDistances(points, regions.grown);
  constexpr float kLeastGap = 0.5F;  // of max_gap: leaves hide as much of a sound stem
  if (!(threshold > 0.0F)) {
    threshold = initialMergingThreshold(distances, kLeastGap * max_gap, max_gap);
  }
  growth.merged = mergeRegions(regions.grown, distancesLeft(scene, regions, distances), threshold);
  growth.regions = std::move(regions.grown);
  growth.points = pruneByMidline(points, pointsOf(growth.regions, growth.merged),
                                 scene.midline().axis, static_cast<float>(parameters.prune_factor));
  growth.quality = evaluateRegion(scene.cloud(), pointsOf(growth.regions).size(), growth.points,
                                  scene.midline(), crowd)
                       .overall;
  return growth;
}

GrowthSummary summarise(const GrowthSettings& settings, float quality, std::uint32_t iterations) {
  GrowthSummary summary;
  summary.quality = quality;
  summary.iterations = iterations;
  summary.r1 = settings.r1;
  summary.M = settings.M;
  summary.alpha = settings.alpha;
  summary.beta = settings.beta;
  return summary;
}

}  // namespace

GrownStem growCandidate(const GrowthScene& scene, Midline midline,
                        const SegmentationParameters& parameters) {
  // Its leaf bases are not known yet, so less is believed of what lies off its surface.
  constexpr float kStricter = 1.2F;
  GrowthSettings settings(parameters);
  settings.M = std::min(kStricter * settings.M, kMostM);
  std::vector<GrowthRegion> regions;
  const StemScene stem_scene(scene, midline);
  const std::vector<StemAxis::Node>& nodes = midline.axis.nodes();
  for (std::size_t k = 0; k + 1U < nodes.size(); ++k) {
    regions.push_back(growRegion(stem_scene, nodes[k].position, nodes[k + 1U].position, settings));
  }
  GrownStem stem;
  stem.points = pruneByMidline(scene.points, pointsOf(regions), midline.axis,
                               static_cast<float>(parameters.prune_factor));
  stem.midline = std::move(midline);
  return stem;
}

namespace {

/// growStem() of a stem whose leaf bases are known.
GrownStem growAmongLeaves(const GrowthScene& scene, const Midline& midline, LeafBases leaf_bases,
                          float max_gap, const SegmentationParameters& parameters) {
  const GrowthSettings first(parameters);
  const auto target = static_cast<float>(parameters.quality_target);
  const std::vector<StemSegment> segments =
      splitStem(midline.axis.length(), leaf_bases.arcLengths());

  const StemScene stem_scene(scene, midline, std::move(leaf_bases));
  const std::size_t crowd = countCrowd(scene, midline);
  Growth best;
  GrowthSettings best_settings = first;
  GrowthSettings settings = first;
  float threshold = 0.0F;
  const auto most_cycles = static_cast<std::uint32_t>(parameters.max_growth_cycles);
  std::uint32_t cycles = 0U;
  while (cycles < most_cycles) {
    Growth growth = growOnce(stem_scene, crowd, segments, settings, max_gap, threshold, parameters);
    ++cycles;
    const float quality = growth.quality;
    if (cycles == 1U || quality > best.quality) {
      best = std::move(growth);
      best_settings = settings;
    }
    if (quality >= target || cycles == most_cycles) break;

    // Step 3d: adapt, and grow again (Step 4).
    constexpr float kDifference = 0.1F;
    const auto slope = [&](float GrowthSettings::*weight) {
      GrowthSettings changed = settings;
      changed.*weight += kDifference;
      return (growOnce(stem_scene, crowd, segments, changed, max_gap, threshold, parameters)
                  .quality -
              quality) /
             kDifference;
    };
    const QualityGradient gradient{slope(&GrowthSettings::alpha), slope(&GrowthSettings::beta)};
    settings = adaptSettings(settings, first, quality, target, gradient);
    threshold = adaptMergingThreshold(threshold, quality, target);
  }

  GrownStem stem;
  stem.midline = midline;
  stem.growth = summarise(best_settings, best.quality, cycles);
  for (std::size_t r = 0; r < segments.size(); ++r) {
    const GrowthRegion& region = best.regions[r];
    stem.growth.regions.push_back({region.start, region.end,
                                   segmentM(segments[r], best_settings.M, parameters),
                                   segments[r].branching, best.merged[r] != 0U,
                                   static_cast<std::uint32_t>(region.points.size())});
  }
  stem.points = std::move(best.points);
  return stem;
}

}  // namespace

std::vector<const Midline*> midlinesOf(const std::vector<GrownStem>& stems) {
  std::vector<const Midline*> midlines;
  for (const GrownStem& stem : stems) midlines.push_back(&stem.midline);
  return midlines;
}

std::vector<GrownStem> growStems(const GrowthScene& scene,
                                 const std::vector<const Midline*>& midlines, float max_gap,
                                 const SegmentationParameters& parameters,
                                 const ComputeDevice& device) {
  std::vector<std::vector<std::uint32_t>> members(midlines.size());
  parallelFor(midlines.size(), [&](std::size_t s) {
    members[s] = pointsAround(scene, midlines[s]->axis, LeafBases::reachOf(*midlines[s]));
  });
  std::vector<LeafBases> leaf_bases = findLeafBases(scene.points, members, midlines, device);
  std::vector<GrownStem> stems(midlines.size());
  parallelFor(midlines.size(), [&](std::size_t s) {
    stems[s] = growAmongLeaves(scene, *midlines[s], std::move(leaf_bases[s]), max_gap, parameters);
  });
  return stems;
}

GrownStem growStem(const GrowthScene& scene, const Midline& midline, float max_gap,
                   const SegmentationParameters& parameters) {
  return growStems(scene, {&midline}, max_gap, parameters).front();
}

}  // namespace field_phenotyping
