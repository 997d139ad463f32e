#include "field_phenotyping/completion/bilateral_filter.hpp"

#include <algorithm>
#include <cmath>

namespace field_phenotyping {

std::vector<double> filterDeviations(const std::vector<FilterPoint>& points,
                                     const std::vector<std::uint32_t>& wanted, double radius,
                                     double sigma_space, double sigma_attribute) {
  constexpr double kReach = 2.0;  // standard deviations
  constexpr std::ptrdiff_t kMostNeighbors = 64;
  constexpr double kTwoPi = 6.28318530717958647692;
  const double reach = kReach * sigma_space;
  const double per_square = 0.5 / (sigma_space * sigma_space);
  const double per_attribute = 0.5 / (sigma_attribute * sigma_attribute);
  const auto before = [](const FilterPoint& p, double s) { return p.position.s < s; };
  std::vector<double> filtered;
  filtered.reserve(wanted.size());
  for (const std::uint32_t i : wanted) {
    const FilterPoint& point = points[i];
    const auto first =
        std::lower_bound(points.begin(), points.end(), point.position.s - reach, before);
    const auto last = std::lower_bound(first, points.end(), point.position.s + reach, before);
    // A band round the whole stem, of which the neighbourhood is a share.
    const double share = std::min(1.0, 2.0 * reach / (kTwoPi * radius));
    const auto stride = static_cast<std::ptrdiff_t>(
        1.0 + share * static_cast<double>(last - first) / kMostNeighbors);
    double sum = point.deviation;
    double total = 1.0;
    for (auto other = first; other < last; other += std::min(stride, last - other)) {
      const double along = other->position.s - point.position.s;
      const double around =
          radius * std::remainder(other->position.theta - point.position.theta, kTwoPi);
      const double squared = along * along + around * around;
      if (squared > reach * reach || &*other == &point) continue;
      const double attribute =
          static_cast<double>((other->attribute - point.attribute).squaredNorm());
      const double weight = std::exp(-per_square * squared - per_attribute * attribute);
      sum += weight * other->deviation;
      total += weight;
    }
    filtered.push_back(sum / total);
  }
  return filtered;
}

}  // namespace field_phenotyping
