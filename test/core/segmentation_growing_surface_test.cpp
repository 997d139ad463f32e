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

SurfaceSighting sighting(float azimuth, float departure) {
  return {std::cos(azimuth), std::sin(azimuth), departure};
}

SurfaceEvidence sumUp(const GrowingSurface& surface, const Sightings& points) {
  SurfaceEvidence all{};
  for (const SurfaceSighting& point : points) {
    const GrowingSurface::Residual residual = surface.compare(point);
    all.sums[SurfaceEvidence::kSums - 1] += residual.evidence;
    if (!residual.counts) continue;
    for (int a = 0; a < GrowingSurface::kTerms; ++a) {
      for (int b = 0; b <= a; ++b) all.sums[pairOf(a, b)] += residual.terms[a] * residual.terms[b];
      all.sums[SurfaceEvidence::kPairs + a] += residual.off * residual.terms[a];
    }
  }
  return all;
}

float evidenceOf(const GrowingSurface& surface, const Sightings& points) {
  return static_cast<float>(sumUp(surface, points).evidence());
}

void update(GrowingSurface& surface, const Sightings& points) {
  surface.update(sumUp(surface, points));
}

/// Points all round a surface that is shifted towards x.
Sightings surfaceShiftedBy(float shift, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> azimuth(-0.5F * kTurn, 0.5F * kTurn);
  std::normal_distribution<float> noise(0.0F, kNoise);
  Sightings points;
  for (int k = 0; k < count; ++k) {
    const float theta = azimuth(random);
    points.push_back(sighting(theta, shift * std::cos(theta) + noise(random)));
  }
  return points;
}

/// Points anywhere in a disc.
Sightings anywhere(float reach, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  Sightings points;
  for (int k = 0; k < count; ++k) {
    const float azimuth = kTurn * (unit(random) - 0.5F);
    points.push_back(sighting(azimuth, reach * std::sqrt(unit(random)) - 1.0F));
  }
  return points;
}

TEST(GrowingSurface, TellsItsOwnFromWhatCrosses) {
  const GrowingSurface coarse(kNoise);
  EXPECT_EQ(evidenceOf(coarse, {}), 0.0F);
  for (unsigned seed = 1; seed <= 5U; ++seed) {
    EXPECT_GT(evidenceOf(coarse, surfaceShiftedBy(0.0F, 40, seed)), 5.0F);
    EXPECT_LT(evidenceOf(coarse, anywhere(1.5F, 40, seed)), -2.0F);
  }
}

TEST(GrowingSurface, ExpectsFurtherUpWhatJoinedBelow) {
  const Sightings shifted = surfaceShiftedBy(0.15F, 200, 6U);
  const Sightings next = surfaceShiftedBy(0.15F, 40, 7U);
  const Sightings other_way = surfaceShiftedBy(-0.15F, 40, 7U);
  const float before = evidenceOf(GrowingSurface(kNoise), next);
  GrowingSurface surface(kNoise);
  update(surface, shifted);
  surface.advance(0.05F);
  EXPECT_GT(evidenceOf(surface, next), before + 2.0F);
  EXPECT_LT(evidenceOf(surface, other_way), evidenceOf(surface, next) - 10.0F);
  surface.advance(3.0F);
  EXPECT_NEAR(evidenceOf(surface, next), before, 0.05F) << "far above it is the coarse model again";
}

TEST(GrowingSurface, OnePointAtATimeOrAllAtOnce) {
  const Sightings points = surfaceShiftedBy(0.1F, 30, 8U);
  GrowingSurface at_once(0.5F);  // so vague that none is left out
  update(at_once, points);
  GrowingSurface in_turn(0.5F);
  for (const SurfaceSighting& point : points) update(in_turn, {point});
  const Sightings next = surfaceShiftedBy(0.1F, 30, 9U);
  EXPECT_NEAR(evidenceOf(at_once, next), evidenceOf(in_turn, next), 1e-3F);
}

TEST(GrowingSurface, WhatLiesFarOffSaysNothing) {
  GrowingSurface surface(kNoise);
  const Sightings next = surfaceShiftedBy(0.0F, 40, 10U);
  const float before = evidenceOf(surface, next);
  update(surface, Sightings(50U, sighting(0.3F, 2.0F)));
  EXPECT_EQ(evidenceOf(surface, next), before);
}

TEST(GrowingSurface, CarriesThickStemsFarther) {
  const float gap = GrowingSurface::longestCarried(0.008F);
  EXPECT_GT(gap, 0.3F);
  EXPECT_LT(gap, 0.5F);
  EXPECT_NEAR(GrowingSurface::longestCarried(0.016F) / gap, std::pow(2.0F, 2.0F / 3.0F), 1e-4F);
}

TEST(GrowingSurface, NoNoiseIsNoTrouble) {
  GrowingSurface surface(0.0F);
  update(surface, {sighting(0.0F, 0.0F), sighting(1.0F, 0.0F), sighting(1.0F, 0.0F)});
  EXPECT_TRUE(std::isfinite(evidenceOf(surface, {sighting(0.5F, 0.0F), sighting(-2.0F, -1.0F)})));
}

}  // namespace
}  // namespace field_phenotyping
