#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace field_phenotyping::benchmark {

/// Writes rows of figures as JSON. @throws std::runtime_error naming the file
void writeRows(const nlohmann::json& rows, const std::string& path);

}  // namespace field_phenotyping::benchmark
