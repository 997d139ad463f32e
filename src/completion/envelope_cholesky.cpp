#include "field_phenotyping/completion/envelope_cholesky.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {

using Eigen::Index;

Index EnvelopeCholesky::first(Index row) const {
  return row >= factor_.rows() - shared_ ? 0 : std::max<Index>(row - band_, 0);
}

bool EnvelopeCholesky::compute(const RowMatrix& lower, Index band, Index shared) {
  factor_ = lower;
  band_ = band;
  shared_ = shared;
  for (Index i = 0; i < factor_.rows(); ++i) {
    const Index begin = first(i);
    for (Index j = begin; j <= i; ++j) {
      const Index from = std::max(begin, first(j));
      double value = factor_(i, j);
      for (Index k = from; k < j; ++k) value -= factor_(i, k) * factor_(j, k);
      if (j < i) {
        factor_(i, j) = value / factor_(j, j);
      } else {
        if (!(value > 0.0)) return false;
        factor_(i, i) = std::sqrt(value);
      }
    }
  }
  return true;
}

void EnvelopeCholesky::solveInPlace(RowMatrix& b) const {
  for (Index i = 0; i < factor_.rows(); ++i) {
    for (Index k = first(i); k < i; ++k) b.row(i) -= factor_(i, k) * b.row(k);
    b.row(i) /= factor_(i, i);
  }
  for (Index i = factor_.rows() - 1; i >= 0; --i) {
    b.row(i) /= factor_(i, i);
    for (Index k = first(i); k < i; ++k) b.row(k) -= factor_(i, k) * b.row(i);
  }
}

}  // namespace field_phenotyping
