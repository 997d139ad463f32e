#pragma once

#include <cstddef>
#include <cstdint>
#include <iterator>
#include <map>
#include <mutex>

#include "field_phenotyping/preprocessing/block.hpp"

namespace field_phenotyping {

/// Which revisions of blocks have been given their plants, where several are at work at a time:
/// tells those that a newer one of the same pass has overtaken. Final ones are remembered while
/// anything is at work that may have come before them. Thread-safe.
class NamedRevisions {
 public:
  /// Work on a block, while it lives.
  class Work {
   public:
    explicit Work(NamedRevisions& revisions) : revisions_(revisions) {
      const std::lock_guard<std::mutex> lock(revisions_.mutex_);
      ++revisions_.at_work_;
    }
    ~Work() {
      const std::lock_guard<std::mutex> lock(revisions_.mutex_);
      if (--revisions_.at_work_ == 0U) revisions_.forgetFinal();
    }
    Work(const Work&) = delete;
    Work& operator=(const Work&) = delete;

   private:
    NamedRevisions& revisions_;
  };

  bool isOvertaken(const BlockHeader& tile) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto newest = newest_.find(tile.index);
    return newest != newest_.end() && newest->second.began_ns == tile.began_ns &&
           newest->second.revision > tile.revision;
  }

  /// Of a tile that is not overtaken.
  void name(const BlockHeader& tile) {
    const std::lock_guard<std::mutex> lock(mutex_);
    newest_[tile.index] = {tile.began_ns, tile.revision, tile.final};
  }

 private:
  struct Newest {
    std::uint64_t began_ns = 0U;  // of its pass
    std::uint32_t revision = 0U;
    bool final = false;
  };

  void forgetFinal() {
    for (auto entry = newest_.begin(); entry != newest_.end();) {
      entry = entry->second.final ? newest_.erase(entry) : std::next(entry);
    }
  }

  mutable std::mutex mutex_;
  std::map<BlockIndex, Newest> newest_;
  std::size_t at_work_ = 0U;  // blocks
};

}  // namespace field_phenotyping
