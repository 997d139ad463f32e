#include "field_phenotyping/preprocessing/ground_model.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {

GroundModel::GroundModel(const Eigen::Vector2f& corner, float spacing, int columns, int rows,
                         std::vector<Node> nodes, bool observed)
    : corner_(corner),
      spacing_(spacing),
      columns_(columns),
      rows_(rows),
      nodes_(std::move(nodes)),
      observed_(observed) {
  if (!(spacing > 0.0F) || columns < 1 || rows < 1 ||
      nodes_.size() != static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows)) {
    throw std::invalid_argument("GroundModel: spacing and node count do not describe a grid");
  }
  highest_ = nodes_.front().height;
  for (const Node& node : nodes_) highest_ = std::max(highest_, node.height);
}

template <class Value>
float GroundModel::interpolate(float x, float y, Value value) const {
  if (empty()) return 0.0F;
  const float u = std::clamp((x - corner_.x()) / spacing_, 0.0F, static_cast<float>(columns_ - 1));
  const float v = std::clamp((y - corner_.y()) / spacing_, 0.0F, static_cast<float>(rows_ - 1));
  const int i = std::min(static_cast<int>(u), std::max(columns_ - 2, 0));
  const int j = std::min(static_cast<int>(v), std::max(rows_ - 2, 0));
  const int i1 = std::min(i + 1, columns_ - 1);
  const int j1 = std::min(j + 1, rows_ - 1);
  const float fu = u - static_cast<float>(i);
  const float fv = v - static_cast<float>(j);
  const auto at = [&](int column, int row) {
    return value(nodes_[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
                        static_cast<std::size_t>(column)]);
  };
  return (1.0F - fv) * ((1.0F - fu) * at(i, j) + fu * at(i1, j)) +
         fv * ((1.0F - fu) * at(i, j1) + fu * at(i1, j1));
}

std::vector<float> GroundModel::heightsAbove(const std::vector<Eigen::Vector3f>& points) const {
  constexpr std::size_t kPoints = 16384U;  // of a task
  std::vector<float> heights(points.size());
  parallelChunks(points.size(), kPoints, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) heights[i] = heightAbove(points[i]);
  });
  return heights;
}

float GroundModel::heightAt(float x, float y) const {
  return interpolate(x, y, [](const Node& node) { return node.height; });
}

float GroundModel::stddevAt(float x, float y) const {
  return interpolate(x, y, [](const Node& node) { return node.stddev; });
}

bool GroundModel::seenAt(float x, float y) const {
  return observed_ &&
         interpolate(x, y, [](const Node& node) { return static_cast<float>(node.seen); }) >= 0.5F;
}

}  // namespace field_phenotyping
