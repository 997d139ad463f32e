#include "field_phenotyping/measurement/stem_cross_section.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>

#include "common/gpu_streams.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/measurement/cross_section_start.hpp"
#include "field_phenotyping/measurement/surface_mixture.hpp"
#include "measurement/cross_section_gpu.hpp"

namespace field_phenotyping {
namespace {

using Parameters = Eigen::Matrix<double, kCrossSectionSize, 1>;
using Information = Eigen::Matrix<double, kCrossSectionSize, kCrossSectionSize, Eigen::RowMajor>;

// Of less than so much of a stem the posterior is no normal distribution: it has several tops, and
// a long tail. By how much its standard deviation is then too small was found by simulation over
// noise 1-4 mm and arcs of 90-200 degrees.
constexpr double kFullArc = 0.72;
constexpr double kPartArc = 0.15;
constexpr double kPartArcExcess = 0.25;
// Of less than half of one it leans to small radii besides, and neither does the prior know better,
// that takes the size from the width of what is seen.
constexpr double kHalfArc = 0.45;
constexpr double kShortArc = 0.1;
constexpr double kShortArcExcess = 0.5;

/// Mean of |z| for z ~ N(mean, covariance) in the plane: |z| is a quarter of the integral of
/// |z . d| over all directions d, and the mean of each |z . d| is known in closed form.
double meanNorm(const Eigen::Vector2d& mean, const Eigen::Matrix2d& covariance) {
  constexpr int kDirections = 32;
  double sum = 0.0;
  for (int i = 0; i < kDirections; ++i) {
    const double angle = M_PI * (i + 0.5) / kDirections;
    const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    const double m = mean.dot(direction);
    const double s = std::sqrt(std::max(direction.dot(covariance * direction), 1e-300));
    sum += s * std::sqrt(2.0 / M_PI) * std::exp(-0.5 * (m / s) * (m / s)) +
           m * std::erf(m / (s * std::sqrt(2.0)));
  }
  return sum * 0.5 * M_PI / kDirections;
}

/// Diameters and their standard deviations from the posterior's normal approximation.
void setDiameters(const Parameters& p, const Information& covariance, StemCrossSection& result) {
  const double radius = p[kRadius];
  const double radius_variance = covariance(kRadius, kRadius);
  const Eigen::Vector2d ellipse = p.segment<2>(kEllipse);
  const Eigen::Matrix2d ellipse_covariance = covariance.block<2, 2>(kEllipse, kEllipse);
  const double half_difference = meanNorm(ellipse, ellipse_covariance);
  const double mean_square = ellipse.squaredNorm() + ellipse_covariance.trace();
  const double difference_variance = std::max(mean_square - half_difference * half_difference, 0.0);
  const double cross =
      covariance.block<1, 2>(kRadius, kEllipse).dot(ellipse.transpose()) / std::sqrt(mean_square);

  result.radius = {radius, std::sqrt(radius_variance)};
  result.major = {
      2.0 * (radius + half_difference),
      2.0 * std::sqrt(std::max(radius_variance + difference_variance + 2.0 * cross, 0.0))};
  result.minor = {
      2.0 * (radius - half_difference),
      2.0 * std::sqrt(std::max(radius_variance + difference_variance - 2.0 * cross, 0.0))};
  result.equivalent = {2.0 * std::sqrt(std::max(radius * radius - mean_square, 0.0)),
                       2.0 * std::sqrt(radius_variance)};
  result.major_angle = 0.5 * std::atan2(ellipse.y(), ellipse.x());
}

/// Share of the priors in what is known of 2a, and of its ellipticity: their precision over that of
/// the result.
void setPriorShares(double radius_variance, double ellipse_variance, const Information& covariance,
                    StemCrossSection& result) {
  const double ellipse_known = 0.5 * covariance.diagonal().segment<2>(kEllipse).sum();
  const double known = result.major.stddev * result.major.stddev;
  result.ellipticity_prior_share = std::clamp(ellipse_known / ellipse_variance, 0.0, 1.0);
  result.prior_share = std::clamp(0.25 * known / (radius_variance + ellipse_variance), 0.0, 1.0);
}

/// Widens the covariance of some parameters by a factor.
void scale(double factor, int first, int size, Information& covariance) {
  covariance.middleRows(first, size) *= std::sqrt(factor);
  covariance.middleCols(first, size) *= std::sqrt(factor);
}

/// Widens the covariance of some parameters to at least that of `other`.
void widen(const Information& other, int first, int size, Information& covariance) {
  const double ratio = other.diagonal().segment(first, size).sum() /
                       covariance.diagonal().segment(first, size).sum();
  if (ratio > 1.0) scale(ratio, first, size, covariance);
}

/// What not knowing the elongation of the noise better than so makes uncertain; it was fitted as
/// known.
void addElongation(double stddev, Information& covariance) {
  const Parameters slope = covariance.col(kElongation) / covariance(kElongation, kElongation);
  covariance += stddev * stddev * slope * slope.transpose();
}

/// Nothing is known worse of the radius than its prior says.
void limitRadius(double prior_variance, Information& covariance) {
  const double ratio = prior_variance / covariance(kRadius, kRadius);
  if (ratio < 1.0) scale(ratio, kRadius, 1, covariance);
}

/// Nor of the ellipticity; `only_prior`: nor better.
void limitEllipticity(bool only_prior, double prior_variance, Information& covariance) {
  const double variance = 0.5 * covariance.diagonal().segment<2>(kEllipse).sum();
  if (!only_prior && variance <= prior_variance) return;
  covariance.middleRows<2>(kEllipse).setZero();
  covariance.middleCols<2>(kEllipse).setZero();
  covariance.diagonal().segment<2>(kEllipse).setConstant(prior_variance);
}

/// The start that another fit is; it must be a sure one, for of half-seen stems, and where many
/// points are none of the stem's, the posterior has several tops.
bool startFrom(const StemCrossSection& near, const CrossSectionPrior& prior,
               CrossSectionStart& start) {
  constexpr double kMostOutliers = 0.3;  // share
  if (!near.valid || !near.converged || near.arc_coverage < kFullArc ||
      near.outlier_share > kMostOutliers) {
    return false;
  }
  const double radius = near.radius.value;
  start = CrossSectionStart();
  Eigen::Map<Parameters> p(start.parameters.values);
  p.segment<2>(kCenter) = near.center;
  p.segment<2>(kTilt) = near.tilt;
  p.segment<2>(kCurvature) = near.curvature;
  p.segment<2>(kTwist) = near.twist;
  p[kRadius] = radius;
  p[kTaper] = near.taper.value * radius;
  p[kTaperChange] = near.taper_change.value * radius;
  if (prior.ellipticity_stddev > 0.0) p.segment<2>(kEllipse) = near.ellipticity * radius;
  p[kNoise] = near.log_noise.value;
  if (prior.log_noise.stddev > 0.0) {
    const double near_weight = 1.0 / std::pow(near.log_noise.stddev, 2);
    const double prior_weight = 1.0 / std::pow(prior.log_noise.stddev, 2);
    p[kNoise] = (near_weight * near.log_noise.value + prior_weight * prior.log_noise.value) /
                (near_weight + prior_weight);
  }
  start.outlier_share = near.outlier_share;
  return true;
}

/// The cross-section that a fit comes to, with its covariance.
StemCrossSection crossSectionOf(const SurfaceMixtureFit& fit, const CrossSectionPrior& prior,
                                bool shapeless) {
  StemCrossSection result;
  result.converged = fit.converged;
  if (!fit.has_covariance) return result;
  const Eigen::Map<const Parameters> p(fit.parameters.values);
  Information covariance = Eigen::Map<const Information>(fit.posterior);
  // With the noise estimated from few points the errors follow Student's distribution.
  const double freedom = std::max(fit.freedom, 3.0);
  covariance *= freedom / (freedom - 2.0);
  for (const double* other : {fit.patches, fit.bound}) {
    widen(Eigen::Map<const Information>(other), kRadius, 1, covariance);
    widen(Eigen::Map<const Information>(other), kEllipse, 2, covariance);
  }
  const double ellipse_variance =
      std::pow(std::max(prior.ellipticity_stddev, 1e-4) * p[kRadius], 2);
  addElongation(prior.elongation.stddev, covariance);
  result.arc_coverage = fit.arc_coverage;
  const double unseen = std::clamp((kFullArc - result.arc_coverage) / kPartArc, 0.0, 1.0);
  const double thicker = 1.0 + std::sqrt(covariance(kRadius, kRadius)) / p[kRadius];
  const double less = std::clamp((kHalfArc - result.arc_coverage / thicker) / kShortArc, 0.0, 1.0);
  const double short_arc = std::pow(1.0 + kShortArcExcess * less, 2);
  scale(std::pow(1.0 + kPartArcExcess * unseen, 2) * short_arc, kRadius, 1, covariance);
  const bool size_by_width = !(prior.radius.stddev > 0.0);
  limitRadius(fit.radius_prior_variance * (size_by_width ? short_arc : 1.0), covariance);
  limitEllipticity(shapeless, ellipse_variance, covariance);

  result.valid = true;
  result.center = p.segment<2>(kCenter);
  result.tilt = p.segment<2>(kTilt);
  result.curvature = p.segment<2>(kCurvature);
  result.twist = p.segment<2>(kTwist);
  const auto relative = [&](int i) -> Trait {
    return {p[i] / p[kRadius], std::sqrt(covariance(i, i)) / p[kRadius]};
  };
  result.taper = relative(kTaper);
  result.taper_change = relative(kTaperChange);
  result.noise = std::exp(p[kNoise]);
  result.log_noise = {p[kNoise], std::sqrt(covariance(kNoise, kNoise))};
  result.ellipticity = p.segment<2>(kEllipse) / p[kRadius];
  result.ellipticity_stddev =
      std::sqrt(0.5 * covariance.diagonal().segment<2>(kEllipse).sum()) / p[kRadius];
  result.outlier_share = fit.outlier_share;
  result.points = fit.surface_points;
  setDiameters(p, covariance, result);
  setPriorShares(fit.radius_prior_variance, ellipse_variance, covariance, result);
  return result;
}

/// Where the fit of a piece begins; none where it has too few points.
std::optional<CrossSectionTask> taskOf(const std::vector<Eigen::Vector3d>& points,
                                       const CrossSectionPrior& prior,
                                       const StemCrossSection& near) {
  if (points.size() < 5U) return std::nullopt;
  CrossSectionStart start;
  const bool has_near = startFrom(near, prior, start);
  const CrossSectionTask task = crossSectionTask(points, prior, has_near ? &start : nullptr);
  if (!(task.extent.width_variance > 0.0)) return std::nullopt;
  return task;
}

StemCrossSection fitOne(const std::vector<Eigen::Vector3d>& points, const CrossSectionTask& task,
                        const CrossSectionPrior& prior) {
  const CrossSectionPoints places = placesOf(points);
  const CrossSectionStart start = startCrossSection(places, task);
  return crossSectionOf(fitSurfaceMixture(places, task, start), prior, start.shapeless);
}

}  // namespace

StemCrossSection fitStemCrossSection(const std::vector<Eigen::Vector3d>& points,
                                     const CrossSectionPrior& prior, const StemCrossSection& near) {
  const std::optional<CrossSectionTask> task = taskOf(points, prior, near);
  return task ? fitOne(points, *task, prior) : StemCrossSection();
}

std::vector<StemCrossSection> fitStemCrossSections(const std::vector<StemPiece>& pieces,
                                                   const ComputeDevice& device) {
  std::vector<std::optional<CrossSectionTask>> tasks(pieces.size());
  parallelFor(pieces.size(), [&](std::size_t i) {
    tasks[i] = taskOf(pieces[i].points, pieces[i].prior, pieces[i].near);
  });
  std::vector<StemCrossSection> sections(pieces.size());
  std::vector<std::size_t> to_fit;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    if (tasks[i]) to_fit.push_back(i);
  }
  if constexpr (kWithCuda) {
    const bool done = !to_fit.empty() && device.attempt([&](GpuStream& stream) {
      std::vector<CrossSectionPiece> on_gpu;
      std::vector<Eigen::Vector3d> points;
      for (const std::size_t i : to_fit) {
        on_gpu.push_back({*tasks[i], static_cast<std::uint32_t>(points.size()),
                          static_cast<int>(pieces[i].points.size())});
        points.insert(points.end(), pieces[i].points.begin(), pieces[i].points.end());
      }
      const GpuCrossSections found =
          crossSectionsOnGpu(stream, placesOf(points).places, points.size(), on_gpu.data(),
                             static_cast<std::uint32_t>(on_gpu.size()));
      for (std::size_t k = 0; k < to_fit.size(); ++k) {
        sections[to_fit[k]] =
            crossSectionOf(found.fits[k], pieces[to_fit[k]].prior, found.starts[k].shapeless);
      }
    });
    if (done) return sections;
  }
  parallelFor(to_fit.size(), [&](std::size_t k) {
    const std::size_t i = to_fit[k];
    sections[i] = fitOne(pieces[i].points, *tasks[i], pieces[i].prior);
  });
  return sections;
}

}  // namespace field_phenotyping
