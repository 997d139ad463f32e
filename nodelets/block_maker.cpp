#include "block_maker.hpp"

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
  return waiting_.size() + (busy_ ? 1U : 0U);
}

void BlockMaker::run() {
  std::unique_lock<std::mutex> lock(mutex_);
  while (running_) {
    if (waiting_.empty()) {
      changed_.wait_for(lock, std::chrono::milliseconds(100));
    } else {
      Task task = std::move(waiting_.front());
      waiting_.pop_front();
      busy_ = true;
      lock.unlock();
      calls_.work(task);
      lock.lock();
      busy_ = false;
    }
    lock.unlock();
    calls_.idle();
    lock.lock();
  }
}

}  // namespace field_phenotyping
