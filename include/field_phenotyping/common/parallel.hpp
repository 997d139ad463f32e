#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <functional>

namespace field_phenotyping {

/// Runs task(0) ... task(count - 1), on several cores where a task library was found at build time.
/// Tasks must not depend on one another; write results by index to keep them deterministic. The
/// first exception thrown by a task is rethrown.
void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task);

/// Whether a task library was found at build time.
bool hasTaskLibrary();

constexpr std::size_t chunksOf(std::size_t count, std::size_t size) {
  return (count + size - 1U) / size;
}

/// Runs task(begin, end) for every chunk of [0, count), `size` long but for the last: for work so
/// small that a task takes much of it. Else as parallelFor().
template <class Task>
void parallelChunks(std::size_t count, std::size_t size, const Task& task) {
  parallelFor(chunksOf(count, size),
              [&](std::size_t chunk) { task(chunk * size, std::min(count, (chunk + 1U) * size)); });
}

/// Limits parallelFor(), whoever calls it, to `threads` threads while it lives; 0 means all cores.
/// The innermost limit holds.
class ThreadLimit {
 public:
  explicit ThreadLimit(int threads);
  ~ThreadLimit();
  ThreadLimit(const ThreadLimit&) = delete;
  ThreadLimit& operator=(const ThreadLimit&) = delete;

 private:
  struct Impl;
  Impl* impl_;
};

/// While it lives, other threads help with what this thread calls parallelFor() for before they
/// help with what threads without one call it for, and those give way: before each of their tasks
/// they wait until no urgent call is under way, kGivesWay at most, so that they go on all the same
/// where there always is one. Where the task library knows no priorities (before oneTBB 2021)
/// threads help with both.
class UrgentWork {
 public:
  static constexpr std::chrono::milliseconds kGivesWay{30};

  UrgentWork();
  ~UrgentWork();
  UrgentWork(const UrgentWork&) = delete;
  UrgentWork& operator=(const UrgentWork&) = delete;

 private:
  bool outer_;
};

}  // namespace field_phenotyping
