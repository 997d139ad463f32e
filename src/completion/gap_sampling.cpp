#include "field_phenotyping/completion/gap_sampling.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/wide_vectors.hpp"
#include "completion/gap_sampling_gpu.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr std::size_t kDensityNeighbors = 8;
constexpr std::size_t kDensitySamples = 400;
// A cell is missing when no measured point is nearer to its centre than this share of the spacing:
// in a surface seen at the target density, 4 in 5 cells have one.
constexpr double kCoverage = 0.75;

GapOutline outlineAt(double theta, const std::array<double, 2>& ellipse) {
  const double cosine = std::cos(2.0 * theta);
  const double sine = std::sin(2.0 * theta);
  const double r = 1.0 + ellipse[0] * cosine + ellipse[1] * sine;
  const double first = 2.0 * (ellipse[1] * cosine - ellipse[0] * sine);
  const double second = 4.0 * (1.0 - r);
  return {r, (r * r + 2.0 * first * first - r * second) / std::pow(r * r + first * first, 1.5)};
}

/// A task with its arrays; none where nothing is to be filled.
struct Prepared {
  std::vector<double> radii;
  std::vector<unsigned char> fills;
  std::vector<GapOutline> outlines;
  GapTask task{};

  explicit Prepared(const GapsToFill& given) {
    const FillRange& range = given.range;
    if (!(given.density > 0.0) || !(range.end > range.begin)) return;
    const double spacing = 1.0 / std::sqrt(given.density);
    const double length = range.end - range.begin;
    GapGrid grid;
    grid.begin = range.begin;
    grid.columns =
        std::max(3, static_cast<int>(std::lround(2.0 * kPi * given.mean_radius / spacing)));
    grid.rows = std::max(1, static_cast<int>(std::lround(length / spacing)));
    grid.row_height = length / grid.rows;
    grid.column_angle = 2.0 * kPi / grid.columns;
    grid.is_odd = given.first_row % 2 != 0;
    for (int column = 0; column < grid.columns; ++column) {
      outlines.push_back(outlineAt(grid.center(0, column).theta, given.shape.ellipse));
    }
    for (int row = 0; row < grid.rows; ++row) {
      const double s = grid.center(row, 0).s;
      radii.push_back(given.shape.radius(s));
      fills.push_back(range.contains(s) ? 1U : 0U);
    }
    task = {given.measured.data(),
            static_cast<int>(given.measured.size()),
            grid,
            kCoverage * spacing,
            given.mean_radius,
            given.density,
            radii.data(),
            fills.data(),
            outlines.data()};
  }
};

/// The gaps of one task, found by one thread.
struct FoundGaps {
  std::unique_ptr<Gap[]> gaps;
  std::unique_ptr<int[]> cells;
  GapTotals totals;

  explicit FoundGaps(const GapTask& task) {
    if (task.grid.cells() == 0) return;
    const auto cell_count = static_cast<std::size_t>(task.grid.cells());
    const auto runs = static_cast<std::size_t>(task.mostRuns());
    // Uninitialised, as the finder wants it.
    cells.reset(new int[cell_count]);
    const std::unique_ptr<int[]> begins(new int[static_cast<std::size_t>(task.grid.rows) + 1U]);
    const std::unique_ptr<GapRun[]> run_memory(new GapRun[runs]);
    const std::unique_ptr<unsigned char[]> missing(new unsigned char[cell_count]);
    gaps.reset(new Gap[runs]);
    GapRows rows;
    GapFinder<SerialTeam>(SerialTeam(), task,
                          {begins.get(), run_memory.get(), &rows, missing.get()})
        .find(gaps.get(), cells.get(), &totals);
  }
};

/// Samples gaps on the GPU; false where that is to be done on the CPU.
bool sampleOnGpu(const std::vector<GapTask>& tasks, const ComputeDevice& device,
                 const std::function<void(const GpuGapSamples&)>& take) {
  if constexpr (kWithCuda) {
    return device.attempt([&](GpuStream& stream) { take(gapSamplesOnGpu(stream, tasks)); });
  }
  return false;
}

}  // namespace

bool FillRange::contains(double s) const {
  if (s < begin || s > end) return false;
  return std::none_of(open.begin(), open.end(), [&](const std::pair<double, double>& gap) {
    return s > gap.first && s < gap.second;
  });
}

FillRange findFillRange(std::vector<double> arc_lengths, double max_gap) {
  if (arc_lengths.empty()) return {};
  std::sort(arc_lengths.begin(), arc_lengths.end());
  FillRange range;
  range.begin = arc_lengths.front();
  range.end = arc_lengths.back();
  for (std::size_t i = 1; i < arc_lengths.size(); ++i) {
    if (arc_lengths[i] - arc_lengths[i - 1] > max_gap) {
      range.open.emplace_back(arc_lengths[i - 1], arc_lengths[i]);
    }
  }
  return range;
}

double medianDensity(const SurfaceIndex& measured, const std::vector<SurfacePosition>& positions) {
  if (positions.size() <= kDensityNeighbors) return 0.0;
  const std::size_t stride = 1 + positions.size() / kDensitySamples;
  std::vector<double> densities;
  for (std::size_t i = 0; i < positions.size(); i += stride) {
    const auto nearest = measured.nearest<kDensityNeighbors + 1>(positions[i]);  // and itself
    const double squared_reach = nearest.squared_distance[kDensityNeighbors];
    densities.push_back(static_cast<double>(kDensityNeighbors) /
                        (kPi * std::max(squared_reach, 1e-12)));
  }
  return medianOf(std::move(densities));
}

double rowHeight(double length, double density) {
  return length / std::max(1.0, std::round(length * std::sqrt(density)));
}

std::vector<GapRegion> findGaps(const GapsToFill& given) {
  const Prepared prepared(given);
  const GapGrid& grid = prepared.task.grid;
  const FoundGaps found(prepared.task);
  std::vector<GapRegion> regions;
  for (int k = 0; k < found.totals.gaps; ++k) {
    regions.push_back({found.gaps[static_cast<std::size_t>(k)], {}});
    const Gap& gap = regions.back().gap;
    for (int i = 0; i < gap.cells; ++i) {
      const int cell = found.cells[static_cast<std::size_t>(gap.first_cell + i)];
      regions.back().cells.push_back(grid.center(cell / grid.columns, cell % grid.columns));
    }
  }
  return regions;
}

GapSamples sampleGaps(const GapsToFill& given) {
  return withWideVectors([&] {
    const Prepared prepared(given);
    const FoundGaps found(prepared.task);
    GapSamples samples;
    samples.may_have_holes = found.totals.may_have_holes;
    samples.places.resize(static_cast<std::size_t>(found.totals.samples));
    spreadOverGaps(SerialTeam(), prepared.task.grid, found.gaps.get(), found.cells.get(),
                   found.totals.samples, samples.places.data());
    return samples;
  });
}

std::vector<GapSamples> sampleGaps(const std::vector<const GapsToFill*>& given,
                                   const ComputeDevice& device) {
  // What the GPU keeps of a stretch is bounded, and so is what it works on at once.
  constexpr std::size_t kAtOnce = 512U;
  std::vector<GapSamples> samples(given.size());
  for (std::size_t first = 0; first < given.size(); first += kAtOnce) {
    const std::size_t end = std::min(given.size(), first + kAtOnce);
    std::vector<Prepared> prepared;
    std::vector<GapTask> tasks;
    std::vector<std::size_t> of_tasks;
    for (std::size_t i = first; device.hasGpu() && i < end; ++i) {
      prepared.emplace_back(*given[i]);
      if (prepared.back().task.grid.cells() == 0) continue;
      tasks.push_back(prepared.back().task);
      of_tasks.push_back(i);
    }
    const auto take = [&](const GpuGapSamples& found) {
      const SurfacePosition* next = found.places;
      for (std::size_t k = 0; k < tasks.size(); ++k) {
        GapSamples& own = samples[of_tasks[k]];
        const GapTotals& totals = found.totals[k];
        own.may_have_holes = totals.may_have_holes;
        own.places.assign(next, next + totals.samples);
        next += totals.samples;
      }
    };
    if (device.hasGpu() && (tasks.empty() || sampleOnGpu(tasks, device, take))) continue;
    parallelFor(end - first,
                [&](std::size_t i) { samples[first + i] = sampleGaps(*given[first + i]); });
  }
  return samples;
}

}  // namespace field_phenotyping
