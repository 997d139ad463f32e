#include "field_phenotyping/segmentation/joined_tiles.hpp"

#include <utility>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"

namespace field_phenotyping {
namespace {

SegmentedBlock tileOf(const SegmentedBlock& whole, const BlockHeader& header) {
  SegmentedBlock tile;
  tile.header = header;
  tile.ground = whole.ground;
  tile.cloud = whole.cloud.emptyAlike();
  const auto isNear = [&](std::size_t i) {
    const Eigen::Vector3d at = whole.cloud.mapPoint(i);
    return header.holds(at.x(), at.y(), header.margin);
  };
  std::size_t count = 0U;
  for (std::size_t i = 0; i < whole.cloud.size(); ++i) count += isNear(i) ? 1U : 0U;
  tile.cloud.reserveLike(whole.cloud, count);
  tile.source_index.reserve(count);
  const auto take = [&](std::uint32_t i) {
    if (!isNear(i)) return;
    tile.cloud.take(whole.cloud, i);
    tile.source_index.push_back(whole.source_index[i]);
  };
  const auto taken = [&] { return static_cast<std::uint32_t>(tile.cloud.size()); };

  std::vector<bool> left(whole.cloud.size(), true);  // for the points that are no plant's here
  for (const Plant& plant : whole.plants) {
    const Eigen::Vector3d base = whole.cloud.origin + plant.base.cast<double>();
    if (!header.holds(base.x(), base.y(), header.margin)) continue;
    Plant own = plant;
    own.owned = header.holds(base.x(), base.y(), PlantRegistry::kBorderTolerance);
    own.points.begin = own.stem.begin = taken();
    for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) take(i);
    own.stem.end = taken();
    for (std::uint32_t i = plant.stem.end; i < plant.points.end; ++i) take(i);
    own.points.end = taken();
    for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) left[i] = false;
    tile.plants.push_back(std::move(own));
  }
  for (std::uint32_t i = 0; i < whole.cloud.size(); ++i) {
    if (left[i]) take(i);
  }
  return tile;
}

}  // namespace

std::vector<SegmentedBlock> splitIntoTiles(SegmentedBlock block,
                                           const std::vector<BlockHeader>& tiles) {
  std::vector<SegmentedBlock> split(tiles.size());
  parallelFor(tiles.size(), [&](std::size_t t) { split[t] = tileOf(block, tiles[t]); });
  if (tiles.empty()) split.push_back(std::move(block));
  return split;
}

}  // namespace field_phenotyping
