// The GPU beside the CPU: every step that was written for both gives the same. Skipped, and said
// so, where there is no GPU. What a device does when it cannot be had is tested everywhere.

#include <gtest/gtest.h>

#include <random>
#include <stdexcept>
#include <string>

#include "common/gpu_streams.hpp"
#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/bilateral_filter.hpp"
#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"
#include "field_phenotyping/measurement/plant_height.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"
#include "field_phenotyping/pipeline.hpp"
#include "field_phenotyping/preprocessing/ground_estimation.hpp"
#include "field_phenotyping/preprocessing/outlier_filter.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"
#include "field_phenotyping/segmentation/leaf_bases.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/stem_growth.hpp"
#include "test_scene.hpp"

namespace field_phenotyping {
namespace {

using Points = std::vector<Eigen::Vector3f>;

TEST(ComputeDevice, IsTheCpuWhenItIsAskedFor) {
  const ComputeDevice device = ComputeDevice::choose("cpu");
  EXPECT_FALSE(device.hasGpu());
  EXPECT_EQ(device.use().device, "cpu");
  EXPECT_EQ(device.use().why_cpu, "the CPU was asked for");
  bool called = false;
  EXPECT_FALSE(device.attempt([&](GpuStream&) { called = true; }));
  EXPECT_FALSE(called);
  EXPECT_EQ(device.use().fallbacks, 0U) << "nothing has failed";
}

TEST(ComputeDevice, KnowsNoOtherWishes) {
  EXPECT_THROW(ComputeDevice::choose("tpu"), std::invalid_argument);
  EXPECT_THROW(ComputeDevice::choose(""), std::invalid_argument);
}

TEST(ComputeDevice, IsTheGpuOrSaysWhyNot) {
  const ComputeDevice device = ComputeDevice::choose("auto");
  if (device.hasGpu()) {
    EXPECT_EQ(device.use().device.rfind("cuda: ", 0), 0U);
    EXPECT_EQ(device.use().why_cpu, "");
    EXPECT_TRUE(ComputeDevice::choose("cuda").hasGpu());
    return;
  }
  EXPECT_NE(device.use().why_cpu.find("no GPU"), std::string::npos) << device.use().why_cpu;
  try {
    ComputeDevice::choose("cuda");
    FAIL() << "there is no GPU";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find(device.use().why_cpu), std::string::npos);
  }
}

class Gpu : public ::testing::Test {
 protected:
  void SetUp() override {
    device_ = ComputeDevice::choose("auto");
    if (!device_.hasGpu()) GTEST_SKIP() << "NOT TESTED, " << device_.use().why_cpu;
  }
  void TearDown() override {
    if (!device_.hasGpu()) return;
    const DeviceUse use = device_.use();
    EXPECT_EQ(use.fallbacks, expected_fallbacks_) << use.last_failure;
    EXPECT_GT(use.gpu_steps, 0U) << "all was done by the CPU";
  }
  ComputeDevice device_;
  std::size_t expected_fallbacks_ = 0U;
};

TEST_F(Gpu, FailuresAreCountedAndTheWorkIsGivenBack) {
  EXPECT_FALSE(device_.attempt([](GpuStream&) { throw GpuError("no luck", false); }));
  EXPECT_EQ(device_.use().fallbacks, 1U);
  EXPECT_EQ(device_.use().last_failure, "no luck");
  EXPECT_THROW(device_.attempt([](GpuStream&) { throw std::out_of_range("not the GPU's"); }),
               std::out_of_range);
  // More at once, and one after the other, than there are streams.
  parallelFor(100U, [&](std::size_t) { EXPECT_TRUE(device_.attempt([](GpuStream&) {})); });
  expected_fallbacks_ = 1U;
}

Points plantsAndNoise(std::size_t count, unsigned seed, float size) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
  Points points;
  for (std::size_t i = 0; i < count; ++i) {
    const float a = uniform(random);
    const float b = uniform(random);
    const float c = uniform(random);
    const auto column = static_cast<float>(i % 40U);
    if (i % 4U == 0U) points.emplace_back(size * a, size * b, 0.05F * c);
    if (i % 4U == 1U) points.emplace_back(0.1F * column + 0.02F * a, 0.02F * b, 2.0F * c);
    if (i % 4U == 2U) points.emplace_back(0.1F * column + 0.4F * a, 0.05F * b, 0.3F + 0.5F * a);
    if (i % 4U == 3U) points.emplace_back(size * a, size * b, 2.0F * c);
  }
  return points;
}

bool sameBits(const LocalShape& a, const LocalShape& b) {
  return a.direction == b.direction && a.normal == b.normal && a.linearity == b.linearity &&
         a.curvature == b.curvature && a.neighbors == b.neighbors;
}

TEST_F(Gpu, LocalShapesAreTheSameBitForBit) {
  struct Case {
    std::size_t points;
    float size;
    float cell;
    float radius;
  };
  // The last ones have hundreds of points in a cell, and no table of cells.
  for (const Case& c : {Case{1U, 1.0F, 0.04F, 0.04F}, Case{7U, 1.0F, 0.04F, 0.04F},
                        Case{20000U, 4.0F, 0.04F, 0.04F}, Case{20000U, 4.0F, 0.02F, 0.05F},
                        Case{60000U, 1.0F, 0.1F, 0.1F}, Case{5000U, 60.0F, 0.01F, 0.05F}}) {
    const Points points = plantsAndNoise(c.points, 3U, c.size);
    const NeighborGrid grid(points, c.cell);
    const std::vector<LocalShape> on_cpu = computeLocalShapes(points, grid, c.radius);
    const std::vector<LocalShape> on_gpu = computeLocalShapes(points, grid, c.radius, device_);
    ASSERT_EQ(on_cpu.size(), on_gpu.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      ASSERT_TRUE(sameBits(on_cpu[i], on_gpu[i])) << i << " of " << c.points;
    }
  }
}

void expectSameVoxels(const VoxelTile& a, const VoxelTile& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) ASSERT_EQ(a.centroid(i), b.centroid(i)) << i;
}

TEST_F(Gpu, VoxelsAreTheSameAndGoOnToBe) {
  for (const std::size_t count : {1U, 2U, 1000U, 200000U}) {
    for (const float voxel_size : {0.003F, 0.05F, 10.0F}) {
      const Points points = plantsAndNoise(count, 12U, 2.0F);
      VoxelTile one_by_one;
      for (const Eigen::Vector3f& p : points) one_by_one.insert(p, voxel_size, false, 0U);
      VoxelTile on_gpu;
      on_gpu.insertAll(points, voxel_size, device_);
      expectSameVoxels(on_gpu, one_by_one);
      for (const Eigen::Vector3f& p : plantsAndNoise(500U, 13U, 2.0F)) {
        EXPECT_EQ(on_gpu.insert(p, voxel_size, false, 0U),
                  one_by_one.insert(p, voxel_size, false, 0U));
      }
      expectSameVoxels(on_gpu, one_by_one);
    }
  }
}

TEST_F(Gpu, OutliersAreTheSame) {
  for (const std::size_t count : {1U, 5U, 800U, 30000U}) {
    for (const float size : {1.0F, 6.0F, 40.0F}) {  // the last makes the radius double
      PointCloud cloud;
      cloud.points = plantsAndNoise(count, 5U, size);
      EXPECT_EQ(radiusOutlierFilter(cloud, 0.05F, 2), radiusOutlierFilter(cloud, 0.05F, 2, device_))
          << count << " points on " << size << " m";
    }
  }
}

TEST_F(Gpu, SoilIsTheSame) {
  PointCloud cloud;
  cloud.points = plantsAndNoise(40000U, 6U, 5.0F);
  for (Eigen::Vector3f& p : cloud.points) p.z() += 0.1F * p.x();
  const PreprocessingParameters parameters;
  const GroundModel on_cpu = estimateGround(cloud, parameters);
  const GroundModel on_gpu = estimateGround(cloud, parameters, device_);
  for (const Eigen::Vector3f& p : cloud.points) {
    ASSERT_EQ(on_cpu.heightAbove(p), on_gpu.heightAbove(p));
  }
}

/// Points of a stem from a part of its circumference, some of a leaf.
StemPiece stemPiece(std::size_t points, double noise, double arc, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  StemPiece piece;
  for (std::size_t i = 0; i < points; ++i) {
    const double angle = arc * uniform(random);
    const double height = 0.3 * (uniform(random) - 0.5);
    const double distance = (i % 15U == 0U ? 0.025 : 0.011) * (1.0 - 0.15 * height);
    piece.points.emplace_back(1.08 * distance * std::cos(angle) + noise * normal(random),
                              0.92 * distance * std::sin(angle) + noise * normal(random), height);
  }
  return piece;
}

bool sameBits(const StemCrossSection& a, const StemCrossSection& b) {
  const auto same = [](const Trait& x, const Trait& y) {
    return x.value == y.value && x.stddev == y.stddev;
  };
  return a.converged == b.converged && a.center == b.center && a.tilt == b.tilt &&
         a.ellipticity == b.ellipticity && same(a.major, b.major) && same(a.minor, b.minor) &&
         same(a.taper, b.taper) && same(a.log_noise, b.log_noise) && a.points == b.points &&
         a.arc_coverage == b.arc_coverage && a.outlier_share == b.outlier_share;
}

TEST_F(Gpu, CrossSectionsAreTheSameBitForBit) {
  std::vector<StemPiece> pieces;
  for (unsigned seed = 0U; seed < 40U; ++seed) {
    pieces.push_back(
        stemPiece(6U + 37U * seed, 0.001 + 0.0001 * seed, seed % 3U ? 6.3 : 3.0, seed));
  }
  pieces.push_back(stemPiece(300U, 0.0002, 6.3, 50U));  // bins that shared memory is too small for
  pieces.push_back(stemPiece(300U, 0.01, 6.3, 51U));    // no shape to be seen
  pieces.back().prior.noise = 0.01;
  pieces.push_back(stemPiece(4U, 0.002, 6.3, 52U));  // too few
  std::size_t valid = 0U;
  for (int round = 0; round < 2; ++round) {
    const std::vector<StemCrossSection> on_cpu = fitStemCrossSections(pieces, {});
    for (int run = 0; run < 2; ++run) {
      const std::vector<StemCrossSection> on_gpu = fitStemCrossSections(pieces, device_);
      ASSERT_EQ(on_gpu.size(), pieces.size());
      for (std::size_t i = 0; i < pieces.size(); ++i) {
        ASSERT_EQ(on_cpu[i].valid, on_gpu[i].valid) << i;
        if (!on_cpu[i].valid) continue;
        ++valid;
        EXPECT_TRUE(sameBits(on_cpu[i], on_gpu[i]))
            << i << ": " << on_cpu[i].major.value << " m on the CPU, " << on_gpu[i].major.value
            << " m on the GPU";
      }
    }
    for (std::size_t i = 0; i < pieces.size(); ++i) pieces[i].near = on_cpu[i];  // and from there
  }
  EXPECT_GT(valid, 3U * pieces.size()) << "of four times as many";
}

/// Points of a leaning stem of which a part of the circumference is seen, some of a leaf.
StemToModel stemToModel(std::size_t points, double noise, double arc, const StemAxis& axis,
                        unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  StemToModel stem{{}, &axis, 0.15};
  for (std::size_t i = 0; i < points; ++i) {
    const double z = 1.2 * uniform(random);
    const double angle = arc * uniform(random);
    const double r = (i % 13U == 0U ? 0.03 : 0.012) - 0.003 * z + noise * normal(random);
    stem.points.emplace_back(0.03 * z * z + 1.05 * r * std::cos(angle), r * std::sin(angle), z);
  }
  return stem;
}

TEST_F(Gpu, SurfacePriorsAreTheSameBitForBit) {
  const StemAxis axis({{{0.002F, 0.0F, 0.0F}, 0.013F}, {{0.03F, 0.002F, 1.2F}, 0.009F}});
  const StemAxis thick({{{0.0F, 0.0F, 0.0F}, 0.5F}, {{0.0F, 0.0F, 1.2F}, 0.5F}});
  std::vector<StemToModel> stems;
  for (unsigned seed = 0U; seed < 140U; ++seed) {  // more than are worked on at once
    stems.push_back(
        stemToModel(4U + 15U * seed, 0.0005 + 0.00001 * seed, seed % 3U ? 6.3 : 3.0, axis, seed));
  }
  stems.push_back(stemToModel(0U, 0.001, 6.3, axis, 71U));
  stems.push_back(stemToModel(200U, 0.001, 6.3, thick, 72U));  // not a stem of that size
  const auto on_cpu = fitSurfacePriors(stems, {});
  std::size_t valid = 0U;
  for (int run = 0; run < 2; ++run) {
    const auto on_gpu = fitSurfacePriors(stems, device_);
    ASSERT_EQ(on_gpu.size(), stems.size());
    for (std::size_t i = 0; i < stems.size(); ++i) {
      ASSERT_EQ(on_cpu[i].has_value(), on_gpu[i].has_value()) << i;
      if (!on_cpu[i]) continue;
      ++valid;
      const SurfacePrior& a = *on_cpu[i];
      const SurfacePrior& b = *on_gpu[i];
      EXPECT_EQ(a.noise(), b.noise()) << i;
      EXPECT_EQ(a.meanRadius(), b.meanRadius()) << i;
      EXPECT_EQ(a.ellipse(), b.ellipse()) << i;
      EXPECT_EQ(a.begin(), b.begin()) << i;
      ASSERT_EQ(a.frame().nodes().size(), b.frame().nodes().size()) << i;
      for (double s = 0.0; s < a.frame().length(); s += 0.05) {
        EXPECT_EQ(a.frame().at(s).position, b.frame().at(s).position) << i;
        EXPECT_EQ(a.radius(8.0 * s, s), b.radius(8.0 * s, s)) << i;
        EXPECT_EQ(a.variance(8.0 * s, s), b.variance(8.0 * s, s)) << i;
        EXPECT_EQ(a.misfitVariance(8.0 * s, s), b.misfitVariance(8.0 * s, s)) << i;
      }
    }
  }
  EXPECT_GT(valid, stems.size()) << "of twice as many";
  EXPECT_EQ(device_.use().gpu_steps, 4U) << "two times two batches";
}

TEST_F(Gpu, SurfacesAreTheSameBitForBit) {
  std::vector<RbfToRead> surfaces;
  std::mt19937 random(41U);
  std::uniform_real_distribution<double> uniform;
  for (int i = 0; i < 700; ++i) {  // more than are worked on at once
    // Some are too wide for shared memory, and one has nothing in it.
    const int count = i % 50 == 7 ? 500 : i % 150;
    const double radius = count == 500 ? 0.05 : 0.012;
    std::vector<SurfaceSample> centers;
    for (int k = 0; k < count; ++k) {
      const double theta = (i % 2 == 0 ? 3.0 : 6.3) * uniform(random);
      centers.push_back(
          {{theta, 0.24 * uniform(random)}, 0.002 * uniform(random) - 0.001, 1.0 + k % 3});
    }
    surfaces.push_back({RbfSystem(centers, radius, {i % 3 == 0 ? 3.0 : 1.0, 1e-3, 0.0005}), {}});
    for (int k = 0; k < i % 200; ++k) {
      surfaces.back().places.push_back(
          surfaces.back().system.index().embed({6.3 * uniform(random), 0.24 * uniform(random)}));
    }
  }
  std::vector<const RbfToRead*> given;
  for (const RbfToRead& surface : surfaces) given.push_back(&surface);
  const std::vector<std::vector<double>> on_cpu = readSurfaces(given, {});
  for (int run = 0; run < 2; ++run) EXPECT_EQ(on_cpu, readSurfaces(given, device_));
  EXPECT_GE(device_.use().gpu_steps, 4U);
  EXPECT_TRUE(readSurfaces({}, device_).empty());
}

TEST_F(Gpu, PointsInGapsAreTheSameBitForBit) {
  std::mt19937 random(47U);
  std::uniform_real_distribution<double> uniform;
  std::vector<GapsToFill> given(600U);  // more than are worked on at once
  for (std::size_t i = 0; i < given.size(); ++i) {
    GapsToFill& one = given[i];
    // Some have too many cells for shared memory, and some are not to be filled.
    one.density = i % 100U == 3U   ? 4e6
                  : i % 100U == 4U ? 0.0
                                   : 1e4 * static_cast<double>(1U + i % 20U);
    one.range = {0.12 * static_cast<double>(i), 0.12 * static_cast<double>(i + 1U), {}};
    if (i % 7U == 0U) one.range.open = {{one.range.begin + 0.03, one.range.begin + 0.05}};
    one.shape.radius = [](double s) { return 0.012 - 1e-5 * s; };
    one.shape.ellipse = {0.05, -0.02};
    one.mean_radius = 0.011;
    one.first_row = static_cast<long>(i);
    for (std::size_t k = 0; k < 2U * i; ++k) {
      one.measured.push_back(
          {6.2 * uniform(random) - 3.1, one.range.begin + 0.12 * uniform(random)});
    }
  }
  std::vector<const GapsToFill*> all;
  for (const GapsToFill& one : given) all.push_back(&one);
  const std::vector<GapSamples> on_cpu = sampleGaps(all, {});
  std::size_t points = 0U;
  for (int run = 0; run < 2; ++run) {
    const std::vector<GapSamples> on_gpu = sampleGaps(all, device_);
    ASSERT_EQ(on_gpu.size(), given.size());
    for (std::size_t i = 0; i < given.size(); ++i) {
      EXPECT_EQ(on_cpu[i].may_have_holes, on_gpu[i].may_have_holes) << i;
      ASSERT_EQ(on_cpu[i].places.size(), on_gpu[i].places.size()) << i;
      points += on_cpu[i].places.size();
      for (std::size_t k = 0; k < on_cpu[i].places.size(); ++k) {
        ASSERT_EQ(on_cpu[i].places[k].theta, on_gpu[i].places[k].theta) << i;
        ASSERT_EQ(on_cpu[i].places[k].s, on_gpu[i].places[k].s) << i;
      }
    }
  }
  EXPECT_GT(points, 1000U * given.size());
  EXPECT_EQ(device_.use().gpu_steps, 4U) << "two times two batches";
  EXPECT_TRUE(sampleGaps({}, device_).empty());
}

TEST_F(Gpu, FiltersAreTheSameBitForBit) {
  std::mt19937 random(43U);
  std::uniform_real_distribution<double> uniform;
  const auto share = [&] { return static_cast<float>(uniform(random)); };
  std::vector<FilterToSolve> given;
  for (int i = 0; i < 600; ++i) {  // more than are worked on at once
    FilterToSolve one;
    // The last is too wide for all rows at once to fit into shared memory.
    one.radius = i == 599 ? 0.3 : i % 100 == 3 ? 0.06 : 0.012;
    one.grid = {0.0025, 48, static_cast<int>(6.3 * one.radius / 0.0025)};
    one.options.attribute = i % 4 == 0 ? FilterAttribute::kColor : FilterAttribute::kNormal;
    for (int k = 0; k < 2 * i; ++k) {
      FilterPoint point;
      point.position = {6.2 * uniform(random) - 3.1, 0.16 * uniform(random) - 0.02};
      point.deviation = 0.002 * uniform(random) - 0.001;
      point.color = {share(), share(), share()};
      point.is_read = k % 5 != 0;
      one.points.push_back(point);
    }
    given.push_back(one);
  }
  std::vector<const FilterToSolve*> all;
  for (const FilterToSolve& one : given) all.push_back(&one);
  const std::vector<BilateralFilter> on_cpu = solveFilters(all, {});
  for (int run = 0; run < 2; ++run) {
    const std::vector<BilateralFilter> on_gpu = solveFilters(all, device_);
    for (std::size_t i = 0; i < given.size(); ++i) {
      for (const FilterPoint& p : given[i].points) {
        ASSERT_EQ(on_cpu[i].at(p.position, p.color), on_gpu[i].at(p.position, p.color)) << i;
      }
    }
  }
  EXPECT_EQ(device_.use().gpu_steps, 4U) << "two times two batches";
  // Blocks in flight have filters of other widths.
  parallelFor(64U, [&](std::size_t i) { solveFilters({all[i % 4U]}, device_); });
  EXPECT_TRUE(solveFilters({}, device_).empty());
}

TEST_F(Gpu, LeafBasesAreTheSameBitForBit) {
  Points points;
  std::vector<Midline> midlines;
  std::vector<std::vector<std::uint32_t>> members;
  std::mt19937 random(31U);
  std::uniform_real_distribution<float> uniform;
  std::normal_distribution<float> noise(0.0F, 0.002F);
  for (unsigned s = 0U; s < 40U; ++s) {
    const float x = 0.2F * static_cast<float>(s);
    members.emplace_back();
    for (unsigned i = 0U; i < 60U * s; ++i) {
      const float up = 1.2F * uniform(random);
      const float above = std::fmod(up, 0.2F);  // a leaf every 20 cm
      const bool is_leaf = i % 2U == 0U && above < 0.06F;
      const float side =
          is_leaf ? std::floor(up / 0.2F) * 3.1F + 0.6F * uniform(random) : 6.3F * uniform(random);
      const float r = 0.011F + (is_leaf ? 0.4F * above : 0.0F) + noise(random);
      members.back().push_back(static_cast<std::uint32_t>(points.size()));
      points.emplace_back(x + r * std::cos(side), r * std::sin(side), up);
    }
    Midline midline;
    midline.axis = StemAxis({{{x, 0.0F, 0.0F}, 0.012F}, {{x, 0.0F, 1.2F}, 0.010F}});
    midline.spread = 0.002F;
    midlines.push_back(midline);
  }
  std::vector<const Midline*> of_stems;
  for (const Midline& midline : midlines) of_stems.push_back(&midline);
  const std::vector<LeafBases> on_cpu = findLeafBases(points, members, of_stems, {});
  std::size_t bases = 0U;
  for (int run = 0; run < 2; ++run) {
    const std::vector<LeafBases> on_gpu = findLeafBases(points, members, of_stems, device_);
    ASSERT_EQ(on_gpu.size(), on_cpu.size());
    for (std::size_t s = 0; s < on_cpu.size(); ++s) {
      const std::vector<LeafBase>& a = on_cpu[s].all();
      const std::vector<LeafBase>& b = on_gpu[s].all();
      ASSERT_EQ(a.size(), b.size()) << s;
      bases += a.size();
      for (std::size_t k = 0; k < a.size(); ++k) {
        EXPECT_EQ(a[k].arc_length, b[k].arc_length) << s;
        EXPECT_EQ(a[k].azimuth, b[k].azimuth) << s;
        EXPECT_EQ(a[k].slope, b[k].slope) << s;
        EXPECT_EQ(a[k].evidence, b[k].evidence) << s;
        EXPECT_EQ(a[k].sight, b[k].sight) << s;
      }
    }
  }
  EXPECT_GT(bases, 200U);
  EXPECT_TRUE(findLeafBases(points, {}, {}, device_).empty());
}

/// A row of stems among leaves, some with a gap, of few points to many.
struct RowOfStems {
  Points points;
  std::vector<Midline> midlines;

  explicit RowOfStems(unsigned stems) {
    std::mt19937 random(37U);
    std::uniform_real_distribution<float> uniform;
    std::normal_distribution<float> noise(0.0F, 0.002F);
    for (unsigned s = 0U; s < stems; ++s) {
      const float x = 0.2F * static_cast<float>(s);
      for (unsigned i = 0U; i < 130U * s; ++i) {  // the last do not fit into shared memory
        const float up = 1.2F * uniform(random);
        if (s % 3U == 1U && up > 0.5F && up < 0.7F) continue;
        const bool is_leaf = i % 3U == 0U;
        const float above = std::fmod(up, 0.2F);  // a leaf every 20 cm
        const float side = is_leaf ? std::floor(up / 0.2F) * 3.1F + 0.6F * uniform(random)
                                   : 6.3F * uniform(random);
        const float r = 0.011F + (is_leaf ? 0.4F * above : 0.0F) + noise(random);
        points.emplace_back(x + 0.03F * up * up + r * std::cos(side), r * std::sin(side), up);
      }
      Midline midline;
      midline.axis = StemAxis({{{x, 0.0F, 0.0F}, 0.012F},
                               {{x + 0.0108F, 0.0F, 0.6F}, 0.011F},
                               {{x + 0.0432F, 0.0F, 1.2F}, 0.010F}});
      midline.spread = 0.002F;
      midlines.push_back(midline);
    }
  }
};

TEST_F(Gpu, GrownStemsAreTheSameBitForBit) {
  const RowOfStems row(40U);
  const NeighborGrid grid(row.points, 0.04F);
  const std::vector<LocalShape> shapes = computeLocalShapes(row.points, grid, 0.04F);
  const GrowthScene scene{row.points, shapes, grid};
  std::vector<const Midline*> midlines;
  for (const Midline& midline : row.midlines) midlines.push_back(&midline);
  SegmentationParameters parameters;
  std::size_t cycles = 0U;
  for (const double target : {0.7, 1.0}) {  // the other is never reached
    parameters.quality_target = target;
    const std::vector<GrownStem> on_cpu = growStems(scene, midlines, 0.3F, parameters);
    for (int run = 0; run < 2; ++run) {
      const std::vector<GrownStem> on_gpu = growStems(scene, midlines, 0.3F, parameters, device_);
      ASSERT_EQ(on_gpu.size(), on_cpu.size());
      for (std::size_t s = 0; s < on_cpu.size(); ++s) {
        const GrowthSummary& a = on_cpu[s].growth;
        const GrowthSummary& b = on_gpu[s].growth;
        EXPECT_EQ(on_cpu[s].points, on_gpu[s].points) << s;
        EXPECT_EQ(a.quality, b.quality) << s;
        EXPECT_EQ(a.iterations, b.iterations) << s;
        EXPECT_EQ(a.r1, b.r1) << s;
        EXPECT_EQ(a.M, b.M) << s;
        EXPECT_EQ(a.alpha, b.alpha) << s;
        EXPECT_EQ(a.beta, b.beta) << s;
        ASSERT_EQ(a.regions.size(), b.regions.size()) << s;
        for (std::size_t r = 0; r < a.regions.size(); ++r) {
          EXPECT_EQ(a.regions[r].points, b.regions[r].points) << s;
          EXPECT_EQ(a.regions[r].merged, b.regions[r].merged) << s;
          EXPECT_EQ(a.regions[r].M, b.regions[r].M) << s;
        }
        cycles += b.iterations;
      }
    }
  }
  EXPECT_GT(cycles, 200U) << "of 40 stems, two times once and two times up to four times";
  EXPECT_EQ(device_.use().gpu_steps, 20U)
      << "four times two batches of leaf bases, three of growth";
  EXPECT_TRUE(growStems(scene, {}, 0.3F, parameters, device_).empty());
}

TEST_F(Gpu, HeightsAreTheSameBitForBit) {
  SegmentedBlock block;
  block.cloud.points = plantsAndNoise(60000U, 23U, 4.0F);
  std::uint32_t begin = 0U;
  for (std::uint32_t size = 0U; begin + size <= block.cloud.size();
       size = size < 8U ? size + 1U : 2U * size) {
    Plant plant;
    plant.points = {begin, begin + size};
    block.plants.push_back(plant);
    begin += size;
  }
  const std::vector<PlantHeight> on_cpu =
      measurePlantHeights(block, {}, 0.003);  // no soil: both ends
  for (int run = 0; run < 2; ++run) {
    const std::vector<PlantHeight> on_gpu = measurePlantHeights(block, {}, 0.003, device_);
    ASSERT_EQ(on_gpu.size(), on_cpu.size());
    for (std::size_t i = 1; i < on_cpu.size(); ++i) {  // the first has no points
      EXPECT_EQ(on_gpu[i].height.value, on_cpu[i].height.value) << i;
      EXPECT_EQ(on_gpu[i].height.stddev, on_cpu[i].height.stddev) << i;
    }
  }
  EXPECT_EQ(device_.use().gpu_steps, 4U) << "two times two ends";
  EXPECT_TRUE(measurePlantHeights({}, {}, 0.003, device_).empty());
}

TEST_F(Gpu, TheWholePipelineIsTheSame) {
  testing::Scene scene(testing::slopingSoil(3.0, 20.0), 1U);
  scene.addSoil({0.0, 0.0}, {6.0, 2.0}, 2500.0);
  for (int k = 0; k < 20; ++k) {
    testing::PlantTruth plant;
    plant.base = {0.5 + 0.25 * k, 0.7 + 0.4 * (k % 2)};
    scene.addPlant(plant);
  }
  const PointCloud& cloud = scene.cloud;
  Parameters parameters;
  parameters.preprocessing.block_size = 2.0;  // several blocks in flight
  const PipelineResult on_cpu = phenotypeCloud(cloud, parameters);
  ASSERT_EQ(on_cpu.plants.size(), 20U);
  for (int run = 0; run < 2; ++run) {
    const PipelineResult on_gpu = phenotypeCloud(cloud, parameters, {}, device_);
    ASSERT_EQ(on_gpu.plants.size(), on_cpu.plants.size());
    for (std::size_t k = 0; k < on_cpu.plants.size(); ++k) {
      EXPECT_EQ(on_gpu.plants[k].height.value, on_cpu.plants[k].height.value);
      EXPECT_EQ(on_gpu.plants[k].stem_diameter.value, on_cpu.plants[k].stem_diameter.value);
      EXPECT_EQ(on_gpu.plants[k].base, on_cpu.plants[k].base);
    }
    ASSERT_EQ(on_gpu.blocks.size(), on_cpu.blocks.size());
    for (std::size_t b = 0; b < on_cpu.blocks.size(); ++b) {
      EXPECT_EQ(on_gpu.blocks[b]->synthetic.points, on_cpu.blocks[b]->synthetic.points);
      EXPECT_EQ(on_gpu.blocks[b]->synthetic_stddev, on_cpu.blocks[b]->synthetic_stddev);
    }
    std::size_t different = 0U;
    for (std::size_t i = 0; i < on_cpu.labels.size(); ++i) {
      different += on_cpu.labels[i].plant_id != on_gpu.labels[i].plant_id ||
                           on_cpu.labels[i].part != on_gpu.labels[i].part
                       ? 1U
                       : 0U;
    }
    EXPECT_EQ(different, 0U);
    EXPECT_GT(on_gpu.times[0].use.gpu_steps, 0U);
    EXPECT_GT(on_gpu.times[1].use.gpu_steps, 0U);
    EXPECT_GT(on_gpu.times[2].use.gpu_steps, 0U);
    EXPECT_GT(on_gpu.times[3].use.gpu_steps, 0U);
  }
  device_.attempt([](GpuStream&) {});  // the pipeline counts for itself
}

}  // namespace
}  // namespace field_phenotyping
