#include "field_phenotyping/segmentation/stem_growth.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/xyz.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/segmentation/leaf_bases.hpp"
#include "field_phenotyping/segmentation/stem_growth_team.hpp"
#include "field_phenotyping/segmentation/stem_segments.hpp"
#include "segmentation/stem_growth_gpu.hpp"

namespace field_phenotyping {
namespace {

/// One stem that is to grow, with the memory that its task points into: move only. The scene and
/// the midline must outlive it.
struct StemToGrow {
  StemToGrow() = default;
  StemToGrow(StemToGrow&&) = default;
  StemToGrow& operator=(StemToGrow&&) = default;

  const Midline* midline = nullptr;
  LeafBases leaf_bases;
  std::vector<StemSegment> segments;
  std::vector<std::uint32_t> members;
  std::vector<GrowthRegionTask> regions;
  GrowthTask task;
};

Place placeOf(const Eigen::Vector3f& point) {
  return {point.x(), point.y(), point.z()};
}

/// What a growth needs of the parameters beyond those of its task.
struct GrowthLimits {
  float least_M;  ///< that a region may have
  float most_r1;  ///< [m]
};

/// Fills the task in once its regions are known: which points it can reach, and where they are.
void setPoints(const GrowthScene& scene, const GrowthLimits& limits,
               const SegmentationParameters& parameters, StemToGrow& stem) {
  const StemAxis& axis = stem.midline->axis;
  GrowthTask& task = stem.task;
  static_assert(sizeof(LocalShape) == sizeof(LocalShapeNumbers), "one layout");
  task.points = reinterpret_cast<const Place*>(xyzOf(scene.points));
  task.shapes = reinterpret_cast<const LocalShapeNumbers*>(scene.shapes.data());
  task.axis = axis.view();
  task.spread = stem.midline->spread;
  // What lies farther off than that is too unlike for any region.
  constexpr float kRounding = 1.001F;
  task.least = limits.least_M / kRounding;
  task.farthest = std::sqrt(std::max(-std::log(task.least), 0.0F) / growth::kSoftness) * kRounding;
  constexpr float kLeastReach = 1e-3F;  // [m]
  float reach = kLeastReach;
  for (const StemAxis::Node& node : axis.nodes()) {
    reach =
        std::max(reach, node.radius + task.farthest * growth::scaleOf(task.spread, node.radius));
  }
  constexpr float kAside = 1.5F;  // spheres leave the axis, and the ends are straight
  stem.members = pointsAlong(scene, axis, reach, kAside * limits.most_r1);
  task.members = stem.members.data();
  task.count = static_cast<int>(stem.members.size());
  task.regions = stem.regions.data();
  task.region_count = static_cast<int>(stem.regions.size());

  constexpr float kBandHeight = 0.10F;  // [m] along the axis, for pruning
  task.bands = std::max(1, static_cast<int>(std::lround(axis.length() / kBandHeight)));
  task.band_height = axis.length() / static_cast<float>(task.bands);
  task.prune_factor = static_cast<float>(parameters.prune_factor);
}

/// Grows the stem by `grow` on the CPU. @param visit visit(outcome, memory) is told what came of it
template <class Grow, class Visit>
void growAlone(const GrowthTask& task, const Grow& grow, const Visit& visit) {
  growth::Memory memory{};
  std::vector<double> room(growth::cut(task, nullptr, memory) / sizeof(double) + 1U);
  growth::cut(task, reinterpret_cast<char*>(room.data()), memory);
  growth::Shared shared;
  int count = 0;
  float value = 0.0F;
  StemGrowth<SerialTeam> stem(SerialTeam(), task, memory, {&shared, &count, &value});
  grow(stem);
  visit(shared.outcome, memory);
}

}  // namespace

GrownStem growCandidate(const GrowthScene& scene, Midline midline,
                        const SegmentationParameters& parameters) {
  // Its leaf bases are not known yet, so less is believed of what lies off its surface.
  constexpr float kStricter = 1.2F;
  StemToGrow stem;
  stem.midline = &midline;
  const std::vector<StemAxis::Node>& nodes = midline.axis.nodes();
  for (std::size_t k = 0; k + 1U < nodes.size(); ++k) {
    stem.regions.push_back(
        {placeOf(nodes[k].position), placeOf(nodes[k + 1U].position), 1.0F, 0.0F, 0.0F});
  }
  GrowthSettings& settings = stem.task.first;
  settings = GrowthSettings(parameters);
  settings.M = std::min(kStricter * settings.M, growth::kMostM);
  setPoints(scene, {settings.M, settings.r1}, parameters, stem);
  GrownStem grown;
  growAlone(
      stem.task, [](StemGrowth<SerialTeam>& work) { work.growCandidate(); },
      [&](const growth::Outcome& outcome, const growth::Memory& memory) {
        for (int i = 0; i < outcome.points; ++i) {
          grown.points.push_back(stem.members[memory.best[i]]);
        }
      });
  grown.midline = std::move(midline);
  return grown;
}

namespace {

/// The task of a stem whose leaf bases are known: it is split at its branchings.
void setTask(const GrowthScene& scene, float max_gap, const SegmentationParameters& parameters,
             StemToGrow& stem) {
  const StemAxis& axis = stem.midline->axis;
  GrowthTask& task = stem.task;
  task.first = GrowthSettings(parameters);
  stem.segments = splitStem(axis.length(), stem.leaf_bases.arcLengths());
  GrowthLimits limits{growth::kMostM, task.first.r1};
  for (const StemSegment& segment : stem.segments) {
    const auto share =
        static_cast<float>(segment.branching ? parameters.M_branching : parameters.M_internode);
    const Eigen::Vector3f start = axis.pointAt(segment.begin);
    stem.regions.push_back({placeOf(start), placeOf(axis.pointAt(segment.end)), share,
                            0.5F * (segment.begin + segment.end),
                            GrowingSurface::longestCarried(axis.project(start).radius)});
    limits.least_M = std::min(
        limits.least_M, growth::regionM(share, std::min(task.first.M, growth::kMostAdaptedM)));
  }
  if (parameters.max_growth_cycles > 1) limits.most_r1 *= growth::kMostWidened;
  setPoints(scene, limits, parameters, stem);
  task.leaf_bases = stem.leaf_bases.all().data();
  task.base_count = static_cast<int>(stem.leaf_bases.all().size());
  task.leaf_spread = stem.leaf_bases.spread();
  task.surface_noise = stem.midline->spread / axis.radiusAt(0.5F * axis.length());
  task.max_gap = max_gap;
  task.target = static_cast<float>(parameters.quality_target);
  task.crowd = static_cast<int>(countCrowd(scene, *stem.midline));
  task.most_cycles = parameters.max_growth_cycles;
}

/// @param kept members of the task
GrownStem grownStem(const StemToGrow& stem, const growth::Outcome& outcome,
                    const growth::RegionResult* regions, const std::uint32_t* kept) {
  GrownStem grown;
  grown.midline = *stem.midline;
  GrowthSummary& summary = grown.growth;
  summary.quality = outcome.quality;
  summary.iterations = static_cast<std::uint32_t>(outcome.cycles);
  summary.r1 = outcome.settings.r1;
  summary.M = outcome.settings.M;
  summary.alpha = outcome.settings.alpha;
  summary.beta = outcome.settings.beta;
  for (std::size_t r = 0; r < stem.regions.size(); ++r) {
    const GrowthRegionTask& task = stem.regions[r];
    summary.regions.push_back({{task.start.x, task.start.y, task.start.z},
                               {task.end.x, task.end.y, task.end.z},
                               growth::regionM(task.share, outcome.settings.M),
                               stem.segments[r].branching,
                               regions[r].merged,
                               regions[r].points});
  }
  for (int i = 0; i < outcome.points; ++i) grown.points.push_back(stem.members[kept[i]]);
  return grown;
}

GrownStem growAlone(const StemToGrow& stem) {
  GrownStem grown;
  growAlone(
      stem.task, [](StemGrowth<SerialTeam>& work) { work.growStem(); },
      [&](const growth::Outcome& outcome, const growth::Memory& memory) {
        grown = grownStem(stem, outcome, memory.results, memory.best);
      });
  return grown;
}

/// Of stems begin ... end - 1 on the GPU; false where they are to be grown on the CPU.
bool growOnGpu(const std::vector<StemToGrow>& stems, std::size_t begin, std::size_t end,
               const ComputeDevice& device, std::vector<GrownStem>& grown) {
  if constexpr (kWithCuda) {
    return device.attempt([&](GpuStream& stream) {
      std::vector<GrowthTask> tasks;
      for (std::size_t s = begin; s < end; ++s) tasks.push_back(stems[s].task);
      const GpuGrowth result = growStemsOnGpu(stream, tasks);
      const growth::RegionResult* regions = result.regions;
      const std::uint32_t* points = result.points;
      for (std::size_t s = begin; s < end; ++s) {
        grown[s] = grownStem(stems[s], result.outcomes[s - begin], regions, points);
        regions += stems[s].regions.size();
        points += stems[s].members.size();
      }
    });
  }
  return false;
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
  std::vector<GrownStem> grown(midlines.size());
  const auto stemToGrow = [&](std::size_t s) {
    StemToGrow stem;
    stem.midline = midlines[s];
    stem.leaf_bases = std::move(leaf_bases[s]);
    setTask(scene, max_gap, parameters, stem);
    return stem;
  };
  if (!device.hasGpu()) {
    parallelFor(midlines.size(), [&](std::size_t s) { grown[s] = growAlone(stemToGrow(s)); });
    return grown;
  }
  std::vector<StemToGrow> stems(midlines.size());
  parallelFor(midlines.size(), [&](std::size_t s) { stems[s] = stemToGrow(s); });
  // While some are on the GPU others are made ready for it, and read from it.
  constexpr std::size_t kAtOnce = 16U;
  parallelChunks(stems.size(), kAtOnce, [&](std::size_t begin, std::size_t end) {
    if (growOnGpu(stems, begin, end, device, grown)) return;
    for (std::size_t s = begin; s < end; ++s) grown[s] = growAlone(stems[s]);
  });
  return grown;
}

GrownStem growStem(const GrowthScene& scene, const Midline& midline, float max_gap,
                   const SegmentationParameters& parameters) {
  return growStems(scene, {&midline}, max_gap, parameters).front();
}

}  // namespace field_phenotyping
