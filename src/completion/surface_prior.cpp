#include "field_phenotyping/completion/surface_prior.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <utility>

#include "common/gpu_streams.hpp"
#include "common/wide_vectors.hpp"
#include "completion/surface_prior_gpu.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/completion/surface_prior_task.hpp"

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

constexpr double kNodeSpacing = 0.01;  // [m] of the frame
constexpr double kMaxLength = 5.0;     // [m]
constexpr double kKnotSpacing = 0.06;  // [m] of the splines; doubled until they are few enough
constexpr std::size_t kMaxFitPoints = 1500;

// What still passes as a stem.
constexpr double kMaxNoiseRatio = 0.6;  // noise over radius: beyond it the fit drifts outwards
constexpr double kMinInlierShare = 0.4;

/// The middle value, the lower one of two.
double lowerMedian(std::vector<double> values) {
  const auto middle = static_cast<std::ptrdiff_t>((values.size() - 1U) / 2U);
  std::nth_element(values.begin(), values.begin() + middle, values.end());
  return values[static_cast<std::size_t>(middle)];
}

/// By sums over a grid of noise. @param noise over the radius
NoiseEffect noiseEffect(double noise) {
  constexpr int kHalf = 40;
  constexpr double kReach = 5.0;  // standard deviations
  struct Sample {
    double beyond, cosine, probability;
  };
  std::vector<Sample> samples;
  double total = 0.0;
  for (int i = -kHalf; i <= kHalf; ++i) {
    for (int j = 0; j <= kHalf; ++j) {
      const double x = kReach * i / kHalf;
      const double y = kReach * j / kHalf;
      const double along = 1.0 + noise * x;
      const double distance = std::hypot(along, noise * y);
      const double beyond = noise > 0.0 ? (distance - 1.0) / noise : x;
      const double probability = (j == 0 ? 0.5 : 1.0) * std::exp(-0.5 * (x * x + y * y));
      samples.push_back({beyond, along / std::max(distance, 1e-12), probability});
      total += probability;
    }
  }
  NoiseEffect effect;
  constexpr int kIterations = 20;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    std::array<double, 3> sums{};
    std::array<double, 3> weights{};
    for (const Sample& sample : samples) {
      const double weight = sample.probability * tukeyWeight(sample.beyond - effect.radius_bias);
      const std::array<double, 3> factor{1.0, sample.cosine,
                                         2.0 * sample.cosine * sample.cosine - 1.0};
      for (std::size_t k = 0; k < 3; ++k) {
        sums[k] += weight * factor[k] * sample.beyond;
        weights[k] += weight * factor[k];
      }
    }
    effect.radius_bias = sums[0] / weights[0];
    effect.shift_bias = sums[1] / weights[1];
    effect.ellipse_bias = sums[2] / weights[2];
  }
  for (Sample& sample : samples) sample.beyond = std::abs(sample.beyond - effect.radius_bias);
  std::sort(samples.begin(), samples.end(),
            [](const Sample& a, const Sample& b) { return a.beyond < b.beyond; });
  double below = 0.0;
  for (const Sample& sample : samples) {
    below += sample.probability;
    effect.median_residual = sample.beyond;
    if (below >= 0.5 * total) break;
  }
  return effect;
}

/// What a fit looks up, the same for all stems.
struct Tables {
  std::array<NoiseEffect, NoiseEffect::kSteps + 1> effects;
  std::array<std::uint32_t, coarse::kDraws> draws{};

  Tables() {
    for (std::size_t k = 0; k < effects.size(); ++k) {
      effects[k] =
          noiseEffect(static_cast<double>(k) / NoiseEffect::kSteps / NoiseEffect::kLeastRatio);
    }
    std::mt19937 random(1);  // NOLINT: the same hypotheses for every stem and every run
    for (std::uint32_t& draw : draws) draw = static_cast<std::uint32_t>(random());
  }
};

const Tables& tables() {
  static const Tables kTables;
  return kTables;
}

/// Evens out the corners of a polyline; the ends stay.
std::vector<Vector3d> smoothed(const std::vector<Vector3d>& curve) {
  constexpr std::size_t kHalfWindow = 4;
  std::vector<Vector3d> result(curve.size());
  for (std::size_t i = 0; i < curve.size(); ++i) {
    const std::size_t half = std::min({kHalfWindow, i, curve.size() - 1 - i});
    Vector3d sum = Vector3d::Zero();
    for (std::size_t k = i - half; k <= i + half; ++k) sum += curve[k];
    result[i] = sum / static_cast<double>(2 * half + 1);
  }
  return result;
}

/// Bits that scatter with a point's coordinates.
std::uint64_t hashOf(const Vector3d& point) {
  std::uint64_t hash = 0U;
  for (int axis = 0; axis < 3; ++axis) {
    std::uint64_t bits = 0U;
    std::memcpy(&bits, &point[axis], sizeof(bits));
    hash = (hash ^ bits) * 0x9E3779B97F4A7C15U;
    hash ^= hash >> 29U;
  }
  return hash >> 8U;
}

/// Of the stem as segmented, at an arc length of its axis; a stem tapers.
double givenRadius(const StemAxis& axis, double s, double otherwise) {
  const double r = static_cast<double>(axis.radiusAt(static_cast<float>(s)));
  return r > 0.0 ? r : otherwise;
}

/// Which points are left out depends on each alone, and how many on their number in steps: a few
/// more points leave the fit about as it was.
std::vector<Vector3d> thinned(const std::vector<Vector3d>& points) {
  std::uint64_t of_16 = 16U;
  std::uint64_t stride = 1U;
  while (of_16 > 1U && of_16 * points.size() > 16U * kMaxFitPoints) --of_16;
  while (of_16 == 1U && points.size() > 16U * stride * kMaxFitPoints) stride *= 2U;
  std::vector<Vector3d> some;
  for (const Vector3d& point : points) {
    const std::uint64_t hash = hashOf(point);
    if (hash % 16U < of_16 && hash / 16U % stride == 0U) some.push_back(point);
  }
  return some.size() < coarse::kFewestPoints ? points : some;
}

/// A fit with its arrays.
struct Fitted {
  SurfacePriorFit fit;
  std::vector<double> curve;         ///< x, y, z of each node
  std::vector<double> coefficients;  ///< and perhaps more behind them
  std::vector<double> covariance;    ///< likewise
};

Fitted fitAlone(const SurfacePriorTask& task) {
  constexpr std::size_t kMost = coarse::kMostCoefficients;
  Fitted fitted;
  fitted.curve.resize(3U * static_cast<std::size_t>(task.nodes));
  fitted.coefficients.resize(kMost);
  fitted.covariance.resize(kMost * kMost);
  std::vector<double> near(coarse::nearSize(1));
  std::vector<double> far(coarse::farSize(task.count, task.nodes, 1));
  SurfacePriorFitter<SerialTeam> fitter(SerialTeam(), task, fitted.curve.data(),
                                        fitted.coefficients.data(), fitted.covariance.data(),
                                        near.data(), far.data());
  fitted.fit = withWideVectors([&] { return fitter.run(); });
  return fitted;
}

/// Fits all of these on the GPU; none where they must be fitted on the CPU.
std::vector<Fitted> fitOnGpu(const std::vector<const StemToFit*>& stems,
                             const ComputeDevice& device) {
  std::vector<Fitted> fitted;
  if constexpr (kWithCuda) {
    device.attempt([&](GpuStream& stream) {
      std::vector<SurfacePriorPiece> pieces;
      std::vector<Vector3d> points;
      std::vector<Vector3d> curves;
      for (const StemToFit* stem : stems) {
        pieces.push_back({stem->task, static_cast<std::uint32_t>(points.size()),
                          static_cast<std::uint32_t>(curves.size())});
        points.insert(points.end(), stem->points.begin(), stem->points.end());
        curves.insert(curves.end(), stem->curve.begin(), stem->curve.end());
      }
      const GpuSurfacePriors found =
          surfacePriorsOnGpu(stream, {pieces.data(), pieces.size(), points.front().data(),
                                      points.size(), curves.front().data(), curves.size(),
                                      tables().effects.data(), tables().draws.data()});
      for (std::size_t i = 0; i < pieces.size(); ++i) {
        constexpr std::size_t kMost = coarse::kMostCoefficients;
        const auto size = static_cast<std::size_t>(found.fits[i].layout.size());
        const double* curve = found.curves + 3U * pieces[i].first_node;
        const double* coefficients = found.coefficients + kMost * i;
        const double* covariance = found.covariances + kMost * kMost * i;
        fitted.push_back({found.fits[i],
                          {curve, curve + 3 * pieces[i].task.nodes},
                          {coefficients, coefficients + size},
                          {covariance, covariance + size * size}});
      }
    });
  }
  return fitted;
}

}  // namespace

StemToFit layOut(const StemToModel& stem) {
  StemToFit given;
  if (stem.points.size() < coarse::kFewestPoints || stem.axis->empty()) return given;
  const StemAxis& axis = *stem.axis;
  given.points = thinned(stem.points);
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
  std::vector<double> radii;
  for (const Vector3d& point : given.points) {
    const StemAxis::Projection p = axis.project(point.cast<float>());
    low = std::min<double>(low, p.arc_length);
    high = std::max<double>(high, p.arc_length);
    radii.push_back(p.radius);
  }
  if (!(high - low < kMaxLength)) return given;
  // Knots lie at fixed places of the axis, so that points added at its end leave the others.
  double spacing = kKnotSpacing;
  while (high - low + stem.extend > (coarse::kMostIntervals - 2) * spacing) spacing *= 2.0;
  low = spacing * std::floor((low - std::max(stem.extend, kNodeSpacing)) / spacing);
  high = spacing * std::ceil((high + kNodeSpacing) / spacing);
  given.begin = low;
  const auto steps = static_cast<int>(std::ceil((high - low) / kNodeSpacing));
  for (int i = 0; i <= steps; ++i) {
    const double s = low + (high - low) * i / steps;
    given.curve.push_back(axis.pointAt(static_cast<float>(s)).cast<double>());
  }
  given.curve = smoothed(given.curve);
  double radius = lowerMedian(std::move(radii));
  double length = 0.0;
  for (std::size_t i = 1; i < given.curve.size(); ++i) {
    length = length + (given.curve[i] - given.curve[i - 1U]).norm();
  }
  if (!(radius > 0.0)) {
    const StemFrame frame(given.curve);
    std::vector<double> distances;
    for (const Vector3d& point : given.points) distances.push_back(frame.unroll(point).r);
    radius = lowerMedian(std::move(distances));
  }
  if (!(radius > 0.0)) return given;
  SurfacePriorTask& task = given.task;
  task.points = given.points.front().data();
  task.curve = given.curve.front().data();
  task.effects = tables().effects.data();
  task.draws = tables().draws.data();
  task.count = static_cast<int>(given.points.size());
  task.nodes = static_cast<int>(given.curve.size());
  task.spacing = spacing;
  task.radius = radius;
  task.first_radius = givenRadius(axis, low, radius);
  task.last_radius = givenRadius(axis, low + length, radius);
  return given;
}

class SurfacePriorMaker {
 public:
  static std::optional<SurfacePrior> make(const StemToFit& given, const StemAxis& axis,
                                          const Fitted& fitted) {
    const SurfacePriorFit& fit = fitted.fit;
    if (!fit.valid || fit.inliers < kMinInlierShare * given.task.count) return std::nullopt;
    std::vector<Vector3d> curve;
    for (std::size_t i = 0; i < fitted.curve.size(); i += 3U) {
      curve.emplace_back(fitted.curve[i], fitted.curve[i + 1U], fitted.curve[i + 2U]);
    }
    SurfacePrior prior(StemFrame(curve), fit.layout);
    const auto size = static_cast<std::ptrdiff_t>(fit.layout.size());
    prior.coefficients_.assign(fitted.coefficients.begin(), fitted.coefficients.begin() + size);
    prior.covariance_.assign(fitted.covariance.begin(), fitted.covariance.begin() + size * size);
    prior.clustering_ = fit.clustering;
    prior.noise_ = fit.noise;
    prior.begin_ = given.begin;
    double sum = 0.0;
    for (const StemFrame::Frame& node : prior.frame_.nodes()) {
      const double r = prior.meanRadiusAt(node.s);
      if (!coarse::isPossibleRadius(r,
                                    givenRadius(axis, given.begin + node.s, given.task.radius))) {
        return std::nullopt;
      }
      sum += r;
    }
    prior.mean_radius_ = sum / static_cast<double>(curve.size());
    if (prior.noise_ > kMaxNoiseRatio * prior.mean_radius_) return std::nullopt;
    return prior;
  }
};

SurfacePrior::SurfacePrior(StemFrame frame, const coarse::Layout& layout)
    : frame_(std::move(frame)), layout_(layout) {}

std::vector<std::optional<SurfacePrior>> fitSurfacePriors(const std::vector<StemToModel>& stems,
                                                          const ComputeDevice& device) {
  // What the GPU keeps of a stem is bounded, and so is what it works on at once.
  constexpr std::size_t kAtOnce = 128U;
  std::vector<std::optional<SurfacePrior>> priors(stems.size());
  if (device.hasGpu()) {
    std::vector<StemToFit> given(stems.size());
    parallelFor(stems.size(), [&](std::size_t i) { given[i] = layOut(stems[i]); });
    std::vector<std::size_t> numbers;
    for (std::size_t i = 0; i < stems.size(); ++i) {
      if (given[i].task.count > 0) numbers.push_back(i);
    }
    parallelChunks(numbers.size(), kAtOnce, [&](std::size_t begin, std::size_t end) {
      std::vector<const StemToFit*> some;
      for (std::size_t k = begin; k < end; ++k) some.push_back(&given[numbers[k]]);
      const std::vector<Fitted> fitted = fitOnGpu(some, device);
      parallelFor(some.size(), [&](std::size_t k) {
        const std::size_t i = numbers[begin + k];
        priors[i] = SurfacePriorMaker::make(given[i], *stems[i].axis,
                                            fitted.empty() ? fitAlone(given[i].task) : fitted[k]);
      });
    });
    return priors;
  }
  parallelFor(stems.size(), [&](std::size_t i) {
    const StemToFit given = layOut(stems[i]);
    if (given.task.count == 0) return;
    priors[i] = SurfacePriorMaker::make(given, *stems[i].axis, fitAlone(given.task));
  });
  return priors;
}

std::optional<SurfacePrior> SurfacePrior::fit(const std::vector<Vector3d>& points,
                                              const StemAxis& axis, double extend) {
  return fitSurfacePriors({{points, &axis, extend}}, {}).front();
}

double SurfacePrior::radius(double theta, double s) const {
  return coarse::surfaceRadius(layout_, coefficients_.data(), placeAt(theta, s));
}

double SurfacePrior::meanRadiusAt(double s) const {
  return coarse::meanRadius(coefficients_.data(), layout_.splines(s));
}

std::array<double, 2> SurfacePrior::ellipse() const {
  const auto first = static_cast<std::size_t>(layout_.ellipse(0));
  return {coefficients_[first], coefficients_[first + 1U]};
}

double SurfacePrior::biasAt(double radius) const {
  return noise_ * NoiseEffect::at(tables().effects.data(), radius / noise_).radius_bias;
}

double SurfacePrior::noiseBias(double s) const {
  return biasAt(meanRadiusAt(s));
}

SurfacePrior::Residual SurfacePrior::residual(const UnrolledPoint& point) const {
  const coarse::Place place = placeAt(point.theta, point.s);
  const double bias = biasAt(coarse::meanRadius(coefficients_.data(), place.along));
  return {point.r - coarse::surfaceRadius(layout_, coefficients_.data(), place) - bias, bias};
}

double SurfacePrior::variance(double theta, double s) const {
  return coarse::varianceAt(layout_, coefficients_.data(), placeAt(theta, s), covariance_.data());
}

double SurfacePrior::misfitVariance(double theta, double s) const {
  return clustering_ > 1.0 ? (clustering_ - 1.0) * variance(theta, s) : 0.0;
}

double SurfacePrior::robustWeight(double residual) const {
  return tukeyWeight(residual / noise_);
}

coarse::Place SurfacePrior::placeAt(double theta, double s) const {
  return {layout_.splines(s), {std::cos(theta), std::sin(theta)}};
}

}  // namespace field_phenotyping
