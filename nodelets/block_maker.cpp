#include "block_maker.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

namespace field_phenotyping {

BlockMaker::BlockMaker(Calls calls) : calls_(std::move(calls)), thread_([this] { run(); }) {}

BlockMaker::~BlockMaker() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    running_ = false;
  }
  changed_.notify_all();
  thread_.join();
}

void BlockMaker::push(Task task) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting_.push_back(std::move(task));
  }
  changed_.notify_all();
}

std::size_t BlockMaker::pending() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return waiting_.size() + (at_work_ ? 1U : 0U);
}

bool BlockMaker::holdsOlderThan(std::uint64_t stamp_ns) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return (at_work_ && *at_work_ < stamp_ns) ||
         std::any_of(waiting_.begin(), waiting_.end(),
                     [&](const Task& task) { return task.points.header.stamp_ns < stamp_ns; });
}

void BlockMaker::run() {
  std::unique_lock<std::mutex> lock(mutex_);
  while (running_) {
    if (waiting_.empty()) {
      changed_.wait_for(lock, std::chrono::milliseconds(100));
    } else {
      Task task = std::move(waiting_.front());
      waiting_.pop_front();
      at_work_ = task.points.header.stamp_ns;
      lock.unlock();
      calls_.work(task);
      lock.lock();
      at_work_.reset();
    }
    lock.unlock();
    calls_.idle();
    lock.lock();
  }
}

}  // namespace field_phenotyping
