#pragma once

#include <cstddef>

#include "field_phenotyping/common/team.hpp"

// Linear systems that a team of threads solves together (see team.hpp), with the same bits whatever
// the team: every element goes through the same operations in the same order.

namespace field_phenotyping {

/// Factors the symmetric matrix A = L D L' in place; of `matrix`, n x n, row by row, only what lies
/// on and right of the diagonal is read and written. Then the diagonal holds D, row k to the right
/// of it column k of L times D[k]. All members must see the same `matrix`, and it must be complete
/// when they come here.
/// @return whether A is positive definite; the same to all members, after which all may read
template <class Team>
FIELD_PHENOTYPING_HD bool teamFactor(const Team& team, double* matrix, int n) {
  const int groups = static_cast<int>(team.groups());
  const int lanes = static_cast<int>(team.size() / team.groups());
  const int lane = static_cast<int>(team.rank()) - static_cast<int>(team.group()) * lanes;
  for (int k = 0; k < n; ++k) {
    const double* pivot_row = matrix + static_cast<std::ptrdiff_t>(k) * n;
    const double pivot = pivot_row[k];
    if (!(pivot > 0.0)) return false;
    const double inverse = 1.0 / pivot;
    for (int i = k + 1 + static_cast<int>(team.group()); i < n; i += groups) {
      double* row = matrix + static_cast<std::ptrdiff_t>(i) * n;
      const double factor = pivot_row[i] * inverse;
      for (int j = i + lane; j < n; j += lanes) row[j] -= factor * pivot_row[j];
    }
    team.sync();
  }
  return true;
}

/// Solves A x = b, of a matrix that teamFactor() has factored. All members must see the same
/// memory; when they come here `right` must be complete, of which nothing is left. All may read the
/// solution afterwards.
template <class Team>
FIELD_PHENOTYPING_HD void teamSolve(const Team& team, const double* matrix, int n, double* right,
                                    double* solution) {
  const int rank = static_cast<int>(team.rank());
  const int size = static_cast<int>(team.size());
  for (int k = 0; k < n; ++k) {
    const double* row = matrix + static_cast<std::ptrdiff_t>(k) * n;
    const double scaled = right[k] / row[k];
    for (int j = k + 1 + rank; j < n; j += size) right[j] -= row[j] * scaled;
    team.sync();
  }
  for (int k = n - 1; k >= 0; --k) {
    const double value = right[k] / matrix[static_cast<std::ptrdiff_t>(k) * n + k];
    if (rank == 0) solution[k] = value;
    for (int i = rank; i < k; i += size) {
      right[i] -= matrix[static_cast<std::ptrdiff_t>(i) * n + k] * value;
    }
    team.sync();
  }
}

/// Column `column` of the inverse, by one member alone: the team's members take a column each.
FIELD_PHENOTYPING_HD inline void columnOfInverse(const double* matrix, int n, int column,
                                                 double* values) {
  for (int k = 0; k < n; ++k) values[k] = k == column ? 1.0 : 0.0;
  for (int k = column; k < n; ++k) {
    const double* row = matrix + static_cast<std::ptrdiff_t>(k) * n;
    const double scaled = values[k] / row[k];
    for (int j = k + 1; j < n; ++j) values[j] -= row[j] * scaled;
  }
  for (int k = n - 1; k >= 0; --k) {
    const double* row = matrix + static_cast<std::ptrdiff_t>(k) * n;
    double sum = 0.0;
    for (int j = k + 1; j < n; ++j) sum += row[j] * values[j];
    values[k] = (values[k] - sum) / row[k];
  }
}

}  // namespace field_phenotyping
