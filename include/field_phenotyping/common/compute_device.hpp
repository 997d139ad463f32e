#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string>

namespace field_phenotyping {

class GpuStream;

/// What a device was used for.
struct DeviceUse {
  std::string device = "cpu";  ///< or "cuda: " and the GPU's own name
  std::string why_cpu;         ///< empty where there is a GPU
  std::size_t gpu_steps = 0U;  ///< steps of blocks that were worked on the GPU
  std::size_t fallbacks = 0U;  ///< steps of blocks that the CPU did because the GPU failed
  std::string last_failure;    ///< of the GPU; empty: none
};

/// Where the stages compute: on the CPU alone, or with a GPU for the steps that were written for
/// one. The results are the same; a step that fails on the GPU is done by the CPU. A handle: copies
/// stand for the same device and count together. Thread-safe.
class ComputeDevice {
 public:
  /// The CPU.
  ComputeDevice();

  /// Looks for a GPU, in this process and machine as they are now. All that are chosen in a process
  /// share the GPU and its memory, and count for themselves.
  /// @param wish "cpu"; "auto": a GPU if there is one, else the CPU; "cuda": a GPU
  /// @throws std::invalid_argument when the wish is none of these
  /// @throws std::runtime_error when "cuda" cannot be had; says why and what to do
  static ComputeDevice choose(const std::string& wish);

  /// The same device, counted for itself.
  ComputeDevice withOwnCounts() const;

  bool hasGpu() const { return gpu_ != nullptr; }
  DeviceUse use() const;

  /// Runs work(stream) on the GPU. Returns false when it must be done on the CPU: there is no GPU,
  /// or the GPU failed, which is counted. `work` must have no effect but at its end, for it may be
  /// given up anywhere. What it throws besides GpuError is passed on.
  bool attempt(const std::function<void(GpuStream&)>& work) const;

 private:
  struct Gpu;
  struct Counts;
  std::shared_ptr<Gpu> gpu_;  // null: the CPU
  std::shared_ptr<Counts> counts_;
};

}  // namespace field_phenotyping
