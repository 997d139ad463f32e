#pragma once

#include <cmath>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"

// The splines of the coarse model of a stem, see SurfacePrior, in plain numbers, for the CPU and
// the GPU.

namespace field_phenotyping {

/// Weight of a residual in standard deviations (Tukey's biweight). What it cuts off are leaf bases;
/// and with this reach the inverse of the normal matrix is the covariance of the fit.
FIELD_PHENOTYPING_HD inline double tukeyWeight(double residual) {
  constexpr double kTukey = 3.5;
  const double u = residual / kTukey;
  return magnitudeOf(u) < 1.0 ? (1.0 - u * u) * (1.0 - u * u) : 0.0;
}

/// What noise in x and y does to the distance and the angle of points of a circle as seen from its
/// centre, with the weights of the fit: all in standard deviations of the noise. Of order sigma /
/// R, but where half of the circumference is hidden nothing else tells a shift from a smaller
/// radius.
struct NoiseEffect {
  double radius_bias = 0.0;      ///< mean distance beyond the circle
  double shift_bias = 0.0;       ///< the same, weighted by the cosine of the angle's error
  double ellipse_bias = 0.0;     ///< the same, by the cosine of twice that
  double median_residual = 1.0;  ///< median of |distance beyond the circle - radius_bias|

  static constexpr int kSteps = 32;  ///< of noise over radius, from 0: a table has one entry more
  static constexpr double kLeastRatio = 1.25;  ///< of radius over noise, where it ends

  /// @param table of kSteps + 1 entries
  /// @param ratio radius over noise; what is beyond the table is taken as its end
  FIELD_PHENOTYPING_HD static NoiseEffect at(const NoiseEffect* table, double ratio) {
    const double place =
        smallerOf(kSteps * kLeastRatio / largerOf(ratio, kLeastRatio), static_cast<double>(kSteps));
    const int low = static_cast<int>(smallerOf(place, kSteps - 1.0));
    const double share = place - low;
    const NoiseEffect& a = table[low];
    const NoiseEffect& b = table[low + 1];
    const auto mix = [&](double x, double y) { return x + share * (y - x); };
    return {mix(a.radius_bias, b.radius_bias), mix(a.shift_bias, b.shift_bias),
            mix(a.ellipse_bias, b.ellipse_bias), mix(a.median_residual, b.median_residual)};
  }
};

namespace coarse {

/// Numbers of a design row: the radius at a place as a linear function of the coefficients. Shift
/// u, shift v and radius of four control points, then the ellipse.
constexpr int kDesignSize = 14;
constexpr int kSplineSize = 12;
constexpr int kEllipseSize = 2;
constexpr int kMostIntervals = 36;

/// An arc length as the splines see it: the four uniform cubic B-splines that are not 0 there.
struct SplinePlace {
  int interval;
  double basis[4];
};

/// A place of the unrolled stem.
struct Place {
  SplinePlace along;
  Direction around;  ///< at the angle

  FIELD_PHENOTYPING_HD double cosineOfTwice() const {
    return around.x * around.x - around.y * around.y;
  }
  FIELD_PHENOTYPING_HD double sineOfTwice() const { return 2.0 * around.x * around.y; }
};

/// Where the coefficients are found: (shift u, shift v, radius) of each control point, then the two
/// of the ellipse.
struct Layout {
  int intervals = 1;
  double interval_length = 0.0;  ///< [m]

  FIELD_PHENOTYPING_HD int controls() const { return intervals + 3; }
  FIELD_PHENOTYPING_HD int size() const { return 3 * controls() + kEllipseSize; }
  FIELD_PHENOTYPING_HD int ellipse(int k) const { return 3 * controls() + k; }
  /// Which coefficient a number of the design row belongs to.
  FIELD_PHENOTYPING_HD int column(int interval, int k) const {
    return k < kSplineSize ? 3 * interval + k : ellipse(k - kSplineSize);
  }

  FIELD_PHENOTYPING_HD SplinePlace splines(double s) const {
    const double place =
        smallerOf(largerOf(s / interval_length, 0.0), static_cast<double>(intervals));
    const int whole = static_cast<int>(place);
    const int interval = whole < intervals ? whole : intervals - 1;
    const double t = place - interval;
    const double t2 = t * t;
    const double t3 = t2 * t;
    return {interval,
            {(1.0 - 3.0 * t + 3.0 * t2 - t3) / 6.0, (4.0 - 6.0 * t2 + 3.0 * t3) / 6.0,
             (1.0 + 3.0 * t + 3.0 * t2 - 3.0 * t3) / 6.0, t3 / 6.0}};
  }
};
constexpr int kMostCoefficients = 3 * (kMostIntervals + 3) + kEllipseSize;

/// @param offset 0: shift u; 1: shift v; 2: radius
FIELD_PHENOTYPING_HD inline double splineValue(const double* coefficients, int offset,
                                               const SplinePlace& place) {
  double value = 0.0;
  for (int i = 0; i < 4; ++i) {
    value += place.basis[i] * coefficients[3 * (place.interval + i) + offset];
  }
  return value;
}

/// R(s), which the ellipse is relative to [m].
FIELD_PHENOTYPING_HD inline double meanRadius(const double* coefficients,
                                              const SplinePlace& place) {
  return splineValue(coefficients, 2, place);
}

/// Radius of the surface: the shifts of the axis are 0 once it has been moved [m].
FIELD_PHENOTYPING_HD inline double surfaceRadius(const Layout& layout, const double* coefficients,
                                                 const Place& place) {
  return meanRadius(coefficients, place.along) *
         (1.0 + coefficients[layout.ellipse(0)] * place.cosineOfTwice() +
          coefficients[layout.ellipse(1)] * place.sineOfTwice());
}

/// @param row kDesignSize numbers
FIELD_PHENOTYPING_HD inline void fillDesignRow(const Place& place, double mean_radius,
                                               double* row) {
  for (std::size_t i = 0; i < 4U; ++i) {
    row[3U * i] = place.along.basis[i] * place.around.x;
    row[3U * i + 1U] = place.along.basis[i] * place.around.y;
    row[3U * i + 2U] = place.along.basis[i];
  }
  row[kSplineSize] = mean_radius * place.cosineOfTwice();
  row[kSplineSize + 1] = mean_radius * place.sineOfTwice();
}

/// Adds what a design row and those before it in a quadratic form come to, with loops unrolled.
/// @param covariance from the first coefficient of the splines on, `stride` numbers a row
/// @param ellipse where those of the ellipse are, from there
template <int kRow = 0>
FIELD_PHENOTYPING_HD inline void addForm(const double* row, const double* covariance, int ellipse,
                                         int stride, double& form) {
  if constexpr (kRow < kDesignSize) {
    const int at = kRow < kSplineSize ? kRow : ellipse + kRow - kSplineSize;
    const double* of_row = covariance + static_cast<std::ptrdiff_t>(at) * stride;
    double sum = 0.5 * row[kRow] * of_row[at];
    for (int b = 0; b < kRow; ++b) {
      sum += row[b] * of_row[b < kSplineSize ? b : ellipse + b - kSplineSize];
    }
    form += 2.0 * row[kRow] * sum;
    addForm<kRow + 1>(row, covariance, ellipse, stride, form);
  }
}

/// Variance of the radius at a place.
/// @param covariance of the coefficients, row by row; symmetric
FIELD_PHENOTYPING_HD inline double varianceAt(const Layout& layout, const double* coefficients,
                                              const Place& place, const double* covariance) {
  double row[kDesignSize];
  fillDesignRow(place, meanRadius(coefficients, place.along), row);
  const int first = 3 * place.along.interval;
  const int n = layout.size();
  double form = 0.0;
  addForm(row, covariance + static_cast<std::ptrdiff_t>(first) * (n + 1), layout.ellipse(0) - first,
          n, form);
  return form;
}

}  // namespace coarse
}  // namespace field_phenotyping
