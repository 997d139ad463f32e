#include "field_phenotyping/completion/measured_surface.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kMinRobustWeight = 0.1;

std::uint64_t hashOf(const Eigen::Vector3f& point, std::uint32_t color) {
  std::uint64_t hash = color;
  for (int axis = 0; axis < 3; ++axis) {
    std::uint32_t bits = 0U;
    const float value = point[axis];
    std::memcpy(&bits, &value, sizeof(bits));
    hash = (hash ^ bits) * 0x9E3779B97F4A7C15U;
    hash ^= hash >> 29U;
  }
  return hash;
}

/// @param in_slice, turn shares of the slice's length and of the circumference
std::size_t patchIndex(long number, double in_slice, double turn) {
  constexpr int kRows = MeasuredSurface::kPatchRows;
  constexpr int kColumns = MeasuredSurface::kPatchColumns;
  const int row = std::clamp(static_cast<int>(in_slice * kRows), 0, kRows - 1);
  const int column = std::clamp(static_cast<int>(turn * kColumns), 0, kColumns - 1);
  return static_cast<std::size_t>((number * kRows + row) * kColumns + column);
}

}  // namespace

long sliceAt(const SurfacePrior& prior, double s) {
  return std::lround(std::floor((prior.begin() + s) / kSliceLength));
}

double sliceBegin(const SurfacePrior& prior, long slice) {
  return kSliceLength * static_cast<double>(slice) - prior.begin();
}

Eigen::Vector3f rgbOf(std::uint32_t color) {
  return Eigen::Vector3f(static_cast<float>((color >> 16U) & 0xFFU),
                         static_cast<float>((color >> 8U) & 0xFFU),
                         static_cast<float>(color & 0xFFU));
}

std::uint32_t packed(const Eigen::Vector3f& rgb) {
  const Eigen::Array<std::uint32_t, 3, 1> bytes =
      rgb.array().round().max(0.0F).min(255.0F).cast<std::uint32_t>();
  return bytes[0] << 16U | bytes[1] << 8U | bytes[2];
}

/// What falls into the cells of all slices while points are added.
struct MeasuredSurface::CellSums {
  /// Places relative to the cell's middle.
  struct Sum {
    double weight = 0.0;
    double turn = 0.0;
    double rise = 0.0;
    double deviation = 0.0;
  };
  struct RowEnds {
    double low = std::numeric_limits<double>::max();
    double high = std::numeric_limits<double>::lowest();
  };

  std::vector<Sum> cells;               // by slice, by row and round the stem
  std::vector<Eigen::Vector3f> colors;  // of those; empty: no colours
  std::vector<RowEnds> rows;            // by slice
};

MeasuredSurface::MeasuredSurface(const PointCloud& cloud, IndexSpan stem, const SurfacePrior& prior,
                                 double cell)
    : points_(stem.size()),
      has_colors_(cloud.hasColors()),
      rows_(std::max(1, static_cast<int>(std::lround(kSliceLength / cell)))),
      columns_(std::max(6, static_cast<int>(std::lround(2.0 * kPi * prior.meanRadius() / cell)))),
      lowest_(std::numeric_limits<double>::max()),
      highest_(std::numeric_limits<double>::lowest()) {
  // What lies beyond the coarse model, which covers all points but a few that its fit did not look
  // at, is no surface.
  first_slice_ = sliceAt(prior, -kSliceLength);
  const long last = sliceAt(prior, prior.frame().length() + kSliceLength);
  slices_.resize(static_cast<std::size_t>(last - first_slice_ + 1));
  patches_.resize(slices_.size() * kPatchRows * kPatchColumns);
  CellSums sums;
  sums.rows.resize(slices_.size() * static_cast<std::size_t>(rows_));
  sums.cells.resize(sums.rows.size() * static_cast<std::size_t>(columns_));
  if (has_colors_) sums.colors.resize(sums.cells.size(), Eigen::Vector3f::Zero());
  for (std::uint32_t i = stem.begin; i < stem.end; ++i) {
    addPoint(cloud, i, prior, points_[i - stem.begin], sums);
  }
  averageCells(prior, sums);
  for (const Patch& patch : patches_) {
    whole_.points += patch.points;
    whole_.sum += patch.sum;
    whole_.squares += patch.squares;
  }
  estimateNoise(prior);
  sortPlaces(prior);
}

void MeasuredSurface::addPoint(const PointCloud& cloud, std::uint32_t i, const SurfacePrior& prior,
                               Point& p, CellSums& sums) {
  Eigen::Vector3d outward;
  const UnrolledPoint unrolled = prior.frame().unroll(cloud.points[i].cast<double>(), outward);
  const long number = sliceAt(prior, unrolled.s) - first_slice_;
  if (number < 0 || number >= static_cast<long>(slices_.size())) return;
  const SurfacePrior::Residual residual = prior.residual(unrolled);
  p.position = {unrolled.theta, unrolled.s};
  p.outward = outward.cast<float>();
  p.deviation = static_cast<float>(residual.deviation);
  p.noise_bias = static_cast<float>(residual.noise_bias);
  const double weight = prior.robustWeight(residual.deviation);
  p.on_surface = weight >= kMinRobustWeight;
  lowest_ = std::min(lowest_, unrolled.s);
  highest_ = std::max(highest_, unrolled.s);
  Slice& slice = slices_[static_cast<std::size_t>(number)];
  slice.hash += hashOf(cloud.points[i], has_colors_ ? cloud.colors[i] : 0U);
  ++slice.points;
  const double in_slice = (unrolled.s - sliceBegin(prior, number + first_slice_)) / kSliceLength;
  const double turn = (unrolled.theta + kPi) / (2.0 * kPi);
  Patch& patch = patches_[patchIndex(number, in_slice, turn)];
  const double most_deviation = prior.meanRadius();
  const double limited = std::clamp(residual.deviation, -most_deviation, most_deviation);
  patch.points += 1.0;
  patch.sum += limited;
  patch.squares += limited * limited;
  if (!p.on_surface) return;
  ++slice.on_surface;

  const double up = in_slice * rows_;
  const double round = turn * columns_;
  const int row = std::clamp(static_cast<int>(up), 0, rows_ - 1);
  const int column = std::clamp(static_cast<int>(round), 0, columns_ - 1);
  const std::size_t row_index = static_cast<std::size_t>(number) * static_cast<std::size_t>(rows_) +
                                static_cast<std::size_t>(row);
  const std::size_t index =
      row_index * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
  CellSums::Sum& sum = sums.cells[index];
  sum.weight += weight;
  sum.turn += weight * (round - column - 0.5);
  sum.rise += weight * (up - row - 0.5);
  sum.deviation += weight * residual.deviation;
  if (has_colors_) sums.colors[index] += static_cast<float>(weight) * rgbOf(cloud.colors[i]);
  CellSums::RowEnds& ends = sums.rows[row_index];
  ends.low = std::min(ends.low, unrolled.s);
  ends.high = std::max(ends.high, unrolled.s);
}

void MeasuredSurface::averageCells(const SurfacePrior& prior, const CellSums& sums) {
  const double turn_a_column = 2.0 * kPi / columns_;
  for (std::size_t number = 0; number < slices_.size(); ++number) {
    const double begin = sliceBegin(prior, first_slice_ + static_cast<long>(number));
    for (int row = 0; row < rows_; ++row) {
      const std::size_t row_index =
          number * static_cast<std::size_t>(rows_) + static_cast<std::size_t>(row);
      const CellSums::RowEnds& ends = sums.rows[row_index];
      if (ends.low > ends.high) continue;
      row_ends_.push_back(ends.low);
      row_ends_.push_back(ends.high);
      for (int column = 0; column < columns_; ++column) {
        const std::size_t index =
            row_index * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
        const CellSums::Sum& sum = sums.cells[index];
        if (!(sum.weight > 0.0)) continue;
        Cell mean;
        mean.position.theta = (column + 0.5 + sum.turn / sum.weight) * turn_a_column - kPi;
        mean.position.s = begin + (row + 0.5 + sum.rise / sum.weight) * rowHeight();
        mean.deviation = sum.deviation / sum.weight;
        mean.weight = sum.weight;
        if (has_colors_) mean.rgb = sums.colors[index] / static_cast<float>(sum.weight);
        cells_.push_back(mean);
      }
    }
    slices_[number].cells_end = cells_.size();
  }
}

void MeasuredSurface::sortPlaces(const SurfacePrior& prior) {
  std::vector<std::size_t> next;
  std::size_t end = 0U;
  for (Slice& slice : slices_) {
    next.push_back(end);
    end += slice.on_surface;
    slice.places_end = end;
  }
  places_.resize(end);
  for (const Point& p : points_) {
    if (!p.on_surface) continue;
    const long number = sliceAt(prior, p.position.s) - first_slice_;
    places_[next[static_cast<std::size_t>(number)]++] = p.position;
  }
}

std::vector<float> MeasuredSurface::differencesWithin(double width,
                                                      const SurfacePrior& prior) const {
  constexpr std::size_t kMostPoints = 16000;
  const std::size_t stride = 1U + points_.size() / kMostPoints;
  const auto rows = static_cast<long>(std::ceil(kSliceLength / width));
  const auto columns = std::max(3L, std::lround(2.0 * kPi * prior.meanRadius() / width));
  const float none = std::numeric_limits<float>::quiet_NaN();
  std::vector<float> last(slices_.size() * static_cast<std::size_t>(rows * columns), none);
  std::vector<float> differences;
  for (const Point& p : points_) {
    if (!p.on_surface) continue;
    // Of a stem with many points some slices will do.
    const long number = sliceAt(prior, p.position.s) - first_slice_;
    if (static_cast<std::size_t>(number) % stride != 0U) continue;
    const double above = p.position.s - sliceBegin(prior, number + first_slice_);
    const auto row = std::clamp(static_cast<long>(above / width), 0L, rows - 1L);
    const double turn = (p.position.theta + kPi) / (2.0 * kPi);
    const auto column =
        std::clamp(static_cast<long>(turn * static_cast<double>(columns)), 0L, columns - 1L);
    const auto cell = [&](long r, long c) -> float& {
      return last[static_cast<std::size_t>((number * rows + r) * columns + c % columns)];
    };
    float& beside = std::isnan(cell(row, column + 1L)) && row + 1L < rows ? cell(row + 1L, column)
                                                                          : cell(row, column + 1L);
    if (std::isnan(beside)) {
      cell(row, column) = p.deviation;
    } else {
      differences.push_back(std::abs(p.deviation - beside));
      beside = none;
    }
  }
  return differences;
}

void MeasuredSurface::estimateNoise(const SurfacePrior& prior) {
  constexpr std::size_t kEnough = 60;  // pairs
  constexpr double kLeast = 0.005;  // [m] clouds are thinned: points nearer to one another across
                                    // the stem than its voxels differ all the more along it
  constexpr double kWidest = 2.0;   // times as much
  constexpr double kRelativeError = 1.65;  // of the square, for one pair
  const auto varianceOf = [&](std::vector<float> differences) {
    const double sigma = kMadToSigma * static_cast<double>(medianOf(std::move(differences)));
    return 0.5 * sigma * sigma;
  };
  noise_variance_ = prior.noise() * prior.noise();
  for (double width = kLeast; width <= kWidest * kLeast; width *= 2.0) {
    std::vector<float> near = differencesWithin(width, prior);
    if (near.size() < kEnough) continue;
    // What still grows with the distance is shape: noise is what is left at no distance.
    std::vector<float> far = differencesWithin(2.0 * width, prior);
    const double near_share = kRelativeError / std::sqrt(static_cast<double>(near.size()));
    const double far_share = kRelativeError / std::sqrt(static_cast<double>(far.size()));
    const double near_variance = varianceOf(std::move(near));
    const double far_variance = varianceOf(std::move(far));
    const double larger = std::max(near_variance, far_variance);
    const double growth = far_variance - near_variance - larger * std::hypot(near_share, far_share);
    noise_variance_ = std::max(near_variance - std::max(growth, 0.0), 0.0);
    noise_variance_error_ = larger * std::hypot(growth > 0.0 ? 2.0 * near_share : near_share,
                                                growth > 0.0 ? far_share : 0.0);
    return;
  }
}

MeasuredSurface::Patch MeasuredSurface::patch(long slice, int row, int column) const {
  const long rows = (slice - first_slice_) * kPatchRows + row;
  const int turned = (column % kPatchColumns + kPatchColumns) % kPatchColumns;
  const long index = rows * kPatchColumns + turned;
  if (rows < 0 || index >= static_cast<long>(patches_.size())) return {};
  return patches_[static_cast<std::size_t>(index)];
}

std::size_t MeasuredSurface::indexOf(long slice) const {
  return static_cast<std::size_t>(
      std::clamp(slice - first_slice_, 0L, static_cast<long>(slices_.size())));
}

MeasuredSurface::Slice MeasuredSurface::slice(long number) const {
  const std::size_t index = indexOf(number);
  return number < first_slice_ || index >= slices_.size() ? Slice() : slices_[index];
}

std::pair<std::size_t, std::size_t> MeasuredSurface::cellsOf(long first, long last) const {
  const auto before = [&](long slice) {
    return indexOf(slice) == 0U ? 0U : slices_[indexOf(slice) - 1U].cells_end;
  };
  return {before(first), before(last)};
}

std::pair<std::size_t, std::size_t> MeasuredSurface::placesOf(long first, long last) const {
  const auto before = [&](long slice) {
    return indexOf(slice) == 0U ? 0U : slices_[indexOf(slice) - 1U].places_end;
  };
  return {before(first), before(last)};
}

}  // namespace field_phenotyping
