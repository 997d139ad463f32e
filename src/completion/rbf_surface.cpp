#include "field_phenotyping/completion/rbf_surface.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr std::size_t kDensityNeighbors = 6;
constexpr double kMinWeight = 0.25;
constexpr double kMaxWeight = 4.0;
constexpr double kMinSpacing = 1e-3;    // [m]
constexpr double kMinAmplitude = 1e-4;  // [m] finer structure than any sensor here resolves
constexpr double kCutoff = 14.0;        // exp(-14) is below one part in a million

/// The kernel phi of Eq 19 as read, in its positive definite form.
double kernel(double squared_distance, double kernel_width, double weight_a, double weight_b) {
  const double mean_weight = 0.5 * (weight_a + weight_b);
  const double overlap = std::sqrt(weight_a * weight_b) / mean_weight;
  return overlap * std::sqrt(overlap) *
         std::exp(-squared_distance / (kernel_width * kernel_width * mean_weight));
}

/// Area per centre, 1 / rho = pi r_k^2 / k [m^2].
double areaPerCenter(const SurfaceIndex& index, const SurfacePosition& position) {
  const auto nearest = index.nearest<kDensityNeighbors>(position);
  if (nearest.count == 0) return 0.0;
  return kPi * nearest.squared_distance[nearest.count - 1] / static_cast<double>(nearest.count);
}

/// What falls into one cell; the place relative to the cell's first.
struct Cell {
  double turn_sum = 0.0, s_sum = 0.0, value_sum = 0.0, weight = 0.0;
};

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

RbfSurface::RbfSurface(const std::vector<SurfaceSample>& centers, double radius,
                       const Options& options) {
  std::vector<SurfacePosition> positions;
  positions.reserve(centers.size());
  for (const SurfaceSample& center : centers) positions.push_back(center.position);
  index_ = SurfaceIndex(positions, radius);
  if (centers.empty()) return;

  mean_area_ = options.center_area;
  if (!(mean_area_ > 0.0)) {
    std::vector<double> areas;
    for (const SurfaceSample& center : centers) {
      areas.push_back(areaPerCenter(index_, center.position));
    }
    mean_area_ = std::max(medianOf(areas), kMinSpacing * kMinSpacing);
  }
  const auto count = static_cast<Eigen::Index>(centers.size());
  kernel_width_ = options.kernel_scale * std::sqrt(mean_area_);
  amplitude_ = options.amplitude > 0.0 ? options.amplitude : amplitudeOf(centers, options.noise);

  Eigen::VectorXd w(count), values(count), noise(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const SurfaceSample& center = centers[static_cast<std::size_t>(i)];
    w[i] = densityWeight(center.position);
    values[i] = center.value;
    noise[i] = options.noise * options.noise / (center.weight * amplitude_ * amplitude_);
  }
  weights_.assign(w.data(), w.data() + count);

  Eigen::MatrixXd system(count, count);
  for (Eigen::Index j = 0; j < count; ++j) {
    for (Eigen::Index i = j; i < count; ++i) {
      const double squared_distance = (index_.embed(positions[static_cast<std::size_t>(i)]) -
                                       index_.embed(positions[static_cast<std::size_t>(j)]))
                                          .squaredNorm();
      system(i, j) = w[i] * w[j] * kernel(squared_distance, kernel_width_, w[i], w[j]);
    }
    system(j, j) += w[j] * w[j] * noise[j];
  }
  // Positive definite but for rounding, when centres coincide and the ridge is tiny.
  constexpr double kRaise = 10.0;
  constexpr double kMaxRidge = 1e3;
  Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> solver;
  double ridge = 0.0;
  for (double next = options.ridge; next < kMaxRidge; next *= kRaise) {
    system.diagonal().array() += next - ridge;
    ridge = next;
    solver.compute(system);
    if (solver.info() == Eigen::Success) break;
  }
  coefficients_.assign(centers.size(), 0.0);
  if (solver.info() != Eigen::Success) return;
  const Eigen::VectorXd lambda = solver.solve(w.cwiseProduct(values));
  Eigen::Map<Eigen::VectorXd>(coefficients_.data(), count) = w.cwiseProduct(lambda);
}

double RbfSurface::densityWeight(const SurfacePosition& position) const {
  return std::clamp(areaPerCenter(index_, position) / mean_area_, kMinWeight, kMaxWeight);
}

double RbfSurface::valueAt(const SurfacePosition& position) const {
  if (index_.size() == 0) return 0.0;
  const double weight = densityWeight(position);
  const double reach = kernel_width_ * std::sqrt(kCutoff * 0.5 * (weight + kMaxWeight));
  double value = 0.0;
  index_.forEachWithin(position, reach, [&](std::uint32_t j, double squared_distance) {
    value += coefficients_[j] * kernel(squared_distance, kernel_width_, weight, weights_[j]);
  });
  return value;
}

}  // namespace field_phenotyping
