#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {

/// Items in partitions that are then worked one by one, the first pass of a radix sort on all
/// cores: each thread sorts chunks of the items, so that nothing waits for the count of all.
template <class Item>
class Partitioned {
 public:
  /// @param count      of items
  /// @param partitions that they go to
  /// @param deal       deal(begin, end, give) calls give(partition, item) for the items number
  ///                   `begin` ... `end` - 1, in their order; called for several chunks at once
  template <class Deal>
  Partitioned(std::size_t count, std::size_t partitions, const Deal& deal)
      : partitions_(partitions), chunks_(chunksOf(count, kChunk)) {
    parallelChunks(count, kChunk, [&](std::size_t begin, std::size_t end) {
      fill(chunks_[begin / kChunk], begin, end, deal);
    });
  }

  std::size_t partitions() const { return partitions_; }

  /// How many items are in one.
  std::size_t sizeOf(std::size_t partition) const {
    std::size_t size = 0U;
    for (const Chunk& chunk : chunks_) size += chunk.begin[partition + 1U] - chunk.begin[partition];
    return size;
  }

  /// Calls visit(item) for the items of one, in their order.
  template <class Visit>
  void forEachOf(std::size_t partition, const Visit& visit) const {
    for (const Chunk& chunk : chunks_) {
      for (std::uint32_t k = chunk.begin[partition]; k < chunk.begin[partition + 1U]; ++k) {
        visit(chunk.items[k]);
      }
    }
  }
  template <class Visit>
  void forEachOf(std::size_t partition, const Visit& visit) {
    for (Chunk& chunk : chunks_) {
      for (std::uint32_t k = chunk.begin[partition]; k < chunk.begin[partition + 1U]; ++k) {
        visit(chunk.items[k]);
      }
    }
  }

  /// The same, the last item first.
  template <class Visit>
  void forEachBackwards(std::size_t partition, const Visit& visit) const {
    for (auto chunk = chunks_.rbegin(); chunk != chunks_.rend(); ++chunk) {
      for (std::uint32_t k = chunk->begin[partition + 1U]; k > chunk->begin[partition]; --k) {
        visit(chunk->items[k - 1U]);
      }
    }
  }

 private:
  static constexpr std::size_t kChunk = 16384U;  // items: they fit the processor's cache
  struct Chunk {
    std::vector<Item> items;           // by partition
    std::vector<std::uint32_t> begin;  // of each partition, with the end of the last
  };

  template <class Deal>
  void fill(Chunk& chunk, std::size_t begin, std::size_t end, const Deal& deal) const {
    std::vector<Item> items(end - begin);
    std::vector<std::uint32_t> partition_of(end - begin);
    chunk.begin.assign(partitions_ + 2U, 0U);
    std::size_t given = 0U;
    deal(begin, end, [&](std::size_t partition, const Item& item) {
      items[given] = item;
      partition_of[given] = static_cast<std::uint32_t>(partition);
      ++chunk.begin[partition + 2U];
      ++given;
    });
    if (partitions_ == 1U) {
      chunk.items = std::move(items);
      chunk.begin = {0U, static_cast<std::uint32_t>(given)};
      return;
    }
    for (std::size_t p = 2U; p < chunk.begin.size(); ++p) chunk.begin[p] += chunk.begin[p - 1U];
    // Where each begins is counted on while it is filled, to where the next one begins.
    chunk.items.resize(items.size());
    for (std::size_t k = 0; k < items.size(); ++k) {
      chunk.items[chunk.begin[partition_of[k] + 1U]++] = items[k];
    }
    chunk.begin.pop_back();
  }

  std::size_t partitions_;
  std::vector<Chunk> chunks_;
};

}  // namespace field_phenotyping
