// The fit of a stem's coarse model, the surfaces and the filters of its regions by teams of
// threads: the same bits as by one, whatever the team; and what they are made of, beside the
// standard library and Eigen.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>
#include <type_traits>
#include <vector>

#include "emulated_team.hpp"
#include "field_phenotyping/common/serial_team.hpp"
#include "field_phenotyping/common/team_envelope.hpp"
#include "field_phenotyping/common/team_order.hpp"
#include "field_phenotyping/completion/bilateral_filter.hpp"
#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/stem_frame.hpp"
#include "field_phenotyping/completion/surface_prior_task.hpp"

namespace field_phenotyping {
namespace {

using Eigen::Vector3d;

TEST(TeamOrder, SelectsAsTheStandardLibraryDoes) {
  std::mt19937 random(4U);
  for (const int count : {1, 2, 3, 10, 333}) {
    for (const int kinds : {1, 4, 100000}) {
      std::vector<double> values;
      for (int i = 0; i < count; ++i) {
        values.push_back(1e-3 * static_cast<double>(random() % static_cast<unsigned>(kinds)));
      }
      std::vector<double> sorted = values;
      std::sort(sorted.begin(), sorted.end());
      for (const int rank : {0, (count - 1) / 2, count - 1}) {
        const double expected = sorted[static_cast<std::size_t>(rank)];
        std::vector<double> alone = values;
        EXPECT_EQ(teamSelect(SerialTeam(), alone.data(), count, rank, nullptr), expected);
        std::sort(alone.begin(), alone.end());
        EXPECT_EQ(alone, sorted) << "they are only put in another order";
        std::vector<double> together = values;
        std::vector<int> counts(8U);
        runEmulatedTeam(2U, [&](const EmulatedTeam& team) {
          EXPECT_EQ(teamSelect(team, together.data(), count, rank, counts.data()), expected);
        });
      }
    }
  }
}

TEST(TeamOrder, SortsAsTheStandardLibraryDoes) {
  struct Item {
    int key;
    int number;
  };
  const auto less = [](const Item& a, const Item& b) { return a.key < b.key; };
  std::mt19937 random(5U);
  for (const int count : {0, 1, 15, 16, 17, 33, 500}) {
    for (const int keys : {3, 10000}) {
      std::vector<Item> items;
      for (int i = 0; i < count; ++i) {
        items.push_back({static_cast<int>(random() % static_cast<unsigned>(keys)), i});
      }
      std::vector<Item> expected = items;
      std::stable_sort(expected.begin(), expected.end(), less);
      const auto expectSorted = [&](const Item* sorted) {
        for (std::size_t i = 0; i < expected.size(); ++i) {
          EXPECT_EQ(sorted[i].number, expected[i].number) << i << " of " << count;
        }
      };
      std::vector<Item> alone = items;
      std::vector<Item> other(items.size());
      expectSorted(teamSort(SerialTeam(), alone.data(), other.data(), count, less));
      std::vector<Item> together = items;
      std::vector<const Item*> found(8U);
      runEmulatedTeam(2U, [&](const EmulatedTeam& team) {
        found[team.rank()] = teamSort(team, together.data(), other.data(), count, less);
      });
      for (const Item* sorted : found) EXPECT_EQ(sorted, found.front());
      expectSorted(found.front());
    }
  }
}

/// A random matrix within an envelope, and the same as an Envelope.
Eigen::MatrixXd fillEnvelope(const Envelope& envelope, double diagonal) {
  std::mt19937 random(3U);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(envelope.size, envelope.size);
  for (int i = 0; i < envelope.size; ++i) {
    for (int k = envelope.first(i); k <= i; ++k) {
      matrix(i, k) = matrix(k, i) = k == i ? diagonal : normal(random);
      envelope.row(i)[k] = matrix(i, k);
    }
  }
  return matrix;
}

TEST(TeamEnvelope, SolvesAsTheDenseMatrixDoesWhateverTheTeam) {
  struct Case {
    int size;
    int band;
    int shared;
    int columns;
  };
  for (const Case& c :
       {Case{40, 5, 2, 3}, Case{14, 11, 2, 14}, Case{3, 11, 2, 1}, Case{9, 2, 0, 2}}) {
    std::vector<double> values(
        static_cast<std::size_t>(Envelope::valuesOf(c.size, c.band, c.shared)));
    const Envelope alone{values.data(), c.size, c.band, c.shared};
    const Eigen::MatrixXd matrix = fillEnvelope(alone, 60.0);
    std::vector<double> same = values;
    const Envelope together{same.data(), c.size, c.band, c.shared};
    using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    const RowMatrix right = RowMatrix::Random(c.size, c.columns);
    RowMatrix solution = right;
    ASSERT_TRUE(teamFactor(SerialTeam(), alone));
    teamSolve(SerialTeam(), alone, solution.data(), c.columns);
    EXPECT_LT((matrix * solution - right).cwiseAbs().maxCoeff(), 1e-12) << c.size;
    RowMatrix by_team = right;
    runEmulatedTeam(2U, [&](const EmulatedTeam& team) {
      EXPECT_TRUE(teamFactor(team, together));
      teamSolve(team, together, by_team.data(), c.columns);
    });
    EXPECT_EQ(same, values) << "factors of " << c.size;
    EXPECT_EQ(by_team, solution) << c.size;
    if (c.shared == 0) {
      const Eigen::VectorXd column = right.col(0);
      Eigen::VectorXd one = column;
      teamSolve(SerialTeam(), alone, one.data());
      EXPECT_LT((matrix * one - column).cwiseAbs().maxCoeff(), 1e-12) << c.size;
      Eigen::VectorXd one_by_team = column;
      runEmulatedTeam(
          2U, [&](const EmulatedTeam& team) { teamSolve(team, together, one_by_team.data()); });
      EXPECT_EQ(one_by_team, one) << c.size;
    }
    fillEnvelope(alone, -1.0);
    EXPECT_FALSE(teamFactor(SerialTeam(), alone));
  }
}

TEST(CurveFrame, IsTheSameWithEitherVector) {
  constexpr double kDigits = 1e-14;
  std::vector<Vector3d> curve;
  std::vector<Vector3> same;
  for (int i = 0; i < 50; ++i) {
    const double s = 0.01 * i;
    curve.emplace_back(0.3 * std::cos(3.0 * s), 0.2 * s * s, s);
    same.emplace_back(curve.back().x(), curve.back().y(), curve.back().z());
  }
  const StemFrame frame(curve);
  const int count = static_cast<int>(same.size());
  std::vector<CurveFrame<Vector3>> nodes(same.size());
  for (int i = 0; i < count; ++i) {
    placeNode(same.data(), count, i, nodes[static_cast<std::size_t>(i)]);
  }
  startFrame(nodes[0]);
  for (std::size_t i = 1; i < nodes.size(); ++i) carryOn(nodes[i - 1U], nodes[i]);
  const auto expectSame = [&](const Vector3& a, const Vector3d& b) {
    EXPECT_LT((Vector3d(a.x(), a.y(), a.z()) - b).norm(), kDigits);
  };
  for (double s = -0.1; s < 0.7; s += 0.013) {
    const CurveFrame<Vector3> here = frameAt(nodes.data(), count, s);
    const StemFrame::Frame expected = frame.at(s);
    expectSame(here.position, expected.position);
    expectSame(here.tangent, expected.tangent);
    expectSame(here.u, expected.u);
    expectSame(here.v, expected.v);
    EXPECT_NEAR(here.s, expected.s, kDigits);
    const Vector3d point = frame.roll({8.0 * s, s, 0.012});
    Vector3d outward;
    const UnrolledPoint unrolled = frame.unroll(point, outward);
    const BesideCurve<Vector3> beside =
        besideCurve(nodes.data(), count, {point.x(), point.y(), point.z()});
    EXPECT_NEAR(beside.s, unrolled.s, kDigits);
    EXPECT_NEAR(beside.r, unrolled.r, kDigits);
    EXPECT_NEAR(std::atan2(beside.sine(), beside.cosine()), unrolled.theta, 100.0 * kDigits);
  }
}

/// Points of a stem of which one side is seen, some of a leaf.
StemToModel stemToModel(int count, double length, const StemAxis& axis) {
  std::mt19937 random(7U);
  std::normal_distribution<double> noise(0.0, 0.001);
  std::uniform_real_distribution<double> uniform;
  StemToModel stem{{}, &axis, 0.05};
  for (int i = 0; i < count; ++i) {
    const double z = length * uniform(random);
    const double angle = 4.0 * uniform(random);
    const double r = (i % 11 == 0 ? 0.03 : 0.011) - 0.003 * z + noise(random);
    stem.points.emplace_back(0.02 * z * z + 1.05 * r * std::cos(angle), r * std::sin(angle), z);
  }
  return stem;
}

struct Fit {
  SurfacePriorFit fit;
  std::vector<double> curve, coefficients, covariance;
};

/// @param run calls what it is given with the members of a team
template <class Run>
Fit fitBy(const SurfacePriorTask& task, int members, const Run& run) {
  constexpr std::size_t kMost = coarse::kMostCoefficients;
  Fit fit;
  fit.curve.resize(3U * static_cast<std::size_t>(task.nodes));
  fit.coefficients.resize(kMost);
  fit.covariance.resize(kMost * kMost);
  std::vector<double> near(coarse::nearSize(members));
  std::vector<double> far(coarse::farSize(task.count, task.nodes, members));
  std::vector<SurfacePriorFit> fits(static_cast<std::size_t>(members));
  run([&](const auto& team) {
    fits[team.rank()] = SurfacePriorFitter<std::decay_t<decltype(team)>>(
                            team, task, fit.curve.data(), fit.coefficients.data(),
                            fit.covariance.data(), near.data(), far.data())
                            .run();
  });
  fit.fit = fits.front();
  for (const SurfacePriorFit& other : fits) {
    EXPECT_EQ(other.valid, fit.fit.valid);
    EXPECT_EQ(other.noise, fit.fit.noise);
    EXPECT_EQ(other.clustering, fit.fit.clustering);
  }
  return fit;
}

TEST(SurfacePriorTeam, FitIsThatOfOneThreadBitForBit) {
  struct Case {
    int points;
    double length;  // [m]
    double radius;  // as segmented [m]; 0: not known
    unsigned groups;
    bool valid;
  };
  for (const Case& c : {Case{150, 0.4, 0.012F, 1U, true}, Case{40, 0.2, 0.0, 2U, true},
                        Case{5, 0.1, 0.015, 2U, true}, Case{40, 0.3, 0.012, 3U, true}}) {
    const auto top = static_cast<float>(c.length);
    const auto radius = static_cast<float>(c.radius);
    const StemAxis axis({{{0.002F, 0.0F, 0.0F}, radius}, {{0.0F, 0.002F, top}, radius}});
    const StemToFit stem = layOut(stemToModel(c.points, c.length, axis));
    ASSERT_EQ(stem.task.count, c.points);
    const Fit alone = fitBy(stem.task, 1, [](const auto& work) { work(SerialTeam()); });
    ASSERT_EQ(alone.fit.valid, c.valid) << c.points;
    const Fit together = fitBy(stem.task, static_cast<int>(c.groups * kLanes),
                               [&](const auto& work) { runEmulatedTeam(c.groups, work); });
    EXPECT_EQ(together.fit.valid, alone.fit.valid);
    EXPECT_EQ(together.fit.layout.intervals, alone.fit.layout.intervals);
    EXPECT_EQ(together.fit.layout.interval_length, alone.fit.layout.interval_length);
    EXPECT_EQ(together.fit.noise, alone.fit.noise);
    EXPECT_EQ(together.fit.inliers, alone.fit.inliers);
    EXPECT_EQ(together.fit.clustering, alone.fit.clustering);
    EXPECT_EQ(together.curve, alone.curve);
    EXPECT_EQ(together.coefficients, alone.coefficients);
    EXPECT_EQ(together.covariance, alone.covariance);
    EXPECT_GT(alone.covariance.front(), 0.0);
  }
}

TEST(SurfacePriorTeam, LeavesWhatIsNoStem) {
  const StemAxis axis({{{0.0F, 0.0F, 0.0F}, 0.012F}, {{0.0F, 0.0F, 0.4F}, 0.012F}});
  EXPECT_EQ(layOut({{}, &axis, 0.0}).task.count, 0);
  EXPECT_EQ(layOut({{Vector3d(0.0, 0.0, 0.1)}, &axis, 0.0}).task.count, 0);
  const StemAxis none;
  EXPECT_EQ(layOut(stemToModel(50, 0.4, axis)).task.count, 50);
  StemToModel without_axis = stemToModel(50, 0.4, axis);
  without_axis.axis = &none;
  EXPECT_EQ(layOut(without_axis).task.count, 0);

  // Among others the rest stay in their places.
  const StemToModel stem = stemToModel(80, 0.4, axis);
  const auto priors = fitSurfacePriors({without_axis, stem, {{}, &axis, 0.0}, stem}, {});
  ASSERT_EQ(priors.size(), 4U);
  EXPECT_FALSE(priors[0]);
  EXPECT_FALSE(priors[2]);
  ASSERT_TRUE(priors[1] && priors[3]);
  EXPECT_EQ(priors[1]->meanRadius(), priors[3]->meanRadius());
  EXPECT_EQ(priors[1]->meanRadius(), SurfacePrior::fit(stem.points, axis, 0.05)->meanRadius());
  EXPECT_NEAR(priors[1]->meanRadius(), 0.011, 0.001);
  EXPECT_TRUE(fitSurfacePriors({}, {}).empty());
}

/// Centres of a wavy surface of which a stretch is not seen.
std::vector<SurfaceSample> wavyCenters(int count, double length) {
  std::mt19937 random(11U);
  std::uniform_real_distribution<double> uniform;
  std::vector<SurfaceSample> centers;
  for (int i = 0; i < count; ++i) {
    const double theta = 5.0 * uniform(random) - 2.5;
    const double s = length * (i % 5 == 0 ? uniform(random) : 0.4 * uniform(random));
    centers.push_back({{theta, s}, 0.001 * std::cos(2.0 * theta + 40.0 * s), 1.0 + i % 4});
  }
  return centers;
}

struct SolvedSurface {
  int band;
  std::vector<double> weights, coefficients;
};

/// @param run calls what it is given with the members of a team
template <class Run>
SolvedSurface solveBy(const RbfSystem& system, int members, const Run& run) {
  const RbfTask task = system.task();
  const std::size_t count = task.centers.count;
  SolvedSurface solved{0, std::vector<double>(count), std::vector<double>(count)};
  std::vector<int> scratch(static_cast<std::size_t>(members));
  std::vector<double> matrix(count * (system.mostBand() + 1U));
  std::vector<int> bands(static_cast<std::size_t>(members));
  run([&](const auto& team) {
    RbfSolver<std::decay_t<decltype(team)>> solver(team, task, solved.weights.data(),
                                                   solved.coefficients.data());
    bands[team.rank()] = solver.prepare(scratch.data());
    solver.solve(matrix.data(), bands[team.rank()]);
  });
  solved.band = bands.front();
  for (const int band : bands) EXPECT_EQ(band, solved.band);
  return solved;
}

TEST(RbfTeam, SurfaceIsThatOfOneThreadBitForBit) {
  struct Case {
    int centers;
    double length;  // [m]
    double kernel_scale;
    unsigned groups;
  };
  for (const Case& c : {Case{1, 0.2, 1.0, 1U}, Case{90, 0.24, 1.0, 2U}, Case{90, 0.6, 0.5, 3U},
                        Case{40, 0.24, 5.0, 2U}}) {
    constexpr double kRadius = 0.012;
    RbfOptions options;
    options.kernel_scale = c.kernel_scale;
    options.noise = 0.0004;
    const RbfSystem system(wavyCenters(c.centers, c.length), kRadius, options);
    const SolvedSurface alone = solveBy(system, 1, [](const auto& work) { work(SerialTeam()); });
    const SolvedSurface together =
        solveBy(system, static_cast<int>(c.groups * kLanes),
                [&](const auto& work) { runEmulatedTeam(c.groups, work); });
    EXPECT_EQ(together.band, alone.band) << c.centers;
    EXPECT_EQ(together.weights, alone.weights) << c.centers;
    EXPECT_EQ(together.coefficients, alone.coefficients) << c.centers;
    EXPECT_LE(alone.band, static_cast<int>(system.mostBand()));
    if (c.length > 0.5) {
      EXPECT_LT(alone.band, 60) << "of 90: far centres are left out";
    }
  }
}

TEST(RbfTeam, SolvesTheEquationsOfThePaper) {
  const RbfSystem system(wavyCenters(80, 0.4), 0.012, {1.0, 1e-3, 0.0004});
  const SolvedSurface solved = solveBy(system, 1, [](const auto& work) { work(SerialTeam()); });
  const RbfTask task = system.task();
  const auto count = static_cast<Eigen::Index>(task.centers.count);
  const Eigen::Map<const Eigen::VectorXd> w(solved.weights.data(), count);
  Eigen::MatrixXd dense(count, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    for (Eigen::Index j = 0; j < count; ++j) {
      const double d = (task.centers.points[i] - task.centers.points[j]).squaredNorm();
      const double mean = 0.5 * (w[i] + w[j]);
      dense(i, j) = w[i] * w[j] * std::pow(std::sqrt(w[i] * w[j]) / mean, 1.5) *
                    std::exp(-d / (system.kernelWidth() * system.kernelWidth() * mean));
    }
    dense(i, i) += 1e-3 + w[i] * w[i] * task.noise[i];
  }
  const Eigen::Map<const Eigen::VectorXd> values(task.values, count);
  const Eigen::VectorXd expected = w.cwiseProduct(dense.llt().solve(w.cwiseProduct(values)));
  const Eigen::Map<const Eigen::VectorXd> found(solved.coefficients.data(), count);
  EXPECT_LT((found - expected).cwiseAbs().maxCoeff(), 1e-12 * expected.cwiseAbs().maxCoeff());
  EXPECT_GT(w.maxCoeff(), 1.5 * w.minCoeff()) << "the density counts";
}

TEST(RbfTeam, CoincidentCentresRaiseTheRidgeTogether) {
  std::vector<SurfaceSample> centers(30, SurfaceSample{{0.3, 0.1}, 0.001, 1.0});
  const RbfSystem system(centers, 0.012, {1.0, 1e-17, 0.0});
  const SolvedSurface alone = solveBy(system, 1, [](const auto& work) { work(SerialTeam()); });
  const SolvedSurface together =
      solveBy(system, 8, [](const auto& work) { runEmulatedTeam(2U, work); });
  EXPECT_EQ(together.coefficients, alone.coefficients);
  EXPECT_GT(alone.coefficients.front(), 0.0);
}

TEST(RbfTeam, ManySurfacesAreReadAsOneIs) {
  std::vector<RbfToRead> surfaces;
  for (int i = 0; i < 5; ++i) {
    RbfSystem system(wavyCenters(30 * i, 0.2), 0.012, {});
    surfaces.push_back({std::move(system), {}});
    for (int k = 0; k < 3 * i; ++k) {
      surfaces.back().places.push_back(surfaces.back().system.index().embed({0.3 * k, 0.01 * k}));
    }
  }
  std::vector<const RbfToRead*> given;
  for (const RbfToRead& surface : surfaces) given.push_back(&surface);
  const std::vector<std::vector<double>> values = readSurfaces(given, {});
  ASSERT_EQ(values.size(), surfaces.size());
  for (std::size_t i = 0; i < surfaces.size(); ++i) {
    EXPECT_EQ(values[i], readSurface(surfaces[i])) << i;
    EXPECT_EQ(values[i].size(), surfaces[i].places.size());
    for (std::size_t k = 0; k < values[i].size(); ++k) EXPECT_NE(values[i][k], 0.0);
  }
  EXPECT_TRUE(readSurfaces({}, {}).empty());
}

FilterToSolve noisyStretch(int count, double radius, FilterAttribute attribute) {
  std::mt19937 random(17U);
  std::uniform_real_distribution<double> uniform;
  const auto share = [&] { return static_cast<float>(uniform(random)); };
  FilterToSolve given;
  given.grid = {0.0025, 20, std::max(3, static_cast<int>(6.3 * radius / 0.0025))};
  given.radius = radius;
  given.options.attribute = attribute;
  for (int i = 0; i < count; ++i) {
    FilterPoint point;
    point.position = {6.2 * uniform(random) - 3.1, 0.09 * uniform(random) - 0.02};
    point.deviation = 0.002 * uniform(random) - 0.001;
    point.weight = 1.0 + i % 3;
    point.color = {share(), share(), share()};
    point.is_read = i % 4 != 0;
    given.points.push_back(point);
  }
  return given;
}

TEST(FilterTeam, FilterIsThatOfOneThreadBitForBit) {
  for (const FilterAttribute attribute : {FilterAttribute::kNormal, FilterAttribute::kColor}) {
    for (const int count : {0, 3, 400}) {
      const FilterToSolve given = noisyStretch(count, 0.012, attribute);
      const std::vector<double> along{1.0, 0.7, 0.2};
      const std::vector<double> around{1.0, 0.6, 0.3, 0.1};
      const FilterTask task{given.points.data(),
                            count,
                            given.grid,
                            along.data(),
                            around.data(),
                            2,
                            3,
                            attribute == FilterAttribute::kColor,
                            12.5};
      const auto sums = static_cast<std::size_t>(task.sums());
      const auto nodes = static_cast<std::size_t>(given.grid.nodes());
      // What the memory holds before does not matter.
      const auto solveBy = [&](std::size_t groups, double rubbish, const auto& run) {
        std::vector<double> weight(sums, rubbish), value(sums, rubbish);
        std::vector<double> rows(groups * static_cast<std::size_t>(task.wideRow()), rubbish);
        std::vector<FilterColor> color(sums, FilterColor{3.0F, 4.0F, 5.0F});
        std::vector<unsigned char> is_read(sums, 7U);
        std::vector<FilterNode> solved(nodes, FilterNode{8.0F, 9.0F});
        std::vector<FilterColor> colors(nodes);
        run([&](const auto& team) {
          FilterSolver<std::decay_t<decltype(team)>>(
              team, task, {weight.data(), value.data(), color.data(), is_read.data(), rows.data()})
              .run(solved.data(), colors.data());
        });
        std::vector<float> numbers;
        for (std::size_t i = 0; i < nodes; ++i) {
          numbers.insert(numbers.end(), {solved[i].deviation, solved[i].weight, colors[i].r,
                                         colors[i].g, colors[i].b});
        }
        return numbers;
      };
      const auto alone = solveBy(1U, 1.0, [](const auto& work) { work(SerialTeam()); });
      for (const unsigned groups : {1U, 3U}) {
        EXPECT_EQ(alone,
                  solveBy(groups, -2.0, [&](const auto& work) { runEmulatedTeam(groups, work); }))
            << count << " points, " << groups << " groups";
      }
      EXPECT_EQ(count > 0, std::any_of(alone.begin(), alone.end(), [](float v) { return v != 0; }));
    }
  }
}

TEST(FilterTeam, ManyFiltersAreThoseAlone) {
  std::vector<FilterToSolve> given;
  for (int i = 0; i < 5; ++i) {
    given.push_back(noisyStretch(100 * i, 0.01 + 0.001 * i,
                                 i % 2 == 0 ? FilterAttribute::kNormal : FilterAttribute::kColor));
  }
  std::vector<const FilterToSolve*> all;
  for (const FilterToSolve& one : given) all.push_back(&one);
  const std::vector<BilateralFilter> filters = solveFilters(all, {});
  ASSERT_EQ(filters.size(), given.size());
  for (std::size_t i = 0; i < given.size(); ++i) {
    const BilateralFilter alone(given[i]);
    for (const FilterPoint& point : given[i].points) {
      EXPECT_EQ(filters[i].at(point.position, point.color), alone.at(point.position, point.color));
    }
  }
  EXPECT_TRUE(solveFilters({}, {}).empty());
}

/// A stretch of stem of which most or little was measured.
struct GapScene {
  std::vector<SurfacePosition> places;
  std::vector<double> radii;
  std::vector<unsigned char> fills;
  std::vector<GapOutline> outlines;
  GapTask task{};

  GapScene(int rows, int columns, int points, unsigned seed) {
    constexpr double kLength = 0.12;
    constexpr double kRadius = 0.01;
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform;
    for (int i = 0; i < points; ++i) {
      places.push_back({6.2 * uniform(random) - 3.1, (kLength + 0.02) * uniform(random) - 0.01});
    }
    for (int row = 0; row < rows; ++row) {
      radii.push_back(kRadius * (1.0 + 0.3 * uniform(random)));
      fills.push_back(row % 11 == 7 ? 0U : 1U);
    }
    for (int column = 0; column < columns; ++column) {
      outlines.push_back({0.9 + 0.2 * uniform(random), 0.5 + uniform(random)});
    }
    GapGrid grid;
    grid.begin = 0.0;
    grid.rows = rows;
    grid.columns = columns;
    grid.row_height = kLength / rows;
    grid.column_angle = 6.283185307179586 / columns;
    grid.is_odd = seed % 2U == 0U;
    task = {places.data(), points,       grid,         0.75 * grid.row_height, kRadius,
            1e5,           radii.data(), fills.data(), outlines.data()};
  }
};

struct FoundGaps {
  GapTotals totals;
  std::vector<Gap> gaps;
  std::vector<int> cells;
  std::vector<SurfacePosition> samples;
};

/// @param run calls what it is given with each member of a team
template <class Run>
FoundGaps gapsBy(unsigned members, const GapTask& task, const Run& run) {
  FoundGaps found;
  found.gaps.resize(static_cast<std::size_t>(task.mostRuns()));
  found.cells.resize(static_cast<std::size_t>(task.grid.cells()));
  std::vector<int> begins(static_cast<std::size_t>(task.grid.rows) + 1U);
  std::vector<GapRun> runs(found.gaps.size());
  std::vector<GapRows> rows(members);
  std::vector<unsigned char> missing(found.cells.size());
  run([&](const auto& team) {
    GapFinder(team, task, {begins.data(), runs.data(), rows.data(), missing.data()})
        .find(found.gaps.data(), found.cells.data(), &found.totals);
  });
  found.samples.resize(static_cast<std::size_t>(found.totals.samples));
  run([&](const auto& team) {
    spreadOverGaps(team, task.grid, found.gaps.data(), found.cells.data(), found.totals.samples,
                   found.samples.data());
  });
  return found;
}

/// Number of the gap that each cell is of, by flooding: 0 where it is not missing.
std::vector<int> floodedGaps(const GapTask& task) {
  const GapGrid& grid = task.grid;
  const auto indexOf = [&](int row, int column) {
    return static_cast<std::size_t>(row * grid.columns + (column + grid.columns) % grid.columns);
  };
  std::vector<int> gap(static_cast<std::size_t>(grid.cells()), 0);
  constexpr int kMissing = -1;
  for (int row = 0; row < grid.rows; ++row) {
    for (int column = 0; column < grid.columns; ++column) {
      const SurfacePosition center = grid.center(row, column);
      const bool is_near =
          std::any_of(task.places, task.places + task.count, [&](const SurfacePosition& place) {
            const double turn = std::remainder(place.theta - center.theta, 6.283185307179586);
            return std::hypot(task.mean_radius * turn, place.s - center.s) <= task.reach;
          });
      if (!is_near && task.fills[row] != 0U) gap[indexOf(row, column)] = kMissing;
    }
  }
  int gaps = 0;
  for (int seed = 0; seed < grid.cells(); ++seed) {
    if (gap[static_cast<std::size_t>(seed)] != kMissing) continue;
    gap[static_cast<std::size_t>(seed)] = ++gaps;
    std::vector<int> open{seed};
    while (!open.empty()) {
      const int row = open.back() / grid.columns;
      const int column = open.back() % grid.columns;
      open.pop_back();
      for (int r = std::max(row - 1, 0); r <= std::min(row + 1, grid.rows - 1); ++r) {
        for (int c = column - 1; c <= column + 1; ++c) {
          if (gap[indexOf(r, c)] != kMissing) continue;
          gap[indexOf(r, c)] = gaps;
          open.push_back(static_cast<int>(indexOf(r, c)));
        }
      }
    }
  }
  return gap;
}

TEST(GapTeam, FindsTheGapsThatFloodingDoesAndFillsThemWhateverTheTeam) {
  unsigned seed = 1U;
  int most_gaps = 0;
  for (const int rows : {1, 2, 30}) {
    for (const int columns : {3, 4, 25}) {
      for (const int points : {0, 1, rows * columns / 4, rows * columns, 6 * rows * columns}) {
        const GapScene scene(rows, columns, points, seed++);
        const FoundGaps alone =
            gapsBy(1U, scene.task, [](const auto& work) { work(SerialTeam()); });
        most_gaps = std::max(most_gaps, alone.totals.gaps);
        std::vector<int> of_cells(alone.cells.size(), 0);
        double area = 0.0;
        std::int64_t samples = 0;
        for (int k = 0; k < alone.totals.gaps; ++k) {
          const Gap& gap = alone.gaps[static_cast<std::size_t>(k)];
          EXPECT_EQ(gap.first_sample, samples);
          samples += gap.samples;
          EXPECT_EQ(gap.samples,
                    std::max(1L, std::lround(expectedPoints(gap, scene.task.density, 0.01))));
          area += gap.area;
          for (int i = gap.first_cell; i < gap.first_cell + gap.cells; ++i) {
            of_cells[static_cast<std::size_t>(alone.cells[static_cast<std::size_t>(i)])] = k + 1;
          }
        }
        EXPECT_EQ(samples, alone.totals.samples);
        EXPECT_EQ(of_cells, floodedGaps(scene.task)) << rows << " x " << columns << ", " << points;
        EXPECT_EQ(area > 0.0, alone.totals.gaps > 0);
        for (const SurfacePosition& sample : alone.samples) {
          const int row = static_cast<int>(sample.s / scene.task.grid.row_height);
          EXPECT_NE(scene.fills[static_cast<std::size_t>(row)], 0U);
        }
        for (const unsigned groups : {1U, 3U}) {
          const FoundGaps by_team = gapsBy(groups * kLanes, scene.task, [&](const auto& work) {
            runEmulatedTeam(groups, [&](const EmulatedTeam& team) { work(team); });
          });
          ASSERT_EQ(by_team.totals.gaps, alone.totals.gaps);
          EXPECT_EQ(by_team.totals.cells, alone.totals.cells);
          EXPECT_EQ(by_team.totals.samples, alone.totals.samples);
          EXPECT_EQ(by_team.totals.may_have_holes, alone.totals.may_have_holes);
          for (std::size_t k = 0; k < static_cast<std::size_t>(alone.totals.gaps); ++k) {
            EXPECT_EQ(by_team.gaps[k].area, alone.gaps[k].area);
            EXPECT_EQ(by_team.gaps[k].volume, alone.gaps[k].volume);
            EXPECT_EQ(by_team.gaps[k].curvature, alone.gaps[k].curvature);
            EXPECT_EQ(by_team.gaps[k].first_cell, alone.gaps[k].first_cell);
          }
          for (std::size_t i = 0; i < static_cast<std::size_t>(alone.totals.cells); ++i) {
            EXPECT_EQ(by_team.cells[i], alone.cells[i]);
          }
          for (std::size_t i = 0; i < alone.samples.size(); ++i) {
            EXPECT_EQ(by_team.samples[i].theta, alone.samples[i].theta);
            EXPECT_EQ(by_team.samples[i].s, alone.samples[i].s);
          }
        }
      }
    }
  }
  EXPECT_GT(most_gaps, 20) << "or nothing was joined and numbered";
}

}  // namespace
}  // namespace field_phenotyping
