#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace field_phenotyping {

/// Values by 64-bit key, in one piece of memory: many times faster to fill and to ask than a map of
/// nodes. Any key but the largest number; none can be taken out. Not thread-safe while it is
/// filled.
template <class Value>
class KeyMap {
 public:
  /// The value of `key`, put there if there is none yet, and whether it was put there. The address
  /// holds until the next insertion.
  std::pair<Value*, bool> tryEmplace(std::uint64_t key, const Value& value) {
    if (2U * (size_ + 1U) > slots_.size()) grow(slots_.empty() ? kLeast : 2U * slots_.size());
    Slot& slot = slots_[slotOf(key)];
    const bool is_new = slot.key == kFree;
    if (is_new) {
      slot = {key, value};
      ++size_;
    }
    return {&slot.value, is_new};
  }

  /// Null where there is none.
  const Value* find(std::uint64_t key) const {
    if (slots_.empty()) return nullptr;
    const Slot& slot = slots_[slotOf(key)];
    return slot.key == kFree ? nullptr : &slot.value;
  }

  /// Has memory fetched that find() and tryEmplace() will need, while other keys are asked for:
  /// many times faster where the map is larger than the caches.
  void prefetch(std::uint64_t key) const {
    if (!slots_.empty()) __builtin_prefetch(&slots_[homeOf(key)]);
  }

  std::size_t size() const { return size_; }

  /// Makes room for so many keys in all: until then insertions move nothing.
  void reserve(std::size_t keys) {
    std::size_t slots = kLeast;
    while (2U * keys > slots) slots *= 2U;
    if (slots > slots_.size()) grow(slots);
  }

 private:
  static constexpr std::size_t kLeast = 64U;  // slots
  static constexpr std::uint64_t kFree = ~std::uint64_t{0};
  struct Slot {
    std::uint64_t key = kFree;
    Value value{};
  };

  /// Where the search for the key begins.
  std::size_t homeOf(std::uint64_t key) const {
    constexpr std::uint64_t kGolden = 0x9E3779B97F4A7C15U;  // scatters neighbouring keys
    return static_cast<std::size_t>((key * kGolden) >> shift_);
  }

  /// Where the key is, or where it would go.
  std::size_t slotOf(std::uint64_t key) const {
    std::size_t at = homeOf(key);
    while (slots_[at].key != kFree && slots_[at].key != key) {
      at = (at + 1U) & (slots_.size() - 1U);
    }
    return at;
  }

  /// @param slots a power of two
  void grow(std::size_t slots) {
    std::vector<Slot> old(slots);
    old.swap(slots_);
    shift_ = 64U;
    for (std::size_t k = slots; k > 1U; k /= 2U) --shift_;
    for (const Slot& slot : old) {
      if (slot.key != kFree) slots_[slotOf(slot.key)] = slot;
    }
  }

  std::vector<Slot> slots_;  // at most half full
  std::size_t size_ = 0U;
  unsigned shift_ = 64U;  // of the hash, to the index of a slot
};

}  // namespace field_phenotyping
