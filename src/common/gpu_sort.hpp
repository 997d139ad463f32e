#pragma once

#include <cstdint>

#include "common/gpu_stream.hpp"

namespace field_phenotyping {

/// Sorts values by their keys; equal keys stay in the order that they are in. All in the device's
/// memory.
/// @param bits lowest ones of the keys that can differ
/// @throws GpuError
void sortOnGpu(GpuStream& stream, const std::uint64_t* keys, std::uint64_t* sorted_keys,
               const std::uint32_t* values, std::uint32_t* sorted_values, std::uint32_t count,
               int bits);

/// Keeps those of `values` whose flag is not 0, in their order, and counts them in `*kept_count`.
/// @throws GpuError
void selectOnGpu(GpuStream& stream, const std::uint32_t* values, const std::uint8_t* flags,
                 std::uint32_t* kept, std::uint32_t* kept_count, std::uint32_t count);

}  // namespace field_phenotyping
