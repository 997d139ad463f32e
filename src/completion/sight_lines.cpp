#include "field_phenotyping/completion/sight_lines.hpp"

#include <Eigen/Geometry>
#include <algorithm>

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

constexpr double kDeep = 0.5;     // of the radius: a beam this near to the axis grazes no surface
constexpr double kBeyond = 0.03;  // [m] that a beam must go on behind the axis
constexpr double kHalfWidth = 0.01;  // [m] of stem that one beam tells of
constexpr std::size_t kBeams = 2;    // one may be a stray point

/// Nearest places of two lines: along the first, and squared distance.
struct Crossing {
  double along_axis;
  double along_beam;
  double distance;
};

Crossing crossingOf(const StemFrame::Frame& frame, const Vector3d& origin, const Vector3d& beam) {
  const Vector3d offset = origin - frame.position;
  const double cosine = frame.tangent.dot(beam);
  const double sine2 = std::max(1.0 - cosine * cosine, 1e-9);
  const double axis = offset.dot(frame.tangent);
  const double along_beam = (cosine * axis - offset.dot(beam)) / sine2;
  const double along_axis = axis + cosine * along_beam;
  return {along_axis, along_beam, (offset + along_beam * beam - along_axis * frame.tangent).norm()};
}

}  // namespace

std::vector<SightLine> sightLinesPast(const PointCloud& cloud, IndexSpan stem,
                                      const SurfacePrior& prior) {
  constexpr double kReach = 0.03;  // [m] beside the chord of the axis
  std::vector<SightLine> sight;
  if (!cloud.hasScanOrigins()) return sight;
  const std::vector<StemFrame::Frame>& nodes = prior.frame().nodes();
  StemFrame::Frame chord = nodes.front();
  const Vector3d way = nodes.back().position - chord.position;
  chord.tangent = way.normalized();
  double bow = 0.0;
  for (const StemFrame::Frame& node : nodes) {
    const Vector3d offset = node.position - chord.position;
    bow = std::max(bow, (offset - offset.dot(chord.tangent) * chord.tangent).norm());
  }
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    if ((i >= stem.begin && i < stem.end) || cloud.scan_origin[i] == kNoScanOrigin) continue;
    const SightLine line{cloud.scan_origins[cloud.scan_origin[i]], cloud.points[i]};
    const Vector3d origin = line.origin.cast<double>();
    const Vector3d beam = line.end.cast<double>() - origin;
    const double length = beam.norm();
    if (!(length > kBeyond)) continue;
    const Crossing crossing = crossingOf(chord, origin, beam / length);
    if (crossing.distance > bow + kReach || crossing.along_beam < 0.0 ||
        crossing.along_beam > length || crossing.along_axis < -kReach ||
        crossing.along_axis > way.norm() + kReach) {
      continue;
    }
    sight.push_back(line);
  }
  return sight;
}

std::vector<std::pair<double, double>> emptyStretches(const SurfacePrior& prior,
                                                      const std::vector<SightLine>& sight) {
  constexpr double kStep = 0.05;  // [m] along which the axis is about straight
  const StemFrame& frame = prior.frame();
  std::vector<double> crossings;
  std::vector<StemFrame::Frame> pieces;
  for (double s = 0.5 * kStep; s < frame.length(); s += kStep) pieces.push_back(frame.at(s));
  for (const SightLine& line : sight) {
    const Vector3d origin = line.origin.cast<double>();
    const Vector3d way = line.end.cast<double>() - origin;
    const double length = way.norm();
    if (!(length > kBeyond)) continue;
    for (const StemFrame::Frame& piece : pieces) {
      const Crossing crossing = crossingOf(piece, origin, way / length);
      if (std::abs(crossing.along_axis) > 0.5 * kStep) continue;
      const double s = piece.s + crossing.along_axis;
      if (crossing.along_beam < 0.0 || crossing.along_beam > length - kBeyond) continue;
      if (crossing.distance < kDeep * prior.meanRadiusAt(s)) crossings.push_back(s);
    }
  }
  std::sort(crossings.begin(), crossings.end());
  std::vector<std::pair<double, double>> stretches;
  for (std::size_t i = 0; i + kBeams <= crossings.size(); ++i) {
    if (crossings[i + kBeams - 1U] - crossings[i] > 2.0 * kHalfWidth) continue;
    const double begin = crossings[i] - kHalfWidth;
    const double end = crossings[i + kBeams - 1U] + kHalfWidth;
    if (!stretches.empty() && begin <= stretches.back().second) {
      stretches.back().second = std::max(stretches.back().second, end);
    } else {
      stretches.emplace_back(begin, end);
    }
  }
  return stretches;
}

}  // namespace field_phenotyping
