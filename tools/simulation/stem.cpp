#include "simulation/stem.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace field_phenotyping::simulation {
namespace {

constexpr double kNodeWidth = 0.005;    // standard deviation of a node's swelling along the stem
constexpr double kBuriedLength = 0.03;  // keeps the surface closed on rough soil
constexpr int kSides = 40;

/// Radius relative to the base's: a slow taper that quickens towards the tassel, and a flared foot.
double taper(double u) {
  const double v = std::clamp(u, 0.0, 1.0);
  return 1.0 - 0.25 * v - 0.30 * v * v * v + 0.08 * std::exp(-v / 0.04);
}

struct CrossSection {
  Eigen::Vector3d centre, major, minor;  // unit vectors across the axis
  double a, b;
};

CrossSection crossSection(const Stem& stem, double h) {
  const Eigen::Vector3d tangent = stem.axisDirection(h);
  const Eigen::Vector3d wished(std::cos(stem.major_azimuth), std::sin(stem.major_azimuth), 0.0);
  CrossSection section;
  section.centre = stem.axisPoint(h);
  section.major = (wished - tangent * tangent.dot(wished)).normalized();
  section.minor = tangent.cross(section.major);
  section.a = stem.semiMajor(h);
  section.b = section.a * stem.axis_ratio;
  return section;
}

/// Signed distance of (x, y) from an ellipse; evolute iteration, exact to 1e-9 in four steps.
double ellipseDistance(double x, double y, double a, double b) {
  const double px = std::abs(x);
  const double py = std::abs(y);
  double tx = M_SQRT1_2;
  double ty = M_SQRT1_2;
  for (int iteration = 0; iteration < 4; ++iteration) {
    const double ex = (a * a - b * b) * tx * tx * tx / a;
    const double ey = (b * b - a * a) * ty * ty * ty / b;
    const double r = std::hypot(a * tx - ex, b * ty - ey);
    const double q = std::max(std::hypot(px - ex, py - ey), 1e-12);
    tx = std::clamp(((px - ex) * r / q + ex) / a, 0.0, 1.0);
    ty = std::clamp(((py - ey) * r / q + ey) / b, 0.0, 1.0);
    const double norm = std::max(std::hypot(tx, ty), 1e-12);
    tx /= norm;
    ty /= norm;
  }
  const double distance = std::hypot(px - a * tx, py - b * ty);
  const bool inside = (px * px) / (a * a) + (py * py) / (b * b) < 1.0;
  return inside ? -distance : distance;
}

/// Heights of the rings of the mesh: even, and denser across the swelling of each node.
std::vector<double> ringHeights(const Stem& stem) {
  std::vector<double> heights;
  const int count = std::max(8, static_cast<int>(std::ceil(stem.height / 0.02)));
  for (int i = 0; i <= count; ++i) {
    heights.push_back(stem.height * i / count);
  }
  heights.push_back(-kBuriedLength);
  for (const StemNode& node : stem.nodes) {
    for (int step = -4; step <= 4; ++step) {
      const double h = node.height + 0.6 * kNodeWidth * step;
      if (h > 0.0 && h < stem.height) {
        heights.push_back(h);
      }
    }
  }
  std::sort(heights.begin(), heights.end());
  const auto close = [](double lower, double upper) { return upper - lower < 1e-4; };
  heights.erase(std::unique(heights.begin(), heights.end(), close), heights.end());
  return heights;
}

}  // namespace

Eigen::Vector3d Stem::axisPoint(double h) const {
  const double u = h / height;
  const Eigen::Vector2d offset =
      h * slope + height * (4.0 * u * (1.0 - u) * bow + std::sin(2.0 * M_PI * u) * wave);
  return base + Eigen::Vector3d(offset.x(), offset.y(), h);
}

Eigen::Vector3d Stem::axisDirection(double h) const {
  const double u = h / height;
  const Eigen::Vector2d derivative =
      slope + 4.0 * (1.0 - 2.0 * u) * bow + 2.0 * M_PI * std::cos(2.0 * M_PI * u) * wave;
  return Eigen::Vector3d(derivative.x(), derivative.y(), 1.0).normalized();
}

double Stem::smoothSemiMajor(double h) const {
  return reference_semi_major * taper(h / height) / taper(reference_height / height);
}

double Stem::semiMajor(double h) const {
  double swelling = 0.0;
  for (const StemNode& node : nodes) {
    const double z = (h - node.height) / kNodeWidth;
    if (std::abs(z) < 5.0) {
      swelling += node.swelling * std::exp(-0.5 * z * z);
    }
  }
  return smoothSemiMajor(h) * (1.0 + swelling);
}

Eigen::Vector3d Stem::surfacePoint(double h, double angle) const {
  const CrossSection s = crossSection(*this, h);
  return s.centre + s.a * std::cos(angle) * s.major + s.b * std::sin(angle) * s.minor;
}

Eigen::Vector3d Stem::surfacePointTowards(double h, double azimuth) const {
  const CrossSection s = crossSection(*this, h);
  const Eigen::Vector3d wished(std::cos(azimuth), std::sin(azimuth), 0.0);
  const double x = wished.dot(s.major);
  const double y = wished.dot(s.minor);
  return surfacePoint(h, std::atan2(y / s.b, x / s.a));
}

Eigen::Vector3d Stem::surfaceNormal(double h, double angle) const {
  const CrossSection s = crossSection(*this, h);
  return (s.b * std::cos(angle) * s.major + s.a * std::sin(angle) * s.minor).normalized();
}

double Stem::length() const {
  constexpr int kSteps = 200;
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    sum += 1.0 / axisDirection(height * (i + 0.5) / kSteps).z();
  }
  return sum * height / kSteps;
}

double Stem::signedDistance(const Eigen::Vector3d& point) const {
  double h = point.z() - base.z();
  for (int iteration = 0; iteration < 8; ++iteration) {
    const Eigen::Vector3d tangent = axisDirection(h);
    h += (point - axisPoint(h)).dot(tangent) * tangent.z();
    h = std::clamp(h, -kBuriedLength, height);
  }
  const CrossSection s = crossSection(*this, h);
  const Eigen::Vector3d offset = point - s.centre;
  return ellipseDistance(offset.dot(s.major), offset.dot(s.minor), s.a, s.b);
}

Eigen::Vector3d Stem::chordDirection() const {
  return (axisPoint(height) - base).normalized();
}

double diameterHeight(double stem_length, double wished) {
  constexpr double kShareOfShortStem = 0.4;
  return std::min(wished, kShareOfShortStem * stem_length);
}

void addStemMesh(const Stem& stem, TriangleMesh& mesh) {
  // Half the sagitta outwards: the polygon's mean radius is then the stem's, within 0.02 mm.
  const double outwards = 2.0 / (1.0 + std::cos(M_PI / kSides));
  const std::vector<double> heights = ringHeights(stem);
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  for (const double h : heights) {
    const CrossSection s = crossSection(stem, h);
    for (int side = 0; side < kSides; ++side) {
      const double angle = 2.0 * M_PI * side / kSides;
      mesh.addVertex(s.centre + outwards * (s.a * std::cos(angle) * s.major +
                                            s.b * std::sin(angle) * s.minor));
    }
  }
  mesh.addGrid(first, heights.size(), kSides, true);
}

std::vector<Eigen::Vector3d> sampleStemSurface(const Stem& stem, double spacing,
                                               std::vector<Eigen::Vector3d>& normals) {
  std::vector<Eigen::Vector3d> points;
  normals.clear();
  const int rings = std::max(1, static_cast<int>(std::lround(stem.length() / spacing)));
  for (int ring = 0; ring < rings; ++ring) {
    const double h = stem.height * (ring + 0.5) / rings;
    const double perimeter = M_PI * stem.semiMajor(h) * (1.0 + stem.axis_ratio);
    const int sides = std::max(8, static_cast<int>(std::lround(perimeter / spacing)));
    for (int side = 0; side < sides; ++side) {
      const double angle = 2.0 * M_PI * side / sides;
      points.push_back(stem.surfacePoint(h, angle));
      normals.push_back(stem.surfaceNormal(h, angle));
    }
  }
  return points;
}

}  // namespace field_phenotyping::simulation
