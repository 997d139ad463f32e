#include "field_phenotyping/common/spatial_order.hpp"

#include <algorithm>
#include <array>
#include <cstddef>

#include "field_phenotyping/common/parallel.hpp"

namespace field_phenotyping {
namespace {

constexpr unsigned kAxisBits = 10U;  // of a cell's place along an axis
constexpr unsigned kDigitBits = 10U;
constexpr std::size_t kDigits = std::size_t{1} << kDigitBits;

/// The bits of a number of kAxisBits, with two zeros before each.
std::uint32_t spread(std::uint32_t bits) {
  bits = (bits | bits << 16U) & 0x030000FFU;
  bits = (bits | bits << 8U) & 0x0300F00FU;
  bits = (bits | bits << 4U) & 0x030C30C3U;
  return (bits | bits << 2U) & 0x09249249U;
}

struct Keyed {
  std::uint32_t key;
  std::uint32_t index;
};

}  // namespace

std::vector<std::uint32_t> spatialOrder(const std::vector<Eigen::Vector3f>& points) {
  if (points.empty()) return {};
  Eigen::Array3f low = points.front().array();
  Eigen::Array3f high = low;
  for (const Eigen::Vector3f& point : points) {
    low = low.min(point.array());
    high = high.max(point.array());
  }
  constexpr float kLeastCell = 0.01F;  // [m] nothing asks for what lies nearer alone
  constexpr float kLast = (1U << kAxisBits) - 1U;
  const float cell = std::max((high - low).maxCoeff() / kLast, kLeastCell);
  std::vector<Keyed> keyed(points.size());
  constexpr std::size_t kChunk = 16384U;
  parallelChunks(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Array3i place = ((points[i].array() - low) / cell).min(kLast).cast<int>();
      const auto along = [&](Eigen::Index axis) {
        return spread(static_cast<std::uint32_t>(place[axis]));
      };
      keyed[i] = {along(0) | along(1) << 1U | along(2) << 2U, static_cast<std::uint32_t>(i)};
    }
  });
  std::vector<Keyed> sorted(keyed.size());
  for (unsigned shift = 0U; shift < 3U * kAxisBits; shift += kDigitBits) {
    const auto digitOf = [&](const Keyed& one) { return (one.key >> shift) & (kDigits - 1U); };
    std::array<std::uint32_t, kDigits + 1U> begin{};
    for (const Keyed& one : keyed) ++begin[digitOf(one) + 1U];
    for (std::size_t digit = 0; digit < kDigits; ++digit) begin[digit + 1U] += begin[digit];
    for (const Keyed& one : keyed) sorted[begin[digitOf(one)]++] = one;
    keyed.swap(sorted);
  }
  std::vector<std::uint32_t> order(keyed.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = keyed[k].index;
  return order;
}

}  // namespace field_phenotyping
