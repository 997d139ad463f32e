#pragma once

#include <vector>

#include "field_phenotyping/segmentation/sampling_profile.hpp"

namespace field_phenotyping {

/// How long the stems of a stand are. They resemble one another, so a stem that shows its end badly
/// may take the one that the others make likely.
///
/// What a stem shows by itself is its length, or more: an axis easily runs on into the youngest
/// leaf or the tassel. It stops short where stems are hardly seen, and nowhere else. So the lengths
/// shown are taken as normal ones, of which a share has grown by an exponential excess, and some
/// have shrunk by an exponential deficit (ex-Gaussian mixtures).
struct StandLength {
  double typical = 0.0;       ///< [m] along the stem
  double spread = 0.0;        ///< standard deviation of the plants [m]; 0 if too few stems say
  double excess = 0.0;        ///< mean of what an axis runs on by, if it does [m]
  double excess_share = 0.0;  ///< of the stems whose axis runs on

  bool known() const { return spread > 0.0; }

  /// The same for plants taller by that factor.
  StandLength scaledBy(double factor) const;

  /// Log of how much less likely a stem of that length is than a typical one; 0 if nothing is
  /// known. Heavy tails: some plants are just short.
  double logPrior(double length) const;

  /// The same of a stem that is at most that long: 0 beyond the typical length.
  double logPriorWithin(double length) const;

  /// The likeliest length [m] of a stem whose axis shows that length.
  double likelyLength(double shown) const;
};

struct StandFit {
  StandLength stand;            ///< unknown for few stems
  double log_likelihood = 0.0;  ///< of all the lengths shown
};

/// Maximum likelihood over the lengths [m] that the stems of a block show. Deterministic;
/// thread-safe.
/// @param relative_spread of the stems, as a share of the typical length
/// @param short_share     of the stems that stop short, in [0, 1)
StandFit fitStandLength(const std::vector<double>& shown, double relative_spread,
                        double short_share = 0.0);

/// What the stand says of each of its stems: all are about as long, or a share of the height that
/// the canopy has there, whichever explains better what they show. Plots of different varieties
/// differ in height.
/// @param heights of the canopy at each stem [m], > 0
/// @param sampling of what stands that high
std::vector<StandLength> standLengths(const std::vector<double>& shown,
                                      const std::vector<double>& heights,
                                      const SamplingProfile& sampling = {});

}  // namespace field_phenotyping
