#pragma once

#include <string>
#include <vector>

#include "cloud_files.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/pipeline.hpp"

namespace field_phenotyping {

/// Refuses a whole cloud whose points lie so far apart that its coordinates cannot be in metres:
/// there are too few on a square metre for any plant.
/// @throws std::runtime_error naming the file and what would help
void requireMetres(const std::string& path, const CloudFile& input);

/// What was wrong with a cloud, as far as the result tells: a sentence each, with what to do.
std::vector<std::string> doubtsAbout(const CloudFile& input, const PipelineResult& result,
                                     const Parameters& parameters);

}  // namespace field_phenotyping
