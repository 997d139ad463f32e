#include "field_phenotyping/completion/bilateral_filter.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>

#include "common/gpu_streams.hpp"
#include "common/wide_vectors.hpp"
#include "completion/bilateral_filter_gpu.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kReach = 2.0;  // standard deviations

/// Weights of the nodes 0, 1, ... to one side.
struct Kernel {
  std::vector<double> along;   // the stem
  std::vector<double> around;  // it
};

/// @param per_attribute of squared differences of normals; 0: they do not count
Kernel kernelOf(const FilterGrid& grid, double radius, double sigma, double per_attribute) {
  // Points are shared out to the nodes and read off between them linearly: each widens the filter
  // by a triangle, whose variance is a sixth of the squared step.
  constexpr double kTriangles = 2.0 / 6.0;
  constexpr double kLeastVariance = 1e-3;  // of the squared step
  const auto variance = [&](double step) {
    return std::max(sigma * sigma - kTriangles * step * step, kLeastVariance * step * step);
  };
  Kernel kernel;
  const double up = grid.row_height;
  const auto rows = static_cast<int>(std::ceil(kReach * sigma / up));
  for (int k = 0; k <= rows; ++k) {
    kernel.along.push_back(std::exp(-0.5 * k * k * up * up / variance(up)));
  }
  const double turn_a_column = 2.0 * kPi / grid.columns;
  const double side = radius * turn_a_column;
  const int columns =
      std::min(static_cast<int>(std::ceil(kReach * sigma / side)), (grid.columns - 1) / 2);
  for (int k = 0; k <= columns; ++k) {
    // Normals that differ by an angle are a chord of the unit circle apart.
    const double chord = 2.0 * std::sin(0.5 * k * turn_a_column);
    kernel.around.push_back(
        std::exp(-0.5 * k * k * side * side / variance(side) - per_attribute * chord * chord));
  }
  return kernel;
}

/// A filter before it is solved.
struct Prepared {
  Kernel kernel;
  FilterTask task;  ///< points into it and what was given

  explicit Prepared(const FilterToSolve& given) {
    const FilterOptions& options = given.options;
    const bool by_color = options.attribute == FilterAttribute::kColor;
    const double per_attribute = 0.5 / (options.sigma_attribute * options.sigma_attribute);
    kernel =
        kernelOf(given.grid, given.radius, options.sigma_space, by_color ? 0.0 : per_attribute);
    task = {given.points.data(),
            static_cast<int>(given.points.size()),
            given.grid,
            kernel.along.data(),
            kernel.around.data(),
            static_cast<int>(kernel.along.size()) - 1,
            static_cast<int>(kernel.around.size()) - 1,
            by_color,
            by_color ? per_attribute : 0.0};
  }
};

/// Solves filters on the GPU; false where they are to be solved on the CPU.
bool solveOnGpu(const std::vector<FilterTask>& tasks, const ComputeDevice& device,
                const std::function<void(const GpuFilters&)>& take) {
  if constexpr (kWithCuda) {
    return device.attempt([&](GpuStream& stream) { take(filtersOnGpu(stream, tasks)); });
  }
  return false;
}

}  // namespace

BilateralFilter::BilateralFilter(const FilterToSolve& given) : grid_(given.grid) {
  const Prepared prepared(given);
  const FilterTask& task = prepared.task;
  const auto sums = static_cast<std::size_t>(task.sums());
  // Uninitialised, as the solver wants it.
  const std::unique_ptr<double[]> memory(
      new double[2U * sums + static_cast<std::size_t>(task.wideRow())]);
  const std::unique_ptr<unsigned char[]> is_read(new unsigned char[sums]);
  std::vector<FilterColor> color(task.by_color ? sums : 0U);
  per_attribute_ = task.per_attribute;
  nodes_.resize(static_cast<std::size_t>(grid_.nodes()));
  if (task.by_color) colors_.resize(nodes_.size());
  double* const weight = memory.get();
  const SerialTeam team;
  FilterSolver<SerialTeam> solver(
      team, task, {weight, weight + sums, color.data(), is_read.get(), weight + 2U * sums});
  withWideVectors([&] { solver.run(nodes_.data(), colors_.data()); });
}

std::vector<BilateralFilter> solveFilters(const std::vector<const FilterToSolve*>& given,
                                          const ComputeDevice& device) {
  // What the GPU keeps of a filter is bounded, and so is what it works on at once.
  constexpr std::size_t kAtOnce = 512U;
  std::vector<BilateralFilter> filters(given.size());
  for (std::size_t first = 0; first < given.size(); first += kAtOnce) {
    const std::size_t count = std::min(kAtOnce, given.size() - first);
    std::vector<Prepared> prepared;
    std::vector<FilterTask> tasks;
    for (std::size_t i = 0; device.hasGpu() && i < count; ++i) {
      prepared.emplace_back(*given[first + i]);
      tasks.push_back(prepared.back().task);
    }
    const auto take = [&](const GpuFilters& found) {
      for (std::size_t i = 0; i < count; ++i) {
        BilateralFilter& filter = filters[first + i];
        filter.grid_ = tasks[i].grid;
        filter.per_attribute_ = tasks[i].per_attribute;
        const std::ptrdiff_t size = filter.grid_.nodes();
        const FilterNode* nodes = found.nodes + found.begins[i];
        const FilterColor* colors = found.colors + found.begins[i];
        filter.nodes_.assign(nodes, nodes + size);
        if (tasks[i].by_color) filter.colors_.assign(colors, colors + size);
      }
    };
    if (solveOnGpu(tasks, device, take)) continue;
    parallelFor(count,
                [&](std::size_t i) { filters[first + i] = BilateralFilter(*given[first + i]); });
  }
  return filters;
}

double BilateralFilter::at(const SurfacePosition& place, const FilterColor& color) const {
  if (nodes_.empty()) return 0.0;
  const FilterCorners corners(grid_, place);
  if (corners.row < -1 || corners.row >= grid_.rows) return 0.0;
  const auto lower = static_cast<std::size_t>((corners.row + 1) * grid_.columns);
  const auto left = static_cast<std::size_t>(corners.column);
  const auto right = static_cast<std::size_t>(corners.next_column);
  const auto upper = lower + static_cast<std::size_t>(grid_.columns);
  const std::array<std::size_t, 4> nodes{lower + left, lower + right, upper + left, upper + right};
  double sum = 0.0;
  double total = 0.0;
  for (std::size_t k = 0; k < nodes.size(); ++k) {
    const FilterNode& node = nodes_[nodes[k]];
    constexpr double kLeast = 1e-12;  // so that one of another colour is better than none
    double w = corners.share[k] * static_cast<double>(node.weight);
    if (!colors_.empty()) {
      w *= kLeast + std::exp(-per_attribute_ * colors_[nodes[k]].squaredDistance(color));
    }
    sum += w * static_cast<double>(node.deviation);
    total += w;
  }
  return total > 0.0 ? sum / total : 0.0;
}

}  // namespace field_phenotyping
