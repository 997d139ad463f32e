#pragma once

#include <cstddef>
#include <functional>

namespace field_phenotyping {

/// Runs task(i) for every i in [0, count) by the task library, on threads of the arena that the
/// caller is in. A file of its own, so that it alone can be left out of ThreadSanitizer's sight.
void runTasks(std::size_t count, const std::function<void(std::size_t)>& task);

}  // namespace field_phenotyping
