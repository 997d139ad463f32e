#pragma once

#include <memory>
#include <stdexcept>
#include <string>

namespace field_phenotyping {

class GpuStream;

/// Whether this build can use GPUs at all.
#ifdef FIELD_PHENOTYPING_WITH_CUDA
constexpr bool kWithCuda = true;
#else
constexpr bool kWithCuda = false;
#endif

/// A call to the GPU failed.
class GpuError : public std::runtime_error {
 public:
  /// @param lasting whether no later call of this process can succeed
  GpuError(const std::string& what, bool lasting) : std::runtime_error(what), lasting_(lasting) {}
  bool lasting() const { return lasting_; }

 private:
  bool lasting_;
};

/// The streams of one GPU, which blocks that are in flight take in turn. Thread-safe.
class GpuStreams {
 public:
  /// Null when no GPU can be used, and then why, with what to do about it.
  static std::unique_ptr<GpuStreams> open(std::string& why);
  ~GpuStreams();

  const std::string& deviceName() const;

  /// Waits until one is free. @throws GpuError
  GpuStream& take();
  /// Waits for what still runs on it, and empties its memory for the next who takes it.
  void giveBack(GpuStream& stream);

 private:
  struct Impl;
  explicit GpuStreams(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace field_phenotyping
