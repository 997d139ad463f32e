#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

/// The numbers of voxels by key: smaller than a KeyMap, for keys are where the voxels' owner has
/// them anyway, voxel after voxel. Not thread-safe.
class VoxelSlots {
 public:
  static std::uint64_t hashOf(std::uint64_t key) {
    constexpr std::uint64_t kGolden = 0x9E3779B97F4A7C15U;  // scatters neighbouring keys
    return key * kGolden;
  }

  /// Makes room for `more` voxels, at least, beside those that have `keys`: these alone are known
  /// afterwards, whatever was before.
  void makeRoom(const std::vector<std::uint64_t>& keys, std::size_t more) {
    const std::size_t voxels = keys.size() + more;
    if (known_ == keys.size() && holds(slots_.size(), voxels)) return;
    unsigned bits = 6U;
    while (!holds(std::size_t{1} << bits, voxels)) ++bits;
    slots_.assign(std::size_t{1} << bits, {kFree, 0U});
    shift_ = 64U - bits;
    for (known_ = 0U; known_ < keys.size(); ++known_) {
      const std::uint64_t hash = hashOf(keys[known_]);
      std::size_t at = hash >> shift_;
      while (slots_[at].voxel != kFree) at = next(at);
      slots_[at] = {static_cast<std::uint32_t>(known_), tagOf(hash)};
    }
  }

  /// Has the slot of a key brought near, for find() a little later.
  void fetch(std::uint64_t hash) const { __builtin_prefetch(&slots_[hash >> shift_], 1); }

  /// Number of the key's voxel: that of the next one where it has none yet, for which there must be
  /// room. The caller then adds its key.
  std::uint32_t find(std::uint64_t key, std::uint64_t hash,
                     const std::vector<std::uint64_t>& keys) {
    const std::uint32_t tag = tagOf(hash);
    std::size_t at = hash >> shift_;
    while (slots_[at].voxel != kFree && (slots_[at].tag != tag || keys[slots_[at].voxel] != key)) {
      at = next(at);
    }
    if (slots_[at].voxel == kFree) slots_[at] = {static_cast<std::uint32_t>(known_++), tag};
    return slots_[at].voxel;
  }

 private:
  static constexpr std::uint32_t kFree = ~std::uint32_t{0};
  struct Slot {
    std::uint32_t voxel;
    std::uint32_t tag;  // tells nearly all other keys without a look at theirs
  };

  static std::uint32_t tagOf(std::uint64_t hash) { return static_cast<std::uint32_t>(hash >> 16U); }
  std::size_t next(std::size_t at) const { return (at + 1U) & (slots_.size() - 1U); }
  /// At most two thirds full.
  static bool holds(std::size_t slots, std::size_t voxels) { return 2U * slots >= 3U * voxels; }

  std::vector<Slot> slots_;
  std::size_t known_ = 0U;  // voxels
  unsigned shift_ = 64U;
};

}  // namespace field_phenotyping
