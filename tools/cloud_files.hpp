#pragma once

#include <pcl/PCLPointCloud2.h>

#include <string>

#include "field_phenotyping/common/point_cloud.hpp"
#include "field_phenotyping/pipeline.hpp"

namespace field_phenotyping {

/// A cloud file as read: the points for the core, and the file's own fields.
struct CloudFile {
  PointCloud cloud;              ///< every point in file order; origin near the first finite one
  pcl::PCLPointCloud2 contents;  ///< as stored
};

/// Reads a .pcd or .ply file; x, y, z may be FLOAT32 or FLOAT64, rgb is used when there.
/// @throws std::runtime_error naming the file, what is wrong and what would help
CloudFile readCloudFile(const std::string& path);

/// Writes `x y z plant_id part`, one point per input point in the input's order; x y z keep the
/// precision of the input.
void writeLabels(const std::string& path, const CloudFile& input,
                 const std::vector<PointLabel>& labels);

/// Writes `x y z rgb plant_id synthetic`: all plants' stem points, measured ones smoothed (Eq 25)
/// in the plant's colour, synthetic ones in red (Fig. 14). Coordinates are FLOAT64 when the input's
/// are.
void writeCompleted(const std::string& path, const CloudFile& input, const PipelineResult& result);

}  // namespace field_phenotyping
