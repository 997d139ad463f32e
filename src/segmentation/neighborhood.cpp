#include "field_phenotyping/segmentation/neighborhood.hpp"

namespace field_phenotyping {

void Neighborhood::grow(std::size_t points) {
  const std::size_t size = 2U * (count_ + points) + 64U;
  for (std::vector<float>* values : {&x_, &y_, &z_}) values->resize(size);
}

Moments Neighborhood::momentsAbout(const Eigen::Vector3f& place, float radius) const {
  Floats count{}, sum_x{}, sum_y{}, sum_z{}, xx{}, yy{}, zz{}, xy{}, yz{}, zx{};
  const Floats limit = allOf(radius * radius);
  const Floats one = allOf(1.0F);
  const Floats none{};
  for (std::size_t k = 0; k < count_; k += kLanes) {
    Floats x = loadFloats(&x_[k]) - place.x();
    Floats y = loadFloats(&y_[k]) - place.y();
    Floats z = loadFloats(&z_[k]) - place.z();
    Integers counts = x * x + (y * y + z * z) <= limit;
    if (k + kLanes > count_) counts &= lanesBefore(count_ - k);
    if (!anyOf(counts)) continue;
    x = counts ? x : none;
    y = counts ? y : none;
    z = counts ? z : none;
    count += counts ? one : none;
    sum_x += x;
    sum_y += y;
    sum_z += z;
    xx += x * x;
    yy += y * y;
    zz += z * z;
    xy += x * y;
    yz += y * z;
    zx += z * x;
  }
  Moments moments;
  moments.count = total(count);
  moments.sum = {total(sum_x), total(sum_y), total(sum_z)};
  moments.squares = {total(xx), total(yy), total(zz)};
  moments.products = {total(xy), total(yz), total(zx)};
  return moments;
}

}  // namespace field_phenotyping
