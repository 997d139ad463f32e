#pragma once

#include <cmath>

#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/team.hpp"

// What the fits of a piece of stem have in common, in plain numbers, for the CPU and the GPU.

namespace field_phenotyping {

/// The parameters of a piece of stem as its fits solve for them. Metres; x and y lie across the
/// reference axis, heights along it. The surface is that of StemCrossSection, with S = r I + [c s;
/// s -c]; ellipticity, taper and its change are not divided by the radius here.
enum CrossSectionIndex {
  kCenter = 0,        ///< x, y [m]
  kTilt = 2,          ///< change of the center with height
  kCurvature = 4,     ///< with the square of height [1/m]
  kTwist = 6,         ///< with its cube [1/m^2]
  kRadius = 8,        ///< r [m]
  kTaper = 9,         ///< its change with height
  kTaperChange = 10,  ///< with the square of height [1/m]
  kEllipse = 11,      ///< c, s [m]
  kNoise = 13,        ///< logarithm of the noise [log m]
  kElongation = 14    ///< of the noise: logarithm of its part along the normal over that
};
constexpr int kCrossSectionSize = 15;

struct CrossSectionVector {
  double values[kCrossSectionSize] = {};

  FIELD_PHENOTYPING_HD double operator[](int i) const { return values[i]; }
  FIELD_PHENOTYPING_HD double& operator[](int i) { return values[i]; }
};

/// Noise below this share of the radius is not told from none.
constexpr double kLeastBlur = 1e-3;

/// One piece of stem to be fitted. All members of a team see the same memory.
struct CrossSectionPoints {
  const double* places;  ///< x, y, height; x, y, height; ...
  int count;
};

/// CrossSectionPrior in plain numbers. Where a standard deviation is not above 0, the value is not
/// known.
struct KnownOfStem {
  double noise;
  double log_noise;
  double log_noise_stddev;
  double elongation;
  double radius;
  double radius_stddev;
  double ellipticity_stddev;
  double taper;
  double taper_stddev;
  double taper_change;
  double taper_change_stddev;
};

/// What the points of a piece of stem look like before anything is fitted.
struct StemExtent {
  double reach = 0.0;           ///< largest distance from the reference axis [m]
  double width_variance = 0.0;  ///< across the stem, in the direction in which it is largest [m^2]
  double depth_variance = 0.0;  ///< across that [m^2]
};

/// The stem's axis at a height.
FIELD_PHENOTYPING_HD inline Direction centerAt(const CrossSectionVector& p, double height) {
  const auto along = [&](int i) {
    return p[kCenter + i] +
           height * (p[kTilt + i] + height * (p[kCurvature + i] + height * p[kTwist + i]));
  };
  return {along(0), along(1)};
}

/// At least a tenth of that at height 0, whatever the taper.
FIELD_PHENOTYPING_HD inline double radiusAt(const CrossSectionVector& p, double height) {
  return largerOf(p[kRadius] + height * (p[kTaper] + height * p[kTaperChange]), 0.1 * p[kRadius]);
}

// What a point says of the parameters it says of the ellipse at its height: how its place on the
// surface moves by a shift in x and y, by the radius, and by the two components of ellipticity; and
// of the noise and its elongation. These are local; a parameter moves one of them, with a power of
// height.
constexpr int kLocalShapeSize = 5;
constexpr int kLocalNoise = 5;
constexpr int kLocalElongation = 6;
constexpr int kLocalSize = 7;

/// How far a place of the surface moves along the direction (dx, dy) by each of the local shape.
/// @param u the place, as the unit vector of its parameter
FIELD_PHENOTYPING_HD inline void surfaceMotion(const Direction& u, double dx, double dy,
                                               double* motion) {
  motion[0] = dx;
  motion[1] = dy;
  motion[2] = u.x * dx + u.y * dy;
  motion[3] = u.x * dx - u.y * dy;
  motion[4] = u.x * dy + u.y * dx;
}

/// Powers of height that the parameters which move a local quantity go up to.
FIELD_PHENOTYPING_HD constexpr int highestPower(int local) {
  return local < 2 ? 3 : local == 2 ? 2 : 0;
}
/// The local quantity that a parameter moves, and the power of height with which it does.
FIELD_PHENOTYPING_HD constexpr int localOf(int parameter) {
  return parameter < kRadius ? parameter % 2 : parameter < kEllipse ? 2 : parameter - kEllipse + 3;
}
FIELD_PHENOTYPING_HD constexpr int powerOf(int parameter) {
  return parameter < kRadius ? parameter / 2 : parameter < kEllipse ? parameter - kRadius : 0;
}

constexpr int kPairs = pairOf(kLocalSize, 0);
/// Where its sums begin: one for each power of height.
FIELD_PHENOTYPING_HD constexpr int sumsOf(int a, int b) {
  int begin = 0;
  for (int i = 0; i <= a; ++i) {
    for (int j = 0; j <= i; ++j) {
      if (i == a && j == b) return begin;
      begin += highestPower(i) + highestPower(j) + 1;
    }
  }
  return begin;
}
/// Of a matrix of information over the parameters: many of its elements are the same sum over the
/// points.
constexpr int kInformationSums = sumsOf(kLocalSize, 0);
constexpr int kHeightPowers = 7;  ///< from 0

FIELD_PHENOTYPING_HD inline void powersOf(double height, double* powers) {
  powers[0] = 1.0;
  for (int k = 1; k < kHeightPowers; ++k) powers[k] = powers[k - 1] * height;
}

/// What an information sum adds up: a pair of local quantities, times a power of height.
struct InformationSum {
  int pair;
  int power;
};
FIELD_PHENOTYPING_HD inline InformationSum informationSum(int sum) {
  int begin = 0;
  for (int a = 0; a < kLocalSize; ++a) {
    for (int b = 0; b <= a; ++b) {
      const int powers = highestPower(a) + highestPower(b) + 1;
      if (sum < begin + powers) return {pairOf(a, b), sum - begin};
      begin += powers;
    }
  }
  return {0, 0};
}

/// Adds the first kSize local quantities' information, by pairOf(), to all sums.
template <int kSize, int kRow = 0, int kColumn = 0>
FIELD_PHENOTYPING_HD inline void addAllInformation(const double* local, const double* powers,
                                                   double* sums) {
  if constexpr (kRow < kSize) {
    constexpr int kBegin = sumsOf(kRow, kColumn);
    constexpr int kCount = highestPower(kRow) + highestPower(kColumn) + 1;
    const double value = local[pairOf(kRow, kColumn)];
    for (int k = 0; k < kCount; ++k) sums[kBegin + k] += powers[k] * value;
    constexpr bool kEndOfRow = kRow == kColumn;
    addAllInformation<kSize, kEndOfRow ? kRow + 1 : kRow, kEndOfRow ? 0 : kColumn + 1>(
        local, powers, sums);
  }
}

/// Adds one point's information to the sums that are a member's own.
/// @tparam kSize of the first so many local quantities
template <int kSize, class Team>
class InformationAdder {
 public:
  FIELD_PHENOTYPING_HD explicit InformationAdder(const Team& team)
      : rank_(static_cast<int>(team.rank())), size_(static_cast<int>(team.size())) {
    if constexpr (!Team::kAlone) {
      first_ = informationSum(rank_);
      second_ = informationSum(rank_ + size_);
    }
  }

  /// @tparam kFirst of the pairs of this local quantity and those after it
  /// @param local by pairOf()
  template <int kFirst = 0>
  FIELD_PHENOTYPING_HD void add(const double* local, const double* powers, double* sums) const {
    if constexpr (Team::kAlone) {
      addAllInformation<kSize, kFirst>(local, powers, sums);
    } else {
      addAll<kFirst>(
          1, [&](int /*k*/) { return local; }, [&](int /*k*/) { return powers; }, sums);
    }
  }

  /// The same for `count` points, by a team of several members.
  /// @param localAt, powersAt of a point, by its number
  template <int kFirst = 0, class LocalAt, class PowersAt>
  FIELD_PHENOTYPING_HD void addAll(int count, const LocalAt& localAt, const PowersAt& powersAt,
                                   double* sums) const {
    InformationSum own = first_;  // most have one sum or two
    for (int i = rank_; i < sumsOf(kSize, 0); i += size_) {
      if (i < sumsOf(kFirst, 0)) continue;
      if (i != rank_) own = i == rank_ + size_ ? second_ : informationSum(i);
      double sum = sums[i];
      for (int k = 0; k < count; ++k) sum += powersAt(k)[own.power] * localAt(k)[own.pair];
      sums[i] = sum;
    }
  }

 private:
  int rank_;
  int size_;
  InformationSum first_ = {};
  InformationSum second_ = {};
};

/// visit(i, j, number of the sum) for all elements i <= j of the matrix of information over the
/// parameters.
template <int kRow = 0, int kColumn = 0, class Visit>
FIELD_PHENOTYPING_HD inline void forEachInformation(const Visit& visit) {
  constexpr int kA = localOf(kRow);
  constexpr int kB = localOf(kColumn);
  constexpr int kPair = kA < kB ? sumsOf(kB, kA) : sumsOf(kA, kB);
  constexpr int kSum = kPair + powerOf(kRow) + powerOf(kColumn);
  visit(kRow, kColumn, kSum);
  if constexpr (kColumn + 1 < kCrossSectionSize) {
    forEachInformation<kRow, kColumn + 1>(visit);
  } else if constexpr (kRow + 1 < kCrossSectionSize) {
    forEachInformation<kRow + 1, kRow + 1>(visit);
  }
}

/// Keeps a step within what a local quadratic model can be trusted for.
FIELD_PHENOTYPING_HD inline void limitStep(const CrossSectionVector& parameters,
                                           CrossSectionVector& step) {
  const double radius = parameters[kRadius];
  const double length =
      largerOf(magnitudeOf(step[kRadius]), largerOf(lengthOf(step[kCenter], step[kCenter + 1]),
                                                    lengthOf(step[kEllipse], step[kEllipse + 1])));
  const double scale = smallerOf(1.0, smallerOf(0.2 * radius / largerOf(length, 1e-12),
                                                0.4 / largerOf(magnitudeOf(step[kNoise]), 1e-12)));
  for (double& value : step.values) value *= scale;
  const double low = logarithm(kLeastBlur * radius) - parameters[kNoise];
  const double high = logarithm(2.0 * radius) - parameters[kNoise];
  step[kNoise] = largerOf(smallerOf(step[kNoise], high), low);
  const double c = parameters[kEllipse] + step[kEllipse];
  const double s = parameters[kEllipse + 1] + step[kEllipse + 1];
  const double wished = lengthOf(c, s);
  const double most = 0.5 * (radius + step[kRadius]);
  if (wished > most) {
    step[kEllipse] = c * (most / wished) - parameters[kEllipse];
    step[kEllipse + 1] = s * (most / wished) - parameters[kEllipse + 1];
  }
}

FIELD_PHENOTYPING_HD inline bool isFinite(const CrossSectionVector& vector) {
  for (const double value : vector.values) {
    if (!(value - value == 0.0)) return false;
  }
  return true;
}

/// How far a step moves the surface [m].
FIELD_PHENOTYPING_HD inline double movedBy(const CrossSectionVector& step) {
  return lengthOf(step[kCenter], step[kCenter + 1]) + magnitudeOf(step[kRadius]) +
         lengthOf(step[kEllipse], step[kEllipse + 1]);
}

/// The priors as independent normal distributions, those that scale with the stem at its present
/// size.
struct ParameterPrior {
  CrossSectionVector mean;
  CrossSectionVector weight;  ///< inverse variances

  ParameterPrior() = default;
  FIELD_PHENOTYPING_HD ParameterPrior(const KnownOfStem& known, const StemExtent& extent,
                                      const CrossSectionVector& parameters) {
    // Weak priors that only matter where points are few or seen from one side. Whether half or all
    // of a stem is seen, its points are 2 r wide; of a quarter they are 1.2 r wide. As deep as wide
    // are those of a stem that is seen all round; those of half of one are less than half as deep.
    constexpr double kSizeOfFlat = 1.2;  // relative to what the width says of a half or whole one
    constexpr double kSizeStddev = 0.4;  // the same
    constexpr double kFlat = 0.25;       // share of the depth's variance in the width's
    constexpr double kRound = 0.6;
    constexpr double kTiltStddev = 0.3;
    constexpr double kCurvatureStddev = 0.5;  // [1/m]
    constexpr double kTwistStddev = 0.3;      // [1/m^2]
    constexpr double kNoiseMean = 0.2;        // relative to the radius
    constexpr double kLogNoiseStddev = 1.0;
    constexpr double kLogNoiseKnown = 1e-3;
    // Not left to the points: what they lie like along the surface is not known either.
    constexpr double kElongationKnown = 1e-3;
    const double radius = parameters[kRadius];
    set(kTilt, 2, 0.0, kTiltStddev);
    set(kCurvature, 2, 0.0, kCurvatureStddev);
    set(kTwist, 2, 0.0, kTwistStddev);
    const double noise = exponential(parameters[kNoise]);
    const double variance = extent.width_variance;
    const double wide = largerOf(variance - noise * noise, 0.25 * variance);
    const double size = std::sqrt(2.0 * wide);
    if (known.radius_stddev > 0.0) {
      set(kRadius, 1, known.radius, known.radius_stddev);
    } else {
      const double roundness = (extent.depth_variance - noise * noise) / wide;
      const double of_round = (roundness - kFlat) / (kRound - kFlat);
      const double mean =
          kSizeOfFlat + (1.0 - kSizeOfFlat) * smallerOf(largerOf(of_round, 0.0), 1.0);
      set(kRadius, 1, mean * size, kSizeStddev * size);
    }
    set(kTaper, 1, known.taper * radius, known.taper_stddev * radius);
    set(kTaperChange, 1, known.taper_change * radius, known.taper_change_stddev * radius);
    set(kEllipse, 2, 0.0, largerOf(known.ellipticity_stddev, 1e-4) * radius);
    set(kElongation, 1, known.elongation, kElongationKnown);
    if (known.noise > 0.0) {
      set(kNoise, 1, logarithm(largerOf(known.noise, kLeastBlur * radius)), kLogNoiseKnown);
    } else if (known.log_noise_stddev > 0.0) {
      set(kNoise, 1, known.log_noise, known.log_noise_stddev);
    } else {
      set(kNoise, 1, logarithm(kNoiseMean * radius), kLogNoiseStddev);
    }
  }

  /// Logarithm of their density, up to a constant.
  FIELD_PHENOTYPING_HD double valueAt(const CrossSectionVector& parameters) const {
    double sum = 0.0;
    for (int i = 0; i < kCrossSectionSize; ++i) {
      const double deviation = parameters[i] - mean[i];
      sum -= 0.5 * weight[i] * deviation * deviation;
    }
    return sum;
  }
  FIELD_PHENOTYPING_HD double scoreOf(const CrossSectionVector& parameters, int i) const {
    return -weight[i] * (parameters[i] - mean[i]);
  }

 private:
  FIELD_PHENOTYPING_HD void set(int first, int size, double value, double stddev) {
    for (int i = first; i < first + size; ++i) {
      mean[i] = value;
      weight[i] = 1.0 / (stddev * stddev);
    }
  }
};

/// How many of the parameters before the noise the points, not the priors, decide. All members get
/// it.
/// @param factored their information, by teamFactor()
/// @param scratch kCrossSectionSize numbers; all members see the same memory
template <class Team>
FIELD_PHENOTYPING_HD double fittedParameters(const Team& team, const double* factored,
                                             const ParameterPrior& prior, double* scratch) {
  team.sync();  // the scratch is free
  for (int r = static_cast<int>(team.rank()); r < kNoise; r += static_cast<int>(team.size())) {
    // The diagonal of the inverse, by which the prior's part of the variance is known.
    double column[kCrossSectionSize] = {};
    column[r] = 1.0;
    double variance = 0.0;
    for (int k = r; k < kCrossSectionSize; ++k) {
      const double* row = factored + k * kCrossSectionSize;
      const double scaled = column[k] / row[k];
      variance += column[k] * scaled;
      for (int j = k + 1; j < kCrossSectionSize; ++j) column[j] -= row[j] * scaled;
    }
    scratch[r] = prior.weight[r] * variance;
  }
  team.sync();
  double fitted = kNoise;
  for (int r = 0; r < kNoise; ++r) fitted -= scratch[r];
  team.sync();
  return fitted;
}

}  // namespace field_phenotyping
