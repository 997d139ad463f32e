// What runs of samples say, against one sample after the other in double precision.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "field_phenotyping/segmentation/curve_samples.hpp"

namespace field_phenotyping {
namespace {

constexpr double kBand = 0.07;  // [m]

StemCurve curveOfThreeNodes() {
  StemCurve curve;
  curve.spacing = 0.05;
  curve.centers = {{0.010, -0.004}, {0.012, 0.001}, {0.009, 0.003}};
  curve.radius = 0.011;
  curve.taper = -0.02;
  return curve;
}

/// Round the curve, on its surface and far from it, by height.
std::vector<Sample> samplesRound(const StemCurve& curve) {
  std::mt19937 random(4U);
  std::uniform_real_distribution<double> height(-0.01, curve.length() + 0.01);
  std::normal_distribution<double> off(0.0, 0.02);
  std::vector<Sample> samples(203U);
  for (Sample& sample : samples) {
    sample.height = height(random);
    const StemCurve::Place place = curve.placeOf(sample.height);
    sample.node = static_cast<std::uint32_t>(place.node);
    sample.share = place.share;
    sample.band = static_cast<std::uint32_t>(std::max(sample.height, 0.0) / kBand);
    sample.offset = curve.centerAt(place) + Eigen::Vector2d(off(random), off(random));
  }
  sortByHeight(samples);
  return samples;
}

/// The same sums, sample by sample.
struct Expected {
  CellSums cell;
  CurveSamples::Share share;

  void add(const Sample& sample, const StemCurve& curve, const Skin& skin, bool surface) {
    const Eigen::Vector2d away = sample.offset - curve.centerAt(sample);
    const double distance = away.norm();
    if (distance > skin.reach) return;
    share.all += 1.0;
    const double radius = curve.radiusAt(sample.height);
    const double z = (surface ? distance - radius : distance) / skin.spread;
    const double norm =
        surface ? std::sqrt(2.0 * M_PI) * 2.0 * M_PI * skin.spread * std::max(radius, skin.spread)
                : 2.0 * M_PI * skin.spread * skin.spread;
    const double density = std::exp(-0.5 * z * z);
    const double probable = density / (density + skin.odds * norm);
    share.stem += probable;
    cell.points += probable;
    constexpr double kNegligible = 1e-4;
    if (probable < kNegligible) return;
    const double weight = skin.trust * probable / (skin.spread * skin.spread);
    const Eigen::Vector2d toward = away / distance;
    Eigen::Matrix<double, 2, 4> rows = Eigen::Matrix<double, 2, 4>::Zero();
    if (surface) {
      rows.row(0) << (1.0 - sample.share) * toward.transpose(), sample.share * toward.transpose();
    } else {
      rows << 1.0 - sample.share, 0.0, sample.share, 0.0, 0.0, 1.0 - sample.share, 0.0,
          sample.share;
    }
    const Eigen::Matrix4d square = weight * rows.transpose() * rows;
    cell.squares[0] += Eigen::Vector3d(square(0, 0), square(0, 1), square(1, 1));
    cell.squares[1] += Eigen::Vector3d(square(0, 2), square(0, 3), square(1, 3));
    cell.squares[2] += Eigen::Vector3d(square(2, 2), square(2, 3), square(3, 3));
    const Eigen::Vector2d target =
        surface ? Eigen::Vector2d(toward.dot(sample.offset), 0.0) : sample.offset;
    const Eigen::Vector4d right = weight * rows.transpose() * target;
    for (int k = 0; k < 4; ++k) {
      Eigen::Vector3d& border = cell.borders[static_cast<std::size_t>(k)];
      border.x() += right[k];
      if (surface) border.tail<2>() += weight * rows(0, k) * Eigen::Vector2d(1.0, sample.height);
    }
    if (!surface) return;
    const Eigen::Vector2d profile(1.0, sample.height);
    cell.radius += weight * Eigen::Vector3d(1.0, sample.height, sample.height * sample.height);
    cell.radius_target += weight * target.x() * profile;
  }
};

/// To the precision of floats.
template <class Vector>
void expectClose(const Vector& value, const Vector& expected) {
  EXPECT_LT((value - expected).norm(), 1e-5 * expected.norm() + 1e-3);
}

class CurveSamplesTest : public ::testing::TestWithParam<bool> {};

TEST_P(CurveSamplesTest, AsOneByOne) {
  const bool surface = GetParam();
  const StemCurve curve = curveOfThreeNodes();
  const CurveSamples samples(samplesRound(curve));
  const Skin skin{0.004, 0.036, 300.0, 0.6};
  std::vector<float> posterior(samples.padded(), -1.0F);
  constexpr std::size_t kFirst = 3U;
  const std::size_t end = samples.size() - 2U;
  std::size_t next = kFirst;
  int runs = 0;
  samples.forEachRun(kFirst, end, [&](const CurveSamples::Run& run) {
    ++runs;
    EXPECT_EQ(run.begin, next) << "nothing between";
    next = run.end;
    Expected expected;
    for (std::size_t i = run.begin; i < run.end; ++i) {
      EXPECT_EQ(samples[i].node, samples[run.begin].node);
      EXPECT_EQ(samples[i].band, samples[run.begin].band);
      expected.add(samples[i], curve, skin, surface);
    }
    CellSums cell;
    const CurveSamples::Share share = surface
                                          ? samples.expectSurface(run, curve, skin, cell, posterior)
                                          : samples.expectBlob(run, curve, skin, cell, posterior);
    EXPECT_EQ(share.all, expected.share.all);
    EXPECT_GT(share.stem, 0.5) << "it is seen";
    EXPECT_NEAR(share.stem, expected.share.stem, 1e-3);
    EXPECT_NEAR(cell.points, expected.cell.points, 1e-3);
    for (std::size_t k = 0; k < 3U; ++k) {
      expectClose(cell.squares[k], expected.cell.squares[k]);
    }
    for (std::size_t k = 0; k < 4U; ++k) {
      expectClose(cell.borders[k], expected.cell.borders[k]);
    }
    expectClose(cell.radius, expected.cell.radius);
    expectClose(cell.radius_target, expected.cell.radius_target);
    double stem = 0.0;
    for (std::size_t i = run.begin; i < run.end; ++i) stem += static_cast<double>(posterior[i]);
    EXPECT_NEAR(stem, share.stem, 1e-3);
  });
  EXPECT_EQ(next, end) << "all of them";
  EXPECT_EQ(runs, 3) << "one border of nodes, one of bands";
}

TEST(CurveSamples, SumsWithWeightsFromElsewhere) {
  const StemCurve curve = curveOfThreeNodes();
  const CurveSamples samples(samplesRound(curve));
  const Skin skin{0.004, 0.036, 300.0, 0.6};
  std::vector<float> posterior(samples.padded(), 0.0F);
  samples.forEachRun(0U, samples.size(), [&](const CurveSamples::Run& run) {
    CellSums expected;
    samples.expectSurface(run, curve, skin, expected, posterior);
    constexpr float kNegligible = 1e-4F;
    std::vector<float> weights(samples.padded(), 1e9F);  // those of other runs do not count
    for (std::size_t i = run.begin; i < run.end; ++i) {
      weights[i] = posterior[i] < kNegligible ? 0.0F : 0.6F / (0.004F * 0.004F) * posterior[i];
    }
    CellSums cell;
    samples.sumSurface(run, curve, weights, cell);
    ASSERT_GT(expected.radius[0], 0.0);
    for (std::size_t k = 0; k < 3U; ++k) expectClose(cell.squares[k], expected.squares[k]);
    for (std::size_t k = 0; k < 4U; ++k) expectClose(cell.borders[k], expected.borders[k]);
    expectClose(cell.radius, expected.radius);
    expectClose(cell.radius_target, expected.radius_target);
  });
}

INSTANTIATE_TEST_SUITE_P(Shapes, CurveSamplesTest, ::testing::Values(false, true));

}  // namespace
}  // namespace field_phenotyping
