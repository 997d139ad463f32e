// Work split over threads: everything once, exceptions come through, the limit holds.

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

TEST(ParallelFor, RunsEveryIndexOnce) {
  for (const std::size_t count : {0U, 1U, 2U, 7U, 1000U, 100000U}) {
    std::vector<std::atomic<int>> runs(count);
    parallelFor(count, [&](std::size_t i) { ++runs[i]; });
    for (std::size_t i = 0; i < count; ++i) ASSERT_EQ(runs[i], 1) << i << " of " << count;
  }
}

TEST(ParallelFor, Nests) {
  std::vector<std::vector<int>> cells(20U, std::vector<int>(50U, 0));
  parallelFor(cells.size(), [&](std::size_t row) {
    parallelFor(cells[row].size(),
                [&](std::size_t column) { cells[row][column] += static_cast<int>(row + column); });
  });
  for (std::size_t row = 0; row < cells.size(); ++row) {
    for (std::size_t column = 0; column < cells[row].size(); ++column) {
      ASSERT_EQ(cells[row][column], static_cast<int>(row + column));
    }
  }
}

TEST(ParallelFor, RethrowsWhatATaskThrows) {
  for (int repeat = 0; repeat < 20; ++repeat) {
    try {
      parallelFor(500U, [](std::size_t i) {
        if (i % 100U == 37U) throw std::runtime_error("task failed");
      });
      FAIL() << "nothing was thrown";
    } catch (const std::runtime_error& error) {
      EXPECT_STREQ(error.what(), "task failed");
    }
  }
  std::atomic<int> runs{0};
  parallelFor(100U, [&](std::size_t) { ++runs; });
  EXPECT_EQ(runs, 100) << "works again after a failure";
}

std::size_t threadsUsed() {
  std::mutex mutex;
  std::set<std::thread::id> threads;
  parallelFor(2000U, [&](std::size_t) {
    const std::lock_guard<std::mutex> lock(mutex);
    threads.insert(std::this_thread::get_id());
  });
  return threads.size();
}

TEST(ThreadLimit, OneThreadMeansTheCaller) {
  const ThreadLimit limit(1);
  std::set<std::thread::id> threads;
  parallelFor(500U, [&](std::size_t) { threads.insert(std::this_thread::get_id()); });
  EXPECT_EQ(threads, std::set<std::thread::id>{std::this_thread::get_id()});
}

TEST(ThreadLimit, BoundsTheThreadsAndEnds) {
  {
    const ThreadLimit limit(2);
    EXPECT_LE(threadsUsed(), 2U);
  }
  {
    const ThreadLimit all(0);
    EXPECT_GE(threadsUsed(), 1U);
  }
  // Nested limits: the inner one holds.
  const ThreadLimit outer(2);
  const ThreadLimit inner(1);
  EXPECT_EQ(threadsUsed(), 1U);
}

/// Whether two tasks can be under way at a time, which takes two threads.
bool tasksMeet() {
  std::atomic<int> under_way{0};
  std::atomic<bool> met{false};
  parallelFor(2U, [&](std::size_t) {
    ++under_way;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(5);
    while (under_way < 2 && std::chrono::steady_clock::now() < end) std::this_thread::yield();
    if (under_way == 2 && std::chrono::steady_clock::now() < end) met = true;
  });
  return met;
}

TEST(ThreadLimit, AllCoresWorkAfterAndWithinOne) {
  if (std::thread::hardware_concurrency() < 2U) GTEST_SKIP() << "one core only";
  for (int repeat = 0; repeat < 10; ++repeat) {
    {
      const ThreadLimit one(1);
      EXPECT_EQ(threadsUsed(), 1U);
      const ThreadLimit all(0);
      ASSERT_TRUE(tasksMeet()) << "in round " << repeat;
    }
    ASSERT_TRUE(tasksMeet()) << "in round " << repeat;
  }
}

TEST(UrgentWork, IsHelpedWhileOthersHaveWork) {
  if (std::thread::hardware_concurrency() < 2U) GTEST_SKIP() << "one core only";
  std::atomic<bool> done{false};
  const unsigned cores = std::thread::hardware_concurrency();
  std::vector<std::thread> others;
  for (unsigned k = 0; k + 1U < cores; ++k) {  // they would keep all threads to themselves
    others.emplace_back([&done] {
      while (!done) {
        parallelFor(
            2000U, [](std::size_t) { std::this_thread::sleep_for(std::chrono::microseconds(50)); });
      }
    });
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  int met = 0;
  constexpr int kRounds = 20;
  for (int round = 0; round < kRounds; ++round) {
    const UrgentWork urgent;
    met += tasksMeet() ? 1 : 0;
  }
  done = true;
  for (std::thread& other : others) other.join();
  EXPECT_EQ(met, kRounds);
}

/// How long a thread without urgent work takes for so many tasks that it does itself [s].
double secondsOfAnother(std::size_t tasks) {
  double seconds = 0.0;
  std::thread other([&] {
    const auto begin = std::chrono::steady_clock::now();
    for (std::size_t k = 0; k < tasks; ++k) parallelFor(1U, [](std::size_t) {});
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  });
  other.join();
  return seconds;
}

TEST(UrgentWork, OthersGiveWayToItsTasksButGoOn) {
  constexpr std::size_t kTasks = 20U;
  const double all_pauses =
      static_cast<double>(kTasks) * std::chrono::duration<double>(UrgentWork::kGivesWay).count();
  const UrgentWork urgent;
  double gave_way = 0.0;
  parallelFor(1U, [&](std::size_t) { gave_way = secondsOfAnother(kTasks); });
  EXPECT_GE(gave_way, all_pauses);
  EXPECT_LT(secondsOfAnother(kTasks), 0.5 * all_pauses) << "between them nobody needs to wait";
  EXPECT_THROW(parallelFor(1U, [](std::size_t) { throw std::runtime_error("task failed"); }),
               std::runtime_error);
  EXPECT_LT(secondsOfAnother(kTasks), 0.5 * all_pauses) << "nor after one that has failed";
}

TEST(UrgentWork, WaitsForNobody) {
  constexpr std::size_t kTasks = 20U;
  const double all_pauses =
      static_cast<double>(kTasks) * std::chrono::duration<double>(UrgentWork::kGivesWay).count();
  const UrgentWork urgent;
  const auto begin = std::chrono::steady_clock::now();
  parallelFor(1U, [](std::size_t) {
    for (std::size_t k = 0; k < kTasks; ++k) parallelFor(1U, [](std::size_t) {});
  });
  EXPECT_LT(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count(),
            0.5 * all_pauses);
}

}  // namespace
}  // namespace field_phenotyping
