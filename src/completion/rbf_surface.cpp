#include "field_phenotyping/completion/rbf_surface.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/wide_vectors.hpp"
#include "completion/rbf_surface_gpu.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kMinSpacing = 1e-3;    // [m]
constexpr double kMinAmplitude = 1e-4;  // [m] finer structure than any sensor here resolves

/// What falls into one cell; the place relative to the cell's first.
struct Cell {
  double turn_sum = 0.0, s_sum = 0.0, value_sum = 0.0, weight = 0.0;
};

/// As many surfaces from `first` on as the GPU works on at once, at least one: what it keeps of
/// each is bounded, and so is what it keeps of them.
std::vector<RbfReading> nextBatch(const std::vector<const RbfToRead*>& surfaces,
                                  std::size_t first) {
  constexpr std::size_t kAtOnce = 512U;
  constexpr std::size_t kMostValues = std::size_t{8} << 20U;  // of their matrices
  std::vector<RbfReading> batch;
  std::size_t values = 0U;
  for (std::size_t i = first; i < surfaces.size() && batch.size() < kAtOnce; ++i) {
    const RbfSystem& system = surfaces[i]->system;
    const std::size_t matrix = system.index().size() * (system.mostBand() + 1U);
    values += matrix;
    if (!batch.empty() && values > kMostValues) break;
    const std::vector<Vector3>& places = surfaces[i]->places;
    batch.push_back({system.task(), places.data(), places.size(), matrix});
  }
  return batch;
}

/// False where they are to be read on the CPU.
bool readOnGpu(const std::vector<RbfReading>& batch, const ComputeDevice& device,
               std::vector<double>* values) {
  if constexpr (kWithCuda) {
    return device.attempt([&](GpuStream& stream) {
      const double* next = readSurfacesOnGpu(stream, batch);
      for (std::size_t i = 0; i < batch.size(); ++i) {
        values[i].assign(next, next + batch[i].place_count);
        next += batch[i].place_count;
      }
    });
  }
  return false;
}

}  // namespace

std::vector<SurfaceSample> thinSamples(const std::vector<SurfaceSample>& samples,
                                       const CenterLattice& lattice) {
  if (samples.empty()) return {};
  const auto rowOf = [&](const SurfaceSample& sample) {
    return std::lround(std::floor(sample.position.s / lattice.row_height));
  };
  long first = rowOf(samples.front());
  long last = first;
  for (const SurfaceSample& sample : samples) {
    first = std::min(first, rowOf(sample));
    last = std::max(last, rowOf(sample));
  }
  const auto columns = static_cast<std::size_t>(lattice.columns);
  std::vector<Cell> cells(static_cast<std::size_t>(last - first + 1) * columns);
  for (const SurfaceSample& sample : samples) {
    const double turn = (sample.position.theta + kPi) / (2.0 * kPi);
    const double place = (turn - std::floor(turn)) * lattice.columns;
    const std::size_t column = std::min(static_cast<std::size_t>(place), columns - 1U);
    Cell& c = cells[static_cast<std::size_t>(rowOf(sample) - first) * columns + column];
    c.turn_sum += sample.weight * (place - static_cast<double>(column));
    c.s_sum += sample.weight * sample.position.s;
    c.value_sum += sample.weight * sample.value;
    c.weight += sample.weight;
  }
  std::vector<SurfaceSample> thinned;
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const Cell& c = cells[i];
    if (!(c.weight > 0.0)) continue;
    const double place = static_cast<double>(i % columns) + c.turn_sum / c.weight;
    thinned.push_back({{2.0 * kPi * place / lattice.columns - kPi, c.s_sum / c.weight},
                       c.value_sum / c.weight,
                       c.weight});
  }
  return thinned;
}

double amplitudeOf(const std::vector<SurfaceSample>& centers, double noise) {
  double signal = 0.0;
  for (const SurfaceSample& center : centers) {
    signal += center.value * center.value - noise * noise / center.weight;
  }
  const double mean = centers.empty() ? 0.0 : signal / static_cast<double>(centers.size());
  return std::sqrt(std::max(mean, kMinAmplitude * kMinAmplitude));
}

RbfSystem::RbfSystem(const std::vector<SurfaceSample>& centers, double radius,
                     const RbfOptions& options)
    : ridge_(options.ridge) {
  std::vector<SurfacePosition> positions;
  positions.reserve(centers.size());
  for (const SurfaceSample& center : centers) positions.push_back(center.position);
  index_ = SurfaceIndex(positions, radius);
  if (centers.empty()) return;

  mean_area_ = options.center_area;
  if (!(mean_area_ > 0.0)) {
    const SurfaceIndexView view = index_.view();
    std::vector<double> areas;
    for (std::size_t i = 0; i < view.count; ++i) {
      areas.push_back(rbf::areaPerCenter(view, view.points[i]));
    }
    mean_area_ = std::max(medianOf(areas), kMinSpacing * kMinSpacing);
  }
  kernel_width_ = options.kernel_scale * std::sqrt(mean_area_);
  const double amplitude =
      options.amplitude > 0.0 ? options.amplitude : amplitudeOf(centers, options.noise);
  values_.reserve(centers.size());
  noise_.reserve(centers.size());
  for (const std::uint32_t i : index_.order()) {
    values_.push_back(centers[i].value);
    noise_.push_back(options.noise * options.noise / (centers[i].weight * amplitude * amplitude));
  }
}

RbfTask RbfSystem::task() const {
  return {index_.view(), values_.data(), noise_.data(), kernel_width_, mean_area_, ridge_};
}

std::size_t RbfSystem::mostBand() const {
  const SurfaceIndexView view = index_.view();
  const double reach = rbf::reachOf(kernel_width_, rbf::kMaxWeight, rbf::kNegligible);
  std::size_t band = 0U;
  std::size_t first = 0U;
  for (std::size_t i = 0; i < view.count; ++i) {
    while (view.points[first].z() < view.points[i].z() - reach) ++first;
    band = std::max(band, i - first);
  }
  return band;
}

RbfSurface::RbfSurface(RbfSystem system)
    : system_(std::move(system)),
      weights_(system_.index().size()),
      coefficients_(system_.index().size()) {
  const RbfTask task = system_.task();
  const SerialTeam team;
  RbfSolver<SerialTeam> solver(team, task, weights_.data(), coefficients_.data());
  int band = 0;
  solver.prepare(&band);
  std::vector<double> matrix(
      static_cast<std::size_t>(Envelope::valuesOf(static_cast<int>(task.centers.count), band, 0)));
  solver.solve(matrix.data(), band);
}

double RbfSurface::valueAt(const Vector3& place) const {
  return rbf::valueAt(system_.task(), weights_.data(), coefficients_.data(), place);
}

std::vector<double> readSurface(const RbfToRead& given) {
  return withWideVectors([&] {
    const RbfSurface surface(given.system);
    std::vector<double> values;
    values.reserve(given.places.size());
    for (const Vector3& place : given.places) values.push_back(surface.valueAt(place));
    return values;
  });
}

std::vector<std::vector<double>> readSurfaces(const std::vector<const RbfToRead*>& surfaces,
                                              const ComputeDevice& device) {
  std::vector<std::vector<double>> values(surfaces.size());
  for (std::size_t first = 0; first < surfaces.size();) {
    std::vector<RbfReading> batch = nextBatch(surfaces, first);
    if (!readOnGpu(batch, device, &values[first])) {
      parallelFor(batch.size(),
                  [&](std::size_t i) { values[first + i] = readSurface(*surfaces[first + i]); });
    }
    first += batch.size();
  }
  return values;
}

}  // namespace field_phenotyping
