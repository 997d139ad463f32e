#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace field_phenotyping {

/// Fewest characters to insert, delete or replace to make `b` of `a` (Levenshtein).
std::size_t editDistance(const std::string& a, const std::string& b);

/// The one of `names` that `name` was most likely meant to be: the nearest by editDistance(), the
/// first of equally near ones. `names` must not be empty.
const std::string& nearestName(const std::string& name, const std::vector<std::string>& names);

}  // namespace field_phenotyping
