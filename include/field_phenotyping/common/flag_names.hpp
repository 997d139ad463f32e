#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace field_phenotyping {

/// One bit of a mask and what it is called.
struct FlagName {
  std::uint32_t flag;
  const char* name;
};

/// Names of the flags that are set, in the order given, joined by '|'; "ok" when none is.
template <std::size_t N>
std::string joinFlagNames(std::uint32_t flags, const FlagName (&names)[N]) {
  std::string joined;
  for (const FlagName& name : names) {
    if ((flags & name.flag) == 0U) continue;
    if (!joined.empty()) joined += '|';
    joined += name.name;
  }
  return joined.empty() ? "ok" : joined;
}

}  // namespace field_phenotyping
