#pragma once

#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace field_phenotyping {

/// Leaves numbers unset that no value is given for.
template <class Value>
struct UnsetAllocator : std::allocator<Value> {
  template <class Other>
  struct rebind {
    using other = UnsetAllocator<Other>;
  };
  template <class Other, class... Arguments>
  void construct(Other* place, Arguments&&... arguments) {
    if constexpr (sizeof...(Arguments) == 0U) {
      ::new (static_cast<void*>(place)) Other;
    } else {
      ::new (static_cast<void*>(place)) Other(std::forward<Arguments>(arguments)...);
    }
  }
};

/// A vector whose resize() leaves numbers unset: where all threads fill it, none has to touch all
/// of its memory before.
template <class Value>
using UnsetVector = std::vector<Value, UnsetAllocator<Value>>;

}  // namespace field_phenotyping
