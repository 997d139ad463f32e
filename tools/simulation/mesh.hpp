#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace field_phenotyping::simulation {

/// Class of a surface, as in the `part` field of the clouds.
enum class Part : std::uint8_t { kGround = 0, kStem = 1, kOrgan = 2 };

/// What a triangle belongs to.
struct Surface {
  std::int32_t plant_id = -1;  ///< -1: ground or weed
  Part part = Part::kGround;
  float reflectance = 0.5F;  ///< share of the light sent back at normal incidence, [0, 1]
};

/// Triangles of the whole scene, in metres in the field's local map frame (map minus origin).
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<std::uint32_t> triangle_surface;  ///< per triangle: index into `surfaces`
  std::vector<Surface> surfaces;

  /// @brief Starts a new surface; triangles added from now on belong to it.
  void beginSurface(const Surface& surface) { surfaces.push_back(surface); }

  /// @brief Adds a vertex. @return Its index.
  std::uint32_t addVertex(const Eigen::Vector3d& position) {
    vertices.push_back(position.cast<float>());
    return static_cast<std::uint32_t>(vertices.size() - 1);
  }

  /// @brief Adds a triangle to the surface begun last.
  void addTriangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    triangles.push_back({a, b, c});
    triangle_surface.push_back(static_cast<std::uint32_t>(surfaces.size() - 1));
  }

  /// @brief Joins a grid of `rows` x `columns` vertices, stored row by row from `first`.
  /// @param closed Join the last column to the first one (a tube).
  void addGrid(std::uint32_t first, std::size_t rows, std::size_t columns, bool closed);
};

}  // namespace field_phenotyping::simulation
