#include "measurement_rivals.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <set>

#include "field_phenotyping/measurement/ellipse_fit.hpp"

namespace field_phenotyping::benchmark {
namespace {

using Points = std::vector<Eigen::Vector2d>;

constexpr double kPi = 3.14159265358979323846;
constexpr double kSpans[] = {0.05, 0.1, 0.2, 0.4};      // [m] of stem
constexpr double kVoxels[] = {0.002, 0.003, 0.005};     // [m] across the stem
constexpr double kPixels[] = {0.001, 0.002, 0.003};     // [m] of its silhouette
constexpr double kHeightCells[] = {0.003, 0.01, 0.02};  // [m] voxels and pixels of whole plants
constexpr int kHeightCounts[] = {1, 2, 4};              // points or pixels that make a layer
constexpr int kViews = 12;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

std::string named(const char* format, double first, double second) {
  char text[80];
  std::snprintf(text, sizeof(text), format, first, second);
  return text;
}

long cellOf(double x, double size) {
  return std::lround(std::floor(x / size));
}

double paperDiameter(const Points& points) {
  const EllipseFit fit = fitAlgebraicEllipse(points);
  return fit.valid ? 2.0 * fit.semi_major : kNone;
}

double circleDiameter(const Points& points) {
  const CircleFit fit = fitCircle(points);
  return fit.valid ? 2.0 * fit.radius : kNone;
}

double voxelDiameter(const Points& points, double size) {
  if (points.empty()) return kNone;
  std::map<long, std::pair<long, long>> rows;  // first and last voxel of each
  for (const Eigen::Vector2d& point : points) {
    const long column = cellOf(point.x(), size);
    auto& row = rows.insert({cellOf(point.y(), size), {column, column}}).first->second;
    row = {std::min(row.first, column), std::max(row.second, column)};
  }
  long voxels = 0;
  for (const auto& [row, ends] : rows) voxels += ends.second - ends.first + 1;
  return std::sqrt(4.0 / kPi * static_cast<double>(voxels)) * size;
}

/// Longest run of pixels that are set; gaps of two pixels are closed.
double silhouetteWidth(const Points& points, double view, double size) {
  constexpr long kGap = 2;
  std::set<long> pixels;
  const Eigen::Vector2d across(std::cos(view), std::sin(view));
  for (const Eigen::Vector2d& point : points) pixels.insert(cellOf(point.dot(across), size));
  long longest = 0;
  long first = 0;
  long last = std::numeric_limits<long>::min() / 2;
  for (const long pixel : pixels) {
    if (pixel > last + 1 + kGap) first = pixel;
    last = pixel;
    longest = std::max(longest, last - first + 1);
  }
  return static_cast<double>(longest) * size;
}

/// Top of the highest layer with at least `least` different entries.
double topLayer(const std::map<long, std::set<long>>& layers, std::size_t least, double size) {
  for (auto layer = layers.rbegin(); layer != layers.rend(); ++layer) {
    if (layer->second.size() >= least) return static_cast<double>(layer->first + 1) * size;
  }
  return kNone;
}

}  // namespace

std::vector<RivalValue> rivalDiameters(const std::vector<Eigen::Vector3d>& points) {
  std::vector<RivalValue> values;
  for (const double span : kSpans) {
    Points slice;
    for (const Eigen::Vector3d& point : points) {
      if (std::abs(point.z()) <= 0.5 * span) slice.emplace_back(point.head<2>());
    }
    values.push_back(
        {"paper mode, Eq 27", named("%.0f cm of stem", 1e2 * span, 0.0), paperDiameter(slice)});
    values.push_back({"circle", named("%.0f cm of stem", 1e2 * span, 0.0), circleDiameter(slice)});
    for (const double size : kVoxels) {
      values.push_back({"voxel",
                        named("%.0f cm of stem, voxels of %.0f mm", 1e2 * span, 1e3 * size),
                        voxelDiameter(slice, size)});
    }
    for (const double size : kPixels) {
      double sum = 0.0;
      double widest = 0.0;
      for (int view = 0; view < kViews; ++view) {
        const double width = silhouetteWidth(slice, kPi * view / kViews, size);
        sum += width;
        widest = std::max(widest, width);
      }
      const bool seen = !slice.empty();
      values.push_back({"projection",
                        named("%.0f cm of stem, pixels of %.0f mm, mean", 1e2 * span, 1e3 * size),
                        seen ? sum / kViews : kNone});
      values.push_back({"projection",
                        named("%.0f cm of stem, pixels of %.0f mm, widest", 1e2 * span, 1e3 * size),
                        seen ? widest : kNone});
    }
  }
  return values;
}

std::vector<RivalValue> rivalHeights(const std::vector<Eigen::Vector3d>& points) {
  std::vector<RivalValue> values;
  for (const double size : kHeightCells) {
    std::map<long, std::set<long>> voxels;
    std::map<long, std::set<long>> pixels;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const long layer = cellOf(points[i].z(), size);
      voxels[layer].insert(static_cast<long>(i));
      pixels[layer].insert(cellOf(points[i].x(), size));
    }
    for (const int least : kHeightCounts) {
      const auto count = static_cast<std::size_t>(least);
      values.push_back({"voxel", named("layers of %.0f mm with %.0f points", 1e3 * size, least),
                        topLayer(voxels, count, size)});
      values.push_back({"projection", named("rows of %.0f mm with %.0f pixels", 1e3 * size, least),
                        topLayer(pixels, count, size)});
    }
  }
  return values;
}

}  // namespace field_phenotyping::benchmark
