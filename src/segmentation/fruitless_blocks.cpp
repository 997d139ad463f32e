#include "field_phenotyping/segmentation/fruitless_blocks.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "field_phenotyping/common/bounds.hpp"

namespace field_phenotyping {
namespace {

// A stem needs about so many points per square metre of field to be told from noise.
constexpr double kSparse = 200.0;

}  // namespace

void FruitlessBlocks::add(const BlockHeader& header, const std::vector<Eigen::Vector3f>& points,
                          const GroundModel& ground, const SegmentationParameters& parameters,
                          std::size_t tiles) {
  tiles_ += tiles;
  if (ground.observed()) with_soil_ += tiles;
  points_ += points.size();
  if (points.empty()) return;
  for (const Eigen::Vector3f& point : points) {
    const float height = ground.heightAbove(point);
    const bool in_band =
        height >= parameters.seed_min_height && height <= parameters.seed_max_height;
    if (in_band) ++points_in_band_;
  }
  const double tile_area = std::pow(header.tile_size + 2.0 * header.margin, 2);
  const Bounds bounds = boundsOf(points);
  const float covered = (bounds.high - bounds.low).head<2>().prod();
  area_ += std::min(static_cast<double>(tiles) * tile_area, static_cast<double>(covered));
}

std::string FruitlessBlocks::reason(const SegmentationParameters& parameters) const {
  std::ostringstream text;
  text << "no plant found in " << tiles_ << (tiles_ == 1U ? " block" : " blocks")
       << " (soil seen in " << with_soil_ << "): ";
  constexpr double kLeastArea = 0.01;  // [m^2]
  const double density = static_cast<double>(points_in_band_) / std::max(area_, kLeastArea);
  if (points_ == 0U) {
    text << "no point is left above the soil. Scattered single points count as noise "
         << "(outlier_radius, outlier_min_neighbors): is the field near enough to the sensor?";
  } else if (density < kSparse) {
    text << "only " << std::lround(density) << " points per square metre at the heights where "
         << "stems are looked for (" << parameters.seed_min_height << " to "
         << parameters.seed_max_height << " m), a stem needs hundreds. Is this a field seen from "
         << "near, are coordinates in metres with z up, does the transform fit?";
  } else {
    text << std::lround(density) << " points per square metre, but nothing as upright and thin as "
         << "a stem. If there are plants, lower seed_min_score (now " << parameters.seed_min_score
         << ") or seed_min_length (now " << parameters.seed_min_length << " m)";
  }
  return text.str();
}

}  // namespace field_phenotyping
