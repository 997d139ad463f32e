#include "stem_pieces.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "simulation/random.hpp"

namespace field_phenotyping::benchmark {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180.0;
constexpr double kAxisOffset = 0.003;        // [m] standard deviation, of the reference axis
constexpr double kAxisTilt = 2.0 * kDegree;  // the same
constexpr double kTaper = -0.15;             // mean, of the radius [1/m]
constexpr double kTaperStddev = 0.10;        // [1/m]
constexpr double kLeafReach = 0.03;          // [m] farthest leaf point from the stem's surface
constexpr double kLeafWidth = 0.5;           // [rad] standard deviation

// Priors of the model that are no parameters, as fitStemCrossSection() has them.
constexpr double kPriorTilt = 0.3;
constexpr double kPriorCurvature = 0.5;  // [1/m]
constexpr double kPriorTwist = 0.3;      // [1/m^2]

}  // namespace

StemPiece drawStemPiece(const PieceSettings& settings, int index) {
  using simulation::RandomStream;
  using simulation::Stream;
  RandomStream random(settings.seed, Stream::kPlant, static_cast<std::uint64_t>(index));
  StemPiece piece;
  const double a = 0.5 * settings.diameter;
  const double b = a * random.uniform(settings.least_axis_ratio, settings.most_axis_ratio);
  piece.major = 2.0 * a;
  piece.minor = 2.0 * b;
  piece.azimuth = random.uniform(0.0, kPi);
  const double view = random.uniform(0.0, 2.0 * kPi);
  const double taper = random.normal(kTaper, kTaperStddev);
  const Eigen::Vector2d offset(random.normal(0.0, kAxisOffset), random.normal(0.0, kAxisOffset));
  const Eigen::Vector2d tilt(std::tan(random.normal(0.0, kAxisTilt)),
                             std::tan(random.normal(0.0, kAxisTilt)));
  const Eigen::Rotation2Dd turn(piece.azimuth);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (int i = 0; i < settings.points; ++i) {
    const double height = settings.span * (random.uniform() - 0.5);
    Eigen::Vector2d point;
    if (random.uniform() < settings.outlier_share) {
      const double azimuth = view + random.normal(0.0, kLeafWidth);
      point = (a + kLeafReach * random.uniform()) *
              Eigen::Vector2d(std::cos(azimuth), std::sin(azimuth));
      piece.feet.emplace_back(nan, nan);
    } else {
      const double t = view - piece.azimuth + settings.arc * (random.uniform() - 0.5);
      const double scale = 1.0 + taper * height;
      point = turn * Eigen::Vector2d(scale * a * std::cos(t), scale * b * std::sin(t));
      piece.feet.emplace_back(t, height);
    }
    point += settings.noise * Eigen::Vector2d(random.normal(), random.normal());
    point += offset + height * tilt;
    piece.points.emplace_back(point.x(), point.y(), height);
  }
  return piece;
}

double cramerRaoBound(const std::vector<Eigen::Vector2d>& feet, double major, double minor,
                      double noise, const CrossSectionPrior& prior) {
  // Center, tilt, curvature, twist (x and y each), radius, taper, its change, ellipticity (two),
  // log of the noise.
  constexpr int kSize = 14;
  constexpr int kRadius = 8;
  constexpr int kEllipse = 11;
  using Information = Eigen::Matrix<double, kSize, kSize>;
  using Vector = Eigen::Matrix<double, kSize, 1>;
  const double r = 0.25 * (major + minor);
  const double e = 0.25 * (major - minor);
  const Eigen::DiagonalMatrix<double, 2> inverse(1.0 / (r + e), 1.0 / (r - e));
  // Of one point about a shift of the surface along its normal, its growth along it, and the
  // logarithm of the noise.
  Eigen::Matrix3d local;
  local << 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 2.0 * noise * noise;
  local /= noise * noise;
  Information information = Information::Zero();
  for (const Eigen::Vector2d& foot : feet) {
    if (!foot.allFinite()) continue;
    const double h = foot.y();
    const Eigen::Vector2d u(std::cos(foot.x()), std::sin(foot.x()));
    const Eigen::Vector2d n = (inverse * u).normalized();
    Eigen::Matrix<double, kSize, 3> jacobian = Eigen::Matrix<double, kSize, 3>::Zero();
    jacobian.col(0).head<8>() << n, h * n, h * h * n, h * h * h * n;
    jacobian.col(1).segment<5>(kRadius) << n.dot(u), h * n.dot(u), h * h * n.dot(u),
        n.x() * u.x() - n.y() * u.y(), n.x() * u.y() + n.y() * u.x();
    jacobian(kSize - 1, 2) = 1.0;
    information += jacobian * local * jacobian.transpose();
  }
  Vector weight = Vector::Constant(1e-9);
  weight.segment<2>(2).setConstant(1.0 / (kPriorTilt * kPriorTilt));
  weight.segment<2>(4).setConstant(1.0 / (kPriorCurvature * kPriorCurvature));
  weight.segment<2>(6).setConstant(1.0 / (kPriorTwist * kPriorTwist));
  weight[kRadius + 1] = 1.0 / std::pow(prior.taper.stddev * r, 2);
  weight[kRadius + 2] = 1.0 / std::pow(prior.taper_change.stddev * r, 2);
  weight.segment<2>(kEllipse).setConstant(
      1.0 / std::pow(std::max(prior.ellipticity_stddev, 1e-4) * r, 2));
  information.diagonal() += weight;
  Vector gradient = Vector::Zero();
  gradient[kRadius] = 2.0;
  gradient[kEllipse] = 2.0;  // the major axis lies along x here
  return std::sqrt(gradient.dot(information.ldlt().solve(gradient)));
}

}  // namespace field_phenotyping::benchmark
