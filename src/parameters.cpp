#include "field_phenotyping/parameters.hpp"

#include <cmath>
#include <sstream>
#include <string>

#include "field_phenotyping/common/nearest_name.hpp"
#include "field_phenotyping/parameter_names.hpp"

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
    line(info) << "'" << value << "' is neither '" << first << "' nor '" << second
               << "'; did you mean '" << nearestName(value, {first, second}) << "'?\n";
  }

 private:
  void check(const ParameterInfo& /*info*/, bool /*value*/, bool /*low*/, bool /*high*/) {}
  template <class Number>
  void check(const ParameterInfo& info, Number value, Number low, Number high) {
    if (value >= low && value <= high) return;  // NaN fails too
    line(info) << value << " is outside " << rangeText(info, low, high) << "\n";
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
  if (p.outlier_min_neighbors > 0 && p.outlier_radius <= p.voxel_size) {
    errors << "preprocessing/outlier_radius: must be above voxel_size (" << p.voxel_size
           << " m), or every point is an outlier\n";
  }
  if (p.block_margin > p.block_size) {
    errors << "preprocessing/block_margin: must not exceed block_size (" << p.block_size << " m)\n";
  }
  if (p.ground_cell > p.block_size) {
    errors << "preprocessing/ground_cell: must not exceed block_size (" << p.block_size << " m)\n";
  }
}

void crossCheck(const SegmentationParameters& p, std::ostringstream& errors) {
  if (p.seed_min_height >= p.seed_max_height) {
    errors << "segmentation/seed_min_height: must be below seed_max_height (" << p.seed_max_height
           << " m)\n";
  } else if (p.seed_min_length > p.seed_max_height - p.seed_min_height) {
    errors << "segmentation/seed_min_length: longer than from seed_min_height to seed_max_height ("
           << p.seed_max_height - p.seed_min_height << " m), no stem can be found\n";
  }
  if (!(p.alpha + p.beta > 0.0)) {
    errors << "segmentation/alpha, beta: one of them must be positive\n";
  }
  if (p.plant_spacing > 0.0 && p.min_plant_spacing > p.plant_spacing) {
    errors << "segmentation/min_plant_spacing: must not exceed plant_spacing (" << p.plant_spacing
           << " m)\n";
  }
  if (p.row_spacing > 0.0 && p.min_plant_spacing > p.row_spacing) {
    errors << "segmentation/min_plant_spacing: must not exceed row_spacing (" << p.row_spacing
           << " m)\n";
  }
}

template <class Section>
void crossCheck(const Section& /*section*/, std::ostringstream& /*errors*/) {}

void crossCheckStages(const Parameters& p, std::ostringstream& errors) {
  if (p.preprocessing.voxel_size >= p.segmentation.max_stem_radius) {
    errors << "preprocessing/voxel_size: must be below segmentation/max_stem_radius ("
           << p.segmentation.max_stem_radius << " m), or a stem is a single voxel\n";
  }
  if (p.preprocessing.ground_distance >= p.segmentation.seed_max_height) {
    errors << "preprocessing/ground_distance: must be below segmentation/seed_max_height ("
           << p.segmentation.seed_max_height << " m), or stems are taken for soil\n";
  }
}

}  // namespace

std::string checkStages(const Parameters& parameters) {
  std::ostringstream errors;
  Parameters::visitSections(parameters, [&](const char* name, const auto& section) {
    std::decay_t<decltype(section)>::visit(section, RangeChecker(name, errors));
    crossCheck(section, errors);
  });
  return errors.str();
}

std::string checkParameters(const Parameters& parameters) {
  std::ostringstream errors;
  errors << checkStages(parameters);
  crossCheckStages(parameters, errors);
  return errors.str();
}

}  // namespace field_phenotyping
