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
  return waiting_.size() + (at_work_.empty() ? 0U : 1U);
}

bool BlockMaker::holdsEarlierPass(const BlockIndex& index, std::uint64_t began_ns) const {
  const auto is_earlier = [&](const BlockHeader& tile) {
    return tile.stamp_ns < began_ns && areNeighbors(tile.index, index);
  };
  const std::lock_guard<std::mutex> lock(mutex_);
  return std::any_of(at_work_.begin(), at_work_.end(), is_earlier) ||
         std::any_of(waiting_.begin(), waiting_.end(), [&](const Task& task) {
           const std::vector<BlockHeader> tiles = task.points.tiles();
           return std::any_of(tiles.begin(), tiles.end(), is_earlier);
         });
}

void BlockMaker::run() {
  std::unique_lock<std::mutex> lock(mutex_);
  while (running_) {
    if (waiting_.empty()) {
      changed_.wait_for(lock, std::chrono::milliseconds(100));
    } else {
      Task task = std::move(waiting_.front());
      waiting_.pop_front();
      at_work_ = task.points.tiles();
      lock.unlock();
      calls_.work(task);
      lock.lock();
      at_work_.clear();
    }
    lock.unlock();
    calls_.idle();
    lock.lock();
  }
}

}  // namespace field_phenotyping
