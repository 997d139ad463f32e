#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "field_phenotyping/completion/surface_index.hpp"

namespace field_phenotyping {

/// One value on the unrolled stem.
struct SurfaceSample {
  SurfacePosition position;
  double value = 0.0;   ///< [m]
  double weight = 1.0;  ///< how many measured points stand behind it
};

/// The cells that samples are averaged over: at fixed places, so that a sample changes one centre.
struct CenterLattice {
  double row_height = 0.01;  ///< along the stem [m]
  int columns = 6;           ///< round it
};

/// Averages samples over the cells of a lattice; in order of the cells. Deterministic.
std::vector<SurfaceSample> thinSamples(const std::vector<SurfaceSample>& samples,
                                       const CenterLattice& lattice);

/// Standard deviation of the values about 0 that is not noise [m].
/// @param noise standard deviation of one measured point [m]
double amplitudeOf(const std::vector<SurfaceSample>& centers, double noise);

/// Density-weighted Gaussian radial basis functions on the unrolled stem, periodic in theta.
///
/// Paper Eq 19 as read: density rho = k / (pi r_k^2) from the k-th nearest centre, weights w
/// proportional to 1 / rho, median 1 and limited to [1/4, 4];
///     A_ij = w_i w_j phi_ij,   phi_ij = o_ij^(3/2) exp(-(e d_ij)^2 / m_ij),
///     m_ij = (w_i + w_j) / 2,  o_ij = sqrt(w_i w_j) / m_ij.
/// Where weights are equal this is exp(-(e d)^2 / sqrt(w_i w_j)); where they differ that form is
/// indefinite and its surface swings between the centres, while this one is positive definite.
/// The rows of Eq 21 carry the weight too, and a ridge and the noise N of the values, relative to
/// their spread, keep them stable: (A + ridge I + W N W) lambda = W z'. The surface is that of Eq
/// 26,
///     z'(x) = sum_j w_j lambda_j phi(x, x_j),
/// with the weight at x from the same density. Far from all centres it tends to 0. Immutable once
/// built, so safe to read from any thread.
class RbfSurface {
 public:
  struct Options {
    double kernel_scale = 1.0;  ///< kernel width in mean distances between centres
    double ridge = 1e-3;        ///< relative to the diagonal, > 0
    double noise = 0.0;         ///< standard deviation of one measured point [m]
    double amplitude = 0.0;     ///< of the values that is not noise [m]; 0: found from the centres
    double center_area = 0.0;   ///< of the surface, usual for a centre [m^2]; 0: found likewise
  };

  /// Solves for the coefficients; any number of centres, none gives 0 everywhere.
  /// @param radius of the stem [m], > 0
  RbfSurface(const std::vector<SurfaceSample>& centers, double radius, const Options& options);

  /// Interpolated value [m].
  double valueAt(const SurfacePosition& position) const;

  /// Standard deviation of the values about 0 that is not noise [m].
  double amplitude() const { return amplitude_; }
  /// Distance at which the unweighted kernel has fallen to 1/e [m].
  double kernelWidth() const { return kernel_width_; }
  std::size_t size() const { return index_.size(); }

 private:
  double densityWeight(const SurfacePosition& position) const;

  SurfaceIndex index_;
  double kernel_width_ = 1.0;
  double amplitude_ = 0.0;
  double mean_area_ = 1.0;            // 1 / rho of weight 1 [m^2]
  std::vector<double> weights_;       // w_j
  std::vector<double> coefficients_;  // w_j lambda_j
};

}  // namespace field_phenotyping
