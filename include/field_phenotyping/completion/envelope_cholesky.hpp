#pragma once

#include <Eigen/Core>

namespace field_phenotyping {

/// Cholesky decomposition of a symmetric positive definite matrix whose rows reach few columns to
/// the left of the diagonal, but for the last ones, which reach all the way: that of splines along
/// a stem and a few coefficients that all of them share. The factor has the same envelope, so that
/// the work is linear in the size.
class EnvelopeCholesky {
 public:
  using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  /// @param lower the lower triangle; what is above is not read
  /// @param band how many columns a row reaches to the left of the diagonal
  /// @param shared how many of the last rows reach all the way
  /// @return whether the matrix is positive definite; only then may solve() be called
  bool compute(const RowMatrix& lower, Eigen::Index band, Eigen::Index shared);

  /// Solution of A X = B, in place.
  void solveInPlace(RowMatrix& b) const;

 private:
  /// First column of a row within the envelope.
  Eigen::Index first(Eigen::Index row) const;

  RowMatrix factor_;
  Eigen::Index band_ = 0;
  Eigen::Index shared_ = 0;
};

}  // namespace field_phenotyping
