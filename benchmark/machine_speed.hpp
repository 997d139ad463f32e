#pragma once

namespace field_phenotyping::benchmark {

/// What one core of this machine does at most, with the instructions that the core library is
/// built for.
struct MachineSpeed {
  double bytes_per_second = 0.0;       ///< read and written by copying far more than caches hold
  double operations_per_second = 0.0;  ///< single-precision additions and multiplications
};

/// Takes about a second. The medians of some runs.
MachineSpeed measureMachine();

/// Most memory that this process ever held [bytes]; 0 where /proc is missing.
double peakMemory();

}  // namespace field_phenotyping::benchmark
