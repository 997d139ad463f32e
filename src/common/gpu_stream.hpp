#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>

#include "common/gpu_streams.hpp"
#include "common/scratch_pool.hpp"

// Owners of what the CUDA runtime gives out. Nothing here, and nothing that uses it, works on the
// default stream. For .cu files.

namespace field_phenotyping {

/// @throws GpuError when a call failed; `what` says what was tried
void checkGpu(cudaError_t result, const char* what);

/// Checks that a kernel could be launched; call it right after the launch.
inline void checkLaunch(const char* kernel) {
  checkGpu(cudaGetLastError(), kernel);
}

/// Lets a kernel have as much dynamic shared memory as the device has for one thread block; gives
/// back how much that is [bytes]. Always as much: blocks in flight launch the same kernel.
/// @throws GpuError
std::size_t allowSharedMemory(const void* kernel);
template <class... Parameters>
std::size_t allowSharedMemory(void (*kernel)(Parameters...)) {
  return allowSharedMemory(reinterpret_cast<const void*>(kernel));
}

/// Memory of the device. Move only.
struct DeviceMemory {
  static void* allocate(std::size_t bytes);
  static void release(void* memory) noexcept;
  static constexpr const char* kName = "GPU memory";
};
/// Memory of the host that the device copies from and to while the CPU goes on.
struct PinnedMemory {
  static void* allocate(std::size_t bytes);
  static void release(void* memory) noexcept;
  static constexpr const char* kName = "pinned memory";
};

/// A stream of the GPU with memory of its own: what one block that is in flight works with. Move
/// only. Not thread-safe.
class GpuStream {
 public:
  GpuStream(int device, std::size_t device_limit, std::size_t pinned_limit);
  ~GpuStream();
  GpuStream(const GpuStream&) = delete;
  GpuStream& operator=(const GpuStream&) = delete;

  cudaStream_t get() const { return stream_; }

  /// Uninitialised memory, until the stream is given back.
  template <class T>
  T* device(std::size_t count) {
    return reinterpret_cast<T*>(device_.take(count * sizeof(T)));
  }
  template <class T>
  T* pinned(std::size_t count) {
    return reinterpret_cast<T*>(pinned_.take(count * sizeof(T)));
  }

  /// A copy of `count` values in the device's memory; the source may go away.
  template <class T>
  T* toDevice(const T* values, std::size_t count) {
    T* target = device<T>(count);
    upload(target, values, count * sizeof(T));
    return target;
  }

  /// The same for values that the caller has put into pinned() memory: copied once less.
  template <class T>
  T* pinnedToDevice(const T* values, std::size_t count) {
    T* target = device<T>(count);
    if (count > 0U) {
      checkGpu(cudaMemcpyAsync(target, values, count * sizeof(T), cudaMemcpyHostToDevice, stream_),
               "copy to the GPU");
    }
    return target;
  }

  /// Where `count` values of the device's memory will be on the host, once wait() has returned.
  template <class T>
  const T* toHost(const T* values, std::size_t count) {
    T* target = pinned<T>(count);
    if (count > 0U) {
      checkGpu(cudaMemcpyAsync(target, values, count * sizeof(T), cudaMemcpyDeviceToHost, stream_),
               "copy from the GPU");
    }
    return target;
  }

  /// Waits for all that was asked of this stream. @throws GpuError when any of it failed
  void wait();

  /// Memory that it has, used or not [bytes].
  std::size_t held() const { return device_.held() + pinned_.held(); }

  /// Makes the calling thread use this stream's device.
  void enter();
  /// Waits, whatever has failed, and takes all memory back.
  void reset() noexcept;

 private:
  void upload(void* target, const void* source, std::size_t bytes);

  int gpu_;
  cudaStream_t stream_ = nullptr;
  ScratchPool<DeviceMemory> device_;
  ScratchPool<PinnedMemory> pinned_;
};

}  // namespace field_phenotyping
