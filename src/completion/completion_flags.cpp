#include "field_phenotyping/completion/completion_flags.hpp"

#include "field_phenotyping/common/flag_names.hpp"

namespace field_phenotyping {

std::string completionFlagNames(std::uint8_t flags) {
  static constexpr FlagName kNames[] = {
      {kCompletionTooFewPoints, "too_few_points"},
      {kCompletionNoSurface, "no_surface"},
      {kCompletionOpenGap, "open_gap"},
      {kCompletionUncertain, "uncertain"},
      {kCompletionSeenEmpty, "seen_empty"},
  };
  return joinFlagNames(flags, kNames);
}

}  // namespace field_phenotyping
