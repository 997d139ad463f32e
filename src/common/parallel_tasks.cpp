#ifdef FIELD_PHENOTYPING_WITH_TBB
#include "common/parallel_tasks.hpp"

#include <tbb/parallel_for.h>

#ifdef FIELD_PHENOTYPING_THREAD_SANITIZER
#include <sanitizer/tsan_interface.h>
#endif

namespace field_phenotyping {
namespace {

/// Tells ThreadSanitizer, which does not see into a task library that is not built with it, what
/// that promises: what was done before all tasks, they see, and what they do is seen after them.
class TaskOrder {
 public:
  TaskOrder() { release(&before_); }
  ~TaskOrder() { acquire(&after_); }
  TaskOrder(const TaskOrder&) = delete;
  TaskOrder& operator=(const TaskOrder&) = delete;

  /// Lives while a task is at work, however that ends.
  class Task {
   public:
    explicit Task(TaskOrder& order) : order_(order) { acquire(&order_.before_); }
    ~Task() { release(&order_.after_); }
    Task(const Task&) = delete;
    Task& operator=(const Task&) = delete;

   private:
    TaskOrder& order_;
  };

 private:
#ifdef FIELD_PHENOTYPING_THREAD_SANITIZER
  static void acquire(char* moment) {
    __tsan_acquire(moment);
  }
  static void release(char* moment) {
    __tsan_release(moment);
  }
#else
  static void acquire(char* /*moment*/) {}
  static void release(char* /*moment*/) {}
#endif

  char before_ = 0;
  char after_ = 0;
};

}  // namespace

void runTasks(std::size_t count, const std::function<void(std::size_t)>& task) {
  TaskOrder order;
  tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
    const TaskOrder::Task one(order);
    task(i);
  });
}

}  // namespace field_phenotyping
#endif
