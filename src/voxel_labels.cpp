#include "voxel_labels.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kBatch = 32U;  // voxels whose memory is fetched at once

}  // namespace

VoxelLabels::VoxelLabels(const PreprocessingParameters& parameters,
                         const Eigen::Vector2d& tile_corner, double height_datum)
    : map_(parameters.block_size, parameters.voxel_size, tile_corner) {
  map_.setHeightDatum(height_datum);
}

void VoxelLabels::add(const std::vector<LabelledBlock>& blocks) {
  // What each block says, tile by tile; then what each tile hears, block by block.
  std::vector<std::map<BlockIndex, std::vector<LabelledVoxel>>> said(blocks.size());
  parallelFor(blocks.size(), [&](std::size_t b) { said[b] = labelsOf(blocks[b]); });
  for (const auto& of_block : said) {
    for (const auto& of_tile : of_block) labels_[of_tile.first];
  }
  std::vector<std::pair<BlockIndex, KeyMap<PointLabel>*>> tiles;
  for (auto& [tile, labels] : labels_) tiles.emplace_back(tile, &labels);
  parallelFor(tiles.size(), [&](std::size_t t) {
    const auto& [tile, labels] = tiles[t];
    std::size_t most = 0U;
    for (const auto& of_block : said) {
      const auto found = of_block.find(tile);
      if (found != of_block.end()) most += found->second.size();
    }
    labels->reserve(most);
    for (std::size_t b = 0; b < blocks.size(); ++b) {
      const auto found = said[b].find(tile);
      if (found == said[b].end()) continue;
      const std::vector<LabelledVoxel>& voxels = found->second;
      for (std::size_t k = 0; k < voxels.size(); ++k) {
        if (k + kBatch < voxels.size()) labels->prefetch(voxels[k + kBatch].key);
        const LabelledVoxel& voxel = voxels[k];
        const auto [label, is_new] = labels->tryEmplace(voxel.key, voxel.label);
        if (!is_new && tile == blocks[b].block->header.index) *label = voxel.label;
      }
    }
  });
}

void VoxelLabels::writeLabels(const PointCloud& cloud, std::size_t begin, std::size_t end,
                              std::vector<PointLabel>& labels) const {
  std::array<Asked, kBatch> asked;
  while (begin < end) {
    const std::size_t count = std::min(kBatch, end - begin);
    for (std::size_t k = 0; k < count; ++k) {
      asked[k] = askFor(cloud, begin + k);
      if (asked[k].labels != nullptr) asked[k].labels->prefetch(asked[k].key);
    }
    for (std::size_t k = 0; k < count; ++k) {
      if (asked[k].labels == nullptr) continue;
      if (const PointLabel* label = asked[k].labels->find(asked[k].key)) {
        labels[begin + k] = *label;
      }
    }
    begin += count;
  }
}

std::map<BlockIndex, std::vector<VoxelLabels::LabelledVoxel>> VoxelLabels::labelsOf(
    const LabelledBlock& labelled) const {
  std::map<BlockIndex, std::vector<LabelledVoxel>> labels;
  const SegmentedBlock& block = *labelled.block;
  BlockIndex tile;
  std::vector<LabelledVoxel>* of_tile = nullptr;  // where the last one went: most follow it there
  const auto note = [&](const Eigen::Vector3f& point, const PointLabel& label) {
    const Eigen::Vector3d p = block.cloud.origin + point.cast<double>();
    const BlockIndex at = map_.tileAt(p.x(), p.y());
    if (of_tile == nullptr || !(at == tile)) {
      tile = at;
      of_tile = &labels[tile];
    }
    of_tile->push_back({keyOf(localOf(p, tile)), label});
  };
  std::vector<PointLabel> of_source(labelled.dense.points.size());  // more than there are
  for (const Plant& plant : block.plants) {
    if (!plant.owned) continue;
    for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
      const PointLabel label{plant.id, i < plant.stem.end ? Part::kStem : Part::kOther};
      if (of_source.empty()) {
        note(block.cloud.points[i], label);
      } else {
        of_source[block.source_index[i]] = label;
      }
    }
  }
  for (std::size_t i = 0; i < labelled.dense.points.size(); ++i) {
    const PointLabel& label = of_source[labelled.dense.thinned[i]];
    if (label.plant_id >= 0) note(labelled.dense.points[i], label);
  }
  return labels;
}

VoxelLabels::Asked VoxelLabels::askFor(const PointCloud& cloud, std::size_t i) const {
  constexpr double kMostDistance = 1e9;  // [m] beyond it tiles cannot be numbered
  if (!cloud.points[i].allFinite()) return {};
  const Eigen::Vector3d p = cloud.mapPoint(i);
  if (!(p.cwiseAbs().maxCoeff() < kMostDistance)) return {};
  const BlockIndex tile = map_.tileAt(p.x(), p.y());
  const auto labels = labels_.find(tile);
  if (labels == labels_.end()) return {};
  const Eigen::Vector3f local = localOf(p, tile);
  if (!hasVoxelKey(local, map_.voxelSize())) return {};
  return {&labels->second, keyOf(local)};
}

}  // namespace field_phenotyping
