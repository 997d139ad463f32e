#pragma once

#include <vector>

namespace field_phenotyping {

/// How long the stems of a stand are. They resemble one another, so a stem that shows its end badly
/// may take the one that the others make likely.
///
/// What a stem shows by itself is its length, or more: an axis easily runs on into the youngest
/// leaf or the tassel, hardly ever does it stop short. So the lengths shown are taken as normal
/// ones, of which a share has grown by an exponential excess (an ex-Gaussian mixture).
struct StandLength {
  double typical = 0.0;       ///< [m] along the stem
  double spread = 0.0;        ///< standard deviation of the plants [m]; 0 if too few stems say
  double excess = 0.0;        ///< mean of what an axis runs on by, if it does [m]
  double excess_share = 0.0;  ///< of the stems whose axis runs on

  bool known() const { return spread > 0.0; }

  /// Log of how much less likely a stem of that length is than a typical one; 0 if nothing is
  /// known. Heavy tails: some plants are just short.
  double logPrior(double length) const;

  /// The likeliest length [m] of a stem whose axis shows that length.
  double likelyLength(double shown) const;
};

/// Maximum likelihood over the lengths [m] that the stems of a block show. Unknown for few stems.
/// Deterministic; thread-safe.
StandLength fitStandLength(const std::vector<double>& shown);

}  // namespace field_phenotyping
