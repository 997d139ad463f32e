#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

/// Sorts indices and leaves each in once: by their digits, which for thousands of them takes a
/// fraction of the time that comparisons take.
inline void sortUnique(std::vector<std::uint32_t>& indices) {
  constexpr unsigned kDigit = 11U;  // bits; counts of one digit fit the first cache
  constexpr std::size_t kDigits = std::size_t{1} << kDigit;
  constexpr std::size_t kFew = 512U;  // below it counting costs more than comparing
  if (indices.size() < kFew) {
    std::sort(indices.begin(), indices.end());
  } else {
    const std::uint32_t most = *std::max_element(indices.begin(), indices.end());
    std::vector<std::uint32_t> sorted(indices.size());
    for (unsigned shift = 0U; shift < 32U && (most >> shift) != 0U; shift += kDigit) {
      const auto digitOf = [&](std::uint32_t index) { return (index >> shift) & (kDigits - 1U); };
      std::array<std::uint32_t, kDigits> begin{};
      for (const std::uint32_t index : indices) ++begin[digitOf(index)];
      std::uint32_t before = 0U;
      for (std::uint32_t& count : begin) {
        const std::uint32_t of_digit = count;
        count = before;
        before += of_digit;
      }
      for (const std::uint32_t index : indices) sorted[begin[digitOf(index)]++] = index;
      indices.swap(sorted);
    }
  }
  indices.erase(std::unique(indices.begin(), indices.end()), indices.end());
}

}  // namespace field_phenotyping
