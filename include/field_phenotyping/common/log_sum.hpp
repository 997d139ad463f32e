#pragma once

#include <cmath>

namespace field_phenotyping {

/// Sum of the logarithms of positive factors, as the logarithm of products: many factors cost one
/// logarithm.
class LogSum {
 public:
  /// @param factor in [1e-100, 1e100]
  void add(double factor) {
    product_ *= factor;
    constexpr double kMost = 1e200;  // leaves room for one more factor
    if (product_ < 1.0 / kMost || product_ > kMost) {
      sum_ += std::log(product_);
      product_ = 1.0;
    }
  }
  double value() const { return sum_ + std::log(product_); }

 private:
  double sum_ = 0.0;
  double product_ = 1.0;
};

}  // namespace field_phenotyping
