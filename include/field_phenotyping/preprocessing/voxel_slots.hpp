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
    bits_ = 6U;
    while (!holds(std::size_t{1} << bits_, voxels)) ++bits_;
    slots_.assign(std::size_t{1} << bits_, kFree);
    for (known_ = 0U; known_ < keys.size(); ++known_) {
      const std::uint64_t hash = hashOf(keys[known_]);
      std::size_t at = homeOf(hash);
      while (slots_[at] != kFree) at = next(at);
      slots_[at] = tagOf(hash) | static_cast<std::uint32_t>(known_);
    }
  }

  /// Has the slot of a key brought near, for find() a little later.
  void fetch(std::uint64_t hash) const { __builtin_prefetch(&slots_[homeOf(hash)], 1); }

  /// Number of the key's voxel: that of the next one where it has none yet, for which there must be
  /// room. The caller then adds its key.
  std::uint32_t find(std::uint64_t key, std::uint64_t hash,
                     const std::vector<std::uint64_t>& keys) {
    const std::uint32_t tag = tagOf(hash);
    const std::uint32_t numbers = mask();
    for (std::size_t at = homeOf(hash);; at = next(at)) {
      const std::uint32_t slot = slots_[at];
      if (slot == kFree) {
        const auto voxel = static_cast<std::uint32_t>(known_++);
        slots_[at] = tag | voxel;
        return voxel;
      }
      const std::uint32_t voxel = slot & numbers;
      if (slot - voxel == tag && keys[voxel] == key) return voxel;
    }
  }

 private:
  static constexpr std::uint32_t kFree = ~std::uint32_t{0};

  std::uint32_t mask() const { return static_cast<std::uint32_t>(slots_.size() - 1U); }
  std::size_t homeOf(std::uint64_t hash) const { return hash >> (64U - bits_); }
  /// What tells nearly all other keys without a look at theirs: bits of the hash that do not choose
  /// the slot, where a voxel's number, which is less than the slots', has none.
  std::uint32_t tagOf(std::uint64_t hash) const {
    return static_cast<std::uint32_t>(hash << bits_ >> 32U) & ~mask();
  }
  std::size_t next(std::size_t at) const { return (at + 1U) & (slots_.size() - 1U); }
  /// At most half full.
  static bool holds(std::size_t slots, std::size_t voxels) { return slots >= 2U * voxels; }

  std::vector<std::uint32_t> slots_;  // tag and number of a voxel
  std::size_t known_ = 0U;            // voxels
  unsigned bits_ = 0U;                // of a slot's index, which are those of a number
};

}  // namespace field_phenotyping
