// The estimators of a stem's cross-section against exact truth.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/rice_distribution.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping {
namespace {

constexpr double kDegree = M_PI / 180.0;

/// How a stem is made and seen.
struct Scene {
  double diameter = 0.020;  // 2a
  double noise = 0.003;
  int points = 300;
  double arc = 360.0;       // [deg]
  double axis_ratio = 0.0;  // 0: drawn from [0.80, 0.95]
  double span = 0.15;
  double taper = -0.15;     // [1/m]
  double offset = 0.003;    // of the reference axis, standard deviation
  double tilt = 2.0;        // of the reference axis, standard deviation [deg]
  double outliers = 0.0;    // share
  bool along_beam = false;  // noise along beams from two opposite sides
  double bumps = 0.0;       // how far the surface departs from its ellipse, root mean square
};

/// Departure of a surface by some waves round and along it, as of sheaths and grooves.
class Bumps {
 public:
  Bumps(double height, std::mt19937& engine) : height_(height) {
    std::uniform_real_distribution<double> uniform;
    for (Wave& wave : waves_) {
      wave.round = std::floor(3.0 + 4.0 * uniform(engine));
      wave.along = 2.0 * M_PI / (0.05 + 0.15 * uniform(engine));
      wave.phase = 2.0 * M_PI * uniform(engine);
    }
  }
  double at(double angle, double height) const {
    double sum = 0.0;
    for (const Wave& wave : waves_) {
      sum += std::cos(wave.round * angle + wave.along * height + wave.phase);
    }
    return height_ * sum * std::sqrt(2.0 / kWaves);
  }

 private:
  static constexpr int kWaves = 4;
  struct Wave {
    double round = 0.0, along = 0.0, phase = 0.0;
  };
  double height_;
  Wave waves_[kWaves];
};

struct Sample {
  std::vector<Eigen::Vector3d> points;
  std::vector<double> angles;  // of the true surface points, in the frame of x and y
  double major = 0.0, minor = 0.0, angle = 0.0;
  double view = 0.0;  // azimuth of the middle of the seen arc
};

Sample makeSample(const Scene& scene, std::uint32_t seed) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  Sample sample;
  const double ratio = scene.axis_ratio > 0.0 ? scene.axis_ratio : 0.80 + 0.15 * uniform(engine);
  const double a = 0.5 * scene.diameter;
  const double b = ratio * a;
  sample.major = 2.0 * a;
  sample.minor = 2.0 * b;
  sample.angle = M_PI * uniform(engine);
  sample.view = 2.0 * M_PI * uniform(engine);
  const Eigen::Vector2d offset(scene.offset * normal(engine), scene.offset * normal(engine));
  const Eigen::Vector2d tilt(std::tan(scene.tilt * kDegree * normal(engine)),
                             std::tan(scene.tilt * kDegree * normal(engine)));
  const Eigen::Rotation2Dd turn(sample.angle);
  const Eigen::Vector2d beam(std::cos(sample.view), std::sin(sample.view));
  std::mt19937 bump_engine(seed + 1U);
  const Bumps bumps(scene.bumps, bump_engine);
  while (static_cast<int>(sample.points.size()) < scene.points) {
    const double height = scene.span * (uniform(engine) - 0.5);
    const double scale = 1.0 + scene.taper * height;
    Eigen::Vector2d point;
    double angle = 0.0;
    if (uniform(engine) < scene.outliers) {  // a leaf that leaves the stem
      const double azimuth = sample.view + 0.5 * normal(engine);
      point = (a + 0.03 * uniform(engine)) * Eigen::Vector2d(std::cos(azimuth), std::sin(azimuth));
    } else {
      const double t = sample.view - sample.angle + scene.arc * kDegree * (uniform(engine) - 0.5);
      angle = t + sample.angle;
      const double out = bumps.at(t, height);
      point =
          turn * Eigen::Vector2d((scale * a + out) * std::cos(t), (scale * b + out) * std::sin(t));
      if (scene.along_beam) {
        // A beam hits a piece of surface as often as the piece is wide across the beam.
        const Eigen::Vector2d normal_there =
            turn * Eigen::Vector2d(b * std::cos(t), a * std::sin(t)).normalized();
        if (uniform(engine) > std::abs(normal_there.dot(beam))) continue;
        point += scene.noise * normal(engine) * beam;
      } else {
        point.x() += scene.noise * normal(engine);
        point.y() += scene.noise * normal(engine);
      }
    }
    point += offset + height * tilt;
    sample.points.emplace_back(point.x(), point.y(), height);
    sample.angles.push_back(angle);
  }
  return sample;
}

/// Cramer-Rao bound of 2a for points at known heights and unknown angles, with the estimator's own
/// prior on ellipticity [m].
double cramerRao(const Scene& scene, const Sample& sample, double ellipticity_prior) {
  const double r = 0.25 * (sample.major + sample.minor);
  const double e = 0.25 * (sample.major - sample.minor);
  const Eigen::Vector2d ellipse(e * std::cos(2.0 * sample.angle), e * std::sin(2.0 * sample.angle));
  Eigen::Matrix2d shape;
  shape << r + ellipse.x(), ellipse.y(), ellipse.y(), r - ellipse.x();
  using Vector = Eigen::Matrix<double, 10, 1>;
  Eigen::Matrix<double, 10, 10> information = Eigen::Matrix<double, 10, 10>::Zero();
  for (std::size_t i = 0; i < sample.points.size(); ++i) {
    const double h = sample.points[i].z();
    const double t = sample.angles[i];
    const Eigen::Vector2d u(std::cos(t), std::sin(t));
    const Eigen::Vector2d n = (shape.inverse() * u).normalized();
    Vector row;
    row << n, h * n, h * h * n, n.dot(u), h * n.dot(u), n.x() * u.x() - n.y() * u.y(),
        n.x() * u.y() + n.y() * u.x();
    information += row * row.transpose() / (scene.noise * scene.noise);
  }
  Vector prior = Vector::Constant(1e-9);
  prior.tail<2>().setConstant(1.0 / std::pow(ellipticity_prior * r, 2));
  information.diagonal() += prior;
  Vector gradient = Vector::Zero();
  gradient[6] = 2.0;
  gradient.tail<2>() = 2.0 * ellipse / std::max(e, 1e-9);
  return std::sqrt(gradient.dot(information.ldlt().solve(gradient)));
}

struct Score {
  double bias = 0.0, rmse = 0.0, coverage = 0.0, bound = 0.0;  // of 2a [mm]
  double bias_equivalent = 0.0;
  double circle_bias = 0.0;  // of a least-squares circle against 2a [mm]
  int failed = 0;
};

Score monteCarlo(const Scene& scene, const CrossSectionPrior& prior, std::uint32_t seed,
                 int trials) {
  Score score;
  int fitted = 0;
  for (int i = 0; i < trials; ++i) {
    const Sample sample = makeSample(scene, seed * 100003U + static_cast<std::uint32_t>(i));
    const StemCrossSection fit = fitStemCrossSection(sample.points, prior);
    if (!fit.valid || !fit.converged) ++score.failed;
    if (!fit.valid) continue;
    const double error = 1e3 * (fit.major.value - sample.major);
    score.bias += error;
    score.rmse += error * error;
    score.bias_equivalent += 1e3 * (fit.equivalent.value - std::sqrt(sample.major * sample.minor));
    score.coverage += std::abs(error) < 1.96e3 * fit.major.stddev ? 1.0 : 0.0;
    score.bound += std::pow(1e3 * cramerRao(scene, sample, prior.ellipticity_stddev), 2);
    std::vector<Eigen::Vector2d> flat;
    for (const Eigen::Vector3d& point : sample.points) flat.emplace_back(point.head<2>());
    score.circle_bias += 1e3 * (2.0 * fitCircle(flat).radius - sample.major);
    ++fitted;
  }
  score.bias /= fitted;
  score.rmse = std::sqrt(score.rmse / fitted);
  score.bias_equivalent /= fitted;
  score.coverage /= fitted;
  score.bound = std::sqrt(score.bound / fitted);
  score.circle_bias /= fitted;
  return score;
}

Score printed(const std::string& name, const Scene& scene,
              const CrossSectionPrior& prior = CrossSectionPrior(), int trials = 100) {
  Score total;
  constexpr int kSeeds = 3;
  for (std::uint32_t seed = 1; seed <= kSeeds; ++seed) {
    const Score score = monteCarlo(scene, prior, seed, trials / kSeeds + 1);
    total.bias += score.bias / kSeeds;
    total.rmse += score.rmse * score.rmse / kSeeds;
    total.coverage += score.coverage / kSeeds;
    total.bound += score.bound * score.bound / kSeeds;
    total.bias_equivalent += score.bias_equivalent / kSeeds;
    total.circle_bias += score.circle_bias / kSeeds;
    total.failed += score.failed;
  }
  total.rmse = std::sqrt(total.rmse);
  total.bound = std::sqrt(total.bound);
  std::printf(
      "%-34s 2a: bias %+6.2f RMSE %5.2f (bound %5.2f) mm, coverage %.2f, failed %d; 2 sqrt(ab): "
      "bias %+5.2f; circle: bias %+6.2f\n",
      name.c_str(), total.bias, total.rmse, total.bound, total.coverage, total.failed,
      total.bias_equivalent, total.circle_bias);
  return total;
}

TEST(Rice, DensityIntegratesToOneAndDerivativesAgreeWithDifferences) {
  for (const double noise : {0.1, 0.5, 1.0, 3.0, 8.0}) {
    const double radius = 10.0;
    double total = 0.0;
    double score = 0.0;
    const double step = 0.02 * noise;
    for (double d = 0.5 * step; d < radius + 12.0 * noise; d += step) {
      const RiceTerms terms = riceTerms(d, radius, noise);
      total += std::exp(terms.value) * step;
      score += std::exp(terms.value) * terms.by_radius * step;
    }
    EXPECT_NEAR(total, 1.0, 1e-4) << noise;
    EXPECT_NEAR(score * noise, 0.0, 1e-4) << noise;

    const double h = 1e-3 * noise;
    for (const double d : {radius - 1.5 * noise, radius, radius + 2.0 * noise}) {
      if (d <= 0.0) continue;
      const RiceTerms here = riceTerms(d, radius, noise);
      const RiceTerms farther = riceTerms(d + h, radius, noise);
      const RiceTerms nearer = riceTerms(d - h, radius, noise);
      EXPECT_NEAR((farther.value - nearer.value) / (2.0 * h), here.by_distance, 3e-3 / noise);
      EXPECT_NEAR((farther.by_distance - nearer.by_distance) / (2.0 * h), here.by_distance2,
                  3e-3 / (noise * noise));
      EXPECT_NEAR((farther.by_radius - nearer.by_radius) / (2.0 * h), here.by_distance_radius,
                  3e-3 / (noise * noise));
      EXPECT_NEAR((farther.by_log_noise - nearer.by_log_noise) / (2.0 * h), here.by_distance_noise,
                  3e-3 / noise);
      const RiceTerms wider = riceTerms(d, radius + h, noise);
      const RiceTerms narrower = riceTerms(d, radius - h, noise);
      EXPECT_NEAR((wider.by_radius - narrower.by_radius) / (2.0 * h), here.by_radius2,
                  3e-3 / (noise * noise));
      const RiceTerms louder = riceTerms(d, radius, noise * 1.001);
      const RiceTerms quieter = riceTerms(d, radius, noise / 1.001);
      const double log_step = 2.0 * std::log(1.001);
      EXPECT_NEAR((louder.by_log_noise - quieter.by_log_noise) / log_step, here.by_log_noise2,
                  2e-2);
      EXPECT_NEAR((louder.by_radius - quieter.by_radius) / log_step, here.by_radius_noise,
                  2e-2 / noise);
    }
  }
}

TEST(PaperMode, ReadsTooLargeByWhatIsKnownOfEq27) {
  Scene scene;
  scene.noise = 0.002;
  scene.points = 100;
  scene.axis_ratio = 1.0;
  scene.taper = scene.offset = scene.tilt = 0.0;
  double bias = 0.0;
  constexpr int kTrials = 300;
  for (std::uint32_t i = 0; i < kTrials; ++i) {
    std::vector<Eigen::Vector2d> flat;
    for (const Eigen::Vector3d& point : makeSample(scene, 77U + i).points) {
      flat.emplace_back(point.head<2>());
    }
    const EllipseFit fit = fitAlgebraicEllipse(flat);
    ASSERT_TRUE(fit.valid);
    bias += 1e3 * (2.0 * fit.semi_major - scene.diameter) / kTrials;
  }
  std::printf("Eq 27 at 20 mm, 2 mm noise, 100 points, full circle: bias %+.2f mm\n", bias);
  EXPECT_NEAR(bias, 2.9, 0.4);
}

TEST(PaperMode, IsExactWithoutNoise) {
  Scene scene;
  scene.noise = 0.0;
  scene.axis_ratio = 0.8;
  scene.taper = scene.tilt = 0.0;
  const Sample sample = makeSample(scene, 5U);
  std::vector<Eigen::Vector2d> flat;
  for (const Eigen::Vector3d& point : sample.points) flat.emplace_back(point.head<2>());
  const EllipseFit fit = fitAlgebraicEllipse(flat);
  ASSERT_TRUE(fit.valid);
  EXPECT_NEAR(2.0 * fit.semi_major, sample.major, 1e-7);
  EXPECT_NEAR(2.0 * fit.semi_minor, sample.minor, 1e-7);
  EXPECT_NEAR(std::sin(fit.angle - sample.angle), 0.0, 1e-5);
}

TEST(PaperMode, RunsAwayOnAHalfCircle) {
  Scene scene;
  scene.arc = 180.0;
  int failed = 0;
  for (std::uint32_t i = 0; i < 50U; ++i) {
    std::vector<Eigen::Vector2d> flat;
    for (const Eigen::Vector3d& point : makeSample(scene, i).points) {
      flat.emplace_back(point.head<2>());
    }
    const EllipseFit fit = fitAlgebraicEllipse(flat);
    failed += !fit.valid || fit.semi_major > scene.diameter ? 1 : 0;
  }
  EXPECT_GT(failed, 40);
}

TEST(Circle, ExactWithoutNoiseAndTooLargeWithIt) {
  Scene scene;
  scene.noise = 0.0;
  scene.axis_ratio = 1.0;
  scene.taper = scene.tilt = 0.0;
  scene.arc = 120.0;
  std::vector<Eigen::Vector2d> flat;
  for (const Eigen::Vector3d& point : makeSample(scene, 3U).points) {
    flat.emplace_back(point.head<2>());
  }
  const CircleFit fit = fitCircle(flat);
  ASSERT_TRUE(fit.valid);
  EXPECT_NEAR(fit.radius, 0.01, 1e-8);
  EXPECT_FALSE(fitCircle({{0.0, 0.0}, {1.0, 0.0}, {0.0, 1.0}}).valid);
}

TEST(CrossSection, UnbiasedAndHonestAroundTheWholeStem) {
  for (const double noise : {0.001, 0.002, 0.003, 0.004}) {
    Scene scene;
    scene.noise = noise;
    const Score score =
        printed("noise " + std::to_string(noise * 1e3).substr(0, 4), scene, {}, 400);
    EXPECT_LT(std::abs(score.bias), 0.10 + 0.08e3 * noise);
    EXPECT_LT(std::abs(score.bias_equivalent), 0.15);
    EXPECT_LT(score.rmse, 1.4 * score.bound);
    EXPECT_GT(score.coverage, 0.87);
    EXPECT_LE(score.failed, 1);
  }
}

TEST(CrossSection, FromThickToThinStems) {
  for (const double diameter : {0.010, 0.015, 0.030, 0.040}) {
    Scene scene;
    scene.diameter = diameter;
    scene.noise = 0.002;
    const Score score = printed("diameter " + std::to_string(diameter * 1e3).substr(0, 4), scene);
    EXPECT_LT(std::abs(score.bias), 0.35);
    EXPECT_LT(score.rmse, 1.0);
    EXPECT_GT(score.coverage, 0.85);
  }
}

TEST(CrossSection, FewPoints) {
  for (const int points : {30, 60, 1000}) {
    Scene scene;
    scene.points = points;
    const Score score = printed("points " + std::to_string(points), scene);
    EXPECT_LT(std::abs(score.bias), 0.8);
    EXPECT_LT(score.rmse, points < 50 ? 2.2 : 1.6);
    EXPECT_GT(score.coverage, 0.85);
  }
}

TEST(CrossSection, FewPointsAreHonest) {
  double coverage = 0.0;
  for (const int points : {20, 25, 30}) {
    Scene scene;
    scene.points = points;
    coverage += printed("few points " + std::to_string(points), scene, {}, 300).coverage / 3.0;
  }
  EXPECT_GT(coverage, 0.92);
  EXPECT_LT(coverage, 0.98);
}

TEST(CrossSection, NoiseOfFewPointsIsNotTooSmall) {
  // The places of the points round the stem are fitted too: that must not be taken for less noise.
  constexpr int kSamples = 200;
  for (const int points : {20, 50}) {
    Scene scene;
    scene.diameter = 0.010;
    scene.points = points;
    scene.noise = 0.002;
    scene.span = 0.1;
    double sum = 0.0;
    for (int i = 0; i < kSamples; ++i) {
      const Sample sample = makeSample(scene, 9000U + static_cast<std::uint32_t>(i));
      sum += fitStemCrossSection(sample.points, {}).log_noise.value;
    }
    EXPECT_NEAR(sum / kSamples, std::log(scene.noise), 0.12) << points << " points";
    const Score score = printed("10 mm, points " + std::to_string(points), scene, {}, 200);
    EXPECT_LT(std::abs(score.bias), 0.5) << points << " points";
  }
}

TEST(CrossSection, NoiseAsLargeAsTheStem) {
  Scene scene;
  scene.noise = 0.010;
  scene.arc = 270.0;
  CrossSectionPrior prior;
  prior.noise = 0.010;
  const Score score = printed("noise 10, known, arc 270", scene, prior);
  EXPECT_LT(std::abs(score.bias), 1.5);
  EXPECT_LT(score.rmse, 3.0);
  EXPECT_GT(score.coverage, 0.85);
  EXPECT_GT(score.circle_bias, 8.0);
}

TEST(CrossSection, SeenInPart) {
  for (const double arc : {270.0, 180.0, 120.0}) {
    Scene scene;
    scene.noise = 0.001;
    scene.arc = arc;
    const Score score = printed("noise 1, arc " + std::to_string(arc).substr(0, 3), scene);
    EXPECT_LT(score.rmse, 1.3 * score.bound);
    EXPECT_LT(std::abs(score.bias), arc > 150.0 ? 0.5 : 1.5);
    EXPECT_GT(score.coverage, 0.84);
  }
  Scene scene;
  scene.arc = 270.0;
  const Score score = printed("noise 3, arc 270", scene);
  EXPECT_LT(score.rmse, 1.3 * score.bound);
  scene.arc = 180.0;
  const Score half = printed("noise 3, arc 180", scene);
  EXPECT_LT(half.rmse, 1.3 * half.bound);
  EXPECT_LT(std::abs(half.bias), 0.6);
  EXPECT_GT(half.coverage, 0.86);
}

TEST(CrossSection, LessThanHalfOfAStemIsKnownBadlyAndSaysSo) {
  for (const double noise : {0.001, 0.002}) {
    for (const double arc : {90.0, 120.0, 150.0}) {
      Scene scene;
      scene.noise = noise;
      scene.points = 500;
      scene.arc = arc;
      const Score score = printed("arc " + std::to_string(arc).substr(0, 3), scene, {}, 200);
      EXPECT_GT(score.coverage, 0.86) << arc << " deg, noise " << noise;
    }
  }
}

TEST(CrossSection, LeafPoints) {
  Scene scene;
  scene.noise = 0.002;
  scene.outliers = 0.2;
  const Score score = printed("20 % leaf points", scene);
  EXPECT_LT(score.rmse, 2.0);
  EXPECT_GT(score.circle_bias, 4.0 * std::abs(score.bias));
}

TEST(CrossSection, NoiseAlongTheBeamFromTwoSides) {
  Scene scene;
  scene.along_beam = true;
  const Score score = printed("noise along the beams, two sides", scene);
  EXPECT_LT(std::abs(score.bias), 0.6);
  EXPECT_LT(score.rmse, 1.2);
}

TEST(CrossSection, ManyPointsOfASurfaceThatIsNoEllipse) {
  Scene scene;
  scene.diameter = 0.030;
  scene.noise = 0.001;
  scene.points = 2500;
  scene.span = 0.4;
  scene.bumps = 0.001;
  const Score round = printed("1 mm off an ellipse, all round", scene, {}, 20);
  EXPECT_LT(round.rmse, 0.3);
  EXPECT_GT(round.coverage, 0.88);
  // Where every point is taken for one that knows nothing of the others the root mean square error
  // is 9.9 mm, coverage 0.19, and half of the fits do not converge.
  scene.bumps = 0.0025;
  scene.arc = 110.0;
  const Score part = printed("2.5 mm off an ellipse, arc 110", scene, {}, 50);
  EXPECT_LT(part.rmse, 7.5);
  EXPECT_GT(part.coverage, 0.65);
  EXPECT_LE(part.failed, 3);
}

TEST(CrossSection, PoorReferenceAxis) {
  Scene scene;
  scene.offset = 0.008;
  scene.tilt = 6.0;
  const Score score = printed("axis off by 8 mm, 6 deg", scene);
  EXPECT_LT(score.rmse, 1.5);
}

TEST(CrossSection, OrientationAndTaperAreFound) {
  Scene scene;
  scene.diameter = 0.030;
  scene.axis_ratio = 0.75;
  scene.noise = 0.001;
  scene.points = 1000;
  scene.taper = -0.8;
  scene.offset = scene.tilt = 0.0;
  for (std::uint32_t seed = 0; seed < 5U; ++seed) {
    const Sample sample = makeSample(scene, seed);
    const StemCrossSection fit = fitStemCrossSection(sample.points, CrossSectionPrior());
    ASSERT_TRUE(fit.valid);
    EXPECT_NEAR(std::sin(fit.major_angle - sample.angle), 0.0, 0.05);
    EXPECT_NEAR(fit.taper.value, scene.taper, 0.12);
    EXPECT_NEAR(fit.noise, scene.noise, 0.1 * scene.noise);
    EXPECT_NEAR(fit.minor.value, sample.minor, 5e-4);
    EXPECT_LT(fit.prior_share, 0.01);
    EXPECT_LT(fit.ellipticity_prior_share, 0.1);
    EXPECT_GT(fit.arc_coverage, 0.99);
  }
}

TEST(CrossSection, CarriedToAnotherHeightWithTheTaper) {
  Scene scene;
  scene.noise = 0.001;
  scene.points = 600;
  double error = 0.0;
  int covered = 0;
  constexpr std::uint32_t kTrials = 40;
  for (std::uint32_t seed = 0; seed < kTrials; ++seed) {
    Sample sample = makeSample(scene, seed);
    for (Eigen::Vector3d& point : sample.points) point.z() += 0.2;  // wanted 20 cm below
    const StemCrossSection fit = fitStemCrossSection(sample.points, CrossSectionPrior());
    ASSERT_TRUE(fit.valid);
    const double truth = sample.major * (1.0 - 0.2 * scene.taper);
    error += (fit.major.value - truth) / kTrials;
    covered += std::abs(fit.major.value - truth) < 1.96 * fit.major.stddev ? 1 : 0;
  }
  EXPECT_LT(std::abs(error), 3e-4);
  EXPECT_GE(covered, 34);
}

TEST(CrossSection, StartsFromAnotherFit) {
  Scene scene;
  CrossSectionPrior prior;
  prior.ellipticity_stddev = 0.03;
  prior.log_noise = {std::log(scene.noise), 0.05};
  double square = 0.0;
  constexpr std::uint32_t kTrials = 40;
  for (std::uint32_t seed = 0; seed < kTrials; ++seed) {
    const Sample sample = makeSample(scene, seed);
    const StemCrossSection weak = fitStemCrossSection(sample.points, CrossSectionPrior());
    const StemCrossSection cold = fitStemCrossSection(sample.points, prior);
    const StemCrossSection warm = fitStemCrossSection(sample.points, prior, weak);
    ASSERT_TRUE(warm.valid && warm.converged) << seed;
    square += std::pow((warm.major.value - cold.major.value) / cold.major.stddev, 2) / kTrials;
  }
  EXPECT_LT(std::sqrt(square), 0.15);
}

TEST(CrossSection, StaysWhereItEnded) {
  for (const double noise : {0.001, 0.003, 0.005}) {
    Scene scene;
    scene.noise = noise;
    scene.outliers = 0.05;
    for (std::uint32_t seed = 0; seed < 10U; ++seed) {
      const Sample sample = makeSample(scene, seed);
      const CrossSectionPrior prior;
      // Once more, for the first start gave other bins; these may differ a little, too.
      const StemCrossSection first = fitStemCrossSection(sample.points, prior);
      const StemCrossSection fit = fitStemCrossSection(sample.points, prior, first);
      ASSERT_TRUE(fit.converged) << seed;
      const StemCrossSection again = fitStemCrossSection(sample.points, prior, fit);
      EXPECT_NEAR(again.major.value, fit.major.value, 0.1 * fit.major.stddev) << seed;
      EXPECT_NEAR(again.major.stddev, fit.major.stddev, 0.1 * fit.major.stddev) << seed;
      EXPECT_NEAR(again.outlier_share, fit.outlier_share, 0.002) << seed;
    }
  }
}

TEST(CrossSection, DoesNotStartFromAFitOfAHalfSeenStem) {
  Scene scene;
  scene.arc = 120.0;
  const CrossSectionPrior prior;
  for (std::uint32_t seed = 0; seed < 5U; ++seed) {
    const Sample sample = makeSample(scene, seed);
    const StemCrossSection cold = fitStemCrossSection(sample.points, prior);
    StemCrossSection near = cold;
    near.radius.value *= 2.0;
    near.center.x() += 0.01;
    const StemCrossSection warm = fitStemCrossSection(sample.points, prior, near);
    EXPECT_EQ(warm.major.value, cold.major.value) << seed;
  }
}

TEST(CrossSection, DegenerateInputIsInvalidNotACrash) {
  const CrossSectionPrior prior;
  EXPECT_FALSE(fitStemCrossSection({}, prior).valid);
  const std::vector<Eigen::Vector3d> same(20, Eigen::Vector3d::Zero());
  EXPECT_FALSE(fitStemCrossSection(same, prior).valid);
  std::vector<Eigen::Vector3d> line;
  for (int i = 0; i < 20; ++i) line.emplace_back(0.001 * i, 0.0, 0.0);
  const StemCrossSection fit = fitStemCrossSection(line, prior);
  if (fit.valid) {
    EXPECT_TRUE(std::isfinite(fit.major.value));
    EXPECT_GT(fit.major.stddev, 0.0);
  }
}

}  // namespace
}  // namespace field_phenotyping
