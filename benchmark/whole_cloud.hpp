#pragma once

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/preprocessing/preprocessor.hpp"

namespace field_phenotyping::benchmark {

/// Default parameters, for a cloud whose sensor is not known: points at any range are taken.
PreprocessingParameters wholeCloudParameters();

/// The voxels of a whole cloud, whose blocks are now due, with those parameters.
Preprocessor accumulate(const PointCloud& cloud);

}  // namespace field_phenotyping::benchmark
