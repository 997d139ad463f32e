#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {

/// Those i of [0, count) for which keep(i) is true, ascending, asked for on all cores: keep() is
/// called once for each, in ascending order within a chunk only. The same on any number of threads.
template <class Keep>
std::vector<std::uint32_t> indicesWhere(std::size_t count, const Keep& keep) {
  constexpr std::size_t kChunk = 16384U;
  std::vector<std::vector<std::uint32_t>> kept(chunksOf(count, kChunk));
  parallelChunks(count, kChunk, [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t>& own = kept[begin / kChunk];
    for (std::size_t i = begin; i < end; ++i) {
      if (keep(i)) own.push_back(static_cast<std::uint32_t>(i));
    }
  });
  if (kept.size() == 1U) return std::move(kept.front());
  std::vector<std::size_t> place(kept.size() + 1U, 0U);
  for (std::size_t c = 0; c < kept.size(); ++c) place[c + 1U] = place[c] + kept[c].size();
  std::vector<std::uint32_t> indices(place.back());
  parallelFor(kept.size(), [&](std::size_t c) {
    std::copy(kept[c].begin(), kept[c].end(),
              indices.begin() + static_cast<std::ptrdiff_t>(place[c]));
  });
  return indices;
}

/// The values that have these numbers, in their order, copied on all cores.
template <class Value>
std::vector<Value> valuesAt(const std::vector<Value>& values,
                            const std::vector<std::uint32_t>& indices) {
  constexpr std::size_t kChunk = 16384U;
  std::vector<Value> out(indices.size());
  parallelChunks(indices.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) out[k] = values[indices[k]];
  });
  return out;
}

}  // namespace field_phenotyping
