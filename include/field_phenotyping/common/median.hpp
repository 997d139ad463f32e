#pragma once

#include <vector>

#include "field_phenotyping/common/order_statistic.hpp"

namespace field_phenotyping {

/// The middle value, the upper one of two. `values` must not be empty.
template <class Value>
Value medianOf(std::vector<Value> values) {
  return nthOf(values, values.size() / 2U);
}

}  // namespace field_phenotyping
