#pragma once

#include <ros/ros.h>
#include <ros/time.h>

#include <algorithm>
#include <boost/shared_ptr.hpp>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <iterator>
#include <list>
#include <map>
#include <mutex>
#include <optional>
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

/// What the tiles of a block say of themselves.
inline std::vector<BlockHeader> tilesOf(const Block& block) {
  return block.tiles();
}
template <class T>
std::vector<BlockHeader> tilesOf(const T& block) {
  return {headerOf(block)};
}

/// Whether any tile of `a` is a neighbour of one of `b`.
template <class T>
bool areNeighbors(const T& a, const T& b) {
  const std::vector<BlockHeader> tiles = tilesOf(a);
  const std::vector<BlockHeader> others = tilesOf(b);
  return std::any_of(tiles.begin(), tiles.end(), [&](const BlockHeader& tile) {
    return std::any_of(others.begin(), others.end(), [&](const BlockHeader& other) {
      return areNeighbors(tile.index, other.index);
    });
  });
}

/// Whether `newer` is about all tiles of `older`, each being `alike` there and here. A draft of a
/// part of a tile replaces nothing, for it has not all of its plants.
template <class T, class Alike>
bool replaces(const T& newer, const T& older, const Alike& alike) {
  if (headerOf(newer).isPart()) return false;
  const std::vector<BlockHeader> tiles = tilesOf(newer);
  const std::vector<BlockHeader> others = tilesOf(older);
  return std::all_of(others.begin(), others.end(), [&](const BlockHeader& other) {
    return std::any_of(tiles.begin(), tiles.end(), [&](const BlockHeader& tile) {
      return tile.index == other.index && alike(tile, other);
    });
  });
}

inline std::size_t pointsOf(const Block& block) {
  return block.cloud.size();
}
inline std::size_t pointsOf(const SegmentedBlock& block) {
  return block.cloud.size();
}
inline std::size_t pointsOf(const CompletedBlock& block) {
  return block.segmented->cloud.size() + block.synthetic.size();
}

/// How many blocks a stage keeps for display and for working again: its parameter `history`.
inline std::size_t historyOf(const ros::NodeHandle& pnh) {
  return static_cast<std::size_t>(std::max(pnh.param("history", 16), 0));
}

/// The newest revision of each of the last blocks, of `capacity` tiles in all. Not thread-safe.
template <class T>
class BlockHistory {
 public:
  using Pointer = boost::shared_ptr<const T>;

  explicit BlockHistory(std::size_t capacity) : capacity_(capacity) {}

  void add(const Pointer& block) {
    const BlockHeader& header = headerOf(*block);
    // Tiles of another size are of a tiling that is no longer in use.
    const auto in_any_pass = [](const BlockHeader&, const BlockHeader&) { return true; };
    const auto outdated = [&](const Pointer& known) {
      return replaces(*block, *known, in_any_pass) ||
             headerOf(*known).tile_size != header.tile_size;
    };
    blocks_.erase(std::remove_if(blocks_.begin(), blocks_.end(), outdated), blocks_.end());
    blocks_.push_back(block);
    std::size_t tiles = 0U;
    for (const Pointer& known : blocks_) tiles += tilesOf(*known).size();
    // The last one stays, however many tiles were joined in it.
    const std::size_t fewest = std::min<std::size_t>(capacity_, 1U);
    for (; tiles > capacity_ && blocks_.size() > fewest; blocks_.pop_front()) {
      tiles -= tilesOf(*blocks_.front()).size();
    }
  }

  /// Oldest first.
  const std::deque<Pointer>& blocks() const { return blocks_; }

 private:
  std::size_t capacity_;
  std::deque<Pointer> blocks_;
};

/// Waits until `done()`, however long that is, while `count` goes on to change; false once it has
/// not for `limit`. All of that, and `changed`, belongs to the mutex of `lock`.
template <class Done>
bool waitWhileItGoesOn(std::condition_variable& changed, std::unique_lock<std::mutex>& lock,
                       std::chrono::milliseconds limit, const std::uint64_t& count,
                       const Done& done) {
  while (!done()) {
    const auto progress = [&, known = count] { return done() || count != known; };
    if (!changed.wait_for(lock, limit, progress)) return false;
  }
  return true;
}

/// When a stage counts as overloaded, and what it holds then.
struct OverloadLimits {
  /// A block that waits longer than this means that more comes than can be worked.
  ros::WallDuration after;
  /// Most points of blocks that wait then; beyond it blocks are dropped.
  std::size_t most_points;
};

/// Works blocks one after another on a thread of its own, so that callbacks return at once. A newer
/// revision takes the place of one of the same pass that still waits, and one that comes later than
/// a newer one that still waits or is at work is left out: no block is worked in vain.
///
/// Drafts, and blocks of which nothing has been worked in their pass, go first, for they give
/// plants their first values, then final ones, then updates, each in the order in which they came.
/// Once one that gives first values has waited for too long the newest of those goes first; where
/// too many points wait for too long the last of that order are dropped, of each kind the oldest.
/// After an update others are put off for some time, in which only first and last values are
/// worked. That ends by itself when less comes. What was last seen before a neighbouring block was
/// first seen goes before that one: what an earlier pass has found there must be known by then.
///
/// A draft need not wait for a large block that is at work already where a second thread takes
/// drafts beside it, one after another: each has all cores, and the first of two is done in half of
/// the time that both take side by side. The other thread then takes final blocks first.
/// Thread-safe.
template <class T>
class BlockWorker {
 public:
  using Pointer = boost::shared_ptr<const T>;
  struct Task {
    Pointer block;
    ros::SteadyTime arrival;  ///< of the first revision that has waited since
  };
  /// What became of a block that came.
  struct Arrival {
    bool replaced = false;     ///< an older revision, that still waited or this one
    std::size_t dropped = 0U;  ///< blocks that waited, or this one
  };

  /// Who works drafts.
  enum class Drafts {
    kInTurn,  ///< the one thread that works all blocks
    kBeside,  ///< another, which works nothing else: `work` is called by two threads at once
  };
  /// What the worker calls, on its threads; none may throw.
  struct Calls {
    std::function<bool()> ready;            ///< may work begin?
    std::function<void(const Task&)> work;  ///< one block
    std::function<void()> idle;             ///< on one thread, between blocks
  };

  /// Nothing is worked before start().
  /// @param history how many blocks are kept for reworkAll()
  BlockWorker(std::size_t history, const OverloadLimits& limits, Calls calls,
              Drafts drafts = Drafts::kInTurn)
      : limits_(limits), calls_(std::move(calls)), drafts_(drafts), history_(history) {}
  ~BlockWorker() { stop(); }

  /// Once, when what the calls use is there, this object among it.
  void start() {
    thread_ = std::thread([this] { run(false); });
    if (drafts_ == Drafts::kBeside) beside_ = std::thread([this] { run(true); });
  }

  /// No call is made after this; what still waits is not worked.
  void stop() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      running_ = false;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
    if (beside_.joinable()) beside_.join();
  }

  BlockWorker(const BlockWorker&) = delete;
  BlockWorker& operator=(const BlockWorker&) = delete;

  Arrival push(const Pointer& block) {
    Arrival arrival;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (isLate(*block)) {
        arrival.replaced = true;
        return arrival;
      }
      history_.add(block);
      arrival.replaced = enqueue(block);
      arrival.dropped = dropExcess();
    }
    changed_.notify_all();
    return arrival;
  }

  /// Works every block of the history again: the parameters have changed.
  void reworkAll() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      for (const Pointer& block : history_.blocks()) enqueue(block);
    }
    changed_.notify_all();
  }

  /// Waits until nothing is left to do, however long that is; false if no block was finished for
  /// longer than `limit`.
  bool drain(std::chrono::milliseconds limit) {
    std::unique_lock<std::mutex> lock(mutex_);
    return waitWhileItGoesOn(changed_, lock, limit, worked_count_,
                             [this] { return waiting_.empty() && at_work_.empty(); });
  }

  std::size_t waiting() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return waiting_.size();
  }

  /// Whether a block has been waiting for too long. Updates may wait: final blocks replace them.
  bool overloaded() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return waitsTooLong(Rank::kLastValues);
  }

 private:
  /// Times as long as an update took nothing but first and last values is worked, that these find
  /// time: the final block will say better what an update would have said.
  static constexpr double kUpdatePause = 3.0;

  /// What a block is worked for; the first goes first.
  enum class Rank { kFirstValues, kLastValues, kUpdate };

  /// Whether newer revisions of all its tiles, in the same pass, wait or are at work.
  bool isLate(const T& block) const {
    const std::vector<BlockHeader> tiles = tilesOf(block);
    const auto is_newer = [](const T& other, const BlockHeader& tile) {
      const std::vector<BlockHeader> others = tilesOf(other);
      return std::any_of(others.begin(), others.end(), [&](const BlockHeader& known) {
        return known.index == tile.index && known.began_ns == tile.began_ns &&
               known.revision > tile.revision;
      });
    };
    return std::all_of(tiles.begin(), tiles.end(), [&](const BlockHeader& tile) {
      return std::any_of(waiting_.begin(), waiting_.end(),
                         [&](const Task& task) { return is_newer(*task.block, tile); }) ||
             std::any_of(at_work_.begin(), at_work_.end(),
                         [&](const Pointer& other) { return is_newer(*other, tile); });
    });
  }

  /// @return whether it takes the place of others
  bool enqueue(const Pointer& block) {
    const auto is_newer = [](const BlockHeader& tile, const BlockHeader& other) {
      const bool sooner = other.draft && !tile.draft && !tile.final;  // gives first values
      return other.began_ns == tile.began_ns && !sooner;
    };
    const auto outdated = [&](const Task& task) { return replaces(*block, *task.block, is_newer); };
    const auto first = std::find_if(waiting_.begin(), waiting_.end(), outdated);
    if (first == waiting_.end()) {
      waiting_.push_back({block, ros::SteadyTime::now()});
      return false;
    }
    // Last values are waited for since the block is final, not since an update was due.
    const bool keeps_place = !headerOf(*block).final || headerOf(*first->block).final;
    if (keeps_place) first->block = block;
    waiting_.erase(std::remove_if(keeps_place ? std::next(first) : first, waiting_.end(), outdated),
                   waiting_.end());
    if (!keeps_place) waiting_.push_back({block, ros::SteadyTime::now()});
    return true;
  }

  /// Whether one of that rank or before it does.
  bool waitsTooLong(Rank last) const {
    return std::any_of(waiting_.begin(), waiting_.end(), [&](const Task& task) {
      return waitsTooLong(task) && rankOf(task) <= last;
    });
  }

  bool waitsTooLong(const Task& task) const {
    return opened_ && ros::SteadyTime::now() - std::max(task.arrival, *opened_) > limits_.after;
  }

  Rank rankOf(const Task& task) const {
    const BlockHeader& header = headerOf(*task.block);
    const std::vector<BlockHeader> tiles = tilesOf(*task.block);
    const bool unknown = std::any_of(tiles.begin(), tiles.end(), [this](const BlockHeader& tile) {
      const auto worked = worked_.find(tile.index);
      return worked == worked_.end() || worked->second != tile.began_ns;
    });
    if (header.draft || unknown) return Rank::kFirstValues;
    return header.final ? Rank::kLastValues : Rank::kUpdate;
  }

  static bool isNewer(const Task& a, const Task& b) {
    return headerOf(*a.block).stamp_ns > headerOf(*b.block).stamp_ns;
  }

  /// Whether `a` is worked before `b`, which came before it.
  bool goesFirst(const Task& a, const Task& b, bool newest_first) const {
    const bool final_a = headerOf(*a.block).final;
    const bool final_b = headerOf(*b.block).final;
    if (drafts_ == Drafts::kBeside && final_a != final_b) return final_a;
    const Rank rank_a = rankOf(a);
    const Rank rank_b = rankOf(b);
    if (rank_a != rank_b) return rank_a < rank_b;
    // Newer ones have nothing to say of a final block's plants.
    const bool replaceable = rank_a == Rank::kFirstValues && !(final_a && final_b);
    return newest_first && replaceable && isNewer(a, b);
  }

  /// @return how many of those that wait were dropped; one stays, however large
  std::size_t dropExcess() {
    std::size_t dropped = 0U;
    if (!waitsTooLong(Rank::kUpdate)) return dropped;
    const auto worth_more = [this](const Task& a, const Task& b) {
      return rankOf(a) != rankOf(b) ? rankOf(a) < rankOf(b) : isNewer(a, b);
    };
    std::size_t points = 0U;
    for (const Task& task : waiting_) points += pointsOf(*task.block);
    for (; points > limits_.most_points && waiting_.size() > 1U; ++dropped) {
      const auto least = std::max_element(waiting_.begin(), waiting_.end(), worth_more);
      points -= pointsOf(*least->block);
      if (headerOf(*least->block).final) forgetWorked(*least->block);
      waiting_.erase(least);
    }
    return dropped;
  }

  void forgetWorked(const T& block) {
    for (const BlockHeader& tile : tilesOf(block)) worked_.erase(tile.index);
  }

  /// Whether a block that waits or is at work is of an earlier pass of the same place.
  bool hasEarlierPass(const T& block) const {
    const auto is_earlier = [&](const Pointer& other) {
      return headerOf(*other).stamp_ns < headerOf(block).began_ns && areNeighbors(*other, block);
    };
    return std::any_of(at_work_.begin(), at_work_.end(), is_earlier) ||
           std::any_of(waiting_.begin(), waiting_.end(),
                       [&](const Task& task) { return is_earlier(task.block); });
  }

  /// Nothing where none may be worked yet.
  std::optional<Task> takeNext(bool takes_drafts, bool& is_update) {
    const bool newest_first = waitsTooLong(Rank::kFirstValues);
    const bool may_update = ros::SteadyTime::now() >= next_update_;
    auto next = waiting_.end();
    for (auto task = waiting_.begin(); task != waiting_.end(); ++task) {
      if (drafts_ == Drafts::kBeside && headerOf(*task->block).draft != takes_drafts) continue;
      if (!may_update && rankOf(*task) == Rank::kUpdate) continue;
      const bool first = next == waiting_.end() || goesFirst(*task, *next, newest_first);
      if (first && !hasEarlierPass(*task->block)) next = task;
    }
    if (next == waiting_.end()) return std::nullopt;
    const Task task = *next;
    is_update = rankOf(task) == Rank::kUpdate;
    waiting_.erase(next);
    const BlockHeader& header = headerOf(*task.block);
    if (header.final) {
      forgetWorked(*task.block);
    } else {
      worked_[header.index] = header.began_ns;
    }
    return task;
  }

  /// @param beside as the thread that takes drafts, where one does
  void run(bool beside) {
    std::unique_lock<std::mutex> lock(mutex_);
    while (running_) {
      const bool ready = calls_.ready();
      if (ready && !opened_) opened_ = ros::SteadyTime::now();
      bool is_update = false;
      const std::optional<Task> task = ready ? takeNext(beside, is_update) : std::nullopt;
      const ros::SteadyTime begin = ros::SteadyTime::now();
      if (!task) {
        changed_.wait_for(lock, std::chrono::milliseconds(100));
      } else {
        const auto at_work = at_work_.insert(at_work_.end(), task->block);
        lock.unlock();
        calls_.work(*task);
        lock.lock();
        at_work_.erase(at_work);
        if (is_update) {
          const ros::SteadyTime end = ros::SteadyTime::now();
          next_update_ = end + (end - begin) * kUpdatePause;
        }
        ++worked_count_;
        changed_.notify_all();
      }
      if (beside) continue;
      lock.unlock();
      calls_.idle();
      lock.lock();
    }
  }

  const OverloadLimits limits_;
  Calls calls_;
  const Drafts drafts_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Task> waiting_;  // as they came
  std::list<Pointer> at_work_;
  std::map<BlockIndex, std::uint64_t> worked_;  // when the pass began that open blocks were in [ns]
  BlockHistory<T> history_;
  std::optional<ros::SteadyTime> opened_;  // since when work is done
  ros::SteadyTime next_update_;            // none is worked before
  std::uint64_t worked_count_ = 0U;        // blocks
  bool running_ = true;
  std::thread thread_;  // last: run on all of the above
  std::thread beside_;
};

}  // namespace field_phenotyping
