#pragma once

#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/team.hpp"

// Cholesky decomposition within an envelope, by a team of threads (see team.hpp): the same bits
// whatever the team, for every element goes through the same operations in the same order.

namespace field_phenotyping {

/// Lower triangle of a symmetric matrix whose rows reach few columns to the left of the diagonal,
/// but for the last ones, which reach all the way: that of splines along a stem and a few
/// coefficients that all of them share. Its Cholesky factor has the same envelope, so that the work
/// is linear in the size.
struct Envelope {
  double* values;  ///< valuesOf(size, band, shared); all members of a team see the same
  int size;
  int band;    ///< how many columns a row reaches to the left
  int shared;  ///< how many of the last rows reach all the way

  FIELD_PHENOTYPING_HD static constexpr int valuesOf(int size, int band, int shared) {
    return (size - shared) * (band + 1) + shared * size;
  }
  FIELD_PHENOTYPING_HD int banded() const { return size - shared; }  ///< rows that reach few
  /// First column of a row within the envelope.
  FIELD_PHENOTYPING_HD int first(int row) const {
    return row >= banded() || row < band ? 0 : row - band;
  }
  /// Where column 0 of a row is or would be: only those from first() to the diagonal are there.
  FIELD_PHENOTYPING_HD double* row(int row) const {
    return row < banded() ? values + (static_cast<std::ptrdiff_t>(row) * (band + 1) + band - row)
                          : values + (static_cast<std::ptrdiff_t>(banded()) * (band + 1) +
                                      static_cast<std::ptrdiff_t>(row - banded()) * size);
  }
};

/// Puts the Cholesky factor in the matrix' place, which must be complete when the members come
/// here.
/// @return whether the matrix is positive definite; the same to all members, after which all may
///         read
template <class Team>
FIELD_PHENOTYPING_HD bool teamFactor(const Team& team, const Envelope& matrix) {
  const int groups = static_cast<int>(team.groups());
  const int lanes = static_cast<int>(team.size() / team.groups());
  const int group = static_cast<int>(team.group());
  const int lane = static_cast<int>(team.rank()) - group * lanes;
  for (int k = 0; k < matrix.size; ++k) {
    const double square = matrix.row(k)[k];
    if (!(square > 0.0)) return false;
    const double pivot = std::sqrt(square);
    // The rows that reach column k: those of the band, then the shared ones.
    const int of_band = k >= matrix.banded()                ? 0
                        : k + matrix.band < matrix.banded() ? matrix.band
                                                            : matrix.banded() - 1 - k;
    const int first_shared = k >= matrix.banded() ? k + 1 : matrix.banded();
    const int reaching = of_band + matrix.size - first_shared;
    const auto rowAt = [&](int i) { return i < of_band ? k + 1 + i : first_shared + i - of_band; };
    team.sync();  // all have read the pivot
    if (team.rank() == 0U) matrix.row(k)[k] = pivot;
    for (int i = static_cast<int>(team.rank()); i < reaching; i += static_cast<int>(team.size())) {
      matrix.row(rowAt(i))[k] /= pivot;
    }
    team.sync();
    // Rows of the band lie one after the other, and so do the shared ones: so do the column's
    // values.
    const double* of_rows = matrix.row(k) + k + matrix.band;
    const double* of_others = matrix.row(first_shared) + k;
    for (int i = group; i < reaching; i += groups) {
      double* row = matrix.row(rowAt(i));
      const double factor = row[k];
      const int in_band = i < of_band ? i + 1 : of_band;
      for (int j = lane; j < in_band; j += lanes) {
        row[k + 1 + j] -= factor * of_rows[j * matrix.band];
      }
      for (int j = lane; j <= i - of_band; j += lanes) {
        row[first_shared + j] -= factor * of_others[j * matrix.size];
      }
    }
    team.sync();
  }
  return true;
}

/// Solves A x = b in place for a matrix without shared rows that teamFactor() has factored, all
/// members working on the one column. All may read it afterwards.
/// @param b complete when the members come here
template <class Team>
FIELD_PHENOTYPING_HD void teamSolve(const Team& team, const Envelope& factor, double* b) {
  const int rank = static_cast<int>(team.rank());
  const int size = static_cast<int>(team.size());
  for (int k = 0; k < factor.size; ++k) {
    const double value = b[k] / factor.row(k)[k];
    team.sync();  // all have read it
    if (rank == 0) b[k] = value;
    const int end = k + factor.band < factor.size ? k + factor.band + 1 : factor.size;
    for (int i = k + 1 + rank; i < end; i += size) b[i] -= factor.row(i)[k] * value;
    team.sync();
  }
  for (int k = factor.size - 1; k >= 0; --k) {
    const double* row = factor.row(k);
    const double value = b[k] / row[k];
    team.sync();
    if (rank == 0) b[k] = value;
    for (int i = factor.first(k) + rank; i < k; i += size) b[i] -= row[i] * value;
    team.sync();
  }
}

/// Solves A X = B in place for a matrix that teamFactor() has factored; each member works on
/// columns of its own. What they wrote may be read after the next sync().
/// @param b A's size x columns, row by row; complete when the members come here
template <class Team>
FIELD_PHENOTYPING_HD void teamSolve(const Team& team, const Envelope& factor, double* b,
                                    int columns) {
  const int rank = static_cast<int>(team.rank());
  const int size = static_cast<int>(team.size());
  const auto subtract = [&](int from, double share, int row) {
    double* to = b + static_cast<std::ptrdiff_t>(from) * columns;
    const double* of = b + static_cast<std::ptrdiff_t>(row) * columns;
    for (int j = rank; j < columns; j += size) to[j] -= share * of[j];
  };
  const auto divide = [&](int row, double by) {
    double* values = b + static_cast<std::ptrdiff_t>(row) * columns;
    for (int j = rank; j < columns; j += size) values[j] /= by;
  };
  for (int i = 0; i < factor.size; ++i) {
    const double* row = factor.row(i);
    for (int k = factor.first(i); k < i; ++k) subtract(i, row[k], k);
    divide(i, row[i]);
  }
  for (int i = factor.size - 1; i >= 0; --i) {
    const double* row = factor.row(i);
    divide(i, row[i]);
    for (int k = factor.first(i); k < i; ++k) subtract(k, row[k], i);
  }
}

}  // namespace field_phenotyping
