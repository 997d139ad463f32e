#include "field_phenotyping/segmentation/curve_samples.hpp"

#include <cmath>
#include <utility>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/lanes.hpp"

namespace field_phenotyping {
namespace {

constexpr float kNegligible = 1e-4F;  // probability below which a sample says nothing
constexpr float kOnAxis = 1e-12F;     // [m^2] nearer there is no direction

/// Sums over the lanes of what kLanes samples say, each with its weight.
struct LaneSums {
  std::array<std::array<Floats, 3>, 3> squares{};  // times 1, share, share^2: xx, xy, yy
  std::array<std::array<Floats, 3>, 4> borders{};  // x, y, x share, y share: target, 1, height
  std::array<Floats, 3> radius{};
  std::array<Floats, 2> radius_target{};

  void addSquares(const Floats& share, const Floats& xx, const Floats& xy, const Floats& yy) {
    std::array<Floats, 3> values{xx, xy, yy};
    for (std::array<Floats, 3>& power : squares) {
      for (std::size_t k = 0; k < values.size(); ++k) {
        power[k] += values[k];
        values[k] *= share;
      }
    }
  }

  void addSurface(const Floats& weight, const Floats& share, const Floats& height, const Floats& x,
                  const Floats& y, const Floats& target) {
    const Floats wx = weight * x;
    const Floats wy = weight * y;
    addSquares(share, wx * x, wx * y, wy * y);
    const std::array<Floats, 4> rows{wx, wy, share * wx, share * wy};
    for (std::size_t row = 0; row < rows.size(); ++row) {
      borders[row][0] += rows[row] * target;
      borders[row][1] += rows[row];
      borders[row][2] += rows[row] * height;
    }
    radius[0] += weight;
    radius[1] += weight * height;
    radius[2] += weight * height * height;
    radius_target[0] += weight * target;
    radius_target[1] += weight * target * height;
  }

  void addCenter(const Floats& weight, const Floats& share, const Floats& u, const Floats& v) {
    addSquares(share, weight, Floats{}, weight);
    borders[0][0] += weight * u;
    borders[1][0] += weight * v;
    borders[2][0] += share * weight * u;
    borders[3][0] += share * weight * v;
  }

  void addTo(CellSums& cell) const {
    const auto sumOf = [](const std::array<Floats, 3>& lanes) -> Eigen::Vector3d {
      return {static_cast<double>(total(lanes[0])), static_cast<double>(total(lanes[1])),
              static_cast<double>(total(lanes[2]))};
    };
    const Eigen::Vector3d all = sumOf(squares[0]);
    const Eigen::Vector3d shared = sumOf(squares[1]);
    const Eigen::Vector3d upper = sumOf(squares[2]);
    cell.squares[0] += all - 2.0 * shared + upper;
    cell.squares[1] += shared - upper;
    cell.squares[2] += upper;
    for (std::size_t k = 0; k < 2U; ++k) {
      const Eigen::Vector3d of_upper = sumOf(borders[k + 2U]);
      cell.borders[k] += sumOf(borders[k]) - of_upper;
      cell.borders[k + 2U] += of_upper;
    }
    cell.radius += sumOf(radius);
    cell.radius_target += Eigen::Vector2d(static_cast<double>(total(radius_target[0])),
                                          static_cast<double>(total(radius_target[1])));
  }
};

}  // namespace

void CellSums::addTo(CurveEquations& equations, std::size_t node, double factor) const {
  const std::size_t i = 2U * node;
  for (const std::size_t end : {std::size_t{0}, std::size_t{2}}) {
    const Eigen::Vector3d square = factor * squares[end];
    equations.add(i + end, i + end, square[0]);
    equations.add(i + end + 1U, i + end, square[1]);
    equations.add(i + end + 1U, i + end + 1U, square[2]);
  }
  const Eigen::Vector3d across = factor * squares[1];
  equations.add(i + 2U, i, across[0]);
  equations.add(i + 2U, i + 1U, across[1]);
  equations.add(i + 3U, i, across[1]);
  equations.add(i + 3U, i + 1U, across[2]);
  for (std::size_t row = 0; row < 4U; ++row) equations.addRight(i + row, factor * borders[row]);
  Eigen::Matrix2d profile;
  profile << radius[0], radius[1], radius[1], radius[2];
  equations.addRadius(factor * profile, factor * radius_target);
}

CurveSamples::CurveSamples(std::vector<Sample> placed) : samples_(std::move(placed)) {
  const std::size_t size = samples_.size() + kLanes;
  for (std::vector<float>* values : {&heights_, &u_, &v_, &shares_}) values->assign(size, 0.0F);
  run_ends_.resize(samples_.size());
  std::size_t end = samples_.size();
  for (std::size_t i = samples_.size(); i-- > 0;) {
    const Sample& sample = samples_[i];
    heights_[i] = static_cast<float>(sample.height);
    u_[i] = static_cast<float>(sample.offset.x());
    v_[i] = static_cast<float>(sample.offset.y());
    shares_[i] = static_cast<float>(sample.share);
    if (i + 1U < samples_.size() &&
        (samples_[i + 1U].node != sample.node || samples_[i + 1U].band != sample.band)) {
      end = i + 1U;
    }
    run_ends_[i] = end;
  }
}

template <bool kSurface>
CurveSamples::Share CurveSamples::expect(const Run& run, const StemCurve& curve, const Skin& skin,
                                         CellSums& cell, std::vector<float>& posterior) const {
  constexpr double kSqrtTwoPi = 2.5066282746310002;
  const std::size_t node = samples_[run.begin].node;
  const Eigen::Vector2f low = curve.centers[node].cast<float>();
  const Eigen::Vector2f step = (curve.centers[node + 1U] - curve.centers[node]).cast<float>();
  const auto foot_radius = static_cast<float>(curve.radius);
  const auto taper = static_cast<float>(curve.taper);
  const auto thinnest = static_cast<float>(curve.thinnest());
  const auto reach = static_cast<float>(skin.reach);
  const auto spread = static_cast<float>(skin.spread);
  const auto precision = static_cast<float>(1.0 / (skin.spread * skin.spread));
  const auto trust = static_cast<float>(skin.trust);
  // The densities' common factors go with the clutter: one division instead of three.
  const auto clutter = static_cast<float>(skin.odds * 2.0 * M_PI * skin.spread *
                                          (kSurface ? kSqrtTwoPi : skin.spread));
  LaneSums sums;
  Floats stem{};
  Floats all{};
  const Floats none{};
  for (std::size_t i = run.begin; i < run.end; i += kLanes) {
    const Floats share = loadFloats(&shares_[i]);
    const Floats u = loadFloats(&u_[i]);
    const Floats v = loadFloats(&v_[i]);
    const Floats x = u - (low.x() + share * step.x());
    const Floats y = v - (low.y() + share * step.y());
    const Floats squared = x * x + y * y;
    const Integers counts = lanesBefore(run.end - i) & (squared <= reach * reach);
    if (!anyOf(counts)) {
      store(none, &posterior[i]);
      continue;
    }
    all += counts ? allOf(1.0F) : none;
    Floats inverse{};
    Floats height{};
    Floats off = squared * precision;
    Floats norm = allOf(clutter);
    if (kSurface) {
      inverse = 1.0F / squareRootOf(largerOf(squared, allOf(kOnAxis)));
      height = loadFloats(&heights_[i]);
      const Floats radius = largerOf(foot_radius + taper * height, allOf(thinnest));
      const Floats beyond = squared * inverse - radius;
      off = beyond * beyond * precision;
      norm = clutter * largerOf(radius, allOf(spread));
    }
    constexpr float kFarthest = 5.6F;  // standard deviations: exp(-16) changes nothing
    const Integers near = counts & (off < kFarthest * kFarthest);
    if (!anyOf(near)) {
      store(none, &posterior[i]);
      continue;
    }
    const Floats density = exponentialOf(near ? -0.5F * off : none);
    const Floats probable = near ? density / (density + norm) : none;
    store(probable, &posterior[i]);
    stem += probable;
    const Floats weight = probable < kNegligible ? none : trust * precision * probable;
    if (!anyOf(weight > none)) continue;
    if (kSurface) {
      // Distance minus radius, linearised: toward . (offset - center) = radius + taper * height.
      const Floats toward_x = x * inverse;
      const Floats toward_y = y * inverse;
      sums.addSurface(weight, share, height, toward_x, toward_y, toward_x * u + toward_y * v);
    } else {
      sums.addCenter(weight, share, u, v);
    }
  }
  sums.addTo(cell);
  const Share shown{static_cast<double>(total(stem)), static_cast<double>(total(all))};
  cell.points += shown.stem;
  return shown;
}

void CurveSamples::sumSurface(const Run& run, const StemCurve& curve,
                              const std::vector<float>& weights, CellSums& cell) const {
  withWideVectors([&] {
    const std::size_t node = samples_[run.begin].node;
    const Eigen::Vector2f low = curve.centers[node].cast<float>();
    const Eigen::Vector2f step = (curve.centers[node + 1U] - curve.centers[node]).cast<float>();
    LaneSums sums;
    const Floats none{};
    for (std::size_t i = run.begin; i < run.end; i += kLanes) {
      const Floats weight = lanesBefore(run.end - i) ? loadFloats(&weights[i]) : none;
      if (!anyOf(weight > none)) continue;
      const Lanes at = lanesFrom(i);
      const Floats x = at.u - (low.x() + at.share * step.x());
      const Floats y = at.v - (low.y() + at.share * step.y());
      const Floats inverse = 1.0F / squareRootOf(largerOf(x * x + y * y, allOf(kOnAxis)));
      const Floats toward_x = x * inverse;
      const Floats toward_y = y * inverse;
      sums.addSurface(weight, at.share, at.height, toward_x, toward_y,
                      toward_x * at.u + toward_y * at.v);
    }
    sums.addTo(cell);
  });
}

CurveSamples::Share CurveSamples::expectSurface(const Run& run, const StemCurve& curve,
                                                const Skin& skin, CellSums& cell,
                                                std::vector<float>& posterior) const {
  return withWideVectors([&] { return expect<true>(run, curve, skin, cell, posterior); });
}

CurveSamples::Share CurveSamples::expectBlob(const Run& run, const StemCurve& curve,
                                             const Skin& skin, CellSums& cell,
                                             std::vector<float>& posterior) const {
  return withWideVectors([&] { return expect<false>(run, curve, skin, cell, posterior); });
}

}  // namespace field_phenotyping
