#include "field_phenotyping/completion/measured_surface.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

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

/// What falls into one cell; places relative to the cell's middle.
struct Sums {
  double weight = 0.0;
  double turn = 0.0;
  double rise = 0.0;
  double deviation = 0.0;
};

struct RowEnds {
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
};

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

MeasuredSurface::MeasuredSurface(const PointCloud& cloud, IndexSpan stem, const SurfacePrior& prior,
                                 double cell)
    : points_(stem.size()),
      has_colors_(cloud.hasColors()),
      rows_(std::max(1, static_cast<int>(std::lround(kSliceLength / cell)))),
      columns_(std::max(6, static_cast<int>(std::lround(2.0 * kPi * prior.meanRadius() / cell)))) {
  // What lies beyond the coarse model, which covers all points but a few that its fit did not look
  // at, is no surface.
  first_slice_ = sliceAt(prior, -kSliceLength);
  const long last = sliceAt(prior, prior.frame().length() + kSliceLength);
  slices_.resize(static_cast<std::size_t>(last - first_slice_ + 1));
  const std::size_t cells_a_slice =
      static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_);
  std::vector<Sums> sums(slices_.size() * cells_a_slice);
  std::vector<Eigen::Vector3f> colors(has_colors_ ? sums.size() : 0U, Eigen::Vector3f::Zero());
  std::vector<RowEnds> ends(slices_.size() * static_cast<std::size_t>(rows_));
  lowest_ = std::numeric_limits<double>::max();
  highest_ = std::numeric_limits<double>::lowest();

  const double turn_a_column = 2.0 * kPi / columns_;
  for (std::uint32_t i = stem.begin; i < stem.end; ++i) {
    Point& p = points_[i - stem.begin];
    Eigen::Vector3d outward;
    const UnrolledPoint unrolled = prior.frame().unroll(cloud.points[i].cast<double>(), outward);
    const long number = sliceAt(prior, unrolled.s) - first_slice_;
    if (number < 0 || number >= static_cast<long>(slices_.size())) continue;
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
    if (!p.on_surface) continue;
    ++slice.on_surface;

    const double up = (unrolled.s - sliceBegin(prior, number + first_slice_)) / rowHeight();
    const double round = (unrolled.theta + kPi) / turn_a_column;
    const int row = std::clamp(static_cast<int>(up), 0, rows_ - 1);
    const int column = std::clamp(static_cast<int>(round), 0, columns_ - 1);
    const std::size_t row_index =
        static_cast<std::size_t>(number) * static_cast<std::size_t>(rows_) +
        static_cast<std::size_t>(row);
    const std::size_t index =
        row_index * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
    Sums& sum = sums[index];
    sum.weight += weight;
    sum.turn += weight * (round - column - 0.5);
    sum.rise += weight * (up - row - 0.5);
    sum.deviation += weight * residual.deviation;
    if (has_colors_) colors[index] += static_cast<float>(weight) * rgbOf(cloud.colors[i]);
    ends[row_index].low = std::min(ends[row_index].low, unrolled.s);
    ends[row_index].high = std::max(ends[row_index].high, unrolled.s);
  }

  for (std::size_t number = 0; number < slices_.size(); ++number) {
    const double begin = sliceBegin(prior, first_slice_ + static_cast<long>(number));
    for (int row = 0; row < rows_; ++row) {
      const std::size_t row_index =
          number * static_cast<std::size_t>(rows_) + static_cast<std::size_t>(row);
      if (ends[row_index].low > ends[row_index].high) continue;
      row_ends_.push_back(ends[row_index].low);
      row_ends_.push_back(ends[row_index].high);
      for (int column = 0; column < columns_; ++column) {
        const std::size_t index =
            row_index * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(column);
        const Sums& sum = sums[index];
        if (!(sum.weight > 0.0)) continue;
        Cell mean;
        mean.position.theta = (column + 0.5 + sum.turn / sum.weight) * turn_a_column - kPi;
        mean.position.s = begin + (row + 0.5 + sum.rise / sum.weight) * rowHeight();
        mean.deviation = sum.deviation / sum.weight;
        mean.weight = sum.weight;
        if (has_colors_) mean.rgb = colors[index] / static_cast<float>(sum.weight);
        cells_.push_back(mean);
      }
    }
    slices_[number].cells_end = cells_.size();
    slices_[number].places_end =
        slices_[number].on_surface + (number > 0U ? slices_[number - 1U].places_end : 0U);
  }

  places_.resize(slices_.back().places_end);
  std::vector<std::size_t> next;
  for (const Slice& slice : slices_) next.push_back(slice.places_end - slice.on_surface);
  for (const Point& p : points_) {
    if (!p.on_surface) continue;
    const long number = sliceAt(prior, p.position.s) - first_slice_;
    places_[next[static_cast<std::size_t>(number)]++] = p.position;
  }
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
