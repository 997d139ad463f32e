#pragma once

#include <nodelet/loader.h>

#include <algorithm>
#include <cctype>
#include <string>

namespace field_phenotyping {
namespace testing {

/// Loads the four stages into this very process, named as the launch file names them. False where
/// one could not be loaded.
inline bool loadChain(nodelet::Loader& loader) {
  std::string input = "/points";
  for (const char* stage : {"Preprocessing", "Segmentation", "Completion", "Measurement"}) {
    std::string name = std::string("/field_phenotyping/") + stage;
    std::transform(name.begin(), name.end(), name.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (!loader.load(name, std::string("field_phenotyping/") + stage, {{name + "/input", input}},
                     {})) {
      return false;
    }
    input = name + "/output";
  }
  return true;
}

}  // namespace testing
}  // namespace field_phenotyping
