#include "field_phenotyping/common/parallel.hpp"

#ifdef FIELD_PHENOTYPING_WITH_TBB
#include <tbb/task_arena.h>

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>

#include "common/parallel_tasks.hpp"
#endif

namespace field_phenotyping {

#ifdef FIELD_PHENOTYPING_WITH_TBB

namespace {

thread_local bool is_urgent = false;

/// How many urgent calls of parallelFor() are under way.
class UrgentCalls {
 public:
  void enter() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++count_;
  }
  void leave() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      --count_;
    }
    changed_.notify_all();
  }
  void giveWay() {
    if (count_.load() == 0) return;
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait_for(lock, UrgentWork::kGivesWay, [this] { return count_.load() == 0; });
  }

 private:
  std::atomic<int> count_{0};
  std::mutex mutex_;
  std::condition_variable changed_;
};

/// Never taken down: threads may still be in it when the process ends.
UrgentCalls& urgentCalls() {
  static UrgentCalls* const calls = new UrgentCalls();
  return *calls;
}

/// One of them, however it ends.
class UrgentCall {
 public:
  UrgentCall() { urgentCalls().enter(); }
  ~UrgentCall() { urgentCalls().leave(); }
  UrgentCall(const UrgentCall&) = delete;
  UrgentCall& operator=(const UrgentCall&) = delete;
};

/// Of TBB's own threads, which leave for urgent work by themselves between two tasks.
bool isHelper() {
  return tbb::this_task_arena::current_thread_index() > 0;
}

/// Where urgent work is done; null where the task library knows no priorities.
tbb::task_arena* urgentArena() {
#if TBB_INTERFACE_VERSION >= 12010
  // Room for every thread that may have urgent work: one more would wait until another has left.
  constexpr unsigned kMostThreads = 8U;
  const int all =
      static_cast<int>(std::max(std::thread::hardware_concurrency(), 1U) + kMostThreads - 1U);
  // Never taken down: threads may still be in it when the process ends.
  static tbb::task_arena* const arena =
      new tbb::task_arena(all, kMostThreads, tbb::task_arena::priority::high);
  return arena;
#else
  return nullptr;
#endif
}

/// Where the threads of the innermost limit work; none: TBB's own, of all cores. TBB also has a
/// limit for the whole process, but after one of a single thread it often stays with that thread.
std::atomic<tbb::task_arena*> limited{nullptr};

}  // namespace

bool hasTaskLibrary() {
  return true;
}

void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task) {
  const std::function<void(std::size_t)> considerate = [&](std::size_t i) {
    if (!isHelper()) urgentCalls().giveWay();
    task(i);
  };
  std::optional<UrgentCall> call;
  if (is_urgent) call.emplace();
  const auto& chosen = is_urgent ? task : considerate;
  const auto run = [&] { runTasks(count, chosen); };
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

bool hasTaskLibrary() {
  return false;
}

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
