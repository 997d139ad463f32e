#include <algorithm>
#include <condition_variable>
#include <cstring>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "common/gpu_stream.hpp"

namespace field_phenotyping {
namespace {

/// After these the process may go on using the GPU; after all others its context is lost.
bool isPassing(cudaError_t error) {
  return error == cudaErrorMemoryAllocation || error == cudaErrorInvalidValue ||
         error == cudaErrorInvalidConfiguration || error == cudaErrorLaunchOutOfResources;
}

/// Whether there is code for a device can only be asked for a kernel.
__global__ void probeKernel() {}

}  // namespace

void checkGpu(cudaError_t result, const char* what) {
  if (result == cudaSuccess) return;
  cudaGetLastError();  // or a later, successful launch would report it again
  throw GpuError(
      std::string(what) + ": " + cudaGetErrorString(result) + " (" + cudaGetErrorName(result) + ")",
      !isPassing(result));
}

std::size_t allowSharedMemory(const void* kernel) {
  int device = 0;
  int most = 0;
  cudaFuncAttributes attributes;
  checkGpu(cudaGetDevice(&device), "number of the GPU");
  checkGpu(cudaDeviceGetAttribute(&most, cudaDevAttrMaxSharedMemoryPerBlockOptin, device),
           "shared memory of the GPU");
  checkGpu(cudaFuncGetAttributes(&attributes, kernel), "attributes of a kernel");
  const int dynamic = most - static_cast<int>(attributes.sharedSizeBytes);
  checkGpu(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, dynamic),
           "shared memory of a kernel");
  return static_cast<std::size_t>(dynamic);
}

void* DeviceMemory::allocate(std::size_t bytes) {
  void* memory = nullptr;
  checkGpu(cudaMalloc(&memory, bytes), "allocation of GPU memory");
  return memory;
}
void DeviceMemory::release(void* memory) noexcept {
  cudaFree(memory);  // fails only where the device is lost, and the memory with it
}
void* PinnedMemory::allocate(std::size_t bytes) {
  void* memory = nullptr;
  checkGpu(cudaMallocHost(&memory, bytes), "allocation of pinned memory");
  return memory;
}
void PinnedMemory::release(void* memory) noexcept {
  cudaFreeHost(memory);
}

GpuStream::GpuStream(int device, std::size_t device_limit, std::size_t pinned_limit)
    : gpu_(device), device_(device_limit), pinned_(pinned_limit) {
  enter();
  // Not ordered with the default stream, which others in this process may use.
  checkGpu(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking), "creation of a stream");
}

GpuStream::~GpuStream() {
  cudaSetDevice(gpu_);
  cudaStreamSynchronize(stream_);
  cudaStreamDestroy(stream_);
}

void GpuStream::enter() {
  checkGpu(cudaSetDevice(gpu_), "choice of the GPU");
}

void GpuStream::wait() {
  checkGpu(cudaStreamSynchronize(stream_), "work on the GPU");
}

void GpuStream::reset() noexcept {
  cudaStreamSynchronize(stream_);
  cudaGetLastError();
  try {
    device_.reset();
    pinned_.reset();
  } catch (const GpuError&) {
    device_.clear();
    pinned_.clear();
  }
}

void GpuStream::upload(void* target, const void* source, std::size_t bytes) {
  // In pieces: while one is on its way the next is put where the GPU can fetch it.
  constexpr std::size_t kPiece = std::size_t{1} << 20U;
  char* staging = pinned_.take(bytes);
  for (std::size_t at = 0U; at < bytes; at += kPiece) {
    const std::size_t count = std::min(kPiece, bytes - at);
    std::memcpy(staging + at, static_cast<const char*>(source) + at, count);
    checkGpu(cudaMemcpyAsync(static_cast<char*>(target) + at, staging + at, count,
                             cudaMemcpyHostToDevice, stream_),
             "copy to the GPU");
  }
}

struct GpuStreams::Impl {
  std::string name;
  std::vector<std::unique_ptr<GpuStream>> streams;
  std::mutex mutex;
  std::condition_variable one_is_free;
  std::vector<GpuStream*> free;
};

std::unique_ptr<GpuStreams> GpuStreams::open(std::string& why) {
  constexpr int kDevice = 0;            // CUDA_VISIBLE_DEVICES says which one that is
  constexpr std::size_t kStreams = 8U;  // of blocks in flight; copies of some, kernels of others
  constexpr double kShare = 0.4;  // of the free memory that they may use; they may hold twice that
  constexpr std::size_t kMostPinned = std::size_t{256} << 20U;  // [bytes] of each
  try {
    int devices = 0;
    const cudaError_t found = cudaGetDeviceCount(&devices);
    if (found != cudaSuccess || devices == 0) {
      cudaGetLastError();
      why = std::string("no GPU is found (") +
            (found == cudaSuccess ? "there is none" : cudaGetErrorString(found)) +
            "): is the NVIDIA driver loaded, and new enough for CUDA " +
            std::to_string(CUDART_VERSION / 1000) + "." +
            std::to_string(CUDART_VERSION % 1000 / 10) +
            "? nvidia-smi says so; in a container --gpus is needed";
      return nullptr;
    }
    checkGpu(cudaSetDevice(kDevice), "choice of the GPU");
    cudaDeviceProp properties;
    checkGpu(cudaGetDeviceProperties(&properties, kDevice), "properties of the GPU");
    cudaFuncAttributes attributes;
    if (cudaFuncGetAttributes(&attributes, probeKernel) != cudaSuccess) {
      cudaGetLastError();
      why = std::string(properties.name) + " has compute capability " +
            std::to_string(properties.major) + "." + std::to_string(properties.minor) +
            ", which this build has no code for: build with "
            "-DFIELD_PHENOTYPING_CUDA_ARCHITECTURES=" +
            std::to_string(properties.major * 10 + properties.minor);
      return nullptr;
    }
    std::size_t free_memory = 0U;
    std::size_t all_memory = 0U;
    checkGpu(cudaMemGetInfo(&free_memory, &all_memory), "free memory of the GPU");
    auto impl = std::make_unique<Impl>();
    impl->name = properties.name;
    const auto limit =
        static_cast<std::size_t>(kShare * static_cast<double>(free_memory)) / kStreams;
    for (std::size_t k = 0; k < kStreams; ++k) {
      impl->streams.push_back(std::make_unique<GpuStream>(kDevice, limit, kMostPinned));
      impl->free.push_back(impl->streams.back().get());
    }
    return std::unique_ptr<GpuStreams>(new GpuStreams(std::move(impl)));
  } catch (const GpuError& error) {
    why = std::string("the GPU cannot be used: ") + error.what();
    return nullptr;
  }
}

GpuStreams::GpuStreams(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
GpuStreams::~GpuStreams() = default;

const std::string& GpuStreams::deviceName() const {
  return impl_->name;
}

GpuStream& GpuStreams::take() {
  std::unique_lock<std::mutex> lock(impl_->mutex);
  impl_->one_is_free.wait(lock, [&] { return !impl_->free.empty(); });
  // That with the most memory, so that large steps come to the same ones again and again.
  const auto largest = std::max_element(
      impl_->free.begin(), impl_->free.end(),
      [](const GpuStream* a, const GpuStream* b) { return a->held() < b->held(); });
  GpuStream* stream = *largest;
  stream->enter();
  impl_->free.erase(largest);
  return *stream;
}

void GpuStreams::giveBack(GpuStream& stream) {
  stream.reset();
  const std::lock_guard<std::mutex> lock(impl_->mutex);
  impl_->free.push_back(&stream);
  impl_->one_is_free.notify_one();
}

}  // namespace field_phenotyping
