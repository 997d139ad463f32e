// Stands in for gpu_stream.cu in builds without CUDA.
#ifndef FIELD_PHENOTYPING_WITH_CUDA

#include "common/gpu_streams.hpp"

namespace field_phenotyping {

struct GpuStreams::Impl {
  std::string name;
};

std::unique_ptr<GpuStreams> GpuStreams::open(std::string& why) {
  why =
      "this build has no GPU code: build where nvcc is on PATH; with -DWITH_CUDA=ON CMake says "
      "what "
      "is missing";
  return nullptr;
}
GpuStreams::GpuStreams(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
GpuStreams::~GpuStreams() = default;
const std::string& GpuStreams::deviceName() const {
  return impl_->name;
}
GpuStream& GpuStreams::take() {
  throw GpuError("this build has no GPU code", true);
}
void GpuStreams::giveBack(GpuStream& /*stream*/) {}

}  // namespace field_phenotyping

#endif
