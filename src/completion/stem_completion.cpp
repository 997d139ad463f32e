#include "field_phenotyping/completion/stem_completion.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>
#include <utility>

#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/stem_region.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTwoPi = 6.28318530717958647692;
constexpr double kMinRobustWeight = 0.1;
constexpr double kMaxPoints = 40000.0;        // made up per stem, whatever density is asked for
constexpr double kMaxDensity = 1e6;           // [1/m^2] finer than any sensor
constexpr double kMinPointsPerMetre = 100.0;  // six for each knot of the coarse model: with fewer
                                              // it cannot tell noise from shape
constexpr double kSoilStep = 0.005;           // [m]
constexpr double kSameModel = 5e-5;           // [m] half of what a region taken over may be off
constexpr double kLevel = 0.15;  // of a settings' logarithm: what follows from all points of a
                                 // stem moves in such steps, so that a few more change nothing

/// The level next to a positive value.
double levelled(double value) {
  return std::exp(kLevel * std::round(std::log(value) / kLevel));
}

}  // namespace

/// What a region was solved from, and the result.
struct SolvedRegion {
  std::uint64_t points = 0U;            ///< hash of the measured points in and round it
  std::array<Eigen::Vector3d, 3> axis;  ///< of the coarse model, ends and middle [m]
  std::array<double, 3> radius{};       ///< [m]
  std::array<double, 3>
      soil{};  ///< height of the axis above it [m]; what is high above does not matter
  std::vector<double> range;  ///< what may be filled of it, from its begin [m]
  StemRegion region;
};

struct StemState {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::vector<double> settings;  ///< all that regions share
  std::array<double, 2> ellipse{};
  std::map<long, SolvedRegion> regions;
};

namespace {

std::vector<Eigen::Vector3d> extractPoints(const PointCloud& cloud, IndexSpan stem) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(stem.size());
  for (std::uint32_t i = stem.begin; i < stem.end; ++i) {
    points.push_back(cloud.points[i].cast<double>());
  }
  return points;
}

/// Step 1: the measured points (Eq 17) on the unrolled stem, in order of s.
std::vector<StemPoint> unrollPoints(const PointCloud& cloud, IndexSpan stem,
                                    const SurfacePrior& prior) {
  std::vector<StemPoint> points(stem.size());
  for (std::uint32_t i = stem.begin; i < stem.end; ++i) {
    StemPoint& p = points[i - stem.begin];
    p.point = cloud.points[i];
    if (cloud.hasColors()) p.color = cloud.colors[i];
    p.rank = i - stem.begin;
    p.unrolled = prior.frame().unroll(p.point.cast<double>());
    p.deviation =
        p.unrolled.r - prior.radius(p.unrolled.theta, p.unrolled.s) - prior.noiseBias(p.unrolled.s);
    p.weight = prior.robustWeight(p.deviation);
  }
  std::sort(points.begin(), points.end(), [](const StemPoint& a, const StemPoint& b) {
    return a.unrolled.s != b.unrolled.s ? a.unrolled.s < b.unrolled.s : a.rank < b.rank;
  });
  return points;
}

std::vector<SurfaceSample> surfaceSamples(const StemModel& model) {
  std::vector<SurfaceSample> samples;
  for (const StemPoint& p : model.points) {
    if (p.weight < kMinRobustWeight) continue;
    samples.push_back(
        {{p.unrolled.theta, p.unrolled.s}, model.prior_weight * p.deviation, p.weight});
  }
  return samples;
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

double densityOf(const std::vector<SurfaceSample>& samples, const SurfacePrior& prior,
                 double length, const CompletionParameters& parameters) {
  double density = parameters.density;
  if (!(density > 0.0)) {
    std::vector<SurfacePosition> positions;
    for (const SurfaceSample& sample : samples) positions.push_back(sample.position);
    const double around = parameters.points_around / (kTwoPi * prior.meanRadius());
    density = std::max(medianDensity(SurfaceIndex(positions, prior.meanRadius()), positions),
                       around * around);
    if (density > 0.0) density = levelled(density);
  }
  const double area = kTwoPi * prior.meanRadius() * length;
  return std::min({density, kMaxDensity, area > 0.0 ? kMaxPoints / area : kMaxDensity});
}

/// Centres at fixed places, about as many as wanted.
CenterLattice latticeOf(const SurfacePrior& prior, double max_centers) {
  constexpr double kLeastCell = 0.008;  // [m] finer structure than noise lets through
  const double around = kTwoPi * levelled(prior.meanRadius());
  const double cell =
      std::max(kLeastCell, std::sqrt(around * levelled(prior.frame().length()) / max_centers));
  return {kRegionLength / std::max(1.0, std::floor(kRegionLength / cell)),
          std::max(3, static_cast<int>(std::floor(around / cell)))};
}

std::uint64_t hashOf(const StemPoint& p) {
  std::uint64_t hash = p.color;
  for (int axis = 0; axis < 3; ++axis) {
    std::uint32_t bits = 0U;
    const float value = p.point[axis];
    std::memcpy(&bits, &value, sizeof(bits));
    hash = (hash ^ bits) * 0x9E3779B97F4A7C15U;
    hash ^= hash >> 29U;
  }
  return hash;
}

/// Of the measured points in and round a region, whatever their order.
std::uint64_t hashPoints(const StemModel& model, double begin, double end) {
  std::uint64_t hash = 0U;
  const auto [first, last] = pointsBetween(model, begin - kRegionMargin, end + kRegionMargin);
  for (auto p = first; p != last; ++p) hash += hashOf(*p);
  return hash;
}

SolvedRegion describeRegion(const StemModel& model, long index) {
  SolvedRegion solved;
  const double begin = regionBegin(model.prior, index);
  solved.points = hashPoints(model, begin, begin + kRegionLength);
  for (std::size_t k = 0; k < 3; ++k) {
    const double s = begin + 0.5 * kRegionLength * static_cast<double>(k);
    solved.axis[k] = model.prior.frame().at(s).position;
    solved.radius[k] = model.prior.meanRadiusAt(s);
    constexpr double kHigh = 0.2;  // [m] from there on no point can reach the soil
    solved.soil[k] =
        model.ground.empty()
            ? kHigh
            : std::min(kHigh,
                       static_cast<double>(model.ground.heightAbove(solved.axis[k].cast<float>())));
  }
  const auto within = [&](double s) { return std::clamp(s - begin, 0.0, kRegionLength); };
  solved.range = {within(model.range.begin), within(model.range.end)};
  for (const auto& [open_begin, open_end] : model.range.open) {
    if (open_end <= begin || open_begin >= begin + kRegionLength) continue;
    solved.range.push_back(within(open_begin));
    solved.range.push_back(within(open_end));
  }
  return solved;
}

bool isSame(const SolvedRegion& a, const SolvedRegion& b) {
  if (a.points != b.points || a.range.size() != b.range.size()) return false;
  for (std::size_t k = 0; k < a.range.size(); ++k) {
    if (std::abs(a.range[k] - b.range[k]) > kSameModel) return false;
  }
  for (std::size_t k = 0; k < a.axis.size(); ++k) {
    if (std::abs(a.soil[k] - b.soil[k]) > kSameModel) return false;
    if ((a.axis[k] - b.axis[k]).norm() + std::abs(a.radius[k] - b.radius[k]) > kSameModel) {
      return false;
    }
  }
  return true;
}

/// All that the regions share, beside the coarse model.
std::vector<double> settingsOf(const StemModel& model) {
  return {model.density,
          model.prior_weight,
          model.smoothing,
          model.max_stddev,
          model.lattice.row_height,
          static_cast<double>(model.lattice.columns),
          model.surface.kernel_scale,
          model.surface.ridge,
          model.surface.noise,
          model.surface.amplitude};
}

}  // namespace

CompletedStem completeStem(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                           const GroundModel& ground, const CompletionParameters& parameters,
                           const StemState* previous, const std::vector<SightLine>& sight) {
  CompletedStem completed;
  completed.solution.smoothed.assign(cloud.points.begin() + stem.begin,
                                     cloud.points.begin() + stem.end);
  const auto min_points = static_cast<std::size_t>(parameters.min_points);
  if (stem.size() < min_points) {
    completed.solution.flags = kCompletionTooFewPoints;
    return completed;
  }
  completed.solution.flags = kCompletionNoSurface;
  if (axis.empty()) return completed;

  // Step 2, coarse: cylinder prior (Eq 18).
  const std::optional<SurfacePrior> prior =
      SurfacePrior::fit(extractPoints(cloud, stem), axis, 0.5 * parameters.max_gap);
  if (!prior) return completed;
  StemModel model{*prior, ground};
  model.points = unrollPoints(cloud, stem, *prior);
  model.has_colors = cloud.hasColors();
  model.prior_weight = parameters.prior_weight;
  const std::vector<SurfaceSample> samples = surfaceSamples(model);
  if (samples.size() < min_points) return completed;
  completed.solution.flags = 0U;
  const double seen = model.points.back().unrolled.s - model.points.front().unrolled.s;
  if (static_cast<double>(samples.size()) < kMinPointsPerMetre * seen) {
    completed.solution.flags = kCompletionTooFewPoints;
    return completed;
  }

  std::vector<double> arc_lengths;
  for (const SurfaceSample& sample : samples) arc_lengths.push_back(sample.position.s);
  model.range = findFillRange(std::move(arc_lengths), parameters.max_gap);
  model.range.begin = lowerEnd(*prior, ground, model.range.begin, parameters.max_gap);
  if (!model.range.open.empty()) completed.solution.flags |= kCompletionOpenGap;
  for (const auto& stretch : emptyStretches(*prior, sight)) {
    model.range.open.push_back(stretch);
    completed.solution.flags |= kCompletionSeenEmpty;
  }
  model.density = densityOf(samples, *prior, model.range.end - model.range.begin, parameters);
  completed.density = model.density;
  model.smoothing = parameters.smoothing * levelled(prior->meanRadius());
  model.max_stddev = parameters.max_stddev;
  model.lattice = latticeOf(*prior, parameters.max_centers);
  model.surface.kernel_scale = parameters.kernel_scale;
  model.surface.ridge = parameters.ridge;
  model.surface.noise = parameters.prior_weight * levelled(prior->noise());
  model.surface.amplitude = levelled(
      amplitudeOf(thinSamples(samples, model.lattice), parameters.prior_weight * prior->noise()));
  model.surface.center_area =
      model.lattice.row_height * kTwoPi * levelled(prior->meanRadius()) / model.lattice.columns;

  // Steps 2 to 6, region by region.
  const auto state = std::make_shared<StemState>();
  state->origin = cloud.origin;
  state->settings = settingsOf(model);
  state->ellipse = prior->ellipse();
  const bool may_take_over = previous != nullptr && previous->origin == cloud.origin &&
                             previous->settings == state->settings &&
                             std::hypot(previous->ellipse[0] - state->ellipse[0],
                                        previous->ellipse[1] - state->ellipse[1]) *
                                     prior->meanRadius() <
                                 kSameModel;
  const double low = std::min(model.range.begin, model.points.front().unrolled.s);
  const double high = std::max(model.range.end, model.points.back().unrolled.s);
  for (long k = regionAt(*prior, low); k <= regionAt(*prior, high); ++k) {
    SolvedRegion solved = describeRegion(model, k);
    const std::vector<std::uint32_t> own = regionPoints(model, k);
    ++completed.solution.regions;
    const auto old =
        may_take_over ? previous->regions.find(k) : std::map<long, SolvedRegion>::const_iterator{};
    if (may_take_over && old != previous->regions.end() && isSame(old->second, solved)) {
      solved = old->second;
    } else {
      solved.region = solveRegion(model, k, own);
      ++completed.solution.regions_solved;
    }
    const StemRegion& region = solved.region;
    completed.points.insert(completed.points.end(), region.points.begin(), region.points.end());
    completed.colors.insert(completed.colors.end(), region.colors.begin(), region.colors.end());
    completed.stddev.insert(completed.stddev.end(), region.stddev.begin(), region.stddev.end());
    if (region.uncertain > 0U) completed.solution.flags |= kCompletionUncertain;
    if (region.no_surface) completed.solution.flags |= kCompletionNoSurface;
    for (std::size_t i = 0; i < own.size(); ++i) {
      completed.solution.smoothed[model.points[own[i]].rank] = region.smoothed[i];
    }
    state->regions.emplace(k, std::move(solved));
  }
  completed.solution.state = state;
  return completed;
}

}  // namespace field_phenotyping
