#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace field_phenotyping {

/// The middle value, the upper one of two. `values` must not be empty.
template <class Value>
Value medianOf(std::vector<Value> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2U);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace field_phenotyping
