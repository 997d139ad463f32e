#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/xyz.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/segmentation/growth_scene.hpp"
#include "field_phenotyping/segmentation/stem_growth_team.hpp"

namespace field_phenotyping::testing {

inline Place placeOf(const Eigen::Vector3f& point) {
  return {point.x(), point.y(), point.z()};
}

/// A region that no surface is carried to.
inline GrowthRegionTask regionTask(const Eigen::Vector3f& start, const Eigen::Vector3f& end,
                                   float share = 1.0F) {
  return {placeOf(start), placeOf(end), share, 0.5F * (start.z() + end.z()), -1.0F};
}

/// A stem that may take any point of the scene; the scene, the midline and the regions must outlive
/// it.
inline GrowthTask growthTask(const GrowthScene& scene, const Midline& midline,
                             const std::vector<GrowthRegionTask>& regions,
                             const GrowthSettings& settings) {
  GrowthTask task;
  task.points = reinterpret_cast<const Place*>(xyzOf(scene.points));
  task.shapes = reinterpret_cast<const LocalShapeNumbers*>(scene.shapes.data());
  task.count = static_cast<int>(scene.points.size());
  task.axis = midline.axis.view();
  task.spread = midline.spread;
  task.regions = regions.data();
  task.region_count = static_cast<int>(regions.size());
  task.farthest = 1e6F;
  task.least = 0.0F;
  task.first = settings;
  task.bands = 1;
  task.band_height = midline.axis.length();
  task.prune_factor = 2.2F;
  task.surface_noise = midline.spread / midline.axis.nodes().front().radius;
  task.max_gap = 0.4F;
  task.target = 0.7F;
  return task;
}

/// Memory that a team grows a stem in.
struct GrowthRoom {
  explicit GrowthRoom(const GrowthTask& task, std::size_t members = 1U)
      : counts(members), values(members) {
    room.resize(growth::cut(task, nullptr, memory) / sizeof(double));
    growth::cut(task, reinterpret_cast<char*>(room.data()), memory);
  }
  growth::Scratch scratch() { return {&shared, counts.data(), values.data()}; }

  growth::Memory memory{};
  growth::Shared shared{};
  std::vector<double> room;
  std::vector<int> counts;
  std::vector<float> values;
};

/// What the growth of one region gave.
struct GrownRegion {
  std::vector<std::uint32_t> points;  // that joined, ascending
  int steps = 0;
};

/// A region by one thread.
inline GrownRegion growRegion(const GrowthScene& scene, const Midline& midline,
                              const Eigen::Vector3f& start, const Eigen::Vector3f& end,
                              const GrowthSettings& settings) {
  const std::vector<GrowthRegionTask> regions{regionTask(start, end)};
  const GrowthTask task = growthTask(scene, midline, regions, settings);
  GrowthRoom room(task);
  RegionGrowth<SerialTeam> growing(SerialTeam(), task, room.memory, room.scratch());
  growing.placePoints();
  growing.growRegions(settings);
  GrownRegion grown;
  grown.steps = room.memory.regions[0].steps;
  for (int i = 0; i < task.count; ++i) {
    const int k = room.memory.slots[i];
    if (k >= 0 && room.memory.marks[k] != 0U) grown.points.push_back(static_cast<std::uint32_t>(i));
  }
  return grown;
}

}  // namespace field_phenotyping::testing
