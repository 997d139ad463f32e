#pragma once

#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

// On the host side nvcc only looks at these: they run on the GPU alone.
#ifdef __CUDA_ARCH__
#define FIELD_PHENOTYPING_ON_GPU(expression, otherwise) (expression)
#else
#define FIELD_PHENOTYPING_ON_GPU(expression, otherwise) (otherwise)
#endif

/// Lanes that are neighbouring threads of a warp (see team.hpp).
struct GpuLanes : ThreadLanes {
  unsigned group_mask;  ///< the group's threads, among those of the warp

  /// The same additions in the same order as in a vector register.
  FIELD_PHENOTYPING_HD float total(float value) const {
    value += FIELD_PHENOTYPING_ON_GPU(__shfl_xor_sync(group_mask, value, 1), value);
    value += FIELD_PHENOTYPING_ON_GPU(__shfl_xor_sync(group_mask, value, 2), value);
    return value;
  }
  FIELD_PHENOTYPING_HD double product(float value) const {
    value *= FIELD_PHENOTYPING_ON_GPU(__shfl_xor_sync(group_mask, value, 1), value);
    const float other = FIELD_PHENOTYPING_ON_GPU(__shfl_xor_sync(group_mask, value, 2), value);
    return static_cast<double>(value) * static_cast<double>(other);
  }
  FIELD_PHENOTYPING_HD float greatest(float value) const {
    value = larger(value, FIELD_PHENOTYPING_ON_GPU(__shfl_xor_sync(group_mask, value, 1), value));
    return larger(value, FIELD_PHENOTYPING_ON_GPU(__shfl_xor_sync(group_mask, value, 2), value));
  }
  FIELD_PHENOTYPING_HD unsigned count(bool mask) const {
    return FIELD_PHENOTYPING_ON_GPU(
        static_cast<unsigned>(__popc(__ballot_sync(group_mask, mask) & group_mask)), mask);
  }
  FIELD_PHENOTYPING_HD void meet() const {
    FIELD_PHENOTYPING_ON_GPU(__syncwarp(group_mask), void());
  }
};

/// A thread block as a team (see team.hpp). Its number of threads must be a multiple of 32.
struct GpuTeam {
  static constexpr bool kAlone = false;
  FIELD_PHENOTYPING_HD static unsigned rank() { return FIELD_PHENOTYPING_ON_GPU(threadIdx.x, 0U); }
  FIELD_PHENOTYPING_HD static unsigned size() { return FIELD_PHENOTYPING_ON_GPU(blockDim.x, 1U); }
  FIELD_PHENOTYPING_HD static void sync() { FIELD_PHENOTYPING_ON_GPU(__syncthreads(), void()); }
  FIELD_PHENOTYPING_HD static unsigned group() { return rank() / static_cast<unsigned>(kLanes); }
  FIELD_PHENOTYPING_HD static unsigned groups() { return size() / static_cast<unsigned>(kLanes); }
  FIELD_PHENOTYPING_HD static GpuLanes lanes() {
    constexpr unsigned kWarp = 32U;
    constexpr unsigned kGroup = (1U << kLanes) - 1U;
    const unsigned lane = rank() % static_cast<unsigned>(kLanes);
    return {{lane}, kGroup << (rank() % kWarp - lane)};
  }
};

}  // namespace field_phenotyping
