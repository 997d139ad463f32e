#include <gtest/gtest.h>

#include <random>
#include <set>

#include "field_phenotyping/common/sorted_indices.hpp"

namespace field_phenotyping {
namespace {

TEST(SortUnique, LikeASet) {
  std::mt19937 random(1U);
  // Few and many, with many and hardly any twice, of one digit and of all.
  for (const std::size_t count : {0U, 1U, 2U, 511U, 512U, 5000U}) {
    for (const std::uint32_t most : {0U, 1U, 100U, 2047U, 2048U, 4194304U, 4294967295U}) {
      std::uniform_int_distribution<std::uint32_t> any(0U, most);
      std::vector<std::uint32_t> indices(count);
      for (std::uint32_t& index : indices) index = any(random);
      const std::set<std::uint32_t> expected(indices.begin(), indices.end());
      sortUnique(indices);
      EXPECT_EQ(indices, std::vector<std::uint32_t>(expected.begin(), expected.end()))
          << count << " up to " << most;
    }
  }
}

}  // namespace
}  // namespace field_phenotyping
