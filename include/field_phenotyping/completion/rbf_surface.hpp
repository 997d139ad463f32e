#pragma once

#include <cstddef>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/rbf_surface_team.hpp"
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

/// How an RbfSurface is solved.
struct RbfOptions {
  double kernel_scale = 1.0;  ///< kernel width in mean distances between centres
  double ridge = 1e-3;        ///< relative to the diagonal, > 0
  double noise = 0.0;         ///< standard deviation of one measured point [m]
  double amplitude = 0.0;     ///< of the values that is not noise [m]; 0: found from the centres
  double center_area = 0.0;   ///< of the surface, usual for a centre [m^2]; 0: found likewise
};

/// The equations of an RbfSurface before they are solved.
class RbfSystem {
 public:
  /// @param centers any number; none gives a surface of 0 everywhere
  /// @param radius of the stem [m], > 0
  RbfSystem(const std::vector<SurfaceSample>& centers, double radius, const RbfOptions& options);

  /// Distance at which the unweighted kernel has fallen to 1/e [m].
  double kernelWidth() const { return kernel_width_; }
  /// The centres.
  const SurfaceIndex& index() const { return index_; }
  /// What a team of threads solves; points into this.
  RbfTask task() const;
  /// No fewer columns beside the diagonal than the system has, whatever the weights.
  std::size_t mostBand() const;

 private:
  SurfaceIndex index_;
  double kernel_width_ = 1.0;
  double mean_area_ = 1.0;  // 1 / rho of weight 1 [m^2]
  double ridge_;
  std::vector<double> values_;  // in the order of the index
  std::vector<double> noise_;   // likewise
};

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
  /// Solves for the coefficients.
  explicit RbfSurface(RbfSystem system);
  RbfSurface(const std::vector<SurfaceSample>& centers, double radius, const RbfOptions& options)
      : RbfSurface(RbfSystem(centers, radius, options)) {}

  /// Interpolated value [m].
  double valueAt(const SurfacePosition& position) const {
    return valueAt(system_.index().embed(position));
  }
  /// @param place on the straight cylinder of the index
  double valueAt(const Vector3& place) const;

 private:
  RbfSystem system_;
  std::vector<double> weights_;       // w_j
  std::vector<double> coefficients_;  // w_j lambda_j
};

/// A surface and where it is to be read.
struct RbfToRead {
  RbfSystem system;
  std::vector<Vector3> places;  ///< on the straight cylinder of the system's index
};

/// RbfSurface::valueAt() of each place of each surface [m].
std::vector<double> readSurface(const RbfToRead& surface);

/// The same of many surfaces at once, a thread block each, on the GPU; with the same bits. What the
/// GPU cannot do the CPU does, on all cores. Thread-safe.
std::vector<std::vector<double>> readSurfaces(const std::vector<const RbfToRead*>& surfaces,
                                              const ComputeDevice& device);

}  // namespace field_phenotyping
