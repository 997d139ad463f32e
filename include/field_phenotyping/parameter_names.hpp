#pragma once

#include <cstddef>
#include <sstream>
#include <string>
#include <type_traits>
#include <vector>

#include "field_phenotyping/parameters.hpp"

// What to say of a parameter that is given wrongly, to the reader of YAML files and to the nodelets
// alike.

namespace field_phenotyping {

/// What values a parameter takes: "0.01 ... 1 m", "true or false", "robust or paper".
template <class Value>
std::string rangeText(const ParameterInfo& info, Value low, Value high) {
  std::ostringstream text;
  if constexpr (std::is_arithmetic_v<Value> && !std::is_same_v<Value, bool>) {
    text << low << " ... " << high;
  } else if constexpr (std::is_same_v<Value, bool>) {
    text << "true or false";
  } else {
    text << low << " or " << high;
  }
  if (info.unit[0] != '\0') text << " " << info.unit;
  return text.str();
}

/// What kind of value a parameter of type Value takes: "a number", "a whole number" ...
template <class Value>
const char* kindText() {
  if constexpr (std::is_same_v<Value, bool>) return "true or false";
  if constexpr (std::is_same_v<Value, int>) return "a whole number";
  if constexpr (std::is_same_v<Value, double>) return "a number";
  return "a word";
}

/// "there is no parameter 'segmentation/voxel_siz'; did you mean 'preprocessing/voxel_size'
/// (0.0005 ... 0.1 m)?" The nearest name is looked for among those of all stages; of equally near
/// ones that of `section` is taken.
/// @param others further names that are right in this section
std::string unknownParameter(const std::string& section, const std::string& name,
                             const std::vector<std::string>& others = {});

/// "there is no stage 'segmentaton'; did you mean 'segmentation'?"
std::string unknownStage(const std::string& name);

/// The stage whose name was most likely meant by `name`, if it is misspelt and near enough to one
/// to be meant for it; else "".
std::string misspeltStage(const std::string& name);

}  // namespace field_phenotyping
