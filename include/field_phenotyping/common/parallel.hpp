#pragma once

#include <cstddef>
#include <functional>

namespace field_phenotyping {

/// Runs task(0) ... task(count - 1), on several cores where a task library was found at build time.
/// Tasks must not depend on one another; write results by index to keep them deterministic. The
/// first exception thrown by a task is rethrown.
void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task);

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

}  // namespace field_phenotyping
