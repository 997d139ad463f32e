#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"

namespace field_phenotyping {

constexpr float kOrganStep = 0.04F;   ///< [m] cells of one organ are this near to one another
constexpr float kOrganShape = 0.05F;  ///< [m] about a cell, that shows which way its organ runs
constexpr std::size_t kCellsOfTask = 512U;  ///< that are worked together

/// Points gathered into cells: far fewer than points, and of even density. Of each cell:
struct OrganCells {
  std::vector<std::uint32_t> of_point;   ///< the cell of each point
  std::vector<Eigen::Vector3f> centers;  ///< local frame [m]
  std::vector<std::int32_t> owner;       ///< index of the plant, or -1
  std::vector<std::uint8_t> is_stem;
  std::vector<std::uint8_t> is_low;  ///< where weeds grow
  std::vector<LocalShape> shapes;    ///< of organs, stems left out
  float noise = 0.0F;  ///< [m] standard deviation of points across the organs' surfaces

  std::uint32_t size() const { return static_cast<std::uint32_t>(centers.size()); }
};

/// @param owner of each point of `block.cloud`, which is not empty: the plant whose stem holds it,
/// or -1
/// Deterministic; thread-safe; the shapes are the GPU's where there is one.
OrganCells gatherOrganCells(const Block& block, const std::vector<std::int32_t>& owner,
                            const ComputeDevice& device);

}  // namespace field_phenotyping
