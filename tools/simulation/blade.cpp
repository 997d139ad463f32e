#include "simulation/blade.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

namespace field_phenotyping::simulation {
namespace {

constexpr double kRippleLength = 0.11;
constexpr double kSegmentLength = 0.02;
/// Across the blade, in half widths: margins, midrib and between.
constexpr std::array<double, 7> kAcross = {-1.0, -0.7, -0.35, 0.0, 0.35, 0.7, 1.0};

/// Width at share `t` of the length, relative to the widest: narrow foot, long taper to a tip.
double widthProfile(double t) {
  constexpr double kWidest = 0.3;
  const double rise = std::min(t / kWidest, 1.0);
  const double fall = std::max((t - kWidest) / (1.0 - kWidest), 0.0);
  return (0.5 + 0.5 * rise * (2.0 - rise)) * (1.0 - std::pow(fall, 2.2));
}

}  // namespace

void addBladeMesh(const Blade& blade, TriangleMesh& mesh) {
  const int segments = std::max(8, static_cast<int>(std::lround(blade.length / kSegmentLength)));
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  Eigen::Vector3d midrib = blade.start;
  for (int i = 0; i <= segments; ++i) {
    const double t = static_cast<double>(i) / segments;
    const double azimuth = blade.azimuth + blade.azimuth_drift * t * t;
    const double angle = blade.insertion_angle + (blade.tip_angle - blade.insertion_angle) *
                                                     std::pow(t, blade.droop_exponent);
    const Eigen::Vector3d along(std::sin(angle) * std::cos(azimuth),
                                std::sin(angle) * std::sin(azimuth), std::cos(angle));
    const Eigen::Vector3d flat(-std::sin(azimuth), std::cos(azimuth), 0.0);
    const double roll = blade.roll * t;
    const Eigen::Vector3d across = std::cos(roll) * flat + std::sin(roll) * along.cross(flat);
    const Eigen::Vector3d upper_side = along.cross(across);

    const double half_width = 0.5 * std::max(blade.width * widthProfile(t), 1e-4);
    // The foot clasps less than half the stem, or its margins would cut through it.
    constexpr double kLargestClasp = 1.45;
    const double foot_share = std::exp(-t * blade.length / 0.04);
    const double curvature =
        std::max(foot_share * std::min(1.0 / blade.clasp_radius, kLargestClasp / half_width), 1e-3);
    const double trough = std::tan(blade.trough_angle) * (1.0 - foot_share) * (1.0 - 0.6 * t);
    const double ripple = blade.ripple * (1.0 - foot_share) * std::min(1.0, 4.0 * (1.0 - t));
    for (const double q : kAcross) {
      const double arc = q * half_width;
      const double wave =
          ripple * q * q *
          std::sin(2.0 * M_PI * t * blade.length / kRippleLength + blade.ripple_phase + 1.3 * q);
      const double lift =
          (1.0 - std::cos(curvature * arc)) / curvature + trough * std::abs(arc) + wave;
      mesh.addVertex(midrib + std::sin(curvature * arc) / curvature * across + lift * upper_side);
    }
    midrib += along * (blade.length / segments);
  }
  mesh.addGrid(first, static_cast<std::size_t>(segments) + 1, kAcross.size(), false);
}

void addTubeMesh(const std::vector<Eigen::Vector3d>& centreline, const std::vector<double>& radii,
                 int sides, TriangleMesh& mesh) {
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  Eigen::Vector3d normal = Eigen::Vector3d::UnitX();
  for (std::size_t i = 0; i < centreline.size(); ++i) {
    const Eigen::Vector3d& before = centreline[i == 0 ? 0 : i - 1];
    const Eigen::Vector3d& after = centreline[std::min(i + 1, centreline.size() - 1)];
    const Eigen::Vector3d tangent = (after - before).normalized();
    if (i == 0) {
      normal = tangent.unitOrthogonal();
    }
    normal = (normal - tangent * tangent.dot(normal)).normalized();
    const Eigen::Vector3d binormal = tangent.cross(normal);
    for (int side = 0; side < sides; ++side) {
      const double angle = 2.0 * M_PI * side / sides;
      mesh.addVertex(centreline[i] +
                     radii[i] * (std::cos(angle) * normal + std::sin(angle) * binormal));
    }
  }
  mesh.addGrid(first, centreline.size(), static_cast<std::size_t>(sides), true);
}

}  // namespace field_phenotyping::simulation
