// Reads points, "x y z" a line in metres with z up, and prints the plants that stand in them.
#include <exception>
#include <iomanip>
#include <iostream>

#include "field_phenotyping/pipeline.hpp"

int main() {
  field_phenotyping::PointCloud cloud;
  Eigen::Vector3d point;
  while (std::cin >> point.x() >> point.y() >> point.z()) {
    if (cloud.empty()) cloud.origin = point;  // points are float, and precise near the origin only
    cloud.points.push_back((point - cloud.origin).cast<float>());
  }

  field_phenotyping::Parameters parameters;  // the defaults, which are for maize
  parameters.measurement.diameter_height = 0.5;
  try {
    const field_phenotyping::PipelineResult result =
        field_phenotyping::phenotypeCloud(cloud, parameters);
    std::cout << std::fixed << std::setprecision(3)
              << "plant x[m] y[m] height[m] +- stem_diameter[mm] +- quality\n";
    for (const field_phenotyping::Phenotype& plant : result.plants) {
      std::cout << plant.id << ' ' << plant.base.x() << ' ' << plant.base.y() << ' '
                << plant.height.value << ' ' << plant.height.stddev << ' '
                << 1e3 * plant.stem_diameter.value << ' ' << 1e3 * plant.stem_diameter.stddev << ' '
                << field_phenotyping::flagNames(plant.flags) << '\n';
    }
  } catch (const std::exception& error) {
    std::cerr << "measure_points: " << error.what() << '\n';
    return 1;
  }
  return 0;
}
