#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

/// Height of the soil under one block: a regular grid of nodes, bilinear in between.
///
/// All lengths in metres, in the local frame of the block's cloud. Outside the grid the nearest
/// border value holds. Immutable after it was estimated, so safe to read from any thread.
class GroundModel {
 public:
  /// What is known of the soil at one node of the grid.
  struct Node {
    float height = 0.0F;     ///< local z of the soil [m]
    float stddev = 0.0F;     ///< standard deviation of `height` [m]
    std::uint8_t seen = 0U;  ///< 1: soil was measured within reach of the node; 0: extrapolated
  };

  /// An empty model: no soil known, `heightAt` is 0 everywhere.
  GroundModel() = default;

  /// @param corner  local x, y of node (0, 0) [m]
  /// @param spacing distance between nodes [m], > 0
  /// @param columns,rows nodes along x and y
  /// @param nodes   row-major, columns * rows of them
  /// @param observed false when no soil was found in the whole block (cropped away): the heights
  ///                 are then those of the lowest plant points
  GroundModel(const Eigen::Vector2f& corner, float spacing, int columns, int rows,
              std::vector<Node> nodes, bool observed);

  float heightAt(float x, float y) const;
  float stddevAt(float x, float y) const;
  /// Whether soil was measured near (x, y), rather than extrapolated to it.
  bool seenAt(float x, float y) const;
  /// Height of `point` above the soil [m].
  float heightAbove(const Eigen::Vector3f& point) const {
    return point.z() - heightAt(point.x(), point.y());
  }
  /// heightAbove() of many points [m], on several cores.
  std::vector<float> heightsAbove(const std::vector<Eigen::Vector3f>& points) const;
  /// Whether `point` lies higher than by `height` [m] above the highest soil of the block, told at
  /// once: false says nothing of how high it lies.
  bool clearlyAbove(const Eigen::Vector3f& point, float height) const {
    constexpr float kRounding = 0.001F;  // [m]
    return point.z() > highest_ + height + kRounding;
  }

  bool empty() const { return nodes_.empty(); }
  bool observed() const { return observed_; }
  const Eigen::Vector2f& corner() const { return corner_; }
  float spacing() const { return spacing_; }
  int columns() const { return columns_; }
  int rows() const { return rows_; }
  const std::vector<Node>& nodes() const { return nodes_; }

 private:
  template <class Value>
  float interpolate(float x, float y, Value value) const;

  Eigen::Vector2f corner_ = Eigen::Vector2f::Zero();
  float spacing_ = 1.0F;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<Node> nodes_;
  float highest_ = 0.0F;  // node
  bool observed_ = false;
};

}  // namespace field_phenotyping
