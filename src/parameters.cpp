#include "field_phenotyping/parameters.hpp"

#include <cmath>
#include <sstream>
#include <string>

namespace field_phenotyping {
namespace {

/// Collects one line per value that is outside its range.
class RangeChecker {
 public:
  RangeChecker(std::string section, std::ostringstream& errors)
      : section_(std::move(section)), errors_(errors) {}

  template <class Value>
  void operator()(const ParameterInfo& info, const Value& value, const Value& low,
                  const Value& high) {
    check(info, value, low, high);
  }
  void operator()(const ParameterInfo& info, const std::string& value, const char* first,
                  const char* second) {
    if (value == first || value == second) return;
    line(info) << "'" << value << "' is neither '" << first << "' nor '" << second << "'\n";
  }

 private:
  void check(const ParameterInfo& /*info*/, bool /*value*/, bool /*low*/, bool /*high*/) {}
  template <class Number>
  void check(const ParameterInfo& info, Number value, Number low, Number high) {
    if (value >= low && value <= high) return;  // NaN fails too
    line(info) << value << " is outside [" << low << ", " << high << "] " << info.unit << "\n";
  }
  std::ostream& line(const ParameterInfo& info) {
    return errors_ << section_ << "/" << info.name << ": ";
  }

  std::string section_;
  std::ostringstream& errors_;
};

void crossCheck(const PreprocessingParameters& p, std::ostringstream& errors) {
  if (p.min_range >= p.max_range) {
    errors << "preprocessing/min_range: must be below max_range (" << p.max_range << " m)\n";
  }
  if (p.min_x >= p.max_x || p.min_y >= p.max_y || p.min_z >= p.max_z) {
    errors << "preprocessing/min_x ... max_z: the crop box is empty\n";
  }
}

void crossCheck(const SegmentationParameters& p, std::ostringstream& errors) {
  if (p.seed_min_height >= p.seed_max_height) {
    errors << "segmentation/seed_min_height: must be below seed_max_height (" << p.seed_max_height
           << " m)\n";
  }
  if (!(p.alpha + p.beta > 0.0)) {
    errors << "segmentation/alpha, beta: one of them must be positive\n";
  }
}

template <class Section>
void crossCheck(const Section& /*section*/, std::ostringstream& /*errors*/) {}

}  // namespace

std::string checkParameters(const Parameters& parameters) {
  std::ostringstream errors;
  Parameters::visitSections(parameters, [&](const char* name, const auto& section) {
    std::decay_t<decltype(section)>::visit(section, RangeChecker(name, errors));
    crossCheck(section, errors);
  });
  return errors.str();
}

}  // namespace field_phenotyping
