#include "field_phenotyping/completion/bilateral_filter.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {

std::vector<double> filterDeviations(const std::vector<FilterPoint>& points,
                                     const std::vector<std::uint32_t>& wanted, double radius,
                                     const FilterOptions& options) {
  constexpr double kReach = 2.0;  // standard deviations
  constexpr double kMostNeighbors = 40.0;
  constexpr double kPi = 3.14159265358979323846;
  const double reach = kReach * options.sigma_space;
  const double per_square = 0.5 / (options.sigma_space * options.sigma_space);
  const double per_attribute = 0.5 / (options.sigma_attribute * options.sigma_attribute);
  const bool by_color = options.attribute == FilterAttribute::kColor;
  const auto before = [](const FilterPoint& p, double s) { return p.position.s < s; };
  // Of a band round the whole stem, the neighbourhood is a share.
  const double share = std::min(1.0, reach / (kPi * radius));
  std::vector<double> filtered;
  filtered.reserve(wanted.size());
  for (const std::uint32_t i : wanted) {
    const FilterPoint& point = points[i];
    const auto first =
        std::lower_bound(points.begin(), points.end(), point.position.s - reach, before);
    const auto last = std::lower_bound(first, points.end(), point.position.s + reach, before);
    // In powers of two, and always the same ones, so that a few more points change little.
    std::size_t stride = 1U;
    while (share * static_cast<double>(last - first) >
           kMostNeighbors * static_cast<double>(stride)) {
      stride *= 2U;
    }
    const auto begin = static_cast<std::size_t>(first - points.begin());
    const auto end = static_cast<std::size_t>(last - points.begin());
    double sum = point.weight * point.deviation;
    double total = point.weight;
    for (std::size_t k = (begin + stride - 1U) / stride * stride; k < end; k += stride) {
      const FilterPoint& other = points[k];
      double turn = std::abs(other.position.theta - point.position.theta);
      if (turn > kPi) turn = std::abs(turn - 2.0 * kPi);
      const double along = other.position.s - point.position.s;
      const double squared = along * along + radius * radius * turn * turn;
      if (squared > reach * reach || &other == &point) continue;
      // Normals that differ by an angle are a chord of the unit circle apart.
      const double attribute = by_color
                                   ? static_cast<double>((other.color - point.color).squaredNorm())
                                   : turn * turn * (1.0 - turn * turn / 12.0);
      const double weight =
          other.weight * std::exp(-per_square * squared - per_attribute * attribute);
      sum += weight * other.deviation;
      total += weight;
    }
    filtered.push_back(sum / total);
  }
  return filtered;
}

}  // namespace field_phenotyping
