#include "simulation/progress.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace field_phenotyping::simulation {

ProgressBar::ProgressBar() : terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() {
  if (terminal_ && !step_.empty()) {
    std::fputc('\n', stderr);
  }
}

void ProgressBar::update(const std::string& step, double share) {
  const int resolution = terminal_ ? 1 : 25;
  const int exact = static_cast<int>(100.0 * std::clamp(share, 0.0, 1.0));
  const int percent = exact / resolution * resolution;
  if (step == step_ && percent <= percent_) {
    return;
  }
  if (terminal_ && !step_.empty() && step != step_) {
    std::fputc('\n', stderr);
  }
  step_ = step;
  percent_ = percent;
  draw();
}

void ProgressBar::draw() const {
  if (!terminal_) {
    std::fprintf(stderr, "%s: %d %%\n", step_.c_str(), percent_);
    return;
  }
  constexpr int kWidth = 40;
  const std::string done(static_cast<std::size_t>(percent_ * kWidth / 100), '#');
  std::fprintf(stderr, "\r%-20s [%-*s] %3d %%", step_.c_str(), kWidth, done.c_str(), percent_);
  std::fflush(stderr);
}

}  // namespace field_phenotyping::simulation
