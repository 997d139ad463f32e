#include "field_phenotyping/common/nearest_name.hpp"

#include <algorithm>
#include <numeric>

namespace field_phenotyping {

std::size_t editDistance(const std::string& a, const std::string& b) {
  // One row of the table at a time: row[j] is the distance from a's first i characters to b's first
  // j.
  std::vector<std::size_t> row(b.size() + 1U);
  std::iota(row.begin(), row.end(), 0U);
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({above + 1U, row[j - 1U] + 1U, diagonal + (a[i - 1U] != b[j - 1U])});
      diagonal = above;
    }
  }
  return row.back();
}

const std::string& nearestName(const std::string& name, const std::vector<std::string>& names) {
  return *std::min_element(names.begin(), names.end(),
                           [&](const std::string& a, const std::string& b) {
                             return editDistance(name, a) < editDistance(name, b);
                           });
}

}  // namespace field_phenotyping
