#include "field_phenotyping/segmentation/growing_surface.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr double kTwoPi = 6.28318530717958647692;

// How surfaces of stems depart from their midlines: standard deviations, shares of the radius.
constexpr double kMean = 0.05;
constexpr double kShift = 0.08;
constexpr double kEllipse = 0.05;  // as in the coarse model of the completion
constexpr double kAlike = 0.25;    // [m] along which a departure stays about the same

constexpr double kLeastNoise = 0.01;  // share of the radius: no surface is smoother
constexpr double kFarthest = 2.5;     // standard deviations off the surface that a point may lie

}  // namespace

GrowingSurface::GrowingSurface(float noise)
    : noise_(std::max(static_cast<double>(noise), kLeastNoise)), state_(Terms::Zero()) {
  Terms stddev;
  stddev << kMean, kShift, kShift, kEllipse, kEllipse;
  covariance_ = stddev.cwiseAbs2().asDiagonal();
}

void GrowingSurface::advance(float by) {
  const double kept = std::exp(-static_cast<double>(by) / kAlike);
  const GrowingSurface coarse(static_cast<float>(noise_));
  state_ *= kept;
  covariance_ = kept * kept * covariance_ + (1.0 - kept * kept) * coarse.covariance_;
}

GrowingSurface::Residual GrowingSurface::residualOf(const SurfaceSighting& point) const {
  const double c = std::cos(static_cast<double>(point.azimuth));
  const double s = std::sin(static_cast<double>(point.azimuth));
  Residual residual;
  residual.terms << 1.0, c, s, c * c - s * s, 2.0 * c * s;
  residual.off = static_cast<double>(point.departure) - residual.terms.dot(state_);
  residual.variance = noise_ * noise_ + residual.terms.dot(covariance_ * residual.terms);
  return residual;
}

void GrowingSurface::update(const std::vector<SurfaceSighting>& points) {
  Covariance information = Covariance::Zero();
  Terms right_side = Terms::Zero();
  for (const SurfaceSighting& point : points) {
    const Residual residual = residualOf(point);
    if (residual.off * residual.off > kFarthest * kFarthest * residual.variance) continue;
    information += residual.terms * residual.terms.transpose();
    right_side += residual.off * residual.terms;
  }
  information /= noise_ * noise_;
  right_side /= noise_ * noise_;
  // (C^-1 + I)^-1 = (1 + C I)^-1 C.
  const Covariance gain = Covariance::Identity() + covariance_ * information;
  const Covariance solved = gain.partialPivLu().solve(covariance_);
  covariance_ = 0.5 * (solved + solved.transpose());
  state_ += covariance_ * right_side;
}

float GrowingSurface::evidence(const std::vector<SurfaceSighting>& points) const {
  const double coarse = kMean * kMean + kShift * kShift + kEllipse * kEllipse;
  const double reach = 1.0 + kFarthest * std::sqrt(noise_ * noise_ + coarse);  // radii
  double sum = 0.0;
  for (const SurfaceSighting& point : points) {
    const Residual residual = residualOf(point);
    const double on_surface = -0.5 * residual.off * residual.off / residual.variance -
                              0.5 * std::log(kTwoPi * residual.variance);
    constexpr double kLeast = 1e-3;  // radii: a point on the axis is no surface's
    const double distance = std::max(1.0 + static_cast<double>(point.departure), kLeast);
    sum += on_surface - std::log(2.0 * distance / (reach * reach));
  }
  return static_cast<float>(sum);
}

float GrowingSurface::longestCarried(float radius) {
  constexpr double kBending = 0.11;  // [1/sqrt(m)] of the slope, which walks at random: a lean that
                                     // wanders by 6 degrees over 1 m
  // Across, that is kBending sqrt(gap^3 / 3): one standard deviation may be a diameter.
  const double across = 2.0 * static_cast<double>(radius) / kBending;
  return static_cast<float>(std::cbrt(3.0 * across * across));
}

}  // namespace field_phenotyping
