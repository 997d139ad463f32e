#include "field_phenotyping/segmentation/sampling_profile.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr double kBand = 0.10;  // [m]

}  // namespace

SamplingProfile::SamplingProfile(const std::vector<float>& heights,
                                 const std::vector<LocalShape>& shapes, double canopy) {
  constexpr float kSoil = 0.05F;        // [m]
  constexpr float kHighest = 10.0F;     // [m] of a crop
  constexpr double kLeastPoints = 10U;  // of a band that tells
  constexpr double kLeast = 0.02;
  // Of the canopy's height, in tasselling stands. Where leaves hang, as those of ripe plants, stems
  // are seen as well as they are, and what is lost by it is little.
  constexpr double kHidden = 0.12;
  hidden_ = kHidden * canopy;
  // Whole numbers, whose sums do not depend on their order.
  struct Band {
    double points = 0.0;
    double neighbors = 0.0;
  };
  constexpr std::size_t kPoints = 16384U;  // of a task
  std::vector<std::vector<Band>> of_chunks(chunksOf(heights.size(), kPoints));
  parallelChunks(heights.size(), kPoints, [&](std::size_t begin, std::size_t end) {
    std::vector<Band>& bands = of_chunks[begin / kPoints];
    for (std::size_t i = begin; i < end; ++i) {
      if (!(heights[i] > kSoil && heights[i] < kHighest)) continue;
      const auto band = static_cast<std::size_t>(static_cast<double>(heights[i]) / kBand);
      if (bands.size() <= band) bands.resize(band + 1U);
      bands[band].points += 1.0;
      bands[band].neighbors += static_cast<double>(shapes[i].neighbors) - 1.0;  // itself is one
    }
  });
  std::vector<Band> bands;
  for (const std::vector<Band>& of_chunk : of_chunks) {
    if (bands.size() < of_chunk.size()) bands.resize(of_chunk.size());
    for (std::size_t band = 0; band < of_chunk.size(); ++band) {
      bands[band].points += of_chunk[band].points;
      bands[band].neighbors += of_chunk[band].neighbors;
    }
  }
  for (const Band& band : bands) {
    bands_.push_back(band.points < kLeastPoints ? 0.0 : band.neighbors / band.points);
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
