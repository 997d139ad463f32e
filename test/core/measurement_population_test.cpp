// What a block's stems say of each other, against populations whose mean and spread are known.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "field_phenotyping/measurement/stem_population.hpp"

namespace field_phenotyping {
namespace {

/// Fits of stems of one population, each with the error that it says, under `weak` priors.
std::vector<StemCrossSection> drawFits(int count, double error_scale, std::uint32_t seed,
                                       const CrossSectionPrior& weak) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0.5, 1.5);
  // The posterior of a measurement under its prior.
  const auto posterior = [&](double truth, double error, const Trait& prior) -> Trait {
    const double measured = truth + error * normal(engine);
    const double precision = 1.0 / (error * error) + 1.0 / (prior.stddev * prior.stddev);
    return {(measured / (error * error) + prior.value / (prior.stddev * prior.stddev)) / precision,
            1.0 / std::sqrt(precision)};
  };
  std::vector<StemCrossSection> fits(static_cast<std::size_t>(count));
  for (StemCrossSection& fit : fits) {
    const double scale = error_scale * uniform(engine);
    fit.valid = fit.converged = true;
    fit.taper = posterior(-0.25 + 0.05 * normal(engine), 0.15 * scale, weak.taper);
    fit.taper_change = posterior(-0.14, 0.3 * scale, weak.taper_change);
    fit.log_noise = {std::log(0.003) + 0.1 * scale * normal(engine), 0.1 * scale};
    const Trait c = posterior(0.04 * normal(engine), 0.03 * scale, {0.0, weak.ellipticity_stddev});
    const Trait s = posterior(0.04 * normal(engine), 0.03 * scale, {0.0, weak.ellipticity_stddev});
    fit.ellipticity << c.value, s.value;
    fit.ellipticity_stddev = c.stddev;
    fit.radius = {0.010 + 0.0008 * normal(engine) + 0.0004 * scale * normal(engine),
                  0.0004 * scale};
  }
  return fits;
}

TEST(Population, MeanAndSpreadAreFound) {
  const CrossSectionPrior weak;
  const CrossSectionPrior prior =
      populationPrior(drawFits(400, 1.0, 1U, weak), weak, PopulationPrior::kShapeAndSize);
  EXPECT_NEAR(prior.taper.value, -0.25, 0.02);
  EXPECT_NEAR(prior.taper.stddev, 0.05, 0.02);
  EXPECT_NEAR(prior.taper_change.value, -0.14, 0.04);
  EXPECT_LT(prior.taper_change.stddev, 0.08);
  EXPECT_NEAR(prior.log_noise.value, std::log(0.003), 0.02);
  EXPECT_LT(prior.log_noise.stddev, 0.07);
  EXPECT_NEAR(prior.ellipticity_stddev, 0.04, 0.005);
  EXPECT_NEAR(prior.radius.value, 0.010, 1e-4);
  EXPECT_NEAR(prior.radius.stddev, 0.0008, 1e-4);
}

TEST(Population, DiameterIsExpectedLooselyUnlessAskedFor) {
  const CrossSectionPrior weak;
  const CrossSectionPrior prior =
      populationPrior(drawFits(50, 1.0, 2U, weak), weak, PopulationPrior::kShape);
  EXPECT_NEAR(prior.radius.value, 0.010, 3e-4);
  EXPECT_NEAR(prior.radius.stddev, 0.2 * prior.radius.value, 1e-6);
  EXPECT_LT(prior.taper.stddev, weak.taper.stddev);
}

TEST(Population, WhatPriorsDecidedMayBeWrongAlike) {
  const CrossSectionPrior weak;
  std::vector<StemCrossSection> fits = drawFits(50, 1.0, 2U, weak);
  const CrossSectionPrior by_points = populationPrior(fits, weak, PopulationPrior::kShape);
  EXPECT_EQ(by_points.radius_alike_stddev, 0.0);
  for (StemCrossSection& fit : fits) fit.prior_share = 0.5;
  const CrossSectionPrior by_priors = populationPrior(fits, weak, PopulationPrior::kShape);
  EXPECT_NEAR(by_priors.radius_alike_stddev, 0.15 * by_priors.radius.value, 1e-9);
  EXPECT_EQ(by_priors.radius.stddev, by_points.radius.stddev);
}

TEST(Population, FewOrPoorFitsTeachNothing) {
  const CrossSectionPrior weak;
  std::vector<StemCrossSection> fits = drawFits(5, 1.0, 3U, weak);
  const auto same = [&](const CrossSectionPrior& prior) {
    return prior.taper.value == weak.taper.value && prior.taper.stddev == weak.taper.stddev &&
           prior.ellipticity_stddev == weak.ellipticity_stddev && std::isnan(prior.log_noise.value);
  };
  EXPECT_TRUE(same(populationPrior({}, weak, PopulationPrior::kShapeAndSize)));
  EXPECT_TRUE(same(populationPrior(fits, weak, PopulationPrior::kShapeAndSize)));
  fits = drawFits(50, 1.0, 3U, weak);
  for (StemCrossSection& fit : fits) fit.converged = false;
  EXPECT_TRUE(same(populationPrior(fits, weak, PopulationPrior::kShapeAndSize)));
  // Points that say nothing leave what was known before nearly as it was.
  const CrossSectionPrior vague =
      populationPrior(drawFits(50, 20.0, 4U, weak), weak, PopulationPrior::kShape);
  EXPECT_GT(vague.taper.stddev, 0.8 * weak.taper.stddev);
  EXPECT_GT(vague.ellipticity_stddev, 0.8 * weak.ellipticity_stddev);
  // So do stems of which only the prior is known, as where the noise hides their shape.
  for (StemCrossSection& fit : fits) {
    fit.converged = true;
    fit.ellipticity.setZero();
    fit.ellipticity_stddev = weak.ellipticity_stddev;
  }
  const CrossSectionPrior round = populationPrior(fits, weak, PopulationPrior::kShape);
  EXPECT_NEAR(round.ellipticity_stddev, weak.ellipticity_stddev, 0.02 * weak.ellipticity_stddev);
}

TEST(Population, KnownNoiseStaysKnown) {
  CrossSectionPrior weak;
  weak.noise = 0.004;
  weak.ellipticity_stddev = 0.0;
  const CrossSectionPrior prior =
      populationPrior(drawFits(50, 1.0, 5U, CrossSectionPrior()), weak, PopulationPrior::kShape);
  EXPECT_EQ(prior.noise, 0.004);
  EXPECT_TRUE(std::isnan(prior.log_noise.value));
  EXPECT_EQ(prior.ellipticity_stddev, 0.0);
}

}  // namespace
}  // namespace field_phenotyping
