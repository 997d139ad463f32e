#pragma once

#include <dynamic_reconfigure/config_tools.h>
#include <dynamic_reconfigure/server.h>
#include <ros/ros.h>

#include <boost/thread/recursive_mutex.hpp>
#include <functional>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "field_phenotyping/parameter_names.hpp"
#include "field_phenotyping/parameters.hpp"
#include "stage_health.hpp"

// Between dynamic_reconfigure's generated Config classes and the core's parameter structs: matched
// by the parameters' names, so that no parameter is listed here a second time.

namespace field_phenotyping {

/// The section's values as the message that dynamic_reconfigure exchanges.
template <class Section>
dynamic_reconfigure::Config toConfigMessage(const Section& section) {
  dynamic_reconfigure::Config message;
  Section::visit(section, [&](const ParameterInfo& info, const auto& value, auto, auto) {
    dynamic_reconfigure::ConfigTools::appendParameter(message, info.name, value);
  });
  return message;
}

/// "preprocessing" and so on.
template <class Section>
std::string sectionName() {
  std::string result;
  const Parameters all;
  Parameters::visitSections(all, [&](const char* name, const auto& section) {
    if constexpr (std::is_same_v<std::decay_t<decltype(section)>, Section>) result = name;
  });
  return result;
}

template <class Section, class Config>
Section toSection(const Config& config) {
  dynamic_reconfigure::Config message;
  config.__toMessage__(message);
  Section section;
  Section::visit(section, [&](const ParameterInfo& info, auto& value, auto, auto) {
    dynamic_reconfigure::ConfigTools::getParameter(message, info.name, value);
  });
  return section;
}

/// Sets the section's values in `config`.
template <class Section, class Config>
void assign(const Section& section, Config& config) {
  dynamic_reconfigure::Config message = toConfigMessage(section);
  config.__fromMessage__(message);
}

/// What checkStages() says about this section; empty when all is well.
template <class Section>
std::string violations(const Section& section) {
  Parameters all;
  Parameters::visitSections(all, [&](const char*, auto& other) {
    if constexpr (std::is_same_v<std::decay_t<decltype(other)>, Section>) other = section;
  });
  return checkStages(all);
}

/// The nearest valid parameters to `wanted`: one value is put back to what it is in `fallback`
/// where that is enough, else all are. `fallback` must be valid.
template <class Section>
Section corrected(const Section& wanted, const Section& fallback) {
  if (violations(wanted).empty()) return wanted;
  std::map<std::string, std::variant<bool, int, double, std::string>> known;
  Section::visit(fallback, [&](const ParameterInfo& info, const auto& value, auto, auto) {
    known[info.name] = value;
  });
  for (const auto& [name, value] : known) {
    Section candidate = wanted;
    Section::visit(candidate, [&, &name = name, &value = value](const ParameterInfo& info,
                                                                auto& target, auto, auto) {
      if (info.name == name) target = std::get<std::decay_t<decltype(target)>>(value);
    });
    if (violations(candidate).empty()) return candidate;
  }
  return fallback;
}

/// The parameters of one stage: read from the stage's private namespace at the start (values given
/// there win over the defaults of the .cfg) and changed while data flows.
///
/// Values out of range are moved into it, combinations that cannot work are put right, and both are
/// said and written back. Thread-safe.
template <class Config, class Section>
class ParameterServer {
 public:
  /// @param others private parameters of the stage that are not in Section
  /// @param on_change called after each change, not at the start; must return at once
  ParameterServer(const ros::NodeHandle& pnh, StageHealth& health,
                  const std::set<std::string>& others, std::function<void()> on_change)
      : health_(health) {
    reportUnusable(pnh, others);
    server_ = std::make_unique<dynamic_reconfigure::Server<Config>>(mutex_, pnh);
    server_->setCallback([this](Config& config, std::uint32_t) { reconfigure(config); });
    on_change_ = std::move(on_change);
  }

  /// A copy of the values in force.
  Section current() const {
    const boost::recursive_mutex::scoped_lock lock(mutex_);
    return current_;
  }

 private:
  // Called by the server with mutex_ held; what it leaves in `config` is written back.
  void reconfigure(Config& config) {
    const auto wanted = toSection<Section>(config);
    const std::string wrong = violations(wanted);
    if (!wrong.empty()) health_.trouble("parameters", "corrected: " + wrong);
    current_ = corrected(wanted, current_);
    assign(current_, config);
    if (on_change_) on_change_();
  }

  /// dynamic_reconfigure passes over misspelt names, wrong types and ranges in silence.
  void reportUnusable(const ros::NodeHandle& pnh, const std::set<std::string>& others) {
    std::set<std::string> known = others;
    Section given_values;
    Section::visit(given_values, [&](const ParameterInfo& info, auto& value, auto low, auto high) {
      using Value = std::decay_t<decltype(value)>;
      known.insert(info.name);
      const std::string name = pnh.resolveName(info.name);
      if (!pnh.hasParam(info.name)) return;
      const std::string range = rangeText(info, low, high);
      std::ostringstream text;
      if (!pnh.getParam(info.name, value)) {
        text << name << " is not " << kindText<Value>() << " (" << range
             << "): ignored, its default is in force";
      } else if constexpr (std::is_arithmetic_v<Value>) {
        if (value >= low && value <= high) return;
        text << name << " is " << value << ", outside " << range << ": moved into it";
      }
      if (!text.str().empty()) health_.trouble(name, text.str());
    });
    std::vector<std::string> given;
    pnh.getParamNames(given);
    const std::string own = pnh.getNamespace();
    const std::string above = ros::names::parentNamespace(own);
    const std::string stage = own.substr(own.rfind('/') + 1U);
    for (const std::string& name : given) {
      const std::string key = below(own, name);
      if (!key.empty() && known.count(key) == 0U) {
        health_.trouble(name, name + ": " +
                                  unknownParameter(sectionName<Section>(), key,
                                                   {others.begin(), others.end()}));
      }
      // One that was meant for this stage is seen by none if the stage's name is misspelt.
      const std::string beside = below(above, name);
      if (beside.find('/') == std::string::npos) continue;
      const std::string sibling = beside.substr(0U, beside.find('/'));
      if (misspeltStage(sibling) == stage) {
        health_.trouble(name, name + " is read by nobody: " + unknownStage(sibling));
      }
    }
  }

  /// The part of `name` that lies below the namespace; empty if it does not.
  static std::string below(const std::string& name_space, const std::string& name) {
    const std::string prefix = name_space == "/" ? name_space : name_space + "/";
    return name.compare(0U, prefix.size(), prefix) == 0 ? name.substr(prefix.size()) : "";
  }

  StageHealth& health_;
  mutable boost::recursive_mutex mutex_;  // before the server, which locks it
  Section current_;
  std::function<void()> on_change_;
  std::unique_ptr<dynamic_reconfigure::Server<Config>> server_;
};

}  // namespace field_phenotyping
