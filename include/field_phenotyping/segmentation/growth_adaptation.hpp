#pragma once

#include "field_phenotyping/segmentation/region_growth.hpp"

namespace field_phenotyping {

/// How Q changes with the weights of Eq 2, by finite differences over a re-growth.
struct QualityGradient {
  float alpha = 0.0F;  ///< dQ / d alpha
  float beta = 0.0F;   ///< dQ / d beta
};

/// Settings for the next growth of a region that scored `quality` where `target` was wanted (paper
/// Eq 11-14). All are kept within ranges in which growth works: r1 within 0.5 ... 2 times that of
/// `first`, M within 0.1 ... 0.9, alpha and beta within 0 ... 1. Thread-safe.
GrowthSettings adaptSettings(const GrowthSettings& settings, const GrowthSettings& first,
                             float quality, float target, const QualityGradient& gradient);

}  // namespace field_phenotyping
