#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "field_phenotyping/segmentation/stem_axis.hpp"

// What the fits of a stem's midline share.

namespace field_phenotyping {

/// Whether plants are so low [m] that their stems have not grown out of the whorl.
inline bool isSeedling(float plant_height) {
  constexpr float kSeedling = 0.7F;
  return plant_height <= kSeedling;
}

/// Whether leaves rise as steeply as the stem and reach far above it [m].
inline bool isYoung(float plant_height) {
  constexpr float kYoung = 1.4F;  // [m] lower than any with a tassel
  return plant_height < kYoung;
}

/// A point in an axis's own frame: height along its chord, offset across it [m].
struct Sample {
  double height = 0.0;
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();
  // Once placed on a curve's nodes: fits look at a sample often, and it keeps its place between
  // them.
  double share = 0.0;       ///< of the upper node
  std::uint32_t node = 0U;  ///< the lower one
  std::uint32_t band = 0U;  ///< of heights with a share of stem points of their own
};

/// The chord of an axis with a basis across it.
struct ChordFrame {
  Eigen::Vector3d origin, u, v, w;
  double length;

  explicit ChordFrame(const StemAxis& axis)
      : origin(axis.nodes().front().position.cast<double>()),
        w(axis.nodes().back().position.cast<double>() - origin),
        length(w.norm()) {
    w /= length;
    u = (Eigen::Vector3d::UnitX() - w.x() * w).normalized();
    v = w.cross(u);
  }
  Sample toFrame(const Eigen::Vector3f& point) const {
    const Eigen::Vector3d away = point.cast<double>() - origin;
    Sample sample;
    sample.height = away.dot(w);
    sample.offset = {away.dot(u), away.dot(v)};
    return sample;
  }
  /// Offset of a plumb line per metre of height.
  Eigen::Vector2d upright() const { return Eigen::Vector2d(u.z(), v.z()) / w.z(); }
  Eigen::Vector3f fromFrame(double height, const Eigen::Vector2d& offset) const {
    return (origin + height * w + offset.x() * u + offset.y() * v).cast<float>();
  }
};

/// The stem as it is fitted: centres at even heights with straight lines between, and a radius that
/// falls evenly with the height.
struct StemCurve {
  double spacing = 0.0;  ///< [m] of the centres
  std::vector<Eigen::Vector2d> centers;
  double radius = 0.0;  ///< at height 0
  double taper = 0.0;   ///< of the radius per metre, <= 0

  struct Place {
    std::size_t node;  // the lower one
    double share;      // of the upper one
  };
  Place placeOf(double height) const {
    const double at = std::clamp(height / spacing, 0.0, static_cast<double>(centers.size() - 1U));
    const auto node = std::min(static_cast<std::size_t>(at), centers.size() - 2U);
    return {node, at - static_cast<double>(node)};
  }
  Eigen::Vector2d centerAt(double height) const { return centerAt(placeOf(height)); }
  Eigen::Vector2d centerAt(const Place& at) const {
    return (1.0 - at.share) * centers[at.node] + at.share * centers[at.node + 1U];
  }
  /// At the height of a sample that has been placed on this curve's nodes.
  Eigen::Vector2d centerAt(const Sample& sample) const {
    return centerAt(Place{sample.node, sample.share});
  }
  double length() const { return spacing * static_cast<double>(centers.size() - 1U); }
  double radiusAt(double height) const { return std::max(radius + taper * height, thinnest()); }
  double thinnest() const {
    constexpr double kThinnest = 0.25;  // of the radius at the base
    return kThinnest * radius;
  }
};

/// Samples by height, so that those of a stretch lie side by side.
void sortByHeight(std::vector<Sample>& samples);

/// The axis as a curve with nodes about `spacing` apart [m]; radius of the axis's foot.
StemCurve curveAlong(const StemAxis& axis, const ChordFrame& frame, double spacing);

/// The curve as an axis whose nodes rise, no thicker than `thickest` [m] (radius); nothing where
/// fewer than two nodes rise.
std::optional<StemAxis> axisOf(const StemCurve& curve, const ChordFrame& frame, double thickest);

/// The normal equations of a curve: two unknowns per node, each tied to those of the next two nodes
/// only, and radius and taper, tied to all. Solved in a time that grows as the nodes.
class CurveEquations {
 public:
  explicit CurveEquations(std::size_t nodes)
      : lower_(kBand + 2U * nodes, std::array<double, kBand + 1U>{}),
        right_(kBand + 2U * nodes, Eigen::Vector4d::Zero()) {}

  /// Adds to the coefficient of two node unknowns, row >= column >= row - 4.
  void add(std::size_t row, std::size_t column, double value) {
    lower_[kBand + row][row - column] += value;
  }
  /// Adds to the right side and to the coefficients of radius and taper in a node's equation.
  void addRight(std::size_t row, const Eigen::Vector3d& right_radius_taper) {
    right_[kBand + row].head<3>() += right_radius_taper;
  }
  void addRadius(const Eigen::Matrix2d& normal, const Eigen::Vector2d& right) {
    radius_normal_ += normal;
    radius_right_ += right;
  }

  /// Holds the curve together: its slope wanders little.
  /// @param spacing of the nodes [m]
  void addBending(double spacing) {
    constexpr double kBend = 0.05;  // [1/sqrt(m)] what the slope wanders by
    const double bend = 1.0 / (kBend * kBend * std::pow(spacing, 3));
    for (std::size_t i = 0; i + kBand < size(); ++i) {
      add(i, i, bend);
      add(i + 2U, i + 2U, 4.0 * bend);
      add(i + 4U, i + 4U, bend);
      add(i + 2U, i, -2.0 * bend);
      add(i + 4U, i + 2U, -2.0 * bend);
      add(i + 4U, i, bend);
    }
  }

  /// Holds the nodes to places; weakly, so that nothing is undetermined, unless those are known.
  /// @param stddev of the places [m]
  void addHold(const std::vector<Eigen::Vector2d>& places, double stddev = kFree) {
    const double hold = 1.0 / (stddev * stddev);
    for (std::size_t i = 0; i < size(); ++i) {
      add(i, i, hold);
      const double held = places[i / 2U][static_cast<Eigen::Index>(i % 2U)];
      addRight(i, {hold * held, 0.0, 0.0});
    }
  }
  static constexpr double kFree = 0.2;  ///< [m]

  /// The node unknowns, then radius and taper if wanted. Not finite where there is no solution.
  Eigen::VectorXd solve(bool with_radius) && {
    const std::size_t end = lower_.size();
    const std::vector<Eigen::Vector4d> border = right_;
    // Cholesky, row by row; the diagonal is kept inverted.
    for (std::size_t i = kBand; i < end; ++i) {
      std::array<double, kBand + 1U>& row = lower_[i];
      for (std::size_t before = kBand; before > 0U; --before) {
        const std::array<double, kBand + 1U>& other = lower_[i - before];
        for (std::size_t k = kBand; k > before; --k) row[before] -= row[k] * other[k - before];
        row[before] *= other[0];
      }
      for (std::size_t k = kBand; k > 0U; --k) row[0] -= row[k] * row[k];
      row[0] = 1.0 / std::sqrt(row[0]);
      for (std::size_t k = kBand; k > 0U; --k) right_[i] -= row[k] * right_[i - k];
      right_[i] *= row[0];
    }
    for (std::size_t i = end; i-- > kBand;) {
      for (std::size_t k = 1U; k <= kBand && i + k < end; ++k) {
        right_[i] -= lower_[i + k][k] * right_[i + k];
      }
      right_[i] *= lower_[i][0];
    }
    Eigen::VectorXd solved(static_cast<Eigen::Index>(size() + (with_radius ? 2U : 0U)));
    Eigen::Vector2d radius = Eigen::Vector2d::Zero();
    if (with_radius) {
      for (std::size_t i = kBand; i < end; ++i) {
        radius_normal_ -= border[i].segment<2>(1) * right_[i].segment<2>(1).transpose();
        radius_right_ -= border[i].segment<2>(1) * right_[i].x();
      }
      radius = radius_normal_.inverse() * radius_right_;
      solved.tail<2>() = radius;
    }
    for (std::size_t i = 0; i < size(); ++i) {
      const Eigen::Vector4d& right = right_[kBand + i];
      solved[static_cast<Eigen::Index>(i)] = right.x() - right.segment<2>(1).dot(radius);
    }
    return solved;
  }

 private:
  static constexpr std::size_t kBand = 4U;
  std::size_t size() const { return lower_.size() - kBand; }  // node unknowns

  // After kBand empty rows, so that none needs to know how many lie before it.
  std::vector<std::array<double, kBand + 1U>> lower_;  // of a row, from the diagonal leftwards
  std::vector<Eigen::Vector4d> right_;                 // right side, radius, taper, nothing
  Eigen::Matrix2d radius_normal_ = Eigen::Matrix2d::Zero();
  Eigen::Vector2d radius_right_ = Eigen::Vector2d::Zero();
};

}  // namespace field_phenotyping
