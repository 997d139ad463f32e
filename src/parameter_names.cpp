#include "field_phenotyping/parameter_names.hpp"

#include <limits>

#include "field_phenotyping/common/nearest_name.hpp"

namespace field_phenotyping {
namespace {

std::vector<std::string> stageNames() {
  std::vector<std::string> names;
  const Parameters parameters;
  Parameters::visitSections(parameters,
                            [&](const char* stage, const auto&) { names.emplace_back(stage); });
  return names;
}

}  // namespace

std::string unknownParameter(const std::string& section, const std::string& name,
                             const std::vector<std::string>& others) {
  std::string best;
  std::size_t best_distance = std::numeric_limits<std::size_t>::max();
  const auto offer = [&](const std::string& stage, const std::string& candidate,
                         const std::string& range) {
    // A name of another stage must be nearer, not only as near.
    const std::size_t distance = 2U * editDistance(name, candidate) + (stage == section ? 0U : 1U);
    if (distance >= best_distance) return;
    best_distance = distance;
    best = "'" + stage + "/" + candidate + "'" + (range.empty() ? "" : " (" + range + ")");
  };
  const Parameters parameters;
  Parameters::visitSections(parameters, [&](const char* stage, const auto& values) {
    std::decay_t<decltype(values)>::visit(
        values, [&](const ParameterInfo& info, const auto&, auto low, auto high) {
          offer(stage, info.name, rangeText(info, low, high));
        });
  });
  for (const std::string& other : others) offer(section, other, "");
  return "there is no parameter '" + section + "/" + name + "'; did you mean " + best + "?";
}

std::string unknownStage(const std::string& name) {
  return "there is no stage '" + name + "'; did you mean '" + nearestName(name, stageNames()) +
         "'?";
}

std::string misspeltStage(const std::string& name) {
  constexpr std::size_t kMostSlips = 3U;  // more, and it is the name of something else
  const std::vector<std::string> stages = stageNames();
  const std::string& nearest = nearestName(name, stages);
  const std::size_t slips = editDistance(name, nearest);
  return slips > 0U && slips <= kMostSlips ? nearest : "";
}

}  // namespace field_phenotyping
