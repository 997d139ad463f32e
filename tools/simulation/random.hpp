#pragma once

#include <cmath>
#include <cstdint>

namespace field_phenotyping::simulation {

/// What a random stream is used for. Streams are independent of each other, so that a change of,
/// say, the sensor's noise leaves the plants as they were.
enum class Stream : std::uint64_t {
  kLayout = 1,
  kPlant = 2,
  kWeed = 3,
  kTerrain = 4,
  kRangeNoise = 5,
  kDropout = 6,
  kFootprint = 7,
  kThinning = 8,
  kPoseNoise = 9,
  kSway = 10,
  kPilot = 11,
};

/// @brief Bijective 64-bit hash (the finaliser of SplitMix64).
inline std::uint64_t hash64(std::uint64_t value) {
  value = (value ^ (value >> 30U)) * 0xbf58476d1ce4e5b9ULL;
  value = (value ^ (value >> 27U)) * 0x94d049bb133111ebULL;
  return value ^ (value >> 31U);
}

/// @brief Counter-based random numbers: a pure function of (seed, stream, index, draw), hence the
/// same on any number of threads. The standard library's distributions differ between vendors.
class RandomStream {
 public:
  RandomStream(std::uint64_t seed, Stream stream, std::uint64_t index)
      : key_(hash64(hash64(hash64(seed + kGolden) + static_cast<std::uint64_t>(stream)) + index)) {}

  /// @return 64 uniformly distributed bits.
  std::uint64_t bits() { return hash64(key_ + kGolden * ++draw_); }

  /// @return A number of [0, 1).
  double uniform() { return static_cast<double>(bits() >> 11U) * 0x1.0p-53; }

  /// @return A number of [low, high).
  double uniform(double low, double high) { return low + (high - low) * uniform(); }

  /// @return A draw of the standard normal distribution (Box-Muller).
  double normal() {
    const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
    return radius * std::cos(2.0 * M_PI * uniform());
  }

  /// @return A normal draw, redrawn until within `limit` standard deviations of the mean.
  double normal(double mean, double stddev, double limit = 2.5) {
    double draw = normal();
    while (std::abs(draw) > limit) {
      draw = normal();
    }
    return mean + stddev * draw;
  }

 private:
  static constexpr std::uint64_t kGolden = 0x9e3779b97f4a7c15ULL;
  std::uint64_t key_;
  std::uint64_t draw_ = 0;
};

}  // namespace field_phenotyping::simulation
