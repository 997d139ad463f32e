#include "simulation/mesh.hpp"

namespace field_phenotyping::simulation {

void TriangleMesh::addGrid(std::uint32_t first, std::size_t rows, std::size_t columns,
                           bool closed) {
  const auto width = static_cast<std::uint32_t>(columns);
  const std::uint32_t quads = closed ? width : width - 1;
  for (std::uint32_t row = 0; row + 1 < rows; ++row) {
    for (std::uint32_t column = 0; column < quads; ++column) {
      const std::uint32_t next = (column + 1) % width;
      const std::uint32_t lower = first + row * width;
      const std::uint32_t upper = lower + width;
      addTriangle(lower + column, lower + next, upper + next);
      addTriangle(lower + column, upper + next, upper + column);
    }
  }
}

}  // namespace field_phenotyping::simulation
