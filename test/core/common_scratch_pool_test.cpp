// Memory that blocks use one after the other, with memory of the host in the place of the GPU's.

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdlib>
#include <cstring>

#include "common/scratch_pool.hpp"

namespace field_phenotyping {
namespace {

/// Counts what is held, and has no more than it is told.
struct CountedMemory {
  static constexpr const char* kName = "counted memory";
  static inline std::size_t pieces = 0U;
  static inline std::size_t allocations = 0U;
  static inline std::size_t most = SIZE_MAX;

  static void* allocate(std::size_t bytes) {
    if (bytes > most) throw GpuError("out of counted memory", false);
    ++pieces;
    ++allocations;
    return std::malloc(bytes);
  }
  static void release(void* memory) noexcept {
    --pieces;
    std::free(memory);
  }
};

class ScratchPoolTest : public testing::Test {
 protected:
  ScratchPoolTest() {
    CountedMemory::allocations = 0U;
    CountedMemory::most = SIZE_MAX;
  }
  ~ScratchPoolTest() override { EXPECT_EQ(CountedMemory::pieces, 0U) << "memory was not released"; }
};

constexpr std::size_t kMegabyte = std::size_t{1} << 20U;

TEST_F(ScratchPoolTest, HandsOutPiecesThatDoNotOverlap) {
  ScratchPool<CountedMemory> pool(64U * kMegabyte);
  std::vector<std::pair<char*, std::size_t>> pieces;
  for (const std::size_t bytes : {std::size_t{1}, std::size_t{0}, std::size_t{300}, 3U * kMegabyte,
                                  std::size_t{257}, kMegabyte, std::size_t{5}}) {
    char* memory = pool.take(bytes);
    std::memset(memory, static_cast<int>(pieces.size()), bytes);
    pieces.emplace_back(memory, bytes);
  }
  for (std::size_t k = 0; k < pieces.size(); ++k) {
    for (std::size_t i = 0; i < pieces[k].second; ++i) {
      ASSERT_EQ(pieces[k].first[i], static_cast<char>(k));
    }
  }
}

TEST_F(ScratchPoolTest, IsUsedAgainWithoutAllocationOnceItIsLargeEnough) {
  ScratchPool<CountedMemory> pool(64U * kMegabyte);
  const auto work = [&] {
    for (int k = 0; k < 10; ++k) pool.take(kMegabyte + 1U);
    pool.reset();
  };
  work();
  const std::size_t after_first = CountedMemory::allocations;
  const std::size_t held = pool.held();
  for (int k = 0; k < 5; ++k) work();
  EXPECT_EQ(CountedMemory::allocations, after_first);
  EXPECT_EQ(CountedMemory::pieces, 1U);
  EXPECT_EQ(pool.held(), held);
}

TEST_F(ScratchPoolTest, GivesNoMoreThanItsLimit) {
  ScratchPool<CountedMemory> pool(4U * kMegabyte);
  EXPECT_THROW(pool.take(5U * kMegabyte), GpuError);
  EXPECT_THROW(pool.take(SIZE_MAX), GpuError);
  pool.take(3U * kMegabyte);
  try {
    pool.take(2U * kMegabyte);
    FAIL() << "beyond the limit";
  } catch (const GpuError& error) {
    EXPECT_FALSE(error.lasting());
    EXPECT_NE(std::string(error.what()).find("4 MiB"), std::string::npos);
  }
  EXPECT_NE(pool.take(kMegabyte), nullptr) << "what was refused is not held against it";
  pool.reset();
  EXPECT_LE(pool.held(), 4U * kMegabyte);
  EXPECT_NE(pool.take(4U * kMegabyte), nullptr);
}

TEST_F(ScratchPoolTest, GoesOnAfterThereWasNoMemory) {
  ScratchPool<CountedMemory> pool(64U * kMegabyte);
  char* before = pool.take(kMegabyte / 2U);
  std::memset(before, 1, kMegabyte / 2U);
  CountedMemory::most = kMegabyte;
  EXPECT_THROW(pool.take(8U * kMegabyte), GpuError);
  std::memset(pool.take(kMegabyte / 4U), 2, kMegabyte / 4U);
  EXPECT_EQ(before[0], 1) << "handed out twice";
  CountedMemory::most = SIZE_MAX;
  EXPECT_NE(pool.take(8U * kMegabyte), nullptr);
}

}  // namespace
}  // namespace field_phenotyping
