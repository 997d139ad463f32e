#pragma once

#include <string>
#include <vector>

#include "field_phenotyping/parameters.hpp"

namespace field_phenotyping {

/// Reads a YAML file of `stage: {parameter: value}` over `parameters`. What the file does not name
/// keeps its value.
/// @throws std::runtime_error for a name that does not exist (with the nearest that does), a value
/// of the wrong type or out of range
void readConfigFile(const std::string& path, Parameters& parameters);

/// Sets single parameters from `stage/parameter=value`.
/// @throws std::runtime_error as readConfigFile
void setParameters(const std::vector<std::string>& assignments, Parameters& parameters);

/// One line per parameter: name, default, unit, range, meaning.
std::string describeParameters();

}  // namespace field_phenotyping
