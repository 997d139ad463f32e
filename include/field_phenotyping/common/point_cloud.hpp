#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

constexpr std::uint16_t kNoScanOrigin = 0xFFFFU;

/// A point cloud in coordinates local to `origin`.
///
/// Maps in UTM have coordinates that single precision cannot hold; every cloud inside the core is
/// therefore stored relative to a nearby origin: float32 resolves 1 um at 10 m.
struct PointCloud {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< [m] of the local frame, in the map frame
  std::vector<Eigen::Vector3f> points;               ///< [m] relative to `origin`
  std::vector<std::uint32_t> colors;  ///< 0x00RRGGBB, one per point, or empty: no colour known
  /// Where the sensor was when points were first seen [m], relative to `origin`; empty: not known.
  std::vector<Eigen::Vector3f> scan_origins;
  /// Of each point, in `scan_origins`; kNoScanOrigin: not known. Empty: none is.
  std::vector<std::uint16_t> scan_origin;

  std::size_t size() const { return points.size(); }
  bool empty() const { return points.empty(); }
  bool hasColors() const { return !colors.empty(); }
  bool hasScanOrigins() const { return !scan_origin.empty(); }

  /// An empty cloud in the same frame, for points that are taken from this one.
  PointCloud emptyAlike() const {
    PointCloud alike;
    alike.origin = origin;
    alike.scan_origins = scan_origins;
    return alike;
  }

  /// Makes room for so many points that are taken from `from`: as they are appended one by one up
  /// to half of the room would stay empty.
  void reserveLike(const PointCloud& from, std::size_t count) {
    points.reserve(count);
    if (from.hasColors()) colors.reserve(count);
    if (from.hasScanOrigins()) scan_origin.reserve(count);
  }

  /// Appends point `i` of a cloud in the same frame, with what that one knows of it.
  void take(const PointCloud& from, std::size_t i) {
    points.push_back(from.points[i]);
    if (from.hasColors()) colors.push_back(from.colors[i]);
    if (from.hasScanOrigins()) scan_origin.push_back(from.scan_origin[i]);
  }

  /// Gives it so many points, each of which is then put() from a cloud like `from`.
  void resizeLike(const PointCloud& from, std::size_t count) {
    points.resize(count);
    if (from.hasColors()) colors.resize(count);
    if (from.hasScanOrigins()) scan_origin.resize(count);
  }

  /// Makes point `at` point `i` of a cloud in the same frame, with what that one knows of it. For
  /// several threads at once, each its own points.
  void put(std::size_t at, const PointCloud& from, std::size_t i) {
    points[at] = from.points[i];
    if (from.hasColors()) colors[at] = from.colors[i];
    if (from.hasScanOrigins()) scan_origin[at] = from.scan_origin[i];
  }

  /// Position of point `i` in the map frame [m].
  Eigen::Vector3d mapPoint(std::size_t i) const { return origin + points[i].cast<double>(); }
};

/// The points of a cloud that have these numbers, in their order, with what it knows of them. Works
/// on all cores.
PointCloud taken(const PointCloud& from, const std::vector<std::uint32_t>& indices);

/// Half-open range [begin, end) of indices into a cloud's points.
struct IndexSpan {
  std::uint32_t begin = 0;
  std::uint32_t end = 0;

  std::uint32_t size() const { return end - begin; }
  bool empty() const { return end <= begin; }
};

}  // namespace field_phenotyping
