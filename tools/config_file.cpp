#include "config_file.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <sstream>
#include <stdexcept>
#include <type_traits>

namespace field_phenotyping {
namespace {

std::size_t editDistance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1U);
  std::iota(row.begin(), row.end(), 0U);
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({above + 1U, row[j - 1U] + 1U, diagonal + (a[i - 1U] != b[j - 1U])});
      diagonal = above;
    }
  }
  return row.back();
}

/// Writes one named value into the section that a visit() walks over.
struct Assigner {
  const std::string& name;
  const YAML::Node& node;
  bool& found;
  std::vector<std::string>& names;

  template <class Value, class Low, class High>
  void operator()(const ParameterInfo& info, Value& value, const Low& /*low*/,
                  const High& /*high*/) {
    names.emplace_back(info.name);
    if (name != info.name) return;
    value = node.as<Value>();
    found = true;
  }
};

std::string nearest(const std::string& name, const std::vector<std::string>& names) {
  return *std::min_element(names.begin(), names.end(),
                           [&](const std::string& a, const std::string& b) {
                             return editDistance(name, a) < editDistance(name, b);
                           });
}

void assign(const std::string& where, const std::string& section, const std::string& name,
            const YAML::Node& node, Parameters& parameters) {
  std::vector<std::string> sections;
  std::vector<std::string> names;
  bool found = false;
  Parameters::visitSections(parameters, [&](const char* stage, auto& values) {
    sections.emplace_back(stage);
    if (section != stage) return;
    try {
      std::decay_t<decltype(values)>::visit(values, Assigner{name, node, found, names});
    } catch (const YAML::Exception&) {
      throw std::runtime_error(where + ": " + section + "/" + name + ": '" + YAML::Dump(node) +
                               "' is not a value of its type");
    }
  });
  if (found) return;
  if (names.empty()) {
    throw std::runtime_error(where + ": there is no stage '" + section + "'; did you mean '" +
                             nearest(section, sections) + "'?");
  }
  throw std::runtime_error(where + ": there is no parameter '" + section + "/" + name +
                           "'; did you mean '" + nearest(name, names) + "'?");
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
  } catch (const YAML::Exception& error) {
    throw std::runtime_error(path + ": cannot be read as YAML: " + error.what());
  }
  if (root.IsNull()) return;
  const std::string form = path + ": expected 'stage: {parameter: value}'";
  if (!root.IsMap()) throw std::runtime_error(form);
  for (const auto& section : root) {
    if (!section.first.IsScalar() || !section.second.IsMap()) throw std::runtime_error(form);
    for (const auto& entry : section.second) {
      if (!entry.first.IsScalar()) throw std::runtime_error(form);
      assign(path, section.first.as<std::string>(), entry.first.as<std::string>(), entry.second,
             parameters);
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
