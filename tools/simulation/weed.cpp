#include "simulation/weed.hpp"

#include <cmath>

#include "simulation/blade.hpp"

namespace field_phenotyping::simulation {
namespace {

constexpr double kDegree = M_PI / 180.0;

void addRosette(const Eigen::Vector3d& base, RandomStream& random, TriangleMesh& mesh) {
  const int leaves = 6 + static_cast<int>(random.uniform(0.0, 5.0));
  const double length = random.uniform(0.07, 0.17);
  const double first_azimuth = random.uniform(0.0, 2.0 * M_PI);
  for (int i = 0; i < leaves; ++i) {
    constexpr double kGoldenAngle = 2.39996;
    Blade leaf;
    leaf.start = base;
    leaf.azimuth = first_azimuth + kGoldenAngle * i + random.normal(0.0, 0.2);
    leaf.length = length * random.uniform(0.7, 1.1);
    leaf.width = leaf.length * random.uniform(0.25, 0.4);
    leaf.insertion_angle = random.uniform(15.0, 60.0) * kDegree;
    leaf.tip_angle = leaf.insertion_angle + random.uniform(15.0, 55.0) * kDegree;
    leaf.ripple = 0.05 * leaf.width;
    leaf.clasp_radius = 0.005;
    addBladeMesh(leaf, mesh);
  }
}

void addGrassTuft(const Eigen::Vector3d& base, RandomStream& random, TriangleMesh& mesh) {
  const int blades = 8 + static_cast<int>(random.uniform(0.0, 9.0));
  const double length = random.uniform(0.10, 0.27);
  for (int i = 0; i < blades; ++i) {
    Blade blade;
    const double azimuth = random.uniform(0.0, 2.0 * M_PI);
    const double offset = 0.012 * std::sqrt(random.uniform());
    blade.start = base + offset * Eigen::Vector3d(std::cos(azimuth), std::sin(azimuth), 0.0);
    blade.azimuth = azimuth;
    blade.length = length * random.uniform(0.6, 1.0);
    blade.width = random.uniform(0.004, 0.009);
    blade.insertion_angle = random.uniform(3.0, 35.0) * kDegree;
    blade.tip_angle = blade.insertion_angle + random.uniform(10.0, 90.0) * kDegree;
    blade.ripple = 0.0;
    blade.clasp_radius = 0.005;
    addBladeMesh(blade, mesh);
  }
}

}  // namespace

void addWeed(const Eigen::Vector3d& base, RandomStream random, TriangleMesh& mesh) {
  constexpr float kReflectance = 0.55F;
  mesh.beginSurface({-1, Part::kGround, kReflectance});
  if (random.uniform() < 0.5) {
    addRosette(base, random, mesh);
  } else {
    addGrassTuft(base, random, mesh);
  }
}

}  // namespace field_phenotyping::simulation
