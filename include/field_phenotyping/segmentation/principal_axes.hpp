#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

/// A symmetric 3 x 3 matrix.
struct Symmetric3 {
  float xx = 0.0F;
  float yy = 0.0F;
  float zz = 0.0F;
  float xy = 0.0F;
  float yz = 0.0F;
  float zx = 0.0F;
};

/// Sums over points, of their offsets from some place near them [m]: so floats stay precise
/// wherever the cloud lies.
struct Moments {
  float count = 0.0F;
  Place sum = {0.0F, 0.0F, 0.0F};
  Symmetric3 squares;

  FIELD_PHENOTYPING_HD void add(const Place& offset) {
    count += 1.0F;
    sum.x += offset.x;
    sum.y += offset.y;
    sum.z += offset.z;
    squares.xx += offset.x * offset.x;
    squares.yy += offset.y * offset.y;
    squares.zz += offset.z * offset.z;
    squares.xy += offset.x * offset.y;
    squares.yz += offset.y * offset.z;
    squares.zx += offset.z * offset.x;
  }
  FIELD_PHENOTYPING_HD Place mean() const { return {sum.x / count, sum.y / count, sum.z / count}; }
  FIELD_PHENOTYPING_HD Symmetric3 covariance() const {
    const Place m = mean();
    return {squares.xx / count - m.x * m.x, squares.yy / count - m.y * m.y,
            squares.zz / count - m.z * m.z, squares.xy / count - m.x * m.y,
            squares.yz / count - m.y * m.z, squares.zx / count - m.z * m.x};
  }
};

/// The same, lane by lane, of points that lie coordinate by coordinate in memory.
template <class Lanes>
struct LaneMoments {
  using Float = typename Lanes::Float;
  Float count{}, x{}, y{}, z{}, xx{}, yy{}, zz{}, xy{}, yz{}, zx{};

  /// Adds the points number 0 ... `points` - 1 that lie within `radius` [m] of `place`.
  FIELD_PHENOTYPING_HD void add(const Lanes& lanes, const float* points_x, const float* points_y,
                                const float* points_z, std::size_t points, const Place& place,
                                float radius) {
    const Float limit = lanes.all(radius * radius);
    const Float one = lanes.all(1.0F);
    for (std::size_t k = 0; k < points; k += kLanes) {
      Float offset_x = lanes.load(points_x, k, points) - lanes.all(place.x);
      Float offset_y = lanes.load(points_y, k, points) - lanes.all(place.y);
      Float offset_z = lanes.load(points_z, k, points) - lanes.all(place.z);
      const typename Lanes::Mask near = lanes.both(
          lanes.before(k, points),
          lanes.atMost(offset_x * offset_x + (offset_y * offset_y + offset_z * offset_z), limit));
      if (!lanes.any(near)) continue;
      offset_x = lanes.where(near, offset_x);
      offset_y = lanes.where(near, offset_y);
      offset_z = lanes.where(near, offset_z);
      count += lanes.where(near, one);
      x += offset_x;
      y += offset_y;
      z += offset_z;
      xx += offset_x * offset_x;
      yy += offset_y * offset_y;
      zz += offset_z * offset_z;
      xy += offset_x * offset_y;
      yz += offset_y * offset_z;
      zx += offset_z * offset_x;
    }
  }

  FIELD_PHENOTYPING_HD Moments total(const Lanes& lanes) const {
    Moments moments;
    moments.count = lanes.total(count);
    moments.sum = {lanes.total(x), lanes.total(y), lanes.total(z)};
    moments.squares = {lanes.total(xx), lanes.total(yy), lanes.total(zz),
                       lanes.total(xy), lanes.total(yz), lanes.total(zx)};
    return moments;
  }
};

/// Eigenvalues, ascending, and unit eigenvectors of a symmetric matrix.
struct PrincipalAxes {
  float values[3];
  Place axes[3];
};

namespace principal_axes {

FIELD_PHENOTYPING_HD inline Place cross(const Place& a, const Place& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
FIELD_PHENOTYPING_HD inline float dot(const Place& a, const Place& b) {
  return a.x * b.x + (a.y * b.y + a.z * b.z);
}
FIELD_PHENOTYPING_HD inline Place scaled(const Place& a, float factor) {
  return {a.x * factor, a.y * factor, a.z * factor};
}
FIELD_PHENOTYPING_HD inline Place product(const Symmetric3& m, const Place& a) {
  return {m.xx * a.x + (m.xy * a.y + m.zx * a.z), m.xy * a.x + (m.yy * a.y + m.yz * a.z),
          m.zx * a.x + (m.yz * a.y + m.zz * a.z)};
}

/// The largest root of x^3 - 3 x = 2 r, for r in [0, 1].
FIELD_PHENOTYPING_HD inline float largestRoot(float r) {
  constexpr float kRootThree = 1.7320508F;
  // Its value at both ends, and its slope at r = 0.
  float x = kRootThree + r * (1.0F / 3.0F + r * (2.0F - kRootThree - 1.0F / 3.0F));
  constexpr int kNewtonSteps = 2;  // 1e-3 off, then 1e-6, then as exact as floats are
  for (int step = 0; step < kNewtonSteps; ++step) {
    x -= (x * (x * x - 3.0F) - 2.0F * r) / (3.0F * (x * x - 1.0F));
  }
  return x;
}

/// A unit vector that both of two rows, of which the third is a combination, are across to.
FIELD_PHENOTYPING_HD inline Place nullVector(const Place& a, const Place& b, const Place& c) {
  Place best = cross(a, b);
  float best_square = dot(best, best);
  const Place other[2] = {cross(b, c), cross(c, a)};
  for (int k = 0; k < 2; ++k) {
    const float square = dot(other[k], other[k]);
    if (square > best_square) {
      best = other[k];
      best_square = square;
    }
  }
  return scaled(best, 1.0F / std::sqrt(best_square));
}

/// A unit vector across to a unit vector.
FIELD_PHENOTYPING_HD inline Place anyAcross(const Place& a) {
  const bool use_x = a.x * a.x <= a.y * a.y;
  const Place across = use_x ? Place{0.0F, a.z, -a.y} : Place{-a.z, 0.0F, a.x};
  return scaled(across, 1.0F / std::sqrt(dot(across, across)));
}

}  // namespace principal_axes

/// Eigenvalues and eigenvectors of a symmetric matrix, without iterations of unknown number: the
/// eigenvalue that stands apart from the other two, by Newton's method, its vector, and the other
/// two in the plane across it. Exact to some 1e-6 of the largest. Entries must be finite.
FIELD_PHENOTYPING_HD inline PrincipalAxes principalAxes(const Symmetric3& m) {
  using namespace principal_axes;
  PrincipalAxes out{{m.xx, m.xx, m.xx}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  const float mean = (m.xx + (m.yy + m.zz)) / 3.0F;
  Symmetric3 b{m.xx - mean, m.yy - mean, m.zz - mean, m.xy, m.yz, m.zx};
  // Largest entry 1, so that no product of three overflows or vanishes.
  float largest = 0.0F;
  const float entries[6] = {b.xx, b.yy, b.zz, b.xy, b.yz, b.zx};
  for (int k = 0; k < 6; ++k) {
    const float size = entries[k] < 0.0F ? -entries[k] : entries[k];
    if (size > largest) largest = size;
  }
  if (!(largest > 0.0F)) return out;
  b = {b.xx / largest, b.yy / largest, b.zz / largest,
       b.xy / largest, b.yz / largest, b.zx / largest};
  const float off_diagonal = b.xy * b.xy + (b.yz * b.yz + b.zx * b.zx);
  const float diagonal = b.xx * b.xx + (b.yy * b.yy + b.zz * b.zz);
  const float scale = std::sqrt((diagonal + 2.0F * off_diagonal) / 6.0F);
  const float determinant = b.xx * (b.yy * b.zz - b.yz * b.yz) -
                            b.xy * (b.xy * b.zz - b.yz * b.zx) + b.zx * (b.xy * b.yz - b.yy * b.zx);
  const float r = determinant / (2.0F * scale * scale * scale);
  const bool apart_is_largest = r >= 0.0F;
  const float size = apart_is_largest ? r : -r;
  const float root = largestRoot(size < 1.0F ? size : 1.0F) * scale;
  const float apart = apart_is_largest ? root : -root;

  const Place axis = nullVector({b.xx - apart, b.xy, b.zx}, {b.xy, b.yy - apart, b.yz},
                                {b.zx, b.yz, b.zz - apart});
  const Place u = anyAcross(axis);
  const Place w = cross(axis, u);
  const Place bu = product(b, u);
  const Place bw = product(b, w);
  const float uu = dot(u, bu);
  const float uw = dot(u, bw);
  const float ww = dot(w, bw);
  const float middle = 0.5F * (uu + ww);
  const float half = 0.5F * (uu - ww);
  const float reach = std::sqrt(half * half + uw * uw);
  // (cosine, sine) of the larger one's angle from u.
  float cosine = 1.0F;
  float sine = 0.0F;
  if (reach > 0.0F) {
    const float away = half < 0.0F ? -half : half;
    const float longer = std::sqrt(0.5F + 0.5F * (away / reach));
    const float shorter = uw / (2.0F * reach * longer);
    cosine = half < 0.0F ? shorter : longer;
    sine = half < 0.0F ? longer : shorter;
  }
  const Place larger{cosine * u.x + sine * w.x, cosine * u.y + sine * w.y,
                     cosine * u.z + sine * w.z};
  const Place smaller{cosine * w.x - sine * u.x, cosine * w.y - sine * u.y,
                      cosine * w.z - sine * u.z};
  const int first = apart_is_largest ? 0 : 1;  // of the pair
  out.values[first] = mean + largest * (middle - reach);
  out.values[first + 1] = mean + largest * (middle + reach);
  out.values[apart_is_largest ? 2 : 0] = mean + largest * apart;
  out.axes[first] = smaller;
  out.axes[first + 1] = larger;
  out.axes[apart_is_largest ? 2 : 0] = axis;
  return out;
}

}  // namespace field_phenotyping
