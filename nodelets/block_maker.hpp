#pragma once

#include <ros/time.h>

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/preprocessor.hpp"

namespace field_phenotyping {

/// Makes blocks of what was taken out of the map, on a thread of its own, so that scans need not
/// wait for it. Thread-safe.
class BlockMaker {
 public:
  struct Task {
    BlockPoints points;
    PreprocessingParameters parameters;
    /// Of a draft: the same points, to be made the whole block of once it is out.
    std::shared_ptr<Task> whole = {};
  };
  /// What it calls, on its thread; none may throw.
  struct Calls {
    std::function<void(Task&)> work;
    std::function<void()> idle;  ///< after each block, and some times a second
  };

  explicit BlockMaker(Calls calls);
  /// What still waits is not made.
  ~BlockMaker();
  BlockMaker(const BlockMaker&) = delete;
  BlockMaker& operator=(const BlockMaker&) = delete;

  void push(Task task);
  /// Blocks that wait or are being made.
  std::size_t pending() const;
  /// Whether any of them is of a pass that has ended before `began_ns` [ns since the epoch] where
  /// tile `index` is, or beside it.
  bool holdsEarlierPass(const BlockIndex& index, std::uint64_t began_ns) const;

 private:
  void run();

  Calls calls_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Task> waiting_;
  std::vector<BlockHeader> at_work_;  // what the tiles of that block say of themselves
  bool running_ = true;
  std::thread thread_;  // last: runs on all of the above
};

}  // namespace field_phenotyping
