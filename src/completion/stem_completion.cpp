#include "field_phenotyping/completion/stem_completion.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"

namespace field_phenotyping {
namespace {

constexpr double kMinRobustWeight = 0.1;
constexpr double kMaxPoints = 20000.0;  // made up per stem, whatever density is asked for
constexpr double kMaxDensity = 1e6;     // [1/m^2] finer than any sensor
constexpr std::size_t kColorNeighbors = 4;
constexpr double kSoilStep = 0.005;  // [m]

/// The stem points that lie on the stem's surface, on the unrolled stem.
struct MeasuredSurface {
  std::vector<std::uint32_t> source;  ///< index in the cloud
  std::vector<SurfacePosition> positions;
  std::vector<SurfaceSample> deviations;  ///< from the prior, after the constraint of Eq 20
  SurfaceIndex index;
};

std::vector<Eigen::Vector3d> extractPoints(const PointCloud& cloud, IndexSpan stem) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(stem.size());
  for (std::uint32_t i = stem.begin; i < stem.end; ++i) {
    points.push_back(cloud.points[i].cast<double>());
  }
  return points;
}

/// Eq 20: z' = alpha z + (1 - alpha) f. Relative to f that is alpha (z - f), so that the surface
/// goes back to the prior where nothing was measured.
MeasuredSurface unrollPoints(const std::vector<Eigen::Vector3d>& points, std::uint32_t first,
                             const SurfacePrior& prior, double prior_weight) {
  MeasuredSurface surface;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const UnrolledPoint p = prior.frame().unroll(points[i]);
    const double deviation = p.r - prior.radius(p.theta, p.s) - prior.noiseBias(p.s);
    const double weight = prior.robustWeight(deviation);
    if (weight < kMinRobustWeight) continue;
    surface.source.push_back(first + static_cast<std::uint32_t>(i));
    surface.positions.push_back({p.theta, p.s});
    surface.deviations.push_back({{p.theta, p.s}, prior_weight * deviation, weight});
  }
  surface.index = SurfaceIndex(surface.positions, prior.meanRadius());
  return surface;
}

/// How far the stem may be carried on below its lowest measured point: a measured end bears half of
/// a gap, and the stem is known to reach the soil.
double lowerEnd(const SurfacePrior& prior, const GroundModel& ground, double lowest,
                double max_gap) {
  if (ground.empty()) return lowest;
  for (double s = lowest; s >= lowest - 0.5 * max_gap; s -= kSoilStep) {
    if (ground.heightAbove(prior.frame().at(s).position.cast<float>()) <= 0.0F) return s;
  }
  return lowest;
}

/// Eq 22, within the limits on where a stem may be filled.
std::vector<SurfacePosition> samplePositions(const MeasuredSurface& measured,
                                             const SurfacePrior& prior, const GroundModel& ground,
                                             const CompletionParameters& parameters,
                                             double& density) {
  std::vector<double> arc_lengths;
  for (const SurfacePosition& position : measured.positions) arc_lengths.push_back(position.s);
  FillRange range = findFillRange(std::move(arc_lengths), parameters.max_gap);
  range.begin = lowerEnd(prior, ground, range.begin, parameters.max_gap);

  constexpr double kTwoPi = 6.28318530717958647692;
  const double area = kTwoPi * prior.meanRadius() * (range.end - range.begin);
  if (!(area > 0.0)) return {};
  density = parameters.density > 0.0 ? parameters.density
                                     : medianDensity(measured.index, measured.positions);
  density = std::min({density, kMaxDensity, kMaxPoints / area});

  const RadiusFunction radius = [&](const SurfacePosition& p) {
    return prior.radius(p.theta, p.s);
  };
  std::vector<SurfacePosition> samples;
  for (const GapRegion& region : findGaps(measured.index, range, density, radius)) {
    sampleRegion(region, expectedPoints(region, density, prior.meanRadius()), samples);
  }
  return samples;
}

/// Eq 23: mean of the nearest measured colours, weighted by inverse distance.
std::uint32_t blendColors(const PointCloud& cloud, const MeasuredSurface& measured,
                          const SurfaceIndex::Nearest<kColorNeighbors>& nearest) {
  constexpr double kTouching = 1e-6;  // [m^2]
  double total = 0.0;
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  for (std::size_t k = 0; k < nearest.count; ++k) {
    const std::uint32_t color = cloud.colors[measured.source[nearest.index[k]]];
    const double weight = 1.0 / std::sqrt(nearest.squared_distance[k] + kTouching);
    sum += weight * Eigen::Array3d((color >> 16U) & 0xFFU, (color >> 8U) & 0xFFU, color & 0xFFU);
    total += weight;
  }
  const Eigen::Array<std::uint32_t, 3, 1> rgb = (sum / total).round().cast<std::uint32_t>();
  return rgb[0] << 16U | rgb[1] << 8U | rgb[2];
}

/// Uncertainty of the prior there, and of the deviation from it, of which less is known the farther
/// the nearest measured point is.
double surfaceStddev(const SurfacePrior& prior, const RbfSurface& deviation,
                     const SurfacePosition& position, double squared_distance) {
  const double width = deviation.kernelWidth();
  const double known = std::exp(-2.0 * squared_distance / (width * width));
  const double unexplained = deviation.amplitude() * deviation.amplitude() * (1.0 - known);
  const double bias = prior.noiseBias(position.s);
  return std::sqrt(prior.variance(position.theta, position.s) + unexplained + 0.25 * bias * bias);
}

}  // namespace

SyntheticPoints completeStem(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                             const GroundModel& ground, const CompletionParameters& parameters) {
  const auto min_points = static_cast<std::size_t>(parameters.min_points);
  if (stem.size() < min_points || axis.empty()) return {};

  // Step 1: the measured points (Eq 17).
  const std::vector<Eigen::Vector3d> points = extractPoints(cloud, stem);

  // Step 2: cylinder prior (Eq 18), constrained deviations (Eq 20), interpolation (Eq 19, 21).
  const std::optional<SurfacePrior> prior =
      SurfacePrior::fit(points, axis, 0.5 * parameters.max_gap);
  if (!prior) return {};
  const MeasuredSurface measured =
      unrollPoints(points, stem.begin, *prior, parameters.prior_weight);
  if (measured.positions.size() < min_points) return {};
  const RbfSurface deviation(
      thinSamples(measured.deviations, prior->meanRadius(),
                  static_cast<std::size_t>(parameters.max_centers)),
      prior->meanRadius(),
      {parameters.kernel_scale, parameters.ridge, parameters.prior_weight * prior->noise()});

  SyntheticPoints synthetic;
  // Step 3: where points are missing, and how many (Eq 22).
  const std::vector<SurfacePosition> samples =
      samplePositions(measured, *prior, ground, parameters, synthetic.density);

  for (const SurfacePosition& sample : samples) {
    const double radius = prior->radius(sample.theta, sample.s) + deviation.valueAt(sample);
    const Eigen::Vector3f point =
        prior->frame().roll({sample.theta, sample.s, std::max(radius, 0.0)}).cast<float>();
    if (!ground.empty() && ground.heightAbove(point) < 0.0F) continue;
    const auto nearest = measured.index.nearest<kColorNeighbors>(sample);
    synthetic.points.push_back(point);
    synthetic.stddev.push_back(
        static_cast<float>(surfaceStddev(*prior, deviation, sample, nearest.squared_distance[0])));
    // Step 4: colour (Eq 23).
    if (cloud.hasColors()) synthetic.colors.push_back(blendColors(cloud, measured, nearest));
  }
  return synthetic;
}

}  // namespace field_phenotyping
