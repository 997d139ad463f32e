#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "common/gpu_streams.hpp"

namespace field_phenotyping {

/// Owns one piece of memory. Move only.
/// @tparam Memory has static void* allocate(bytes), which throws GpuError, void release(void*), and
/// kName
template <class Memory>
class OwnedMemory {
 public:
  explicit OwnedMemory(std::size_t bytes) : data_(Memory::allocate(bytes)), bytes_(bytes) {}
  ~OwnedMemory() {
    if (data_ != nullptr) Memory::release(data_);
  }
  OwnedMemory(OwnedMemory&& other) noexcept
      : data_(std::exchange(other.data_, nullptr)), bytes_(std::exchange(other.bytes_, 0U)) {}
  OwnedMemory& operator=(OwnedMemory&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(bytes_, other.bytes_);
    return *this;
  }
  OwnedMemory(const OwnedMemory&) = delete;
  OwnedMemory& operator=(const OwnedMemory&) = delete;

  char* data() const { return static_cast<char*>(data_); }
  std::size_t bytes() const { return bytes_; }

 private:
  void* data_;
  std::size_t bytes_;
};

/// Memory that is handed out in pieces and taken back all at once, for the next block to use again.
/// It keeps what the largest block so far needed, and half as much again. At most `limit` bytes are
/// handed out; while a block needs more than all before it, up to twice as much is held. Not
/// thread-safe.
template <class Memory>
class ScratchPool {
 public:
  explicit ScratchPool(std::size_t limit) : limit_(limit) {}

  /// @throws GpuError beyond the limit, or where there is no more memory
  char* take(std::size_t bytes) {
    constexpr std::size_t kAlignment = 256U;
    const std::size_t whole = limit_ - limit_ % kAlignment;
    if (bytes <= whole)
      bytes = (std::max<std::size_t>(bytes, 1U) + kAlignment - 1U) / kAlignment * kAlignment;
    if (bytes > whole || held_before_ + used_ > whole - bytes) {
      throw GpuError(std::string("a block needs more ") + Memory::kName + " than its share of " +
                         std::to_string(limit_ >> 20U) + " MiB",
                     false);
    }
    if (pieces_.empty() || pieces_.back().bytes() - used_ < bytes) {
      constexpr std::size_t kLeast = std::size_t{1} << 20U;
      pieces_.emplace_back(std::max(bytes, std::min(kLeast, whole)));
      // What is left of the piece before is lost until reset(), but not its share of the limit.
      held_before_ += used_;
      used_ = 0U;
    }
    char* memory = pieces_.back().data() + used_;
    used_ += bytes;
    return memory;
  }

  /// Takes everything back. Nothing that uses it may still run.
  void reset() {
    const std::size_t needed = held_before_ + used_;
    used_ = 0U;
    held_before_ = 0U;
    if (pieces_.size() <= 1U) return;
    // One piece from now on, with room for a block that needs some more: all wait while one
    // allocates.
    pieces_.clear();
    pieces_.emplace_back(std::min(needed + needed / 2U, limit_));
  }
  /// Gives the memory itself back.
  void clear() {
    pieces_.clear();
    used_ = 0U;
    held_before_ = 0U;
  }
  std::size_t held() const {
    std::size_t bytes = 0U;
    for (const OwnedMemory<Memory>& piece : pieces_) bytes += piece.bytes();
    return bytes;
  }

 private:
  std::size_t limit_;
  std::vector<OwnedMemory<Memory>> pieces_;
  std::size_t used_ = 0U;         // of the last piece
  std::size_t held_before_ = 0U;  // of the others
};

}  // namespace field_phenotyping
