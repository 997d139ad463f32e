#pragma once

#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/common/team_envelope.hpp"
#include "field_phenotyping/completion/surface_index_view.hpp"

// The solution of an RbfSurface by a team of threads (see team.hpp), with the same bits whatever
// the team.

namespace field_phenotyping {

/// What an RbfSurface is solved from: its centres in order of z, and what belongs to each. The
/// memory is the caller's; all members of a team see the same.
struct RbfTask {
  SurfaceIndexView centers;
  const double* values;  ///< [m]
  const double* noise;   ///< variance of each value, relative to that of the surface
  double kernel_width;   ///< [m]
  double mean_area;      ///< of the surface, of a centre of weight 1 [m^2]
  double ridge;          ///< relative to the diagonal
};

namespace rbf {

constexpr double kPi = 3.14159265358979323846;
constexpr std::size_t kDensityNeighbors = 6;
constexpr double kMinWeight = 0.25;
constexpr double kMaxWeight = 4.0;
constexpr double kCutoff = 14.0;      // exp(-14) is below one part in a million
constexpr double kNegligible = 37.0;  // exp(-37) is lost in the rounding of a diagonal of 1

/// The kernel phi of Eq 19 as read, in its positive definite form.
FIELD_PHENOTYPING_HD inline double kernel(double squared_distance, double kernel_width,
                                          double weight_a, double weight_b) {
  const double mean_weight = 0.5 * (weight_a + weight_b);
  const double overlap = std::sqrt(weight_a * weight_b) / mean_weight;
  return overlap * std::sqrt(overlap) *
         exponential(-squared_distance / (kernel_width * kernel_width * mean_weight));
}

/// Area per centre, 1 / rho = pi r_k^2 / k [m^2].
FIELD_PHENOTYPING_HD inline double areaPerCenter(const SurfaceIndexView& centers,
                                                 const Vector3& place) {
  const auto nearest = centers.nearestWithin<kDensityNeighbors>(place, SurfaceIndexView::kInfinity);
  if (nearest.count == 0) return 0.0;
  return kPi * nearest.squared_distance[nearest.count - 1] / static_cast<double>(nearest.count);
}

FIELD_PHENOTYPING_HD inline double densityWeight(const RbfTask& task, const Vector3& place) {
  const double weight = areaPerCenter(task.centers, place) / task.mean_area;
  return smallerOf(largerOf(weight, kMinWeight), kMaxWeight);
}

/// How far from a centre of some weight another one is that says nothing of it [m].
FIELD_PHENOTYPING_HD inline double reachOf(double kernel_width, double weight, double exponent) {
  return kernel_width * std::sqrt(exponent * 0.5 * (weight + kMaxWeight));
}

/// @param weights, coefficients of the centres, as RbfSolver leaves them
FIELD_PHENOTYPING_HD inline double valueAt(const RbfTask& task, const double* weights,
                                           const double* coefficients, const Vector3& place) {
  if (task.centers.count == 0) return 0.0;
  const double weight = densityWeight(task, place);
  double value = 0.0;
  task.centers.forEachWithin(
      place, reachOf(task.kernel_width, weight, kCutoff),
      [&](std::size_t j, double squared_distance) {
        value += coefficients[j] * kernel(squared_distance, task.kernel_width, weight, weights[j]);
      });
  return value;
}

}  // namespace rbf

/// Finds the coefficients of one surface. Centres that lie farther apart along the stem than their
/// kernels reach say nothing of one another, so that the system is one of few columns beside the
/// diagonal.
template <class Team>
class RbfSolver {
 public:
  /// @param weights, coefficients of the centres: the result; all members see the same
  FIELD_PHENOTYPING_HD RbfSolver(const Team& team, const RbfTask& task, double* weights,
                                 double* coefficients)
      : team_(team),
        task_(task),
        weights_(weights),
        coefficients_(coefficients),
        count_(static_cast<int>(task.centers.count)) {}

  /// The weights, and how many columns beside the diagonal the system has; the same to all members.
  /// @param bands one for each member
  FIELD_PHENOTYPING_HD int prepare(int* bands) {
    for (int i = rank(); i < count_; i += size()) {
      weights_[i] = rbf::densityWeight(task_, task_.centers.points[i]);
    }
    team_.sync();
    int own = 0;
    for (int i = rank(); i < count_; i += size()) {
      const int reaching = i - firstOf(i);
      own = reaching > own ? reaching : own;
    }
    bands[rank()] = own;
    team_.sync();
    int band = 0;
    for (int k = 0; k < size(); ++k) band = bands[k] > band ? bands[k] : band;
    return band;
  }

  /// The coefficients; 0 where there is no solution. All may read them afterwards.
  /// @param matrix Envelope::valuesOf(count of centres, band, 0)
  FIELD_PHENOTYPING_HD void solve(double* matrix, int band) {
    const Envelope system{matrix, count_, band, 0};
    // Positive definite but for rounding, when centres coincide and the ridge is tiny.
    constexpr double kRaise = 10.0;
    constexpr double kMaxRidge = 1e3;
    bool is_solved = false;
    for (double ridge = task_.ridge; ridge < kMaxRidge && !is_solved; ridge *= kRaise) {
      assemble(system, ridge);
      team_.sync();
      is_solved = teamFactor(team_, system);
      team_.sync();  // before it is assembled again
    }
    for (int i = rank(); i < count_; i += size()) {
      coefficients_[i] = is_solved ? weights_[i] * task_.values[i] : 0.0;
    }
    team_.sync();
    if (!is_solved) return;
    teamSolve(team_, system, coefficients_);
    for (int i = rank(); i < count_; i += size()) coefficients_[i] *= weights_[i];
    team_.sync();
  }

 private:
  FIELD_PHENOTYPING_HD int rank() const { return static_cast<int>(team_.rank()); }
  FIELD_PHENOTYPING_HD int size() const { return static_cast<int>(team_.size()); }

  /// The first centre, in order, that says anything of this one.
  FIELD_PHENOTYPING_HD int firstOf(int i) const {
    const Vector3& place = task_.centers.points[i];
    const double squared_width = task_.kernel_width * task_.kernel_width;
    const double reach = rbf::reachOf(task_.kernel_width, weights_[i], rbf::kNegligible);
    int first = static_cast<int>(task_.centers.lowerBound(place.z() - reach));
    while (first < i &&
           (task_.centers.points[first] - place).squaredNorm() >
               rbf::kNegligible * squared_width * 0.5 * (weights_[first] + weights_[i])) {
      ++first;
    }
    return first;
  }

  /// The rows of Eq 21 with weights, ridge and noise.
  FIELD_PHENOTYPING_HD void assemble(const Envelope& system, double ridge) const {
    const int groups = static_cast<int>(team_.groups());
    const int group = static_cast<int>(team_.group());
    const int lanes = size() / groups;
    for (int i = group; i < count_; i += groups) {
      double* row = system.row(i);
      const double w = weights_[i];
      const Vector3& place = task_.centers.points[i];
      for (int j = system.first(i) + rank() - group * lanes; j < i; j += lanes) {
        row[j] = w * weights_[j] *
                 rbf::kernel((task_.centers.points[j] - place).squaredNorm(), task_.kernel_width, w,
                             weights_[j]);
      }
      if (team_.lanes().first()) row[i] = w * w * (1.0 + task_.noise[i]) + ridge;
    }
  }

  const Team& team_;
  const RbfTask& task_;
  double* weights_;
  double* coefficients_;
  int count_;
};

}  // namespace field_phenotyping
