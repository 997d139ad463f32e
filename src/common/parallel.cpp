#include "field_phenotyping/common/parallel.hpp"

#ifdef FIELD_PHENOTYPING_WITH_TBB
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <optional>
#endif

namespace field_phenotyping {

#ifdef FIELD_PHENOTYPING_WITH_TBB

namespace {

thread_local bool is_urgent = false;

/// Where urgent work is done; null where the task library knows no priorities.
tbb::task_arena* urgentArena() {
#if TBB_INTERFACE_VERSION >= 12010
  // Never taken down: threads may still be in it when the process ends.
  static tbb::task_arena* const arena =
      new tbb::task_arena(tbb::task_arena::automatic, 1U, tbb::task_arena::priority::high);
  return arena;
#else
  return nullptr;
#endif
}

/// Where the threads of the innermost limit work; none: TBB's own, of all cores. TBB also has a
/// limit for the whole process, but after one of a single thread it often stays with that thread.
std::atomic<tbb::task_arena*> limited{nullptr};

}  // namespace

void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task) {
  const auto run = [&] { tbb::parallel_for(std::size_t{0}, count, task); };
  tbb::task_arena* arena = limited.load();
  if (arena == nullptr && is_urgent) arena = urgentArena();
  if (arena != nullptr) {
    arena->execute(run);
  } else {
    run();
  }
}

struct ThreadLimit::Impl {
  explicit Impl(int threads) {
    if (threads > 0) arena.emplace(threads);
    outer = limited.exchange(arena ? &*arena : nullptr);
  }
  ~Impl() { limited.store(outer); }

  std::optional<tbb::task_arena> arena;
  tbb::task_arena* outer = nullptr;
};

ThreadLimit::ThreadLimit(int threads) : impl_(new Impl(threads)) {}

UrgentWork::UrgentWork() : outer_(is_urgent) {
  is_urgent = true;
}

UrgentWork::~UrgentWork() {
  is_urgent = outer_;
}

#else

void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task) {
  for (std::size_t i = 0; i < count; ++i) task(i);
}

struct ThreadLimit::Impl {};

ThreadLimit::ThreadLimit(int /*threads*/) : impl_(nullptr) {}

UrgentWork::UrgentWork() : outer_(false) {}

UrgentWork::~UrgentWork() = default;

#endif

ThreadLimit::~ThreadLimit() {
  delete impl_;
}

}  // namespace field_phenotyping
