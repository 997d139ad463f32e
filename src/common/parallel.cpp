#include "field_phenotyping/common/parallel.hpp"

#ifdef FIELD_PHENOTYPING_WITH_TBB
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#endif

namespace field_phenotyping {

#ifdef FIELD_PHENOTYPING_WITH_TBB

void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task) {
  tbb::parallel_for(std::size_t{0}, count, task);
}

struct ThreadLimit::Impl {
  tbb::global_control control;
};

ThreadLimit::ThreadLimit(int threads)
    : impl_(threads > 0 ? new Impl{tbb::global_control(tbb::global_control::max_allowed_parallelism,
                                                       static_cast<std::size_t>(threads))}
                        : nullptr) {}

#else

void parallelFor(std::size_t count, const std::function<void(std::size_t)>& task) {
  for (std::size_t i = 0; i < count; ++i) task(i);
}

struct ThreadLimit::Impl {};

ThreadLimit::ThreadLimit(int /*threads*/) : impl_(nullptr) {}

#endif

ThreadLimit::~ThreadLimit() {
  delete impl_;
}

}  // namespace field_phenotyping
