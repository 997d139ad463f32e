#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/completion/stem_frame.hpp"
#include "field_phenotyping/completion/surface_prior_model.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"

namespace field_phenotyping {

/// The cylinder that stands for the stem where nothing was measured: a curved axis, a radius
/// profile R(s) along it and one ellipticity (paper Eq 18, read as axis and radius by RANSAC).
///
/// RANSAC finds a straight correction of the given axis and a linear taper; robust re-weighted
/// least squares then lets axis and radius bend as far as the points ask for. Because this is a
/// maximum a posteriori fit, it stays defined for one-sided and gappy stems, and its covariance
/// tells how well the surface is known at every place. Immutable, so safe to read from any thread.
class SurfacePrior {
 public:
  /// Fits the prior to the points of one stem (local frame of the block's cloud, metres).
  /// @param axis   as segmented; may be some millimetres off
  /// @param extend length that the frame goes on below the lowest point [m]
  /// @return nothing when the points do not lie on anything like a stem
  static std::optional<SurfacePrior> fit(const std::vector<Eigen::Vector3d>& points,
                                         const StemAxis& axis, double extend);

  const StemFrame& frame() const { return frame_; }

  /// Radius of the stem, that is R(s) with the ellipse [m].
  double radius(double theta, double s) const;
  /// R(s) without the ellipse [m].
  double meanRadiusAt(double s) const;
  /// Shares of R(s): radius = R(s) (1 + ellipse[0] cos 2 theta + ellipse[1] sin 2 theta).
  std::array<double, 2> ellipse() const;
  /// Arc length on the given axis at which the frame begins [m]; a multiple of the knots' spacing.
  double begin() const { return begin_; }
  /// How far noise moves points outwards on average: about sigma^2 / 2R, across a curved
  /// surface [m].
  double noiseBias(double s) const;
  /// How far a point lies beyond the surface, the noise bias taken off, and that bias.
  struct Residual {
    double deviation = 0.0;   ///< [m]
    double noise_bias = 0.0;  ///< [m]
  };
  Residual residual(const UnrolledPoint& point) const;
  /// Variance of the prior surface, along the radius, by the points' noise and by how stems are
  /// shaped [m^2].
  double variance(double theta, double s) const;
  /// What is to be added where points depart from any such surface together, as round leaf bases
  /// and sheaths: they hold the surface no better than one of them, and the stem is shaped less as
  /// stems are. Large where little holds the surface, as on the far side of a stem of which only
  /// half is seen [m^2].
  double misfitVariance(double theta, double s) const;

  double meanRadius() const { return mean_radius_; }  ///< [m]
  double noise() const { return noise_; }  ///< robust standard deviation of the points [m]

  /// Weight in [0, 1] of a point `residual` [m] off the prior surface (Tukey's biweight); 0 for
  /// points that are not the stem's.
  double robustWeight(double residual) const;

 private:
  SurfacePrior(StemFrame frame, const coarse::Layout& layout);

  friend class SurfacePriorMaker;

  coarse::Place placeAt(double theta, double s) const;
  /// The noise bias where R(s) is so large.
  double biasAt(double radius) const;

  StemFrame frame_;
  coarse::Layout layout_;
  double mean_radius_ = 0.0;
  double noise_ = 0.0;
  double begin_ = 0.0;
  double clustering_ = 1.0;  // of the residuals
  std::vector<double> coefficients_;
  std::vector<double> covariance_;  // of the coefficients, row by row
};

/// A stem that a prior is to be fitted to.
struct StemToModel {
  std::vector<Eigen::Vector3d> points;  ///< local frame of the block's cloud [m]
  const StemAxis* axis;                 ///< as segmented, not null
  double extend;                        ///< as for SurfacePrior::fit() [m]
};

/// SurfacePrior::fit() of many stems at once, on all cores or, a thread block each, on the GPU,
/// with the same bits. Thread-safe.
std::vector<std::optional<SurfacePrior>> fitSurfacePriors(const std::vector<StemToModel>& stems,
                                                          const ComputeDevice& device);

}  // namespace field_phenotyping
