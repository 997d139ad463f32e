#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <map>
#include <memory>
#include <vector>

#include "field_phenotyping/common/key_map.hpp"
#include "field_phenotyping/pipeline.hpp"
#include "field_phenotyping/preprocessing/thinning.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// A segmented block, and what its points were made of.
struct LabelledBlock {
  std::shared_ptr<const SegmentedBlock> block;
  DensePoints dense;
};

/// Plant and organ of every voxel of a cloud, and so of every point that fell into one. By tile:
/// block clouds hold voxel centroids, which lie in their own voxel.
class VoxelLabels {
 public:
  /// @param parameters, tile_corner, height_datum of the preprocessor that made the blocks: the
  /// corner of tile (0, 0) and the z that voxels are counted from, in the map frame [m]
  VoxelLabels(const PreprocessingParameters& parameters, const Eigen::Vector2d& tile_corner,
              double height_datum);

  /// Plants reach into their neighbours' tiles; a block has the last word in its own, else the
  /// first one has it. To be called once.
  void add(const std::vector<LabelledBlock>& blocks);

  /// Labels the cloud's points number `begin` ... `end` - 1; those in no voxel keep what they have.
  /// May be called from many threads for points that differ.
  void writeLabels(const PointCloud& cloud, std::size_t begin, std::size_t end,
                   std::vector<PointLabel>& labels) const;

 private:
  struct LabelledVoxel {
    VoxelKey key;
    PointLabel label;
  };
  /// A voxel, and the tile that may know it: none where none can.
  struct Asked {
    const KeyMap<PointLabel>* labels = nullptr;
    VoxelKey key = 0U;
  };

  std::map<BlockIndex, std::vector<LabelledVoxel>> labelsOf(const LabelledBlock& labelled) const;
  Asked askFor(const PointCloud& cloud, std::size_t i) const;
  Eigen::Vector3f localOf(const Eigen::Vector3d& p, const BlockIndex& tile) const {
    return (p - map_.originOf(tile)).cast<float>();
  }
  VoxelKey keyOf(const Eigen::Vector3f& local) const {
    return voxelKeyOf({local.x(), local.y(), local.z()}, map_.voxelSize());
  }

  VoxelMap map_;
  std::map<BlockIndex, KeyMap<PointLabel>> labels_;
};

}  // namespace field_phenotyping
