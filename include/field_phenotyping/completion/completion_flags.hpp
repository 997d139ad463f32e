#pragma once

#include <cstdint>
#include <string>

namespace field_phenotyping {

/// Why a stem, or part of it, was left as it was measured. A bit mask; names in
/// `completionFlagNames`.
enum CompletionFlag : std::uint8_t {
  kCompletionTooFewPoints = 1U,  ///< fewer than min_points, or than 100 a metre
  kCompletionNoSurface = 2U,  ///< the points, or those of a stretch, lie on no one surface: a fork
  kCompletionOpenGap = 4U,    ///< a gap is longer than max_gap
  kCompletionUncertain = 8U,  ///< a part is known less well than max_stddev: one side only
  kCompletionSeenEmpty = 16U  ///< the sensor saw through a gap
};

/// Lower-case names of the flags that are set, joined by '|'; "ok" when none is.
std::string completionFlagNames(std::uint8_t flags);

}  // namespace field_phenotyping
