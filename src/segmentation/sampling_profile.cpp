#include "field_phenotyping/segmentation/sampling_profile.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace field_phenotyping {
namespace {

constexpr double kBand = 0.10;  // [m]

}  // namespace

SamplingProfile::SamplingProfile(const std::vector<float>& heights,
                                 const std::vector<LocalShape>& shapes) {
  constexpr float kSoil = 0.05F;        // [m]
  constexpr float kHighest = 10.0F;     // [m] of a crop
  constexpr double kLeastPoints = 10U;  // of a band that tells
  constexpr double kLeast = 0.02;
  std::vector<double> points;
  std::vector<double> neighbors;
  for (std::size_t i = 0; i < heights.size(); ++i) {
    if (!(heights[i] > kSoil && heights[i] < kHighest)) continue;
    const auto band = static_cast<std::size_t>(static_cast<double>(heights[i]) / kBand);
    if (points.size() <= band) {
      points.resize(band + 1U, 0.0);
      neighbors.resize(band + 1U, 0.0);
    }
    points[band] += 1.0;
    neighbors[band] += static_cast<double>(shapes[i].neighbors) - 1.0;  // itself is one
  }
  for (std::size_t band = 0; band < points.size(); ++band) {
    bands_.push_back(points[band] < kLeastPoints ? 0.0 : neighbors[band] / points[band]);
  }
  const auto best = std::max_element(bands_.begin(), bands_.end());
  if (best == bands_.end() || !(*best > 0.0)) {
    bands_.clear();
    return;
  }
  constexpr double kFew = 7.0;  // neighbours
  const auto sparse = std::find_if(best, bands_.end(), [](double seen) { return seen < kFew; });
  if (sparse != bands_.end()) sparse_from_ = kBand * static_cast<double>(sparse - bands_.begin());
  const double most = *best;
  std::fill(bands_.begin(), best, most);
  while (!(bands_.back() > 0.0)) bands_.pop_back();
  double below = 1.0;
  for (double& band : bands_) {
    band = below = std::clamp(band / most, kLeast, below);
  }
}

double SamplingProfile::at(double height) const {
  if (bands_.empty()) return 1.0;
  const double place =
      std::clamp(height / kBand - 0.5, 0.0, static_cast<double>(bands_.size() - 1U));
  const auto low = static_cast<std::size_t>(place);
  const std::size_t high = std::min(low + 1U, bands_.size() - 1U);
  return bands_[low] + (place - static_cast<double>(low)) * (bands_[high] - bands_[low]);
}

}  // namespace field_phenotyping
