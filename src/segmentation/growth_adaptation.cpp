#include "field_phenotyping/segmentation/growth_adaptation.hpp"

#include <algorithm>

namespace field_phenotyping {

GrowthSettings adaptSettings(const GrowthSettings& settings, const GrowthSettings& first,
                             float quality, float target, const QualityGradient& gradient) {
  constexpr float kLambdaR = 0.5F;      // lambda_r of Eq 11
  constexpr float kLambdaM = 0.5F;      // lambda_M of Eq 12
  constexpr float kEtaAlpha = 0.1F;     // of Eq 13
  constexpr float kEtaBeta = 0.1F;      // of Eq 14
  constexpr float kLeastRadius = 0.5F;  // of the first
  constexpr float kMostRadius = 2.0F;
  constexpr float kLeastM = 0.1F;
  constexpr float kMostM = 0.9F;
  const float missing = target - quality;
  GrowthSettings next = settings;
  next.r1 = std::clamp(settings.r1 * (1.0F + kLambdaR * missing), kLeastRadius * first.r1,
                       kMostRadius * first.r1);
  next.M = std::clamp(settings.M * (1.0F + kLambdaM * missing), kLeastM, kMostM);
  next.alpha = std::clamp(settings.alpha + kEtaAlpha * gradient.alpha, 0.0F, 1.0F);
  next.beta = std::clamp(settings.beta + kEtaBeta * gradient.beta, 0.0F, 1.0F);
  return next;
}

}  // namespace field_phenotyping
