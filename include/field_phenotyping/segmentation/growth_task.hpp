#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/segmentation/axis_view.hpp"
#include "field_phenotyping/segmentation/growing_surface.hpp"
#include "field_phenotyping/segmentation/leaf_search_team.hpp"
#include "field_phenotyping/segmentation/local_shape_team.hpp"

// What the growth of one stem begins with, works on and comes to, see StemGrowth: plain numbers and
// pointers, for the CPU and the GPU.

namespace field_phenotyping {

struct SegmentationParameters;

/// The parameters that the paper adapts while a stem grows (Eq 11-14).
struct GrowthSettings {
  float r1 = 0.0F;     ///< growth radius [m]
  float M = 0.0F;      ///< similarity threshold
  float alpha = 0.0F;  ///< weights of Eq 2
  float beta = 0.0F;
  int max_steps = 0;

  GrowthSettings() = default;
  explicit GrowthSettings(const SegmentationParameters& parameters);
};

/// A region that is to grow.
struct GrowthRegionTask {
  Place start;            ///< its start point s_0 [m]
  Place end;              ///< its end point s_n [m]
  float share;            ///< of the stem's M that is its own
  float middle;           ///< arc length [m]
  float longest_carried;  ///< gap that the stem's surface carries across there [m]
};

/// One stem, and the points round it.
struct GrowthTask {
  const Place* points = nullptr;              ///< of the cloud, local frame [m]
  const LocalShapeNumbers* shapes = nullptr;  ///< of each point
  const std::uint32_t* members = nullptr;     ///< those round the stem, ascending; null: all
  const LeafBase* leaf_bases = nullptr;       ///< by arc length
  const GrowthRegionTask* regions = nullptr;  ///< from the base up
  AxisView axis;
  int count = 0;  ///< of the members
  int base_count = 0;
  int region_count = 0;
  float spread = 0.0F;       ///< noise of the stem's surface [m]
  float leaf_spread = 0.0F;  ///< likewise, as the leaf bases were found with
  float farthest = 0.0F;     ///< off the surface that a point may join, see growth::awayOf()
  float least = 0.0F;        ///< similarity below which no region of any growth takes a point
  GrowthSettings first;      ///< settings of the first growth

  // Of the pruning (2.4.2).
  int bands = 1;
  float band_height = 0.0F;   ///< [m]
  float prune_factor = 0.0F;  ///< k of Eq 16

  // Of merging, quality and cycles.
  float surface_noise = 0.0F;  ///< share of the radius
  float max_gap = 0.0F;        ///< [m] longest gap that regions merge across for their distance
  float target = 0.0F;         ///< T of Eq 10-14
  int crowd = 0;               ///< points that crowd round the stem without being its own
  int most_cycles = 1;
};

namespace growth {

constexpr float kMostWidened = 2.0F;   // r1, of the first: see adaptSettings()
constexpr float kMostAdaptedM = 0.9F;  // likewise
constexpr float kMostM = 0.95F;        // of a region

FIELD_PHENOTYPING_HD inline float within(float value, float low, float high) {
  return value < low ? low : value > high ? high : value;
}

/// M of a region: a share of the stem's.
FIELD_PHENOTYPING_HD inline float regionM(float share, float M) {
  const float own = share * M;
  return own < kMostM ? own : kMostM;
}

/// A point round the stem, before it has its place in the order.
struct Placed {
  float arc_length;
  float distance;
  float radius;
  float similarity;  // negative: no region takes it
  float away_x;      // from the axis
  float away_y;
};

/// Arc length, by which points are sorted, and which member of the task it is.
struct Key {
  float arc_length;
  int member;
};

/// A region as it has grown.
struct Region {
  int begin;  // of the points that its spheres reached, in their order
  int end;
  int steps;
  int count;       // of the points that joined
  float evidence;  // that they lie where the surface below leads
  float distance;  // from the next one below that has points [m]
  Place centroid;
  Place lower_end;  // along its own line
  Place upper_end;
  bool merged;
};

/// What becomes known of a region.
struct RegionResult {
  std::uint32_t points;
  bool merged;
};

/// What becomes known of the stem.
struct Outcome {
  GrowthSettings settings;  // of the best growth
  float quality;
  int cycles;
  int points;  // that were kept
};

/// Memory that all members of a team see. Of the points that may join, in their order along the
/// axis; coordinates, similarities and weights have kLanes numbers more at their ends.
struct Memory {
  GrowingSurface::Residual* residuals;
  double* values;
  float *x, *y, *z;
  float *similarity, *weight;
  float *lowest, *highest;  // z of all from here on, and of all up to here
  float *arc_length, *distance, *radius, *azimuth;
  float *curvature, *density;
  float *cosine, *sine, *departure;  // see SurfaceSighting
  float *of_curvature, *of_density;  // their terms of Eq 7
  float* near[2];                    // points of two regions: x, y, z
  Placed* placed;                    // of each member
  Key *keys, *other_keys;
  Region* regions;
  RegionResult* results;  // of the best growth
  int* member;            // which one it is
  int* slots;             // of each member: its place in the order, or -1
  int* by_index;          // places, by the index of the point
  int *list, *kept, *kept_by_index;
  std::uint32_t* best;   // members that the best growth kept, ascending
  float* thresholds;     // of bands
  unsigned char* flags;  // of each point
  unsigned char* marks;  // of each region, of each point: whether it joined
};

/// Numbers of one row of a region's points.
FIELD_PHENOTYPING_HD inline int paddedOf(int count) {
  return count + static_cast<int>(kLanes);
}

/// Cuts memory for one stem into pieces. @return how many bytes that takes
/// @param bytes null: only count
FIELD_PHENOTYPING_HD inline std::size_t cut(const GrowthTask& task, char* bytes, Memory& memory) {
  std::size_t at = 0U;
  const auto take = [&](auto*& piece, int count) {
    using Value = std::remove_reference_t<decltype(*piece)>;
    constexpr std::size_t kWhole = alignof(double);
    if (bytes != nullptr) piece = reinterpret_cast<Value*>(bytes + at);
    at += (static_cast<std::size_t>(count) * sizeof(Value) + kWhole - 1U) / kWhole * kWhole;
  };
  const int count = task.count;
  const int padded = paddedOf(count);
  take(memory.residuals, count);
  take(memory.values, count + task.region_count);
  for (float** values :
       {&memory.x, &memory.y, &memory.z, &memory.similarity, &memory.weight, &memory.lowest,
        &memory.highest, &memory.arc_length, &memory.distance, &memory.radius, &memory.azimuth,
        &memory.curvature, &memory.density, &memory.cosine, &memory.sine, &memory.departure,
        &memory.of_curvature, &memory.of_density}) {
    take(*values, padded);
  }
  take(memory.near[0], 3 * padded);
  take(memory.near[1], 3 * padded);
  take(memory.placed, count);
  take(memory.keys, count);
  take(memory.other_keys, count);
  take(memory.regions, task.region_count);
  take(memory.results, task.region_count);
  for (int** values : {&memory.member, &memory.slots, &memory.by_index, &memory.list, &memory.kept,
                       &memory.kept_by_index}) {
    take(*values, count);
  }
  take(memory.best, count);
  take(memory.thresholds, task.bands);
  take(memory.flags, count);
  take(memory.marks, task.region_count * count);
  return at;
}

/// What a team has beside it, small enough for shared memory.
struct Shared {
  GrowingSurface surface{0.0F};
  SurfaceEvidence evidence;
  double extents[5];  // of a region: sums of x, y, z; least and most along its line
  float sums[4];
  Outcome outcome;
};
struct Scratch {
  Shared* shared;
  int* counts;    // one for each member
  float* values;  // likewise
};

}  // namespace growth
}  // namespace field_phenotyping
