#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

/// Where a fixed number of threads wait for one another.
class Barrier {
 public:
  explicit Barrier(unsigned threads) : threads_(threads) {}

  void wait() {
    std::unique_lock<std::mutex> lock(mutex_);
    const std::uint64_t round = round_;
    if (++waiting_ == threads_) {
      waiting_ = 0U;
      ++round_;
      all_there_.notify_all();
      return;
    }
    all_there_.wait(lock, [&] { return round_ != round; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable all_there_;
  unsigned threads_;
  unsigned waiting_ = 0U;
  std::uint64_t round_ = 0U;
};

/// What the lanes of one group say to one another.
struct LaneExchange {
  Barrier barrier{static_cast<unsigned>(kLanes)};
  std::array<float, kLanes> values{};
};

/// Lanes that are threads of the CPU.
struct EmulatedLanes : ThreadLanes {
  LaneExchange* exchange;

  float total(float value) const {
    const std::array<float, kLanes> v = exchanged(value);
    return (v[0] + v[1]) + (v[2] + v[3]);
  }
  double product(float value) const {
    const std::array<float, kLanes> v = exchanged(value);
    return static_cast<double>(v[0] * v[1]) * static_cast<double>(v[2] * v[3]);
  }
  float greatest(float value) const {
    const std::array<float, kLanes> v = exchanged(value);
    return larger(larger(v[0], v[1]), larger(v[2], v[3]));
  }
  unsigned count(bool mask) const {
    const std::array<float, kLanes> v = exchanged(mask ? 1.0F : 0.0F);
    return static_cast<unsigned>(v[0] + v[1] + v[2] + v[3]);
  }
  void meet() const { exchange->barrier.wait(); }

 private:
  std::array<float, kLanes> exchanged(float value) const {
    exchange->values[lane] = value;
    exchange->barrier.wait();
    const std::array<float, kLanes> all = exchange->values;
    exchange->barrier.wait();
    return all;
  }
};

/// A team of CPU threads: what a thread block of the GPU does, with races that ThreadSanitizer
/// sees.
class EmulatedTeam {
 public:
  static constexpr bool kAlone = false;
  EmulatedTeam(unsigned rank, unsigned size, Barrier& barrier, LaneExchange& exchange)
      : rank_(rank), size_(size), barrier_(&barrier), exchange_(&exchange) {}

  unsigned rank() const { return rank_; }
  unsigned size() const { return size_; }
  void sync() const { barrier_->wait(); }
  unsigned group() const { return rank_ / static_cast<unsigned>(kLanes); }
  unsigned groups() const { return size_ / static_cast<unsigned>(kLanes); }
  EmulatedLanes lanes() const { return {{rank_ % static_cast<unsigned>(kLanes)}, exchange_}; }

 private:
  unsigned rank_;
  unsigned size_;
  Barrier* barrier_;
  LaneExchange* exchange_;
};

/// Calls work(team) on every member of a team of `groups` lane groups.
template <class Work>
void runEmulatedTeam(unsigned groups, const Work& work) {
  const unsigned size = groups * static_cast<unsigned>(kLanes);
  Barrier barrier(size);
  std::vector<LaneExchange> exchanges(groups);
  std::vector<std::thread> members;
  for (unsigned rank = 0; rank < size; ++rank) {
    members.emplace_back(
        [&, rank] { work(EmulatedTeam(rank, size, barrier, exchanges[rank / kLanes])); });
  }
  for (std::thread& member : members) member.join();
}

}  // namespace field_phenotyping
