#include "field_phenotyping/common/compute_device.hpp"

#include <atomic>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "common/gpu_streams.hpp"

namespace field_phenotyping {
namespace {

/// Gives the stream back whatever happens.
class Lease {
 public:
  explicit Lease(GpuStreams& streams) : streams_(streams), stream_(streams.take()) {}
  ~Lease() { streams_.giveBack(stream_); }
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;
  GpuStream& stream() { return stream_; }

 private:
  GpuStreams& streams_;
  GpuStream& stream_;
};

}  // namespace

struct ComputeDevice::Gpu {
  std::unique_ptr<GpuStreams> streams;
  std::atomic<bool> is_lost{false};
};

struct ComputeDevice::Counts {
  std::mutex mutex;
  DeviceUse use;
};

ComputeDevice::ComputeDevice() : counts_(std::make_shared<Counts>()) {
  counts_->use.why_cpu = "the CPU was asked for";
}

ComputeDevice ComputeDevice::choose(const std::string& wish) {
  ComputeDevice device;
  if (wish == "cpu") return device;
  if (wish != "auto" && wish != "cuda") {
    throw std::invalid_argument("device '" + wish + "' is none of auto, cpu, cuda");
  }
  DeviceUse& use = device.counts_->use;
  {
    static std::mutex mutex;
    static std::weak_ptr<Gpu> of_process;
    const std::lock_guard<std::mutex> lock(mutex);
    device.gpu_ = of_process.lock();
    if (!device.gpu_) {
      if (std::unique_ptr<GpuStreams> streams = GpuStreams::open(use.why_cpu)) {
        device.gpu_ = std::make_shared<Gpu>();
        device.gpu_->streams = std::move(streams);
        of_process = device.gpu_;
      }
    }
  }
  if (device.gpu_) {
    use.device = "cuda: " + device.gpu_->streams->deviceName();
    use.why_cpu.clear();
    return device;
  }
  if (wish == "cuda") throw std::runtime_error("device 'cuda' cannot be had: " + use.why_cpu);
  return device;
}

ComputeDevice ComputeDevice::withOwnCounts() const {
  ComputeDevice same;
  same.gpu_ = gpu_;
  const DeviceUse all = use();
  same.counts_->use.device = all.device;
  same.counts_->use.why_cpu = all.why_cpu;
  return same;
}

DeviceUse ComputeDevice::use() const {
  const std::lock_guard<std::mutex> lock(counts_->mutex);
  return counts_->use;
}

bool ComputeDevice::attempt(const std::function<void(GpuStream&)>& work) const {
  if (!gpu_) return false;
  std::string failure = "the GPU was lost before";
  if (!gpu_->is_lost) {
    try {
      Lease lease(*gpu_->streams);
      work(lease.stream());
      const std::lock_guard<std::mutex> lock(counts_->mutex);
      ++counts_->use.gpu_steps;
      return true;
    } catch (const GpuError& error) {
      failure = error.what();
      if (error.lasting()) gpu_->is_lost = true;
    }
  }
  const std::lock_guard<std::mutex> lock(counts_->mutex);
  ++counts_->use.fallbacks;
  counts_->use.last_failure = failure;
  return false;
}

}  // namespace field_phenotyping
