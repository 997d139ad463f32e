#pragma once

#include <string>

namespace field_phenotyping::simulation {

/// @brief Progress of named steps on stderr: a bar where that is a terminal, else a line per step
/// and per quarter. Not thread-safe.
class ProgressBar {
 public:
  ProgressBar();
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// @param step What is being done; a new name starts a new bar.
  /// @param share Of the step that is done, [0, 1].
  void update(const std::string& step, double share);

 private:
  void draw() const;

  bool terminal_;
  std::string step_;
  int percent_ = -1;
};

}  // namespace field_phenotyping::simulation
