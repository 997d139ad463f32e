// The flat hash map against the standard library's.

#include <gtest/gtest.h>

#include <random>
#include <unordered_map>

#include "field_phenotyping/common/key_map.hpp"

namespace field_phenotyping {
namespace {

TEST(KeyMap, AsAMapOfNodes) {
  // Neighbouring keys, as voxels have them, and scattered ones; many come again.
  std::mt19937_64 random(7U);
  KeyMap<int> map;
  std::unordered_map<std::uint64_t, int> expected;
  EXPECT_EQ(map.find(3U), nullptr) << "nothing is in it";
  for (int i = 0; i < 20000; ++i) {
    const std::uint64_t key = i % 2 == 0 ? random() % 9000U : (random() % 500U) << 42U;
    const auto [value, is_new] = map.tryEmplace(key, i);
    const auto [entry, is_expected] = expected.try_emplace(key, i);
    EXPECT_EQ(is_new, is_expected);
    EXPECT_EQ(*value, entry->second);
    if (i % 7 == 0) *value = entry->second = -i;
  }
  EXPECT_EQ(map.size(), expected.size());
  for (const auto& [key, value] : expected) {
    ASSERT_NE(map.find(key), nullptr);
    EXPECT_EQ(*map.find(key), value);
  }
  EXPECT_EQ(map.find(std::uint64_t{1} << 60U), nullptr);
}

TEST(KeyMap, HoldsWhatItHeldOnceThereIsRoomForMore) {
  KeyMap<int> map;
  map.reserve(0U);
  for (int i = 0; i < 100; ++i) map.tryEmplace(static_cast<std::uint64_t>(7 * i), i);
  map.reserve(5000U);
  const int* first = map.tryEmplace(1U, -1).first;
  for (int i = 0; i < 4000; ++i) map.tryEmplace(static_cast<std::uint64_t>(7 * i), i);
  EXPECT_EQ(map.find(1U), first) << "nothing moved: there was room";
  EXPECT_EQ(map.size(), 4001U);
  for (int i = 0; i < 4000; ++i) {
    ASSERT_NE(map.find(static_cast<std::uint64_t>(7 * i)), nullptr);
    EXPECT_EQ(*map.find(static_cast<std::uint64_t>(7 * i)), i);
  }
}

}  // namespace
}  // namespace field_phenotyping
