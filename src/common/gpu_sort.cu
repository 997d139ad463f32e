#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_select.cuh>

#include "common/gpu_sort.hpp"

namespace field_phenotyping {

void sortOnGpu(GpuStream& stream, const std::uint64_t* keys, std::uint64_t* sorted_keys,
               const std::uint32_t* values, std::uint32_t* sorted_values, std::uint32_t count,
               int bits) {
  // The first call only says how much scratch memory the second one needs.
  std::size_t bytes = 0U;
  char* scratch = nullptr;
  for (int call = 0; call < 2; ++call) {
    checkGpu(
        cub::DeviceRadixSort::SortPairs(scratch, bytes, keys, sorted_keys, values, sorted_values,
                                        static_cast<int>(count), 0, bits, stream.get()),
        "sorting");
    if (call == 0) scratch = stream.device<char>(bytes);
  }
}

void selectOnGpu(GpuStream& stream, const std::uint32_t* values, const std::uint8_t* flags,
                 std::uint32_t* kept, std::uint32_t* kept_count, std::uint32_t count) {
  std::size_t bytes = 0U;
  char* scratch = nullptr;
  for (int call = 0; call < 2; ++call) {
    checkGpu(cub::DeviceSelect::Flagged(scratch, bytes, values, flags, kept, kept_count,
                                        static_cast<int>(count), stream.get()),
             "selection");
    if (call == 0) scratch = stream.device<char>(bytes);
  }
}

}  // namespace field_phenotyping
