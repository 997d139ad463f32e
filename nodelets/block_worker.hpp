#pragma once

#include <ros/ros.h>
#include <ros/time.h>

#include <algorithm>
#include <boost/shared_ptr.hpp>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

inline const BlockHeader& headerOf(const Block& block) {
  return block.header;
}
inline const BlockHeader& headerOf(const SegmentedBlock& block) {
  return block.header;
}
inline const BlockHeader& headerOf(const CompletedBlock& block) {
  return block.segmented->header;
}

/// How many blocks a stage keeps for display and for working again: its parameter `history`.
inline std::size_t historyOf(const ros::NodeHandle& pnh) {
  return static_cast<std::size_t>(std::max(pnh.param("history", 16), 0));
}

/// The newest revision of each of the last `capacity` blocks. Not thread-safe.
template <class T>
class BlockHistory {
 public:
  using Pointer = boost::shared_ptr<const T>;

  explicit BlockHistory(std::size_t capacity) : capacity_(capacity) {}

  void add(const Pointer& block) {
    const BlockHeader& header = headerOf(*block);
    // Tiles of another size are of a tiling that is no longer in use.
    const auto outdated = [&](const Pointer& known) {
      return headerOf(*known).index == header.index ||
             headerOf(*known).tile_size != header.tile_size;
    };
    blocks_.erase(std::remove_if(blocks_.begin(), blocks_.end(), outdated), blocks_.end());
    blocks_.push_back(block);
    if (blocks_.size() > capacity_) blocks_.pop_front();
  }

  /// Oldest first.
  const std::deque<Pointer>& blocks() const { return blocks_; }

 private:
  std::size_t capacity_;
  std::deque<Pointer> blocks_;
};

/// Works blocks one after another on a thread of its own, so that callbacks return at once. A newer
/// revision takes the place of one of the same pass that still waits: no block is lost, none is
/// worked in vain. Thread-safe.
template <class T>
class BlockWorker {
 public:
  using Pointer = boost::shared_ptr<const T>;
  struct Task {
    Pointer block;
    ros::WallTime arrival;
  };

  /// What the worker calls, on its thread; none may throw.
  struct Calls {
    std::function<bool()> ready;            ///< may work begin?
    std::function<void(const Task&)> work;  ///< one block
    std::function<void()> idle;             ///< after each block, and some times a second
  };

  /// @param history how many blocks are kept for reworkAll()
  BlockWorker(std::size_t history, Calls calls)
      : calls_(std::move(calls)), history_(history), thread_([this] { run(); }) {}

  ~BlockWorker() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      running_ = false;
    }
    changed_.notify_all();
    thread_.join();
  }

  BlockWorker(const BlockWorker&) = delete;
  BlockWorker& operator=(const BlockWorker&) = delete;

  /// @return whether an older revision that still waited was replaced
  bool push(const Pointer& block) {
    bool replaced = false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      history_.add(block);
      replaced = enqueue(block);
    }
    changed_.notify_all();
    return replaced;
  }

  /// Works every block of the history again: the parameters have changed.
  void reworkAll() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      for (const Pointer& block : history_.blocks()) enqueue(block);
    }
    changed_.notify_all();
  }

  /// Waits until nothing is left to do; false if that took longer than `limit`.
  bool drain(std::chrono::seconds limit) {
    std::unique_lock<std::mutex> lock(mutex_);
    return changed_.wait_for(lock, limit, [this] { return waiting_.empty() && !busy_; });
  }

  std::size_t waiting() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return waiting_.size();
  }

 private:
  bool enqueue(const Pointer& block) {
    const BlockHeader& header = headerOf(*block);
    for (Task& task : waiting_) {
      const BlockHeader& other = headerOf(*task.block);
      if (!(other.index == header.index) || other.began_ns != header.began_ns) continue;
      task.block = block;
      return true;
    }
    waiting_.push_back({block, ros::WallTime::now()});
    return false;
  }

  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (running_) {
      if (waiting_.empty() || !calls_.ready()) {
        changed_.wait_for(lock, std::chrono::milliseconds(100));
      } else {
        const Task task = waiting_.front();
        waiting_.pop_front();
        busy_ = true;
        lock.unlock();
        calls_.work(task);
        lock.lock();
        busy_ = false;
        changed_.notify_all();
      }
      lock.unlock();
      calls_.idle();
      lock.lock();
    }
  }

  Calls calls_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Task> waiting_;
  BlockHistory<T> history_;
  bool busy_ = false;
  bool running_ = true;
  std::thread thread_;  // last: runs on all of the above
};

}  // namespace field_phenotyping
