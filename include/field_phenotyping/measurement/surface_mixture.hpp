#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <vector>

#include "field_phenotyping/measurement/cross_section_model.hpp"

namespace field_phenotyping {

/// Maximum-likelihood fit of a piece of stem together with where round it the points lie.
///
/// A measured point is a place of the surface, at an unknown angle, plus isotropic Gaussian noise
/// across the axis, or an outlier anywhere on the disc that holds all points. How many points lie
/// at which angle is not assumed but found: bins round the stem, about one and a half standard
/// deviations of the noise wide, have shares of their own, whose logarithms may not jump much from
/// bin to bin (a random walk). So the ends of a half-seen arc, which the noise blurs, are neither
/// taken for more surface nor for less. That is the nonparametric maximum-likelihood estimator of a
/// mixing distribution (Kiefer and Wolfowitz 1956), here penalised so that shape and shares have
/// one posterior with a normal approximation.
///
/// Newton's method on all parameters and shares at once, with the observed information of Louis
/// (1982), else a step of expectation maximisation; each step raises the posterior. The noise is
/// found by residual maximum likelihood. Bins are no finer than kFinest of the radius needs:
/// thinner noise is found too large, up to half of that.
///
/// Not thread-safe; deterministic. Refers to the points, which must outlive it.
class SurfaceMixture {
 public:
  static constexpr double kFinest = 0.02;  ///< noise over radius

  SurfaceMixture(const std::vector<Eigen::Vector3d>& points, const CrossSectionPrior& prior,
                 const StemExtent& extent, const CrossSectionVector& start, double outlier_share);

  /// Up to `steps` steps; true once nothing moves.
  bool run(int steps);

  double value() const { return evaluation_.value; }  ///< logarithm of the posterior
  const CrossSectionVector& parameters() const { return parameters_; }
  double radiusPriorVariance() const { return 1.0 / prior_.weight[kRadius]; }
  double outlierShare() const { return outlier_share_; }
  double surfacePoints() const;  ///< expected number of points that are no outliers
  /// Points that the noise is known from, beyond those that the shape takes; its prior counts too.
  double freedom() const;
  /// Share of the circumference at which points are.
  double arcCoverage() const;

  /// Covariances of the parameters, the shares integrated out; not valid where nothing finite was
  /// found.
  struct Covariance {
    bool valid = false;
    CrossSectionMatrix posterior;  ///< inverse of the observed information
    CrossSectionMatrix patches;    ///< by how much patches of the surface disagree ("sandwich"):
                                   ///< errors that neighbours share show in it
    CrossSectionMatrix bound;      ///< of Kanatani, Cramer and Rao, with the same priors: what is
                                   ///< known at best where the angles of the points are not
  };
  Covariance covariance() const;

 private:
  struct Evaluation {
    double value = 0.0;
    double members = 0.0;
    Eigen::VectorXd score;
    Eigen::MatrixXd observed;  ///< information; may be indefinite far from the maximum
    Eigen::MatrixXd complete;  ///< information if every point's angle were known
    Eigen::VectorXd occupancy;
  };

  Evaluation evaluate(const CrossSectionVector& parameters,
                      const Eigen::VectorXd& log_shares) const;
  /// What is taken as given in the next evaluation: priors, share of outliers, freedom.
  void update();
  /// The observed information, or as much of the complete one with it as makes it positive.
  Eigen::LLT<Eigen::MatrixXd> information() const;
  /// How many bins there are, filled up to whole lanes.
  Eigen::Index paddedBins() const;
  /// visit(point, candidate bins) for every point.
  template <typename Visitor>
  void visitPoints(const CrossSectionVector& parameters, const Eigen::VectorXd& log_shares,
                   const Visitor& visit) const;

  const std::vector<Eigen::Vector3d>* points_;
  CrossSectionPrior given_;
  StemExtent extent_;
  ParameterPrior prior_;
  CrossSectionVector parameters_;
  Eigen::VectorXd log_shares_;   ///< of the bins, up to a constant
  Eigen::Matrix2Xd directions_;  ///< u(t) of the bins
  double smoothness_ = 0.0;      ///< inverse variance of the difference of neighbours
  double outlier_share_;
  double fitted_ = 0.0;  ///< parameters that the points, not the priors, decide
  int steps_ = 0;
  Evaluation evaluation_;
};

}  // namespace field_phenotyping
