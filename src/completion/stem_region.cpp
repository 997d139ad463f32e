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
constexpr double kMapStep = 0.0151;  // [m] of the coarse map: fine against the kernels
constexpr int kMapColumns = 12;
constexpr double kSigmaNormal = 0.5;  // [-] of the difference of unit normals
constexpr double kSigmaColor = 0.2;   // [-] of rgb in [0, 1]

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
  CoarseMap(double begin, double end, bool has_colors, const NodeAt& nodeAt)
      : has_colors_(has_colors),
        begin_(begin),
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
      if (has_colors_) node.rgb += static_cast<float>(share) * of.rgb;
    };
    add(row, column, (1.0 - a) * (1.0 - b));
    add(row, column + 1, a * (1.0 - b));
    add(row + 1, column, (1.0 - a) * b);
    add(row + 1, column + 1, a * b);
    return node;
  }

 private:
  bool has_colors_;
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

/// Cosine and sine of angles in [-2 pi, 2 pi] within 1e-8, several times as fast as the standard
/// library's: tens of thousands of points are made for a stem.
class TurnTable {
 public:
  TurnTable() {
    for (int k = 0; k < kEntries; ++k) {
      const double angle = (k - kHalf) * kStep;
      entries_[static_cast<std::size_t>(k)] = {std::cos(angle), std::sin(angle)};
    }
  }
  std::pair<double, double> cosineAndSine(double angle) const {
    const double place = angle / kStep;
    const int k = static_cast<int>(place + kHalf + 0.5);
    const double rest = angle - (k - kHalf) * kStep;
    const auto& [cosine, sine] = entries_[static_cast<std::size_t>(k)];
    const double less = 1.0 - 0.5 * rest * rest;
    return {cosine * less - sine * rest, sine * less + cosine * rest};
  }

 private:
  static constexpr int kHalf = 2048;
  static constexpr int kEntries = 2 * kHalf + 2;
  static constexpr double kStep = 2.0 * kPi / kHalf;
  std::array<std::pair<double, double>, kEntries> entries_;
};

class RegionSolver {
 public:
  RegionSolver(const StemModel& model, long index, const std::vector<std::uint32_t>& own)
      : model_(model),
        own_(own),
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
    const CoarseMap map(begin_, end_, model_.has_colors,
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
    constexpr double kLeastShare = 0.65;
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
    // Eq 20 leaves out a share of what deviates from the prior, wherever it was measured.
    const double left_out = (1.0 - model_.prior_weight) / std::max(model_.prior_weight, 0.1);
    node.variance = model_.prior.variance(place.theta, place.s) +
                    amplitude * amplitude * (1.0 - known + left_out * left_out) +
                    0.25 * bias * bias;
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
      const double count = expectedPoints(gap, model_.density, model_.prior.meanRadius());
      sampleRegion(gap, count, places);
      constexpr double kLeaky = 0.95;  // of the density: fewer points leave holes
      if (count < kLeaky * model_.density * gap.area) may_have_holes_ = true;
    }
    filled_.reserve(places.size());
    for (const SurfacePosition& place : places) {
      if (!mayFill(place.s)) continue;
      const CoarseMap::Node node = map.at(place);
      if (isKnown(node)) {
        filled_.push_back({place, node.deviation, node.variance});
      } else {
        ++region_.uncertain;
      }
    }
  }

  /// Step 6, topological repair. What was left open on purpose is no defect.
  void repair(const CoarseMap& map) {
    if (filled_.empty()) return;
    const double most_deviation = 4.0 * (model_.surface.amplitude + model_.surface.noise);
    const bool has_folds = std::any_of(filled_.begin(), filled_.end(), [&](const auto& point) {
      return !(std::abs(point.deviation) <= most_deviation);
    });
    if (!may_have_holes_ && !has_folds) return;
    const std::vector<GapRegion> defects =
        findDefects(positions_, filled_, most_deviation, range(), model_.density, shape_,
                    model_.prior.meanRadius(), firstRow());
    if (defects.empty()) return;
    std::vector<CompletedPoint> all = filled_;
    for (const SurfaceSample& sample : samples_) {
      all.push_back({sample.position, sample.value, 0.0});
    }
    std::vector<CompletedPoint> repaired;
    for (const GapRegion& defect : defects) {
      for (CompletedPoint& point :
           repairDefect(defect, all, model_.density, model_.prior.meanRadius(), model_.surface)) {
        const CoarseMap::Node node = map.at(point.position);
        if (!mayFill(point.position.s) || !isKnown(node)) continue;
        if (!(std::abs(point.deviation) <= most_deviation)) continue;
        point.variance = node.variance;
        repaired.push_back(point);
      }
    }
    filled_.insert(filled_.end(), repaired.begin(), repaired.end());
  }

  /// Step 6, bilateral filter (Eq 25). What was filled in lies on a smooth surface already; of its
  /// points a part stands for all.
  void smooth() {
    keepMeasured();
    if (!(model_.smoothing > 0.0) || own_.empty()) return;
    constexpr std::size_t kMostFilled = 256;
    constexpr std::uint32_t kFilled = ~0U;
    struct Entry {
      FilterPoint point;
      std::uint32_t rank;  // of a measured point
    };
    std::vector<Entry> entries;
    for (std::size_t i = 0; i < measured_.size(); ++i) {
      FilterPoint point;
      point.position = positions_[i];
      point.deviation = measured_[i]->deviation;
      if (model_.has_colors) point.color = rgbOf(measured_[i]->color) / 255.0F;
      entries.push_back({point, measured_[i]->rank});
    }
    if (!model_.has_colors) {  // what is filled in has no colour of its own
      const std::size_t stride = 1U + filled_.size() / kMostFilled;
      for (std::size_t i = 0; i < filled_.size(); i += stride) {
        FilterPoint point;
        point.position = filled_[i].position;
        point.deviation = filled_[i].deviation;
        point.weight = static_cast<double>(stride);
        entries.push_back({point, kFilled});
      }
    }
    std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
      return std::make_tuple(a.point.position.s, a.point.position.theta, a.rank) <
             std::make_tuple(b.point.position.s, b.point.position.theta, b.rank);
    });
    std::vector<FilterPoint> points;
    std::vector<std::uint32_t> wanted;
    std::vector<std::uint32_t> ranks;  // of the wanted points
    for (const Entry& entry : entries) {
      const double s = entry.point.position.s;
      if (entry.rank != kFilled && s >= begin_ && s < end_) {
        wanted.push_back(static_cast<std::uint32_t>(points.size()));
        ranks.push_back(entry.rank);
      }
      points.push_back(entry.point);
    }
    FilterOptions options;
    options.sigma_space = model_.smoothing;
    options.attribute = model_.has_colors ? FilterAttribute::kColor : FilterAttribute::kNormal;
    options.sigma_attribute = model_.has_colors ? kSigmaColor : kSigmaNormal;
    const std::vector<double> deviations =
        filterDeviations(points, wanted, model_.prior.meanRadius(), options);
    std::vector<std::pair<std::uint32_t, std::size_t>> place_of;  // rank, place in smoothed
    for (std::size_t k = 0; k < own_.size(); ++k) {
      place_of.emplace_back(model_.points[own_[k]].rank, k);
    }
    std::sort(place_of.begin(), place_of.end());
    for (std::size_t k = 0; k < wanted.size(); ++k) {
      const auto at = std::lower_bound(place_of.begin(), place_of.end(),
                                       std::make_pair(ranks[k], std::size_t{0}));
      const FilterPoint& point = points[wanted[k]];
      const Eigen::Vector3d normal = normalOf(at->second, point.position);
      region_.smoothed[at->second] +=
          ((deviations[k] - point.deviation - model_.prior.noiseBias(point.position.s)) * normal)
              .cast<float>();
    }
  }

  /// Of the stem where one of the region's measured points is: away from the axis.
  Eigen::Vector3d normalOf(std::size_t own, const SurfacePosition& place) const {
    const StemFrame::Frame frame = model_.prior.frame().at(place.s);
    return (model_.points[own_[own]].point.cast<double>() - frame.position).normalized();
  }

  void keepMeasured() {
    for (const std::uint32_t i : own_) region_.smoothed.push_back(model_.points[i].point);
  }

  void finish(const CoarseMap& map) {
    static const TurnTable kTurn;
    const std::array<double, 2> ellipse = model_.prior.ellipse();
    region_.points.reserve(filled_.size());
    region_.stddev.reserve(filled_.size());
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
      const auto [cosine, sine] = kTurn.cosineAndSine(place.theta);
      const double outline =
          1.0 + ellipse[0] * (cosine * cosine - sine * sine) + ellipse[1] * 2.0 * cosine * sine;
      const double r = std::max(mean_radius * outline + point.deviation, 0.0);
      const Eigen::Vector3f position =
          (frame.position + r * (cosine * frame.u + sine * frame.v)).cast<float>();
      if (near_soil && model_.ground.heightAbove(position) < 0.0F) continue;
      region_.points.push_back(position);
      region_.stddev.push_back(std::sqrt(static_cast<float>(point.variance)));
      if (model_.has_colors) region_.colors.push_back(packed(map.at(place).rgb));
    }
  }

  const StemModel& model_;
  const std::vector<std::uint32_t>& own_;
  double begin_;
  double end_;
  long index_;
  StemShape shape_;
  std::vector<const StemPoint*> measured_;
  std::vector<SurfacePosition> positions_;
  std::vector<SurfaceSample> samples_;
  SurfaceIndex index_of_measured_;
  std::vector<CompletedPoint> filled_;
  bool may_have_holes_ = false;
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

std::pair<std::vector<StemPoint>::const_iterator, std::vector<StemPoint>::const_iterator>
pointsBetween(const StemModel& model, double begin, double end) {
  const auto before = [](const StemPoint& p, double s) { return p.unrolled.s < s; };
  const auto first = std::lower_bound(model.points.begin(), model.points.end(), begin, before);
  return {first, std::lower_bound(first, model.points.end(), end, before)};
}

StemRegion solveRegion(const StemModel& model, long index, const std::vector<std::uint32_t>& own) {
  return RegionSolver(model, index, own).solve();
}

}  // namespace field_phenotyping
