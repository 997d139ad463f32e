#include "whole_cloud.hpp"

#include <limits>

namespace field_phenotyping::benchmark {

PreprocessingParameters wholeCloudParameters() {
  PreprocessingParameters parameters;
  parameters.min_range = 0.0;
  parameters.max_range = std::numeric_limits<double>::infinity();
  return parameters;
}

Preprocessor accumulate(const PointCloud& cloud) {
  Preprocessor preprocessor(wholeCloudParameters(), "map");
  Scan scan;
  scan.cloud = cloud;
  preprocessor.addScan(scan, Eigen::Isometry3d::Identity());
  return preprocessor;
}

}  // namespace field_phenotyping::benchmark
