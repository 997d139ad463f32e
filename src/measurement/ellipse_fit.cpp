#include "field_phenotyping/measurement/ellipse_fit.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr int kMaxIterations = 200;
constexpr double kConverged = 1e-9;  // relative step
constexpr double kRunAway = 50.0;    // semi-axis beyond this many times the points' own spread

Eigen::Vector2d centroidOf(const std::vector<Eigen::Vector2d>& points) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& point : points) sum += point;
  return sum / static_cast<double>(points.size());
}

/// Root mean square distance of the points from `center`.
double spreadAbout(const std::vector<Eigen::Vector2d>& points, const Eigen::Vector2d& center) {
  double sum = 0.0;
  for (const Eigen::Vector2d& point : points) sum += (point - center).squaredNorm();
  return std::sqrt(sum / static_cast<double>(points.size()));
}

/// Levenberg-Marquardt over residuals given by `residual(parameters, point, gradient)`.
template <int Size>
struct LeastSquares {
  using Parameters = Eigen::Matrix<double, Size, 1>;
  using Normal = Eigen::Matrix<double, Size, Size>;

  Parameters parameters = Parameters::Zero();
  Normal covariance = Normal::Zero();
  bool converged = false;

  template <class Residual>
  void solve(const std::vector<Eigen::Vector2d>& points, const Residual& residual) {
    double damping = 1e-3;
    double cost = evaluate(points, residual, parameters);
    for (int iteration = 0; iteration < kMaxIterations && !converged; ++iteration) {
      const Normal normal = normal_;
      const Parameters gradient = gradient_;
      Normal damped = normal;
      damped.diagonal() *= 1.0 + damping;
      const Parameters step = -damped.ldlt().solve(gradient);
      if (!step.allFinite()) return;
      const double stepped = evaluate(points, residual, parameters + step);
      if (stepped <= cost) {
        parameters += step;
        converged = step.norm() <= kConverged * (1.0 + parameters.norm());
        cost = stepped;
        damping = std::max(damping * 0.1, 1e-12);
      } else {
        normal_ = normal;
        gradient_ = gradient;
        damping *= 10.0;
        converged = damping > 1e12;  // no descent left at machine precision
      }
    }
    const double freedom = static_cast<double>(points.size()) - Size;
    covariance = cost / freedom * normal_.ldlt().solve(Normal::Identity());
  }

 private:
  template <class Residual>
  double evaluate(const std::vector<Eigen::Vector2d>& points, const Residual& residual,
                  const Parameters& at) {
    normal_.setZero();
    gradient_.setZero();
    double cost = 0.0;
    Parameters row;
    for (const Eigen::Vector2d& point : points) {
      const double value = residual(at, point, row);
      cost += value * value;
      gradient_ += row * value;
      normal_ += row * row.transpose();
    }
    return cost;
  }

  Normal normal_ = Normal::Zero();
  Parameters gradient_ = Parameters::Zero();
};

}  // namespace

EllipseFit fitAlgebraicEllipse(const std::vector<Eigen::Vector2d>& points) {
  EllipseFit fit;
  if (points.size() < 6U) return fit;
  const Eigen::Vector2d centroid = centroidOf(points);
  const double scale = spreadAbout(points, centroid);
  if (!(scale > 0.0)) return fit;

  // u^2/a^2 + v^2/b^2 = (x - c)^T Q (x - c); parameters: c, Qxx, Qxy, Qyy, in units of `scale`.
  LeastSquares<5> problem;
  problem.parameters << 0.0, 0.0, 1.0, 0.0, 1.0;
  problem.solve(points, [&](const Eigen::Matrix<double, 5, 1>& p, const Eigen::Vector2d& point,
                            Eigen::Matrix<double, 5, 1>& row) {
    const Eigen::Vector2d d = (point - centroid) / scale - p.head<2>();
    row << 2.0 * (p[2] * d.x() + p[3] * d.y()), 2.0 * (p[3] * d.x() + p[4] * d.y()), -d.x() * d.x(),
        -2.0 * d.x() * d.y(), -d.y() * d.y();
    return 1.0 - p[2] * d.x() * d.x() - 2.0 * p[3] * d.x() * d.y() - p[4] * d.y() * d.y();
  });

  Eigen::Matrix2d form;
  form << problem.parameters[2], problem.parameters[3], problem.parameters[3],
      problem.parameters[4];
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(form);
  if (!problem.converged || !(eigen.eigenvalues()[0] > 1.0 / (kRunAway * kRunAway))) return fit;

  // An eigenvalue is 1/a^2, so that da = -a^3/2 dlambda, with dlambda = w^T dQ w.
  const auto stddevOf = [&](int i) {
    const Eigen::Vector2d w = eigen.eigenvectors().col(i);
    const Eigen::Vector3d row(w.x() * w.x(), 2.0 * w.x() * w.y(), w.y() * w.y());
    const double variance = row.dot(problem.covariance.bottomRightCorner<3, 3>() * row);
    return 0.5 * scale * std::pow(eigen.eigenvalues()[i], -1.5) * std::sqrt(variance);
  };
  const Eigen::Vector2d major = eigen.eigenvectors().col(0);
  fit.valid = true;
  fit.center = centroid + scale * problem.parameters.head<2>();
  fit.semi_major = scale / std::sqrt(eigen.eigenvalues()[0]);
  fit.semi_minor = scale / std::sqrt(eigen.eigenvalues()[1]);
  fit.semi_major_stddev = stddevOf(0);
  fit.semi_minor_stddev = stddevOf(1);
  fit.angle = std::atan(major.y() / major.x());
  return fit;
}

CircleFit fitCircle(const std::vector<Eigen::Vector2d>& points) {
  CircleFit fit;
  if (points.size() < 4U) return fit;
  const Eigen::Vector2d centroid = centroidOf(points);
  const double scale = spreadAbout(points, centroid);
  if (!(scale > 0.0)) return fit;

  // Start from the algebraic circle |x|^2 = 2 c.x + k, which a half-seen arc does not lead astray.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const Eigen::Vector2d& point : points) {
    const Eigen::Vector2d d = (point - centroid) / scale;
    const Eigen::Vector3d row(2.0 * d.x(), 2.0 * d.y(), 1.0);
    normal += row * row.transpose();
    right += row * d.squaredNorm();
  }
  const Eigen::Vector3d start = normal.ldlt().solve(right);
  if (!start.allFinite() || start.head<2>().norm() > kRunAway) return fit;

  LeastSquares<3> problem;
  problem.parameters << start[0], start[1],
      std::sqrt(std::max(start[2] + start.head<2>().squaredNorm(), 1e-6));
  problem.solve(points,
                [&](const Eigen::Vector3d& p, const Eigen::Vector2d& point, Eigen::Vector3d& row) {
                  const Eigen::Vector2d d = (point - centroid) / scale - p.head<2>();
                  const double distance = std::max(d.norm(), 1e-12);
                  row << -d.x() / distance, -d.y() / distance, -1.0;
                  return distance - p[2];
                });
  if (!problem.converged || !(problem.parameters[2] > 0.0) || problem.parameters[2] > kRunAway) {
    return fit;
  }
  fit.valid = true;
  fit.center = centroid + scale * problem.parameters.head<2>();
  fit.radius = scale * problem.parameters[2];
  fit.radius_stddev = scale * std::sqrt(problem.covariance(2, 2));
  return fit;
}

}  // namespace field_phenotyping
