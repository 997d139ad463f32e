#include "config_file.hpp"

#include <yaml-cpp/yaml.h>

#include <set>
#include <sstream>
#include <stdexcept>
#include <type_traits>

#include "field_phenotyping/parameter_names.hpp"

namespace field_phenotyping {
namespace {

void assign(const std::string& where, const std::string& section, const std::string& name,
            const YAML::Node& node, Parameters& parameters) {
  bool stage_found = false;
  bool found = false;
  const auto assignTo = [&](const ParameterInfo& info, auto& value, auto low, auto high) {
    if (name != info.name) return;
    found = true;
    using Value = std::decay_t<decltype(value)>;
    try {
      value = node.as<Value>();
    } catch (const YAML::Exception&) {
      throw std::runtime_error(where + ": " + section + "/" + name + ": '" + YAML::Dump(node) +
                               "' is not " + kindText<Value>() + " (" + rangeText(info, low, high) +
                               ")");
    }
  };
  Parameters::visitSections(parameters, [&](const char* stage, auto& values) {
    if (section != stage) return;
    stage_found = true;
    std::decay_t<decltype(values)>::visit(values, assignTo);
  });
  if (!stage_found) throw std::runtime_error(where + ": " + unknownStage(section));
  if (!found) throw std::runtime_error(where + ": " + unknownParameter(section, name));
}

void requireValid(const std::string& where, const Parameters& parameters) {
  const std::string errors = checkParameters(parameters);
  if (!errors.empty()) throw std::runtime_error(where + ":\n" + errors);
}

}  // namespace

void readConfigFile(const std::string& path, Parameters& parameters) {
  YAML::Node root;
  try {
    root = YAML::LoadFile(path);
  } catch (const YAML::BadFile&) {
    throw std::runtime_error("cannot read " + path +
                             ". Check that the file is there and may be read.");
  } catch (const YAML::Exception& error) {
    throw std::runtime_error(path + ": cannot be read as YAML: " + error.what());
  }
  if (root.IsNull()) return;
  const std::string form = path + ": expected 'stage: {parameter: value}'";
  if (!root.IsMap()) throw std::runtime_error(form);
  std::set<std::string> given;
  for (const auto& section : root) {
    if (!section.first.IsScalar() || !section.second.IsMap()) throw std::runtime_error(form);
    for (const auto& entry : section.second) {
      if (!entry.first.IsScalar()) throw std::runtime_error(form);
      const auto stage = section.first.as<std::string>();
      const auto name = entry.first.as<std::string>();
      assign(path, stage, name, entry.second, parameters);
      if (given.insert(stage + "/" + name).second) continue;
      throw std::runtime_error(path + ": " + stage + "/" + name + " is given twice");
    }
  }
  requireValid(path, parameters);
}

void setParameters(const std::vector<std::string>& assignments, Parameters& parameters) {
  for (const std::string& assignment : assignments) {
    const std::string where = "--set " + assignment;
    const std::size_t slash = assignment.find('/');
    const std::size_t equals = assignment.find('=');
    if (slash == std::string::npos || equals == std::string::npos || equals < slash) {
      throw std::runtime_error(where + ": expected stage/parameter=value");
    }
    assign(where, assignment.substr(0, slash), assignment.substr(slash + 1U, equals - slash - 1U),
           YAML::Node(assignment.substr(equals + 1U)), parameters);
  }
  requireValid("--set", parameters);
}

std::string describeParameters() {
  std::ostringstream text;
  text << std::boolalpha;
  const Parameters defaults;
  Parameters::visitSections(defaults, [&](const char* stage, const auto& values) {
    std::decay_t<decltype(values)>::visit(values, [&](const ParameterInfo& info, const auto& value,
                                                      const auto& low, const auto& high) {
      text << stage << "/" << info.name << " = " << value;
      if (info.unit[0] != '\0') text << " " << info.unit;
      text << "  [" << low << " ... " << high << "]\n    " << info.description << "\n";
    });
  });
  return text.str();
}

}  // namespace field_phenotyping
