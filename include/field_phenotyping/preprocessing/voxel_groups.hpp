#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/partitioned.hpp"
#include "field_phenotyping/preprocessing/voxel_team.hpp"

namespace field_phenotyping {

/// Points by the voxels that they lie in; voxels are numbered as points meet them, the same on any
/// number of threads. Works on all cores: points are dealt out by the column of voxels that they
/// lie in, and each share is numbered by itself, with a table that fits the processor's cache.
/// Read-only after construction.
class VoxelGroups {
 public:
  /// @param points less than 2^20 voxels from zero along each axis; held by reference
  /// @param edge   of the voxels [m], > 0
  VoxelGroups(const std::vector<Eigen::Vector3f>& points, float edge);
  VoxelGroups(std::vector<Eigen::Vector3f>&&, float) = delete;

  /// How many voxels hold a point.
  std::size_t size() const { return first_.size(); }
  /// The first point of each voxel, ascending.
  const std::vector<std::uint32_t>& first() const { return first_; }
  /// The voxel of each point.
  std::vector<std::uint32_t> ofPoints() const;
  /// What each voxel makes of its points, one after the other.
  std::vector<VoxelMean> means() const;

 private:
  struct Member {
    std::uint64_t key;    // of its voxel
    std::uint32_t point;  // its number
    std::uint32_t voxel;  // number among the voxels of its partition
  };

  Partitioned<Member> partition(float edge) const;
  void numberWithin(std::size_t partition);
  void numberAll();

  const std::vector<Eigen::Vector3f>& points_;
  Partitioned<Member> members_;
  std::vector<std::vector<std::uint32_t>> voxels_;  // of each partition: their numbers among all
  std::vector<std::uint32_t> first_;
};

}  // namespace field_phenotyping
