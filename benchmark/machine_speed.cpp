#include "machine_speed.hpp"

#include <array>
#include <cstddef>
#include <fstream>
#include <string>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/median.hpp"
#include "timed_runs.hpp"

namespace field_phenotyping::benchmark {
namespace {

constexpr int kRuns = 5;

double copyRate() {
  constexpr std::size_t kValues = std::size_t{1} << 25U;  // 256 MB each way
  std::vector<double> from(kValues, 1.0);
  std::vector<double> to(kValues, 0.0);
  std::vector<double> seconds;
  for (int run = 0; run <= kRuns; ++run) {
    const double took = secondsOf([&] {
      for (std::size_t i = 0; i < kValues; ++i) to[i] = from[i];
    });
    from[0] += to[kValues / 2U];  // so that no copy can be left out
    if (run > 0) seconds.push_back(took);
  }
  return 2.0 * kValues * sizeof(double) / medianOf(seconds);
}

double arithmeticRate() {
  constexpr std::size_t kChains = 12U;  // that do not wait for one another
  constexpr int kSteps = 20'000'000;
  constexpr double kOperations = 2.0;  // a multiplication and an addition
  std::array<Floats, kChains> values;
  for (std::size_t c = 0; c < kChains; ++c) values[c] = allOf(static_cast<float>(c));
  const Floats factor = allOf(0.999F);
  const Floats shift = allOf(0.001F);
  std::vector<double> seconds;
  float all = 0.0F;
  for (int run = 0; run <= kRuns; ++run) {
    const double took = secondsOf([&] {
      std::array<Floats, kChains> chain = values;
      for (int step = 0; step < kSteps; ++step) {
        for (Floats& value : chain) value = value * factor + shift;
      }
      values = chain;
    });
    if (run > 0) seconds.push_back(took);
  }
  for (const Floats& value : values) all += total(value);
  const double useless = all == 0.0F ? 1.0 : 0.0;  // so that no step can be left out
  return kOperations * kSteps * kChains * kLanes / (medianOf(seconds) + useless);
}

}  // namespace

MachineSpeed measureMachine() {
  return {copyRate(), arithmeticRate()};
}

double peakMemory() {
  constexpr double kKilobyte = 1024.0;
  std::ifstream status("/proc/self/status");
  std::string word;
  while (status >> word) {
    double kilobytes = 0.0;
    if (word == "VmHWM:" && status >> kilobytes) return kKilobyte * kilobytes;
  }
  return 0.0;
}

}  // namespace field_phenotyping::benchmark
