#pragma once

#include "field_phenotyping/common/team.hpp"
#include "field_phenotyping/segmentation/growth_task.hpp"

namespace field_phenotyping {

/// How Q changes with the weights of Eq 2, by finite differences over a re-growth.
struct QualityGradient {
  float alpha = 0.0F;  ///< dQ / d alpha
  float beta = 0.0F;   ///< dQ / d beta
};

/// Settings for the next growth of a region that scored `quality` where `target` was wanted (paper
/// Eq 11-14). All are kept within ranges in which growth works: r1 within 0.5 ... 2 times that of
/// `first`, M within 0.1 ... 0.9, alpha and beta within 0 ... 1. Thread-safe; on the CPU and on the
/// GPU.
FIELD_PHENOTYPING_HD inline GrowthSettings adaptSettings(const GrowthSettings& settings,
                                                         const GrowthSettings& first, float quality,
                                                         float target,
                                                         const QualityGradient& gradient) {
  constexpr float kLambdaR = 0.5F;      // lambda_r of Eq 11
  constexpr float kLambdaM = 0.5F;      // lambda_M of Eq 12
  constexpr float kEtaAlpha = 0.1F;     // of Eq 13
  constexpr float kEtaBeta = 0.1F;      // of Eq 14
  constexpr float kLeastRadius = 0.5F;  // of the first
  constexpr float kMostRadius = growth::kMostWidened;
  constexpr float kLeastM = 0.1F;
  const float missing = target - quality;
  GrowthSettings next = settings;
  next.r1 = growth::within(settings.r1 * (1.0F + kLambdaR * missing), kLeastRadius * first.r1,
                           kMostRadius * first.r1);
  next.M = growth::within(settings.M * (1.0F + kLambdaM * missing), kLeastM, growth::kMostAdaptedM);
  next.alpha = growth::within(settings.alpha + kEtaAlpha * gradient.alpha, 0.0F, 1.0F);
  next.beta = growth::within(settings.beta + kEtaBeta * gradient.beta, 0.0F, 1.0F);
  return next;
}

}  // namespace field_phenotyping
