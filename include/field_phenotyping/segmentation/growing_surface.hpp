#pragma once

#include <cmath>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

/// Where a point lies about a midline.
struct SurfaceSighting {
  float cosine;     ///< of the azimuth, from x
  float sine;       ///< from x towards y
  float departure;  ///< beyond the midline's radius, share of it; without noise's bias
};

/// What points round one place say of a stem's surface: sums over them.
struct SurfaceEvidence {
  static constexpr int kTerms = 5;  // mean; cosine and sine of theta; of 2 theta
  static constexpr int kPairs = pairOf(kTerms, 0);
  static constexpr int kSums = kPairs + kTerms + 1;

  /// Of pairs of terms, of terms with what the points lie beyond the expected surface, and the
  /// evidence that they lie on it.
  double sums[kSums];

  FIELD_PHENOTYPING_HD double evidence() const { return sums[kSums - 1]; }
};

/// The surface of a stem, completed while the stem grows (paper 2.6.1): each region that grows
/// brings it up to date, and what it expects further up says whether the next region goes on from
/// those below.
///
/// The departure of r(theta, s) from the midline's radius, in shares of it, is interpolated by its
/// mean, shift and ellipse, which wander along the stem: a Kalman filter from the base up, that is
/// a Gaussian process with an exponential kernel along s. It begins as the coarse model that the
/// start points gave, the midline itself. On the CPU and on the GPU, with the same bits. Not
/// thread-safe.
class GrowingSurface {
 public:
  static constexpr int kTerms = SurfaceEvidence::kTerms;

  /// How a point compares with the expected surface.
  struct Residual {
    double terms[kTerms];
    double off;       ///< beyond it
    double evidence;  ///< logarithm of how much likelier it is to lie on the surface than anywhere
                      ///< within reach of it, as what crosses the axis by chance does
    bool counts;      ///< not so far off that it is left out
  };

  /// @param noise standard deviation of points about the surface, share of the radius
  FIELD_PHENOTYPING_HD explicit GrowingSurface(float noise)
      : noise_(largerOf(static_cast<double>(noise), kLeastNoise)),
        reach_(1.0 + kFarthest * std::sqrt(noise_ * noise_ + kMean * kMean + kShift * kShift +
                                           kEllipse * kEllipse)) {
    for (int a = 0; a < kTerms; ++a) {
      state_[a] = 0.0;
      for (int b = 0; b < kTerms; ++b) covariance_[a][b] = a == b ? coarseVariance(a) : 0.0;
    }
  }

  /// Carries the state up the stem. @param by arc length [m], >= 0
  FIELD_PHENOTYPING_HD void advance(float by) {
    const double kept = exponential(-static_cast<double>(by) / kAlike);
    for (int a = 0; a < kTerms; ++a) {
      state_[a] *= kept;
      for (int b = 0; b < kTerms; ++b) covariance_[a][b] *= kept * kept;
      covariance_[a][a] += (1.0 - kept * kept) * coarseVariance(a);
    }
  }

  FIELD_PHENOTYPING_HD Residual compare(const SurfaceSighting& point) const {
    const auto c = static_cast<double>(point.cosine);
    const auto s = static_cast<double>(point.sine);
    Residual residual{{1.0, c, s, c * c - s * s, 2.0 * c * s}, 0.0, 0.0, false};
    double expected = 0.0;
    double variance = noise_ * noise_;
    for (int a = 0; a < kTerms; ++a) {
      expected += residual.terms[a] * state_[a];
      double across = 0.0;
      for (int b = 0; b < a; ++b) across += covariance_[a][b] * residual.terms[b];
      variance += residual.terms[a] * (2.0 * across + covariance_[a][a] * residual.terms[a]);
    }
    residual.off = static_cast<double>(point.departure) - expected;
    const double squared = residual.off * residual.off;
    residual.counts = squared <= kFarthest * kFarthest * variance;
    constexpr double kLeast = 1e-3;  // radii: a point on the axis is no surface's
    const double distance = largerOf(1.0 + static_cast<double>(point.departure), kLeast);
    // The normal density on the surface, over that of the disc within reach.
    const double odds = reach_ * reach_ / (2.0 * distance);
    residual.evidence =
        -0.5 * squared / variance + 0.5 * logarithm(odds * odds / (kTwoPi * variance));
    return residual;
  }

  /// Takes in points round the place that was advanced to; those that do not count are left out of
  /// the sums but for the evidence.
  FIELD_PHENOTYPING_HD void update(const SurfaceEvidence& points) {
    const double per_noise = 1.0 / (noise_ * noise_);
    // (C^-1 + I)^-1 = (1 + C I)^-1 C, by elimination.
    double gain[kTerms][2 * kTerms];
    for (int a = 0; a < kTerms; ++a) {
      for (int b = 0; b < kTerms; ++b) {
        double sum = 0.0;
        for (int k = 0; k < kTerms; ++k) {
          sum += covariance_[a][k] * points.sums[k < b ? pairOf(b, k) : pairOf(k, b)];
        }
        gain[a][b] = (a == b ? 1.0 : 0.0) + sum * per_noise;
        gain[a][kTerms + b] = covariance_[a][b];
      }
    }
    eliminate(gain);
    double moved[kTerms];
    for (int a = 0; a < kTerms; ++a) {
      for (int b = 0; b < kTerms; ++b) {
        covariance_[a][b] = 0.5 * (gain[a][kTerms + b] + gain[b][kTerms + a]);
      }
    }
    for (int a = 0; a < kTerms; ++a) {
      moved[a] = 0.0;
      for (int b = 0; b < kTerms; ++b) {
        moved[a] += covariance_[a][b] * (per_noise * points.sums[SurfaceEvidence::kPairs + b]);
      }
    }
    for (int a = 0; a < kTerms; ++a) state_[a] += moved[a];
  }

  /// Longest gap along a stem of that radius [m] that its surface carries across [m]: as long as
  /// where it goes on, free to bend, still overlaps with where it was heading. For the CPU.
  static float longestCarried(float radius);

 private:
  static constexpr double kTwoPi = 6.28318530717958647692;

  // How surfaces of stems depart from their midlines: standard deviations, shares of the radius.
  static constexpr double kMean = 0.05;
  static constexpr double kShift = 0.08;
  static constexpr double kEllipse = 0.05;  // as in the coarse model of the completion
  static constexpr double kAlike = 0.25;    // [m] along which a departure stays about the same

  static constexpr double kLeastNoise = 0.01;  // share of the radius: no surface is smoother
  static constexpr double kFarthest = 2.5;     // standard deviations off the surface that a point
                                               // may lie

  FIELD_PHENOTYPING_HD static double coarseVariance(int term) {
    return term == 0 ? kMean * kMean : term < 3 ? kShift * kShift : kEllipse * kEllipse;
  }

  /// Makes the left half the identity, and the right half its inverse times what it was.
  FIELD_PHENOTYPING_HD static void eliminate(double (&rows)[kTerms][2 * kTerms]) {
    for (int k = 0; k < kTerms; ++k) {
      int most = k;
      for (int a = k + 1; a < kTerms; ++a) {
        if (magnitudeOf(rows[a][k]) > magnitudeOf(rows[most][k])) most = a;
      }
      for (int b = k; b < 2 * kTerms; ++b) {
        const double swapped = rows[k][b];
        rows[k][b] = rows[most][b];
        rows[most][b] = swapped;
      }
      const double inverse = 1.0 / rows[k][k];
      for (int b = k; b < 2 * kTerms; ++b) rows[k][b] *= inverse;
      for (int a = 0; a < kTerms; ++a) {
        if (a == k) continue;
        const double factor = rows[a][k];
        for (int b = k; b < 2 * kTerms; ++b) rows[a][b] -= factor * rows[k][b];
      }
    }
  }

  double noise_;
  double reach_;  // radii from the axis
  double state_[kTerms];
  double covariance_[kTerms][kTerms];
};

/// Adds up what points say of the surface: every sum is one member's, who adds in their order. All
/// members of the team see the same memory; the sums are complete once they have met.
template <class Team>
FIELD_PHENOTYPING_HD void addUp(const Team& team, const GrowingSurface::Residual* residuals,
                                int count, SurfaceEvidence& evidence) {
  constexpr int kTerms = GrowingSurface::kTerms;
  constexpr int kPairs = SurfaceEvidence::kPairs;
  constexpr int kLast = SurfaceEvidence::kSums - 1;
  double* const sums = evidence.sums;
  if constexpr (Team::kAlone) {
    for (int e = 0; e <= kLast; ++e) sums[e] = 0.0;
    for (int i = 0; i < count; ++i) {
      const GrowingSurface::Residual& residual = residuals[i];
      sums[kLast] += residual.evidence;
      if (!residual.counts) continue;
      for (int a = 0; a < kTerms; ++a) {
        for (int b = 0; b <= a; ++b) sums[pairOf(a, b)] += residual.terms[a] * residual.terms[b];
        sums[kPairs + a] += residual.off * residual.terms[a];
      }
    }
    return;
  }
  for (int e = static_cast<int>(team.rank()); e <= kLast; e += static_cast<int>(team.size())) {
    int a = 0;
    while (e < kPairs && pairOf(a + 1, 0) <= e) ++a;
    const int b = e - pairOf(a, 0);
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
      const GrowingSurface::Residual& residual = residuals[i];
      if (e == kLast) {
        sum += residual.evidence;
      } else if (residual.counts) {
        sum += e < kPairs ? residual.terms[a] * residual.terms[b]
                          : residual.off * residual.terms[e - kPairs];
      }
    }
    sums[e] = sum;
  }
}

}  // namespace field_phenotyping
