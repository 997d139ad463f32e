#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "field_phenotyping/common/grid_view.hpp"
#include "field_phenotyping/common/team.hpp"

namespace field_phenotyping {

namespace principal_axes {

/// Numbers of one symmetric matrix, or of as many as Float has lanes.
template <class Float>
struct Vector {
  Float x;
  Float y;
  Float z;
};
template <class Float>
struct Matrix {
  Float xx, yy, zz, xy, yz, zx;
};
template <class Float>
struct Axes {
  Float values[3];
  Vector<Float> axes[3];
};

/// Covariance of points of which there are `count`, from the sums of their offsets and of products.
template <class Float>
FIELD_PHENOTYPING_HD Matrix<Float> covarianceOf(const Float& count, const Vector<Float>& sum,
                                                const Matrix<Float>& squares) {
  const Vector<Float> m{sum.x / count, sum.y / count, sum.z / count};
  return {squares.xx / count - m.x * m.x, squares.yy / count - m.y * m.y,
          squares.zz / count - m.z * m.z, squares.xy / count - m.x * m.y,
          squares.yz / count - m.y * m.z, squares.zx / count - m.z * m.x};
}

}  // namespace principal_axes

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
    const principal_axes::Matrix<float> m = principal_axes::covarianceOf<float>(
        count, {sum.x, sum.y, sum.z},
        {squares.xx, squares.yy, squares.zz, squares.xy, squares.yz, squares.zx});
    return {m.xx, m.yy, m.zz, m.xy, m.yz, m.zx};
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
    addAround(lanes, points_x, points_y, points_z, points,
              {lanes.all(place.x), lanes.all(place.y), lanes.all(place.z)}, radius);
  }
  /// Likewise, with a place for each lane.
  FIELD_PHENOTYPING_HD void addAround(const Lanes& lanes, const float* points_x,
                                      const float* points_y, const float* points_z,
                                      std::size_t points,
                                      const principal_axes::Vector<Float>& place, float radius) {
    const Float limit = lanes.all(radius * radius);
    const Float one = lanes.all(1.0F);
    for (std::size_t k = 0; k < points; k += kLanes) {
      Float offset_x = lanes.load(points_x, k, points) - place.x;
      Float offset_y = lanes.load(points_y, k, points) - place.y;
      Float offset_z = lanes.load(points_z, k, points) - place.z;
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
    return totalBy([&](const Float& value) { return lanes.total(value); });
  }
  /// @param total total(value) of some lanes
  template <class Total>
  FIELD_PHENOTYPING_HD Moments totalBy(const Total& total) const {
    Moments moments;
    moments.count = total(count);
    moments.sum = {total(x), total(y), total(z)};
    moments.squares = {total(xx), total(yy), total(zz), total(xy), total(yz), total(zx)};
    return moments;
  }
};

/// Eigenvalues, ascending, and unit eigenvectors of a symmetric matrix.
struct PrincipalAxes {
  float values[3];
  Place axes[3];
};

namespace principal_axes {

template <class Float>
FIELD_PHENOTYPING_HD Vector<Float> cross(const Vector<Float>& a, const Vector<Float>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class Float>
FIELD_PHENOTYPING_HD Float dot(const Vector<Float>& a, const Vector<Float>& b) {
  return a.x * b.x + (a.y * b.y + a.z * b.z);
}
template <class Float>
FIELD_PHENOTYPING_HD Vector<Float> scaled(const Vector<Float>& a, const Float& factor) {
  return {a.x * factor, a.y * factor, a.z * factor};
}
template <class Float>
FIELD_PHENOTYPING_HD Vector<Float> product(const Matrix<Float>& m, const Vector<Float>& a) {
  return {m.xx * a.x + (m.xy * a.y + m.zx * a.z), m.xy * a.x + (m.yy * a.y + m.yz * a.z),
          m.zx * a.x + (m.yz * a.y + m.zz * a.z)};
}
template <class Lanes, class Float = typename Lanes::Float>
FIELD_PHENOTYPING_HD Vector<Float> chosen(const typename Lanes::Mask& mask, const Vector<Float>& a,
                                          const Vector<Float>& b) {
  return {Lanes::choose(mask, a.x, b.x), Lanes::choose(mask, a.y, b.y),
          Lanes::choose(mask, a.z, b.z)};
}

/// The largest root of x^3 - 3 x = 2 r, for r in [0, 1].
template <class Float>
FIELD_PHENOTYPING_HD Float largestRoot(const Float& r) {
  constexpr float kRootThree = 1.7320508F;
  // Its value at both ends, and its slope at r = 0.
  Float x = kRootThree + r * (1.0F / 3.0F + r * (2.0F - kRootThree - 1.0F / 3.0F));
  constexpr int kNewtonSteps = 2;  // 1e-3 off, then 1e-6, then as exact as floats are
  for (int step = 0; step < kNewtonSteps; ++step) {
    x -= (x * (x * x - 3.0F) - 2.0F * r) / (3.0F * (x * x - 1.0F));
  }
  return x;
}

/// A unit vector that both of two rows, of which the third is a combination, are across to.
template <class Lanes, class Float = typename Lanes::Float>
FIELD_PHENOTYPING_HD Vector<Float> nullVector(const Vector<Float>& a, const Vector<Float>& b,
                                              const Vector<Float>& c) {
  Vector<Float> best = cross(a, b);
  Float best_square = dot(best, best);
  const Vector<Float> other[2] = {cross(b, c), cross(c, a)};
  for (int k = 0; k < 2; ++k) {
    const Float square = dot(other[k], other[k]);
    const typename Lanes::Mask better = square > best_square;
    best = chosen<Lanes>(better, other[k], best);
    best_square = Lanes::choose(better, square, best_square);
  }
  return scaled(best, 1.0F / Lanes::squareRoot(best_square));
}

/// A unit vector across to a unit vector.
template <class Lanes, class Float = typename Lanes::Float>
FIELD_PHENOTYPING_HD Vector<Float> anyAcross(const Vector<Float>& a) {
  const Float none = Lanes::all(0.0F);
  const Vector<Float> across = chosen<Lanes>(a.x * a.x <= a.y * a.y, Vector<Float>{none, a.z, -a.y},
                                             Vector<Float>{-a.z, none, a.x});
  return scaled(across, 1.0F / Lanes::squareRoot(dot(across, across)));
}

/// What principalAxes() does; entries that are all alike, or of one value three times, give the
/// coordinate axes.
template <class Lanes, class Float = typename Lanes::Float>
FIELD_PHENOTYPING_HD Axes<Float> axesOf(const Matrix<Float>& m) {
  const Float none = Lanes::all(0.0F);
  const Float one = Lanes::all(1.0F);
  const Float mean = (m.xx + (m.yy + m.zz)) / 3.0F;
  Matrix<Float> b{m.xx - mean, m.yy - mean, m.zz - mean, m.xy, m.yz, m.zx};
  // Largest entry 1, so that no product of three overflows or vanishes.
  Float largest = none;
  const Float entries[6] = {b.xx, b.yy, b.zz, b.xy, b.yz, b.zx};
  for (int k = 0; k < 6; ++k) {
    const Float size = Lanes::larger(entries[k], -entries[k]);
    largest = Lanes::larger(largest, size);
  }
  const typename Lanes::Mask differ = largest > 0.0F;
  largest = Lanes::choose(differ, largest, one);
  b = {b.xx / largest, b.yy / largest, b.zz / largest,
       b.xy / largest, b.yz / largest, b.zx / largest};
  const Float off_diagonal = b.xy * b.xy + (b.yz * b.yz + b.zx * b.zx);
  const Float diagonal = b.xx * b.xx + (b.yy * b.yy + b.zz * b.zz);
  const Float scale = Lanes::squareRoot((diagonal + 2.0F * off_diagonal) / 6.0F);
  const Float determinant = b.xx * (b.yy * b.zz - b.yz * b.yz) -
                            b.xy * (b.xy * b.zz - b.yz * b.zx) + b.zx * (b.xy * b.yz - b.yy * b.zx);
  const Float r = determinant / (2.0F * scale * scale * scale);
  const typename Lanes::Mask apart_is_largest = r >= 0.0F;
  const Float size = Lanes::choose(apart_is_largest, r, -r);
  const Float root = largestRoot(Lanes::choose(size < 1.0F, size, one)) * scale;
  const Float apart = Lanes::choose(apart_is_largest, root, -root);

  const Vector<Float> axis = nullVector<Lanes>(Vector<Float>{b.xx - apart, b.xy, b.zx},
                                               Vector<Float>{b.xy, b.yy - apart, b.yz},
                                               Vector<Float>{b.zx, b.yz, b.zz - apart});
  const Vector<Float> u = anyAcross<Lanes>(axis);
  const Vector<Float> w = cross(axis, u);
  const Vector<Float> bu = product(b, u);
  const Vector<Float> bw = product(b, w);
  const Float uu = dot(u, bu);
  const Float uw = dot(u, bw);
  const Float ww = dot(w, bw);
  const Float middle = 0.5F * (uu + ww);
  const Float half = 0.5F * (uu - ww);
  const Float reach = Lanes::squareRoot(half * half + uw * uw);
  // (cosine, sine) of the larger one's angle from u.
  const Float away = Lanes::larger(half, -half);
  const Float longer = Lanes::squareRoot(0.5F + 0.5F * (away / reach));
  const Float shorter = uw / (2.0F * reach * longer);
  const typename Lanes::Mask turned = half < 0.0F;
  const typename Lanes::Mask unequal = reach > 0.0F;
  const Float cosine = Lanes::choose(unequal, Lanes::choose(turned, shorter, longer), one);
  const Float sine = Lanes::choose(unequal, Lanes::choose(turned, longer, shorter), none);
  const Vector<Float> larger{cosine * u.x + sine * w.x, cosine * u.y + sine * w.y,
                             cosine * u.z + sine * w.z};
  const Vector<Float> smaller{cosine * w.x - sine * u.x, cosine * w.y - sine * u.y,
                              cosine * w.z - sine * u.z};
  const Float low = mean + largest * (middle - reach);
  const Float high = mean + largest * (middle + reach);
  const Float alone = mean + largest * apart;
  const auto valueOf = [&](const Float& if_largest, const Float& if_least) -> Float {
    return Lanes::choose(differ, Lanes::choose(apart_is_largest, if_largest, if_least), m.xx);
  };
  const auto axisOf = [&](const Vector<Float>& if_largest, const Vector<Float>& if_least,
                          const Vector<Float>& if_alike) -> Vector<Float> {
    return chosen<Lanes>(differ, chosen<Lanes>(apart_is_largest, if_largest, if_least), if_alike);
  };
  return {{valueOf(low, alone), valueOf(high, low), valueOf(alone, high)},
          {axisOf(smaller, axis, {one, none, none}), axisOf(larger, smaller, {none, one, none}),
           axisOf(axis, larger, {none, none, one})}};
}

}  // namespace principal_axes

/// Eigenvalues and eigenvectors of a symmetric matrix, without iterations of unknown number: the
/// eigenvalue that stands apart from the other two, by Newton's method, its vector, and the other
/// two in the plane across it. Exact to some 1e-6 of the largest. Entries must be finite.
FIELD_PHENOTYPING_HD inline PrincipalAxes principalAxes(const Symmetric3& m) {
  const principal_axes::Axes<float> found =
      principal_axes::axesOf<ThreadLanes>({m.xx, m.yy, m.zz, m.xy, m.yz, m.zx});
  PrincipalAxes out;
  for (int k = 0; k < 3; ++k) {
    out.values[k] = found.values[k];
    out.axes[k] = {found.axes[k].x, found.axes[k].y, found.axes[k].z};
  }
  return out;
}

}  // namespace field_phenotyping
