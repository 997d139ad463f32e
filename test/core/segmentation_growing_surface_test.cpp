// The surface of a stem, completed while the stem grows (2.6.1).

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "field_phenotyping/segmentation/growing_surface.hpp"

namespace field_phenotyping {
namespace {

using Sightings = std::vector<SurfaceSighting>;

constexpr float kNoise = 0.2F;  // shares of the radius
constexpr float kTurn = 6.2832F;

/// Points all round a surface that is shifted towards x.
Sightings surfaceShiftedBy(float shift, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> azimuth(-0.5F * kTurn, 0.5F * kTurn);
  std::normal_distribution<float> noise(0.0F, kNoise);
  Sightings points;
  for (int k = 0; k < count; ++k) {
    const float theta = azimuth(random);
    points.push_back({theta, shift * std::cos(theta) + noise(random)});
  }
  return points;
}

/// Points anywhere in a disc.
Sightings anywhere(float reach, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  Sightings points;
  for (int k = 0; k < count; ++k) {
    points.push_back({kTurn * (unit(random) - 0.5F), reach * std::sqrt(unit(random)) - 1.0F});
  }
  return points;
}

TEST(GrowingSurface, TellsItsOwnFromWhatCrosses) {
  const GrowingSurface coarse(kNoise);
  EXPECT_EQ(coarse.evidence({}), 0.0F);
  for (unsigned seed = 1; seed <= 5U; ++seed) {
    EXPECT_GT(coarse.evidence(surfaceShiftedBy(0.0F, 40, seed)), 5.0F);
    EXPECT_LT(coarse.evidence(anywhere(1.5F, 40, seed)), -2.0F);
  }
}

TEST(GrowingSurface, ExpectsFurtherUpWhatJoinedBelow) {
  const Sightings shifted = surfaceShiftedBy(0.15F, 200, 6U);
  const Sightings next = surfaceShiftedBy(0.15F, 40, 7U);
  const Sightings other_way = surfaceShiftedBy(-0.15F, 40, 7U);
  const float before = GrowingSurface(kNoise).evidence(next);
  GrowingSurface surface(kNoise);
  surface.update(shifted);
  surface.advance(0.05F);
  EXPECT_GT(surface.evidence(next), before + 2.0F);
  EXPECT_LT(surface.evidence(other_way), surface.evidence(next) - 10.0F);
  surface.advance(3.0F);
  EXPECT_NEAR(surface.evidence(next), before, 0.05F) << "far above it is the coarse model again";
}

TEST(GrowingSurface, OnePointAtATimeOrAllAtOnce) {
  const Sightings points = surfaceShiftedBy(0.1F, 30, 8U);
  GrowingSurface at_once(0.5F);  // so vague that none is left out
  at_once.update(points);
  GrowingSurface in_turn(0.5F);
  for (const SurfaceSighting& point : points) in_turn.update({point});
  const Sightings next = surfaceShiftedBy(0.1F, 30, 9U);
  EXPECT_NEAR(at_once.evidence(next), in_turn.evidence(next), 1e-3F);
}

TEST(GrowingSurface, WhatLiesFarOffSaysNothing) {
  GrowingSurface surface(kNoise);
  const Sightings next = surfaceShiftedBy(0.0F, 40, 10U);
  const float before = surface.evidence(next);
  surface.update(Sightings(50U, {0.3F, 2.0F}));
  EXPECT_EQ(surface.evidence(next), before);
}

TEST(GrowingSurface, CarriesThickStemsFarther) {
  const float gap = GrowingSurface::longestCarried(0.008F);
  EXPECT_GT(gap, 0.3F);
  EXPECT_LT(gap, 0.5F);
  EXPECT_NEAR(GrowingSurface::longestCarried(0.016F) / gap, std::pow(2.0F, 2.0F / 3.0F), 1e-4F);
}

TEST(GrowingSurface, NoNoiseIsNoTrouble) {
  GrowingSurface surface(0.0F);
  surface.update({{0.0F, 0.0F}, {1.0F, 0.0F}, {1.0F, 0.0F}});
  EXPECT_TRUE(std::isfinite(surface.evidence({{0.5F, 0.0F}, {-2.0F, -1.0F}})));
}

}  // namespace
}  // namespace field_phenotyping
