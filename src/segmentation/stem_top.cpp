#include "field_phenotyping/segmentation/stem_top.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr double kBandHeight = 0.05;    // [m] the top is found to this step
constexpr double kReach = 0.025;        // [m] points farther from the axis say nothing
constexpr double kSpikeRadius = 0.002;  // [m] of a tassel's axis
constexpr double kClutterShare =
    0.4;  // of the points within reach that are leaf anywhere on a stem

double normalDensity(double x, double mean, double stddev) {
  const double z = (x - mean) / stddev;
  return std::exp(-0.5 * z * z) / (stddev * std::sqrt(2.0 * M_PI));
}

/// Log likelihood of a spike over that of a stem, for a point at `distance` from the axis.
double spikeEvidence(double distance, double radius, double noise) {
  const double clutter = 2.0 * distance / (kReach * kReach);  // even over the disc
  const double variance = noise * noise + kSpikeRadius * kSpikeRadius;
  const double spike = distance / variance * std::exp(-0.5 * distance * distance / variance);
  // Out-of-roundness and bends widen a stem's shell beyond the noise.
  const double stem = normalDensity(distance, radius, std::hypot(noise, 0.15 * radius));
  return std::log(kClutterShare * clutter + (1.0 - kClutterShare) * spike) -
         std::log(kClutterShare * clutter + (1.0 - kClutterShare) * stem);
}

}  // namespace

float findStemTop(const std::vector<Eigen::Vector3f>& points,
                  const std::vector<std::uint32_t>& members, const Midline& midline) {
  const float length = midline.axis.length();
  const auto bands = static_cast<std::size_t>(std::ceil(length / kBandHeight)) + 1U;
  std::vector<double> evidence(bands, 0.0);
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = midline.axis.project(points[i]);
    if (at.distance >= kReach || at.arc_length < 0.0F || at.arc_length > length) continue;
    const auto band = static_cast<std::size_t>(at.arc_length / kBandHeight);
    evidence[band] +=
        spikeEvidence(static_cast<double>(at.distance) + 1e-6, static_cast<double>(at.radius),
                      static_cast<double>(midline.spread));
  }
  // A cut must explain everything above it, so sum from the top down.
  constexpr double kLeastEvidence = 3.0;
  double sum = 0.0;
  double best = kLeastEvidence;
  auto top = static_cast<double>(length);
  for (std::size_t band = bands; band-- > 0U;) {
    sum += evidence[band];
    if (sum <= best) continue;
    best = sum;
    top = static_cast<double>(band) * kBandHeight;
  }
  return static_cast<float>(std::min(top, static_cast<double>(length)));
}

}  // namespace field_phenotyping
