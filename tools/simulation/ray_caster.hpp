#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>

#include "simulation/mesh.hpp"

namespace field_phenotyping::simulation {

/// Nearest intersection of a ray.
struct RayHit {
  double range = 0.0;         ///< from the origin of the ray [m]
  double cosine = 0.0;        ///< of the angle of incidence, (0, 1]
  std::uint32_t surface = 0;  ///< index into TriangleMesh::surfaces
};

/// @brief Casts rays at a mesh with Embree. cast() may be called from several threads.
class RayCaster {
 public:
  /// @param mesh Copied where needed, except its labels: must outlive the caster.
  explicit RayCaster(const TriangleMesh& mesh);
  ~RayCaster();
  RayCaster(RayCaster&&) noexcept;
  RayCaster& operator=(RayCaster&&) noexcept;

  /// @param direction Unit vector.
  /// @return The first triangle hit, from either side, within `max_range` [m].
  std::optional<RayHit> cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                             double max_range) const;

 private:
  struct EmbreeScene;
  std::unique_ptr<EmbreeScene> scene_;
  const TriangleMesh* mesh_;
};

}  // namespace field_phenotyping::simulation
