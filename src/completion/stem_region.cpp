#include "field_phenotyping/completion/stem_region.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/completion/bilateral_filter.hpp"
#include "field_phenotyping/completion/topology_repair.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kMinRobustWeight = 0.1;
constexpr std::size_t kColorNeighbors = 4;
constexpr double kMapStep = 0.01;  // [m] of the coarse map: fine against the kernels
constexpr int kMapColumns = 16;
constexpr double kSigmaNormal = 0.5;  // [-] of the difference of unit normals
constexpr double kSigmaColor = 0.2;   // [-] of rgb in [0, 1]

using Range =
    std::pair<std::vector<StemPoint>::const_iterator, std::vector<StemPoint>::const_iterator>;

Range pointsBetween(const StemModel& model, double begin, double end) {
  const auto before = [](const StemPoint& p, double s) { return p.unrolled.s < s; };
  const auto first = std::lower_bound(model.points.begin(), model.points.end(), begin, before);
  return {first, std::lower_bound(first, model.points.end(), end, before)};
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

/// Surface, its uncertainty and its colour at the nodes of a coarse grid over one region, linear
/// between them: all are smooth at the kernels' scale.
class CoarseMap {
 public:
  struct Node {
    double deviation = 0.0;  ///< from the prior [m]
    double variance = 0.0;   ///< of the surface [m^2]
    Eigen::Vector3f rgb = Eigen::Vector3f::Zero();
  };

  template <class NodeAt>
  CoarseMap(double begin, double end, const NodeAt& nodeAt)
      : begin_(begin),
        rows_(std::max(1, static_cast<int>(std::ceil((end - begin) / kMapStep)))),
        step_((end - begin) / rows_) {
    nodes_.reserve(static_cast<std::size_t>((rows_ + 1) * kMapColumns));
    for (int row = 0; row <= rows_; ++row) {
      for (int column = 0; column < kMapColumns; ++column) {
        nodes_.push_back(
            nodeAt(SurfacePosition{2.0 * kPi * column / kMapColumns - kPi, begin_ + row * step_}));
      }
    }
  }

  Node at(const SurfacePosition& place) const {
    const double up = std::clamp((place.s - begin_) / step_, 0.0, rows_ - 1e-9);
    const double turn = (place.theta + kPi) / (2.0 * kPi);
    const double round = (turn - std::floor(turn)) * kMapColumns;
    const int row = static_cast<int>(up);
    const int column = std::min(static_cast<int>(round), kMapColumns - 1);
    const double b = up - row;
    const double a = round - column;
    Node node;
    const auto add = [&](int r, int c, double share) {
      const Node& of = nodes_[static_cast<std::size_t>(r * kMapColumns + c % kMapColumns)];
      node.deviation += share * of.deviation;
      node.variance += share * of.variance;
      node.rgb += static_cast<float>(share) * of.rgb;
    };
    add(row, column, (1.0 - a) * (1.0 - b));
    add(row, column + 1, a * (1.0 - b));
    add(row + 1, column, (1.0 - a) * b);
    add(row + 1, column + 1, a * b);
    return node;
  }

 private:
  double begin_;
  int rows_;
  double step_;
  std::vector<Node> nodes_;
};

/// Eq 23: mean of the nearest measured colours, weighted by inverse distance.
Eigen::Vector3f blendColors(const std::vector<const StemPoint*>& measured,
                            const SurfaceIndex::Nearest<kColorNeighbors>& nearest) {
  constexpr double kTouching = 1e-6;  // [m^2]
  double total = 0.0;
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (std::size_t k = 0; k < nearest.count; ++k) {
    const double weight = 1.0 / std::sqrt(nearest.squared_distance[k] + kTouching);
    sum += static_cast<float>(weight) * rgbOf(measured[nearest.index[k]]->color);
    total += weight;
  }
  return total > 0.0 ? Eigen::Vector3f(sum / static_cast<float>(total)) : sum;
}

/// Unit normal of the prior surface, as it looks from outside.
Eigen::Vector3f normalOf(const StemFrame::Frame& frame, double theta) {
  return (std::cos(theta) * frame.u + std::sin(theta) * frame.v).cast<float>();
}

class RegionSolver {
 public:
  RegionSolver(const StemModel& model, long index)
      : model_(model),
        begin_(regionBegin(model.prior, index)),
        end_(begin_ + kRegionLength),
        index_(index) {}

  StemRegion solve() {
    gather();
    if (!isOneSurface()) {
      region_.no_surface = true;
      keepMeasured();
      return std::move(region_);
    }
    const RbfSurface surface(thinSamples(samples_, model_.lattice), model_.prior.meanRadius(),
                             model_.surface);
    const CoarseMap map(begin_, end_,
                        [&](const SurfacePosition& place) { return describe(surface, place); });
    fill(map);
    repair(map);
    smooth();
    finish(map);
    return std::move(region_);
  }

 private:
  /// The measured points in the region and round it.
  void gather() {
    const auto [first, last] = pointsBetween(model_, begin_ - kRegionMargin, end_ + kRegionMargin);
    for (auto p = first; p != last; ++p) {
      if (p->weight < kMinRobustWeight) continue;
      const SurfacePosition position{p->unrolled.theta, p->unrolled.s};
      measured_.push_back(&*p);
      positions_.push_back(position);
      // Eq 20: z' = alpha z + (1 - alpha) f. Relative to f that is alpha (z - f), so that the
      // surface goes back to the prior where nothing was measured.
      samples_.push_back({position, model_.prior_weight * p->deviation, p->weight});
    }
    index_of_measured_ = SurfaceIndex(positions_, model_.prior.meanRadius());
  }

  /// Whether the region's points lie about its prior surface: not on the branches of a fork.
  bool isOneSurface() const {
    constexpr std::size_t kEnough = 8;
    constexpr double kLeastShare = 0.5;
    const auto [first, last] = pointsBetween(model_, begin_, end_);
    const auto all = static_cast<std::size_t>(last - first);
    if (all < kEnough) return true;
    const auto on_surface =
        std::count_if(first, last, [](const StemPoint& p) { return p.weight >= kMinRobustWeight; });
    return static_cast<double>(on_surface) >= kLeastShare * static_cast<double>(all);
  }

  /// The variance is that of the prior, and of the deviation from it, of which less is known the
  /// farther the nearest measured point is.
  CoarseMap::Node describe(const RbfSurface& surface, const SurfacePosition& place) const {
    CoarseMap::Node node;
    const double width = surface.kernelWidth();
    const auto nearest = index_of_measured_.nearestWithin<1>(place, 2.0 * width);
    if (nearest.count > 0) node.deviation = surface.valueAt(place);
    const double known =
        nearest.count > 0 ? std::exp(-2.0 * nearest.squared_distance[0] / (width * width)) : 0.0;
    const double amplitude = model_.surface.amplitude;
    const double bias = model_.prior.noiseBias(place.s);
    node.variance = model_.prior.variance(place.theta, place.s) +
                    amplitude * amplitude * (1.0 - known) + 0.25 * bias * bias;
    if (model_.has_colors) {
      node.rgb = blendColors(measured_, index_of_measured_.nearest<kColorNeighbors>(place));
    }
    return node;
  }

  FillRange range() const {
    FillRange range = model_.range;
    range.begin = begin_;
    range.end = end_;
    return range;
  }

  long firstRow() const {
    return index_ * std::lround(kRegionLength / rowHeight(kRegionLength, model_.density));
  }

  bool mayFill(double s) const { return s >= model_.range.begin && s <= model_.range.end; }

  bool isKnown(const CoarseMap::Node& node) const {
    const double most = model_.max_stddev;
    return !(most > 0.0) || node.variance <= most * most;
  }

  /// Step 3: where points are missing, and how many (Eq 22).
  void fill(const CoarseMap& map) {
    StemShape shape;
    shape.radius = [this](double s) { return model_.prior.meanRadiusAt(s); };
    shape.ellipse = model_.prior.ellipse();
    shape_ = shape;
    std::vector<SurfacePosition> places;
    for (const GapRegion& gap : findGaps(positions_, range(), model_.density, shape_,
                                         model_.prior.meanRadius(), firstRow())) {
      sampleRegion(gap, expectedPoints(gap, model_.density, model_.prior.meanRadius()), places);
    }
    for (const SurfacePosition& place : places) {
      if (!mayFill(place.s)) continue;
      const CoarseMap::Node node = map.at(place);
      if (isKnown(node)) {
        filled_.push_back({place, node.deviation});
      } else {
        ++region_.uncertain;
      }
    }
  }

  /// Step 6, topological repair. What was left open on purpose is no defect.
  void repair(const CoarseMap& map) {
    if (filled_.empty()) return;
    const double most_deviation = 4.0 * (model_.surface.amplitude + model_.surface.noise);
    const std::vector<GapRegion> defects =
        findDefects(positions_, filled_, most_deviation, range(), model_.density, shape_,
                    model_.prior.meanRadius(), firstRow());
    if (defects.empty()) return;
    std::vector<CompletedPoint> all = filled_;
    for (const SurfaceSample& sample : samples_) all.push_back({sample.position, sample.value});
    std::vector<CompletedPoint> repaired;
    for (const GapRegion& defect : defects) {
      for (const CompletedPoint& point :
           repairDefect(defect, all, model_.density, model_.prior.meanRadius(), model_.surface)) {
        const SurfacePosition& place = point.position;
        if (mayFill(place.s) && isKnown(map.at(place)) &&
            std::abs(point.deviation) <= most_deviation) {
          repaired.push_back(point);
        }
      }
    }
    filled_.insert(filled_.end(), repaired.begin(), repaired.end());
  }

  /// Step 6, bilateral filter (Eq 25). What was filled in lies on a smooth surface already.
  void smooth() {
    keepMeasured();
    if (!(model_.smoothing > 0.0) || measured_.empty()) return;
    struct Entry {
      FilterPoint point;
      const StemPoint* measured;
    };
    std::vector<Entry> entries;
    const double middle = 0.5 * (begin_ + end_);
    const StemFrame::Frame frame = model_.prior.frame().at(middle);
    const auto attributeOf = [&](const SurfacePosition& place, const StemPoint* measured) {
      return model_.has_colors && measured != nullptr
                 ? Eigen::Vector3f(rgbOf(measured->color) / 255.0F)
                 : normalOf(frame, place.theta);
    };
    for (std::size_t i = 0; i < measured_.size(); ++i) {
      entries.push_back(
          {{positions_[i], measured_[i]->deviation, attributeOf(positions_[i], measured_[i])},
           measured_[i]});
    }
    if (!model_.has_colors) {  // what is filled in has no colour of its own
      for (const CompletedPoint& point : filled_) {
        entries.push_back(
            {{point.position, point.deviation, attributeOf(point.position, nullptr)}, nullptr});
      }
    }
    std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
      return a.point.position.s < b.point.position.s;
    });
    std::vector<FilterPoint> points;
    std::vector<std::uint32_t> wanted;
    std::vector<std::uint32_t> rank;  // of each wanted point
    for (const Entry& entry : entries) {
      if (entry.measured != nullptr && entry.point.position.s >= begin_ &&
          entry.point.position.s < end_) {
        wanted.push_back(static_cast<std::uint32_t>(points.size()));
        rank.push_back(entry.measured->rank);
      }
      points.push_back(entry.point);
    }
    const std::vector<double> deviations =
        filterDeviations(points, wanted, model_.prior.meanRadiusAt(middle), model_.smoothing,
                         model_.has_colors ? kSigmaColor : kSigmaNormal);
    std::vector<std::pair<std::uint32_t, std::size_t>> place_of;  // rank, place in smoothed
    for (std::size_t k = 0; k < own_.size(); ++k) {
      place_of.emplace_back(model_.points[own_[k]].rank, k);
    }
    std::sort(place_of.begin(), place_of.end());
    for (std::size_t k = 0; k < wanted.size(); ++k) {
      const SurfacePosition& place = points[wanted[k]].position;
      const double r = std::max(0.0, model_.prior.radius(place.theta, place.s) + deviations[k]);
      const auto at = std::lower_bound(place_of.begin(), place_of.end(),
                                       std::make_pair(rank[k], std::size_t{0}));
      region_.smoothed[at->second] =
          model_.prior.frame().roll({place.theta, place.s, r}).cast<float>();
    }
  }

  void keepMeasured() {
    own_ = regionPoints(model_, index_);
    for (const std::uint32_t i : own_) region_.smoothed.push_back(model_.points[i].point);
  }

  void finish(const CoarseMap& map) {
    const std::array<double, 2> ellipse = shape_.ellipse;
    double row = std::numeric_limits<double>::quiet_NaN();
    StemFrame::Frame frame;
    double mean_radius = 0.0;
    bool near_soil = false;
    for (const CompletedPoint& point : filled_) {
      const SurfacePosition& place = point.position;
      if (place.s != row) {
        row = place.s;
        frame = model_.prior.frame().at(row);
        mean_radius = model_.prior.meanRadiusAt(row);
        constexpr float kNearSoil = 0.1F;  // [m]
        near_soil = !model_.ground.empty() &&
                    model_.ground.heightAbove(frame.position.cast<float>()) < kNearSoil;
      }
      const double cosine = std::cos(place.theta);
      const double sine = std::sin(place.theta);
      const double outline =
          1.0 + ellipse[0] * (cosine * cosine - sine * sine) + ellipse[1] * 2.0 * cosine * sine;
      const double r = std::max(mean_radius * outline + point.deviation, 0.0);
      const Eigen::Vector3f position =
          (frame.position + r * (cosine * frame.u + sine * frame.v)).cast<float>();
      if (near_soil && model_.ground.heightAbove(position) < 0.0F) continue;
      const CoarseMap::Node node = map.at(place);
      region_.points.push_back(position);
      region_.stddev.push_back(static_cast<float>(std::sqrt(node.variance)));
      if (model_.has_colors) region_.colors.push_back(packed(node.rgb));
    }
  }

  const StemModel& model_;
  double begin_;
  double end_;
  long index_;
  StemShape shape_;
  std::vector<const StemPoint*> measured_;
  std::vector<SurfacePosition> positions_;
  std::vector<SurfaceSample> samples_;
  SurfaceIndex index_of_measured_;
  std::vector<CompletedPoint> filled_;
  std::vector<std::uint32_t> own_;
  StemRegion region_;
};

}  // namespace

std::vector<std::uint32_t> regionPoints(const StemModel& model, long index) {
  const double begin = regionBegin(model.prior, index);
  const auto [first, last] = pointsBetween(model, begin, begin + kRegionLength);
  std::vector<std::uint32_t> own;
  for (auto p = first; p != last; ++p) {
    own.push_back(static_cast<std::uint32_t>(p - model.points.begin()));
  }
  std::sort(own.begin(), own.end(), [&](std::uint32_t a, std::uint32_t b) {
    const StemPoint& p = model.points[a];
    const StemPoint& q = model.points[b];
    return std::make_tuple(p.point.z(), p.point.x(), p.point.y(), p.rank) <
           std::make_tuple(q.point.z(), q.point.x(), q.point.y(), q.rank);
  });
  return own;
}

long regionAt(const SurfacePrior& prior, double s) {
  return std::lround(std::floor((prior.begin() + s) / kRegionLength));
}

double regionBegin(const SurfacePrior& prior, long index) {
  return kRegionLength * static_cast<double>(index) - prior.begin();
}

StemRegion solveRegion(const StemModel& model, long index) {
  return RegionSolver(model, index).solve();
}

}  // namespace field_phenotyping
