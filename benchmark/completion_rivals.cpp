#include "completion_rivals.hpp"

#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/search/kdtree.h>
#include <pcl/surface/mls.h>

#ifdef FIELD_PHENOTYPING_WITH_CGAL
#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/natural_neighbor_coordinates_2.h>
#endif

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <unordered_set>
#include <utility>

#include "field_phenotyping/completion/stem_frame.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "pcl_stages.hpp"

namespace field_phenotyping::benchmark {
namespace {

using Cloud = PclPoints;

constexpr double kPi = 3.14159265358979323846;
constexpr double kCoverage = 0.75;  // of the spacing: an empty place has no point nearer than that

class CpuClock {
 public:
  double seconds() const { return static_cast<double>(std::clock() - start_) / CLOCKS_PER_SEC; }

 private:
  std::clock_t start_ = std::clock();
};

/// A stem about the axis that it is given with, and the places on it where nothing was measured.
struct UnrolledStem {
  StemFrame frame;
  std::vector<UnrolledPoint> points;
  double radius = 0.0;  // [m] mean
  std::vector<SurfacePosition> empty;
};

StemFrame frameOf(const StemAxis& axis) {
  constexpr float kStep = 0.01F;  // [m]
  const int steps = std::max(1, static_cast<int>(std::ceil(axis.length() / kStep)));
  std::vector<Eigen::Vector3d> curve;
  for (int i = 0; i <= steps; ++i) {
    curve.push_back(axis.pointAt(axis.length() * static_cast<float>(i) / static_cast<float>(steps))
                        .cast<double>());
  }
  return StemFrame(curve);
}

UnrolledStem unroll(const GappyStem& stem, double density) {
  UnrolledStem unrolled{frameOf(stem.axis), {}, 0.0, {}};
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
  std::vector<SurfacePosition> positions;
  for (const Eigen::Vector3f& point : stem.cloud.points) {
    const UnrolledPoint p = unrolled.frame.unroll(point.cast<double>());
    unrolled.points.push_back(p);
    positions.push_back({p.theta, p.s});
    unrolled.radius += p.r / static_cast<double>(stem.cloud.size());
    low = std::min(low, p.s);
    high = std::max(high, p.s);
  }
  const SurfaceIndex index(positions, unrolled.radius);
  const double spacing = 1.0 / std::sqrt(density);
  const int columns =
      std::max(3, static_cast<int>(std::lround(2.0 * kPi * unrolled.radius / spacing)));
  const int rows = std::max(1, static_cast<int>(std::lround((high - low) / spacing)));
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const double turn = (column + 0.25 + 0.5 * (row % 2)) / columns;
      const SurfacePosition place{kPi * (2.0 * turn - 1.0),
                                  low + (high - low) * (row + 0.5) / rows};
      if (index.nearestWithin<1>(place, kCoverage * spacing).count == 0) {
        unrolled.empty.push_back(place);
      }
    }
  }
  return unrolled;
}

/// Puts a point at every empty place for which a radius is found.
template <class Radius>
FilledStem fillPlaces(const GappyStem& stem, const UnrolledStem& unrolled, const Radius& radiusAt) {
  FilledStem filled;
  filled.measured = stem.cloud.points;
  for (const SurfacePosition& place : unrolled.empty) {
    const std::optional<double> r = radiusAt(place);
    if (r) filled.filled.push_back(unrolled.frame.roll({place.theta, place.s, *r}).cast<float>());
  }
  return filled;
}

FilledStem interpolateNearest(const GappyStem& stem, double density, int k) {
  const CpuClock clock;
  const UnrolledStem unrolled = unroll(stem, density);
  std::vector<Eigen::Vector3f> flat;
  std::vector<double> radii;
  for (const UnrolledPoint& p : unrolled.points) {
    for (const int turn : {-1, 0, 1}) {
      flat.emplace_back(
          Eigen::Vector3d(unrolled.radius * (p.theta + 2.0 * kPi * turn), p.s, 0.0).cast<float>());
      radii.push_back(p.r);
    }
  }
  pcl::KdTreeFLANN<pcl::PointXYZ> tree;
  tree.setInputCloud(toPcl(flat));
  std::vector<int> index;
  std::vector<float> squared;
  FilledStem filled =
      fillPlaces(stem, unrolled, [&](const SurfacePosition& place) -> std::optional<double> {
        const Eigen::Vector3f at(static_cast<float>(unrolled.radius * place.theta),
                                 static_cast<float>(place.s), 0.0F);
        tree.nearestKSearch({at.x(), at.y(), at.z()}, k, index, squared);
        double sum = 0.0;
        double total = 0.0;
        for (std::size_t i = 0; i < index.size(); ++i) {
          constexpr double kTouching = 1e-6;  // [m]
          const double weight = 1.0 / (std::sqrt(static_cast<double>(squared[i])) + kTouching);
          sum += weight * radii[static_cast<std::size_t>(index[i])];
          total += weight;
        }
        return sum / total;
      });
  filled.seconds = clock.seconds();
  return filled;
}

#ifdef FIELD_PHENOTYPING_WITH_CGAL
FilledStem interpolateNaturally(const GappyStem& stem, double density) {
  using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
  using Point = Kernel::Point_2;
  const CpuClock clock;
  const UnrolledStem unrolled = unroll(stem, density);
  std::map<Point, double, Kernel::Less_xy_2> radii;
  std::vector<Point> points;
  for (const UnrolledPoint& p : unrolled.points) {
    for (const int turn : {-1, 0, 1}) {
      constexpr double kOverlap = 1.5;  // turns either way that the strip is repeated for
      const double theta = p.theta + 2.0 * kPi * turn;
      if (std::abs(theta) > kOverlap * kPi) continue;
      points.emplace_back(unrolled.radius * theta, p.s);
      radii[points.back()] = p.r;
    }
  }
  const CGAL::Delaunay_triangulation_2<Kernel> triangulation(points.begin(), points.end());
  std::vector<std::pair<Point, double>> coordinates;
  FilledStem filled =
      fillPlaces(stem, unrolled, [&](const SurfacePosition& place) -> std::optional<double> {
        coordinates.clear();
        const auto found = CGAL::natural_neighbor_coordinates_2(
            triangulation, Point(unrolled.radius * place.theta, place.s),
            std::back_inserter(coordinates));
        if (!found.third || !(found.second > 0.0)) return std::nullopt;
        double sum = 0.0;
        for (const auto& [point, share] : coordinates) sum += share * radii.at(point);
        return sum / found.second;
      });
  filled.seconds = clock.seconds();
  return filled;
}
#endif

struct MlsSettings {
  double search_radius;  // [m]
  double reach;          // [m] of a point's own plane, or of the dilation
  int order;
  bool by_dilation;
};

FilledStem fitLocally(const GappyStem& stem, double density, const MlsSettings& settings) {
  const auto [search_radius, reach, order, by_dilation] = settings;
  const CpuClock clock;
  const double spacing = 1.0 / std::sqrt(density);
  using Mls = pcl::MovingLeastSquares<pcl::PointXYZ, pcl::PointXYZ>;
  Mls mls;
  const Cloud::Ptr input = toPcl(stem.cloud.points);
  mls.setInputCloud(input);
  mls.setSearchMethod(
      pcl::search::KdTree<pcl::PointXYZ>::Ptr(new pcl::search::KdTree<pcl::PointXYZ>));
  mls.setSearchRadius(search_radius);
  mls.setPolynomialOrder(order);
  if (by_dilation) {
    mls.setUpsamplingMethod(Mls::VOXEL_GRID_DILATION);
    mls.setDilationVoxelSize(static_cast<float>(spacing));
    mls.setDilationIterations(static_cast<int>(std::lround(reach / spacing)));
  } else {
    mls.setUpsamplingMethod(Mls::SAMPLE_LOCAL_PLANE);
    mls.setUpsamplingRadius(reach);
    mls.setUpsamplingStepSize(spacing);
  }
  Cloud::Ptr output(new Cloud);
  mls.process(*output);
  FilledStem filled;
  if (!output->empty()) {
    pcl::KdTreeFLANN<pcl::PointXYZ> tree;
    tree.setInputCloud(input);
    std::vector<int> index;
    std::vector<float> squared;
    Cloud::Ptr kept(new Cloud);
    for (const pcl::PointXYZ& p : output->points) {
      // Ill-conditioned polynomials throw points far away: those nobody would keep.
      if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) continue;
      tree.nearestKSearch(p, 1, index, squared);
      if (squared[0] <= static_cast<float>(4.0 * reach * reach)) kept->push_back(p);
    }
    const Cloud::Ptr thinned = voxelGrid(kept, static_cast<float>(spacing));
    for (const pcl::PointXYZ& p : thinned->points) {
      tree.nearestKSearch(p, 1, index, squared);
      const bool is_new =
          squared[0] > static_cast<float>(kCoverage * kCoverage * spacing * spacing);
      (is_new ? filled.filled : filled.measured).emplace_back(p.x, p.y, p.z);
    }
  }
  filled.seconds = clock.seconds();
  return filled;
}

/// Occupied voxels; 21 bits an axis.
class Voxels {
 public:
  using Index = Eigen::Array3i;

  static std::uint64_t keyOf(const Index& v) {
    constexpr std::int64_t kOffset = 1 << 20;
    const auto bits = [](int i) { return static_cast<std::uint64_t>(i + kOffset); };
    return bits(v.x()) << 42U | bits(v.y()) << 21U | bits(v.z());
  }
  bool add(const Index& v) {
    if (!keys_.insert(keyOf(v)).second) return false;
    list_.push_back(v);
    return true;
  }
  bool has(const Index& v) const { return keys_.count(keyOf(v)) > 0; }
  const std::vector<Index>& list() const { return list_; }

 private:
  std::unordered_set<std::uint64_t> keys_;
  std::vector<Index> list_;
};

FilledStem closeVoxels(const GappyStem& stem, double edge, int ball) {
  const CpuClock clock;
  Voxels occupied;
  for (const Eigen::Vector3f& p : stem.cloud.points) {
    occupied.add((p.cast<double>().array() / edge).floor().cast<int>());
  }
  std::vector<Eigen::Array3i> offsets;
  for (int x = -ball; x <= ball; ++x) {
    for (int y = -ball; y <= ball; ++y) {
      for (int z = -ball; z <= ball; ++z) {
        if (x * x + y * y + z * z <= ball * ball) offsets.emplace_back(x, y, z);
      }
    }
  }
  Voxels dilated;
  for (const auto& v : occupied.list()) {
    for (const auto& offset : offsets) dilated.add(v + offset);
  }
  Voxels closed;
  for (const auto& v : dilated.list()) {
    const bool stays = std::all_of(offsets.begin(), offsets.end(),
                                   [&](const auto& offset) { return dilated.has(v + offset); });
    if (stays) closed.add(v);
  }
  const std::array<Eigen::Array3i, 6> sides{Eigen::Array3i{1, 0, 0}, Eigen::Array3i{-1, 0, 0},
                                            Eigen::Array3i{0, 1, 0}, Eigen::Array3i{0, -1, 0},
                                            Eigen::Array3i{0, 0, 1}, Eigen::Array3i{0, 0, -1}};
  FilledStem filled;
  filled.measured = stem.cloud.points;
  for (const auto& v : closed.list()) {
    const bool is_surface = std::any_of(sides.begin(), sides.end(),
                                        [&](const auto& side) { return !closed.has(v + side); });
    if (!is_surface || occupied.has(v)) continue;
    filled.filled.push_back((edge * (v.cast<double>() + 0.5)).matrix().cast<float>());
  }
  filled.seconds = clock.seconds();
  return filled;
}

std::string millimetres(double value) {
  return std::to_string(std::lround(1e3 * value)) + " mm";
}

}  // namespace

std::vector<Rival> rivalMethods() {
  std::vector<Rival> rivals;
  for (const MlsSettings& settings :
       {MlsSettings{0.02, 0.01, 1, false}, MlsSettings{0.02, 0.01, 2, false},
        MlsSettings{0.04, 0.01, 2, false}, MlsSettings{0.02, 0.02, 1, false},
        MlsSettings{0.02, 0.005, 2, true}}) {
    rivals.push_back({"MLS",
                      std::string(settings.by_dilation ? "voxel dilation" : "local plane") +
                          ", reach " + millimetres(settings.reach) + ", search radius " +
                          millimetres(settings.search_radius) + ", order " +
                          std::to_string(settings.order),
                      [settings](const GappyStem& stem, double density) {
                        return fitLocally(stem, density, settings);
                      }});
  }
  for (const int k : {4, 8, 16, 32}) {
    rivals.push_back({"kNN", "k " + std::to_string(k), [k](const GappyStem& stem, double density) {
                        return interpolateNearest(stem, density, k);
                      }});
  }
  for (const double share : {2.0, 4.0, 6.0}) {
    for (const int ball : {2, 4}) {
      rivals.push_back({"VGC",
                        "voxels of " + std::to_string(std::lround(share)) + " spacings, ball of " +
                            std::to_string(ball),
                        [=](const GappyStem& stem, double density) {
                          return closeVoxels(stem, share / std::sqrt(density), ball);
                        }});
    }
  }
#ifdef FIELD_PHENOTYPING_WITH_CGAL
  rivals.push_back({"NNI", "Sibson", interpolateNaturally});
#endif
  return rivals;
}

}  // namespace field_phenotyping::benchmark
