#include "tiling.hpp"

namespace field_phenotyping {

Tiling leastWork(const PointCloud& cloud, const PreprocessingParameters& parameters) {
  const Eigen::Array2d least(parameters.min_x, parameters.min_y);
  const Eigen::Array2d most(parameters.max_x, parameters.max_y);
  Eigen::Array2d low = most;
  Eigen::Array2d high = least;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const Eigen::Array2d place = cloud.mapPoint(i).head<2>().array();
    if (!place.allFinite() || (place < least).any() || (place > most).any()) continue;
    low = low.min(place);
    high = high.max(place);
  }
  const double wanted = parameters.block_size;
  if ((low > high).any()) return {wanted, Eigen::Vector2d::Zero()};
  const Eigen::Array2d extent = high - low;
  const auto tilesOf = [&](double edge) -> Eigen::Array2d { return (extent / edge).floor() + 1.0; };
  const auto workOf = [&](double edge) {
    return (extent + 2.0 * parameters.block_margin * (tilesOf(edge) - 1.0)).prod();
  };
  constexpr int kSteps = 20;
  constexpr double kWide = 1.5;    // of what is asked for
  constexpr double kWidest = 2.0;  // the same
  constexpr double kMuch = 0.1;    // of the work
  double edge = wanted;
  for (int k = 1; k <= kSteps; ++k) {
    const double wider = wanted * (1.0 + (kWidest - 1.0) * k / kSteps);
    const double gain = wider > kWide * wanted ? kMuch : 0.0;
    if (workOf(wider) < (1.0 - gain) * workOf(edge)) edge = wider;
  }
  return {edge, low - 0.5 * (tilesOf(edge) * edge - extent)};
}

}  // namespace field_phenotyping
