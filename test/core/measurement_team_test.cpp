// The fit of a cross-section by teams of threads: the same bits as by one, whatever the team; and
// what it is made of, beside the standard library and Eigen.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <random>
#include <vector>

#include "emulated_team.hpp"
#include "field_phenotyping/common/elementary.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/team_cholesky.hpp"
#include "field_phenotyping/measurement/cross_section_start.hpp"
#include "field_phenotyping/measurement/outermost_heights_team.hpp"
#include "field_phenotyping/measurement/surface_mixture.hpp"

namespace field_phenotyping {
namespace {

constexpr double kDigits = 5e-16;

TEST(OutermostHeights, AreThoseOfASortWhateverTheTeam) {
  std::mt19937 random(11U);
  std::uniform_real_distribution<float> height(-1.0F, 2.0F);
  for (const std::uint32_t count : {0U, 1U, 3U, 4U, 5U, 7U, 300U}) {
    for (const float upwards : {1.0F, -1.0F}) {
      constexpr std::uint32_t kBegin = 2U;  // those before, and the one behind, are others'
      std::vector<float> xyz(3U * (kBegin + count + 1U), 9.0F * upwards);
      std::vector<float> sorted;
      for (std::uint32_t i = 0; i < count; ++i) {
        const float z = i % 5U == 4U ? sorted.back() * upwards : height(random);  // some are equal
        xyz[3U * (kBegin + i) + 2U] = z;
        sorted.push_back(upwards * z);
      }
      std::sort(sorted.begin(), sorted.end(), std::greater<float>());
      const PlantEndTask task{kBegin, kBegin + count, upwards};
      const auto expectOutermost = [&](const OutermostHeights& found) {
        ASSERT_EQ(found.count, std::min<int>(OutermostHeights::kMost, static_cast<int>(count)));
        for (int k = 0; k < found.count; ++k) {
          EXPECT_EQ(found.heights[k], sorted[static_cast<std::size_t>(k)]) << k << " of " << count;
        }
      };
      OutermostHeights alone;
      findOutermostHeights(SerialTeam(), task, xyz.data(), &alone);
      expectOutermost(alone);
      for (const unsigned groups : {1U, 3U}) {
        std::vector<OutermostHeights> found(groups * kLanes);
        runEmulatedTeam(groups, [&](const EmulatedTeam& team) {
          findOutermostHeights(team, task, xyz.data(), found.data());
        });
        expectOutermost(found.front());
      }
    }
  }
}

TEST(Elementary, ExponentialAndLogarithmAreExactToTheLastDigits) {
  std::mt19937 random(1U);
  std::uniform_real_distribution<double> exponent(-690.0, 690.0);
  std::uniform_real_distribution<double> small(-1.0, 1.0);
  for (int i = 0; i < 20000; ++i) {
    for (const double x : {exponent(random), small(random), 12.0 * small(random)}) {
      EXPECT_NEAR(exponential(x) / std::exp(x), 1.0, kDigits) << x;
      const double value = std::exp(x);
      EXPECT_NEAR(logarithm(value), std::log(value),
                  kDigits * std::max(1.0, std::abs(std::log(value))))
          << value;
    }
  }
  EXPECT_EQ(exponential(0.0), 1.0);
  EXPECT_EQ(exponential(-1e5), 0.0);
  EXPECT_EQ(exponential(-INFINITY), 0.0);
  EXPECT_TRUE(std::isnan(exponential(NAN)));
  EXPECT_EQ(logarithm(1.0), 0.0);
  EXPECT_TRUE(std::isnan(logarithm(NAN)));
  EXPECT_EQ(logarithm(INFINITY), INFINITY);
}

TEST(Elementary, DirectionsPartTheCircle) {
  for (const int count : {1, 3, 4, 30, 31, 315}) {
    for (int k = 0; k < count; ++k) {
      const Direction u = directionOf(k, count);
      const long double angle = std::acos(-1.0L) * 2 * k / count;
      EXPECT_NEAR(u.x, static_cast<double>(std::cos(angle)), kDigits) << k << " of " << count;
      EXPECT_NEAR(u.y, static_cast<double>(std::sin(angle)), kDigits) << k << " of " << count;
    }
  }
}

TEST(Elementary, AnglesAndDirectionsAreExactToTheLastDigits) {
  constexpr double kTurn = 2.0 * M_PI;
  for (int i = -2000; i <= 2000; ++i) {
    const double angle = kTurn / 1000.0 * i + 1e-5;
    const Direction u = directionAt(angle);
    EXPECT_NEAR(u.x, std::cos(angle), kDigits) << angle;
    EXPECT_NEAR(u.y, std::sin(angle), kDigits) << angle;
    const double size = 1e-6 * std::pow(10.0, i % 12);
    EXPECT_NEAR(angleOf(size * u.x, size * u.y), std::atan2(u.y, u.x), 2.0 * kDigits) << angle;
  }
  for (const double x : {-1.0, 0.0, 2.0}) {
    for (const double y : {-2.0, -1.0, 0.0, 1.0}) {
      EXPECT_NEAR(angleOf(x, y), std::atan2(y, x), kDigits) << x << ' ' << y;
    }
  }
}

TEST(Elementary, SectorsAreThoseOfTheArctangent) {
  for (int degree = -179; degree < 180; degree += 2) {
    const double angle = M_PI / 180.0 * degree;
    EXPECT_EQ(mixture::sectorOf(std::cos(angle), std::sin(angle)), (degree + 180) / 30) << degree;
  }
}

TEST(Information, SumsAreThoseOfTheMatrix) {
  std::mt19937 random(2U);
  std::normal_distribution<double> normal;
  std::vector<double> sums(kInformationSums, 0.0);
  std::vector<double> by_team(kInformationSums, 0.0);
  Eigen::MatrixXd expected = Eigen::MatrixXd::Zero(kCrossSectionSize, kCrossSectionSize);
  for (int point = 0; point < 5; ++point) {
    Eigen::MatrixXd local(kLocalSize, kLocalSize);
    std::vector<double> pairs(kPairs);
    for (int a = 0; a < kLocalSize; ++a) {
      for (int b = 0; b <= a; ++b) {
        local(a, b) = local(b, a) = normal(random);
        pairs[static_cast<std::size_t>(pairOf(a, b))] = local(a, b);
      }
    }
    double powers[kHeightPowers];
    powersOf(normal(random), powers);
    InformationAdder<kLocalSize, SerialTeam>(SerialTeam()).add(pairs.data(), powers, sums.data());
    runEmulatedTeam(2U, [&](const EmulatedTeam& team) {
      InformationAdder<kLocalSize, EmulatedTeam>(team).add(pairs.data(), powers, by_team.data());
    });
    for (int i = 0; i < kCrossSectionSize; ++i) {
      for (int j = 0; j < kCrossSectionSize; ++j) {
        expected(i, j) += powers[powerOf(i)] * powers[powerOf(j)] * local(localOf(i), localOf(j));
      }
    }
  }
  EXPECT_EQ(sums, by_team);
  int elements = 0;
  forEachInformation([&](int i, int j, int sum) {
    EXPECT_NEAR(sums[static_cast<std::size_t>(sum)], expected(i, j), 1e-9) << i << ' ' << j;
    ++elements;
  });
  EXPECT_EQ(elements, kCrossSectionSize * (kCrossSectionSize + 1) / 2);
}

TEST(TeamCholesky, SolvesAsEigenWhateverTheTeam) {
  std::srand(3U);
  for (const int n : {1, 2, 15, 47}) {
    const Eigen::MatrixXd root = Eigen::MatrixXd::Random(n, n);
    const Eigen::MatrixXd matrix = root * root.transpose() + Eigen::MatrixXd::Identity(n, n);
    const Eigen::VectorXd right = Eigen::VectorXd::Random(n);
    const Eigen::VectorXd expected = matrix.llt().solve(right);
    Eigen::MatrixXd serial_factors = matrix;  // symmetric: rows may be columns
    Eigen::VectorXd serial_right = right;
    Eigen::VectorXd serial(n);
    ASSERT_TRUE(teamFactor(SerialTeam(), serial_factors.data(), n));
    teamSolve(SerialTeam(), serial_factors.data(), n, serial_right.data(), serial.data());
    EXPECT_LT((serial - expected).norm(), 1e-10 * expected.norm());
    Eigen::VectorXd column(n);
    columnOfInverse(serial_factors.data(), n, n / 2, column.data());
    EXPECT_LT((matrix * column - Eigen::VectorXd::Unit(n, n / 2)).norm(), 1e-10);
    for (const unsigned groups : {1U, 3U}) {
      Eigen::MatrixXd factors = matrix;
      Eigen::VectorXd left = right;
      Eigen::VectorXd solution(n);
      runEmulatedTeam(groups, [&](const EmulatedTeam& team) {
        EXPECT_TRUE(teamFactor(team, factors.data(), n));
        teamSolve(team, factors.data(), n, left.data(), solution.data());
      });
      EXPECT_EQ(solution, serial) << groups << " groups, n = " << n;
    }
  }
  Eigen::Matrix2d indefinite;
  indefinite << 1.0, 2.0, 2.0, 1.0;
  EXPECT_FALSE(teamFactor(SerialTeam(), indefinite.data(), 2));
}

/// Points of a stem, and some of a leaf.
/// @param bump how far, in the upper half, every other sixth of the stem is off its ellipse
std::vector<Eigen::Vector3d> stemPoints(int count, double radius, double noise, double arc,
                                        double bump, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < count; ++i) {
    const double angle = arc * uniform(random);
    const double height = 0.2 * (uniform(random) - 0.5);
    const bool is_off = height > 0.0 && static_cast<int>(angle * 3.0 / M_PI) % 2 == 0;
    const double distance =
        (i % 12 == 0 ? 2.0 : 1.0) * radius * (1.0 - 0.2 * height) + (is_off ? bump : 0.0);
    points.emplace_back(1.1 * distance * std::cos(angle) + noise * normal(random) + 0.002,
                        0.9 * distance * std::sin(angle) + noise * normal(random), height);
  }
  return points;
}

/// A whole fit as a team does it; `fit` of all its members.
SurfaceMixtureFit fitByTeam(unsigned groups, const CrossSectionPoints& points,
                            const CrossSectionTask& task, CrossSectionStart& start) {
  const std::size_t members = groups * kLanes;
  std::vector<start::Record> records(members);
  start::Sums sums;
  double matrix[kCrossSectionSize * kCrossSectionSize];
  double vector[kCrossSectionSize];
  double solution[kCrossSectionSize];
  std::vector<CrossSectionStart> starts(members);
  runEmulatedTeam(groups, [&](const EmulatedTeam& team) {
    starts[team.rank()] =
        startCrossSection(team, points, task, {records.data(), &sums, matrix, vector, solution});
  });
  start = starts.front();
  for (const CrossSectionStart& other : starts) {
    EXPECT_EQ(std::memcmp(&other.parameters, &start.parameters, sizeof start.parameters), 0);
    EXPECT_EQ(other.outlier_share, start.outlier_share);
  }
  const int bins = mixture::binsOf(start.parameters);
  std::vector<double> shared(mixture::sharedScratchSize(bins));
  std::vector<double> of_points(members * mixture::pointScratchSize(bins));
  SurfaceMixtureFit fit;
  runEmulatedTeam(groups, [&](const EmulatedTeam& team) {
    fitSurfaceMixture(team, points, task, start, bins, shared.data(), of_points.data(), fit);
  });
  return fit;
}

void expectSame(const double* a, const double* b, int count, const char* what) {
  for (int i = 0; i < count; ++i) EXPECT_EQ(a[i], b[i]) << what << ' ' << i;
}

TEST(CrossSectionTeam, FitIsThatOfOneThreadBitForBit) {
  struct Case {
    int points;
    double noise;  // [m]
    double arc;    // [rad]
    double bump;   // [m]
    unsigned groups;
  };
  // The noise of the fourth one leaves no shape to be seen; points of the last one count together.
  for (const Case& c :
       {Case{30, 0.003, 6.3, 0.0, 1U}, Case{14, 0.002, 2.5, 0.0, 2U}, Case{5, 0.003, 6.3, 0.0, 3U},
        Case{9, 0.01, 6.3, 0.0, 2U}, Case{120, 0.0005, 6.3, 0.003, 2U}}) {
    const std::vector<Eigen::Vector3d> points =
        stemPoints(c.points, 0.012, c.noise, c.arc, c.bump, 7U);
    const CrossSectionPoints places = placesOf(points);
    const bool shapeless = c.noise > 0.005;
    CrossSectionPrior prior;
    if (shapeless) prior.noise = c.noise;
    const CrossSectionTask task = crossSectionTask(points, prior, nullptr);
    const CrossSectionStart start = startCrossSection(places, task);
    const SurfaceMixtureFit alone = fitSurfaceMixture(places, task, start);
    ASSERT_TRUE(alone.has_covariance) << c.points;
    if (c.bump > 0.0) {
      EXPECT_LT(alone.freedom, 0.7 * c.points);
    }

    CrossSectionStart by_team_start;
    const SurfaceMixtureFit by_team = fitByTeam(c.groups, places, task, by_team_start);
    expectSame(start.parameters.values, by_team_start.parameters.values, kCrossSectionSize,
               "start");
    EXPECT_EQ(start.outlier_share, by_team_start.outlier_share);
    EXPECT_EQ(start.shapeless, by_team_start.shapeless);
    EXPECT_EQ(start.shapeless, shapeless);
    EXPECT_EQ(alone.converged, by_team.converged);
    ASSERT_TRUE(by_team.has_covariance);
    expectSame(alone.parameters.values, by_team.parameters.values, kCrossSectionSize, "parameter");
    EXPECT_EQ(alone.outlier_share, by_team.outlier_share);
    EXPECT_EQ(alone.surface_points, by_team.surface_points);
    EXPECT_EQ(alone.freedom, by_team.freedom);
    EXPECT_EQ(alone.arc_coverage, by_team.arc_coverage);
    EXPECT_EQ(alone.radius_prior_variance, by_team.radius_prior_variance);
    constexpr int kElements = kCrossSectionSize * kCrossSectionSize;
    expectSame(alone.posterior, by_team.posterior, kElements, "posterior");
    expectSame(alone.patches, by_team.patches, kElements, "patches");
    expectSame(alone.bound, by_team.bound, kElements, "bound");
  }
}

}  // namespace
}  // namespace field_phenotyping
