#include "field_phenotyping/completion/stem_region.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/completion/topology_repair.hpp"

namespace field_phenotyping {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr std::size_t kColorNeighbors = 4;
constexpr double kMapStep = 0.0151;  // [m] of the coarse map: fine against the kernels
constexpr int kMapColumns = 12;
constexpr double kSigmaNormal = 0.5;  // [-] of the difference of unit normals
constexpr double kSigmaColor = 0.2;   // [-] of rgb in [0, 1]

/// Surface, its uncertainty and its colour at the nodes of a coarse grid over one region, linear
/// between them: all are smooth at the kernels' scale.
class CoarseMap {
 public:
  struct Node {
    double deviation = 0.0;  ///< from the prior [m]
    double variance = 0.0;   ///< of the surface as far as the model goes [m^2]
    double misfit = 0.0;     ///< of what is finer than the model [m^2]
    Eigen::Vector3f rgb = Eigen::Vector3f::Zero();
  };

  CoarseMap(double begin, double end, bool has_colors)
      : has_colors_(has_colors),
        begin_(begin),
        rows_(std::max(1, static_cast<int>(std::ceil((end - begin) / kMapStep)))),
        step_((end - begin) / rows_),
        nodes_(static_cast<std::size_t>((rows_ + 1) * kMapColumns)) {}

  std::vector<Node>& nodes() { return nodes_; }
  SurfacePosition placeOf(std::size_t node) const {
    const auto column = static_cast<double>(node % kMapColumns);
    const auto row = static_cast<double>(node / kMapColumns);
    return {2.0 * kPi * column / kMapColumns - kPi, begin_ + row * step_};
  }

  /// The nodes interpolated at one arc length: places come row by row.
  class Row {
   public:
    Node at(double theta) const {
      const double turn = (theta + kPi) / (2.0 * kPi);
      const double round = (turn - std::floor(turn)) * kMapColumns;
      const int column = std::min(static_cast<int>(round), kMapColumns - 1);
      const Node& left = nodes_[static_cast<std::size_t>(column)];
      const Node& right = nodes_[static_cast<std::size_t>(column) + 1U];
      return mix(left, right, round - column, has_colors_);
    }

   private:
    friend class CoarseMap;

    std::array<Node, kMapColumns + 1> nodes_;  // the last is the first again
    bool has_colors_ = false;
  };

  Row rowAt(double s) const {
    const double up = std::clamp((s - begin_) / step_, 0.0, rows_ - 1e-9);
    const auto first = static_cast<std::size_t>(up) * kMapColumns;
    const double share = up - std::floor(up);
    Row row;
    row.has_colors_ = has_colors_;
    for (std::size_t k = 0; k < kMapColumns; ++k) {
      row.nodes_[k] = mix(nodes_[first + k], nodes_[first + kMapColumns + k], share, has_colors_);
    }
    row.nodes_[kMapColumns] = row.nodes_[0];
    return row;
  }

  Node at(const SurfacePosition& place) const { return rowAt(place.s).at(place.theta); }

 private:
  static Node mix(const Node& a, const Node& b, double share, bool has_colors) {
    Node node;
    node.deviation = a.deviation + share * (b.deviation - a.deviation);
    node.variance = a.variance + share * (b.variance - a.variance);
    node.misfit = a.misfit + share * (b.misfit - a.misfit);
    if (has_colors) node.rgb = a.rgb + static_cast<float>(share) * (b.rgb - a.rgb);
    return node;
  }

  bool has_colors_;
  double begin_;
  int rows_;
  double step_;
  std::vector<Node> nodes_;
};

/// Eq 23: mean of the nearest measured colours, weighted by inverse distance.
Eigen::Vector3f blendColors(const std::vector<const MeasuredSurface::Cell*>& cells,
                            const NearestOnSurface<kColorNeighbors>& nearest) {
  constexpr double kTouching = 1e-6;  // [m^2]
  double total = 0.0;
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (std::size_t k = 0; k < nearest.count; ++k) {
    const double weight = 1.0 / std::sqrt(nearest.squared_distance[k] + kTouching);
    sum += static_cast<float>(weight) * cells[nearest.index[k]]->rgb;
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

}  // namespace

class RegionSolver::Work {
 public:
  Work(const StemModel& model, long index)
      : model_(model),
        begin_(regionBegin(model.prior, index)),
        end_(begin_ + kRegionLength),
        index_(index),
        map_(begin_, end_, model.measured.hasColors()) {
    gather();
    region_.no_surface = !isOneSurface();
    if (!region_.no_surface) describe();
    describeGaps();
  }

  const RbfToRead* surface() const { return surface_ ? &*surface_ : nullptr; }

  const GapsToFill* gaps() const { return region_.no_surface ? nullptr : &gaps_; }

  void fill(const std::vector<double>& deviations, const GapSamples& samples) {
    if (region_.no_surface) return;
    for (std::size_t i = 0; i < deviations.size(); ++i) {
      map_.nodes()[read_nodes_[i]].deviation = deviations[i];
    }
    setMisfit();
    fillGaps(samples);
    repair();
    prepareFilter();
  }

  const FilterToSolve* filter() const { return filter_ ? &*filter_ : nullptr; }

  StemRegion finish(BilateralFilter filter) {
    if (region_.no_surface) return std::move(region_);
    region_.is_smoothed = filter_.has_value();
    region_.filter = std::move(filter);
    makePoints();
    return std::move(region_);
  }

 private:
  /// What was measured in the region and beside it.
  void gather() {
    const MeasuredSurface& measured = model_.measured;
    const long first = kSlicesPerRegion * index_ - 1;
    const long last = first + kSlicesPerRegion + 2;
    const auto [first_cell, end_cell] = measured.cellsOf(first, last);
    std::vector<SurfacePosition> positions;
    for (std::size_t i = first_cell; i < end_cell; ++i) {
      const MeasuredSurface::Cell& cell = measured.cells()[i];
      cells_.push_back(&cell);
      positions.push_back(cell.position);
      // Eq 20: z' = alpha z + (1 - alpha) f. Relative to f that is alpha (z - f), so that the
      // surface goes back to the prior where nothing was measured.
      samples_.push_back({cell.position, model_.prior_weight * cell.deviation, cell.weight});
    }
    index_of_cells_ = SurfaceIndex(positions, model_.prior.meanRadius());
    // Beside the region only those count that are as near as the density asks for.
    const double reach = 1.0 / std::sqrt(std::max(model_.density, 1.0));
    const auto [first_place, end_place] = measured.placesOf(first, last);
    gaps_.measured.reserve(end_place - first_place);
    for (std::size_t i = first_place; i < end_place; ++i) {
      const SurfacePosition& place = measured.places()[i];
      if (place.s > begin_ - reach && place.s < end_ + reach) gaps_.measured.push_back(place);
    }
  }

  /// Whether the region's points lie about its prior surface: not on the branches of a fork.
  bool isOneSurface() const {
    constexpr std::size_t kEnough = 8;
    constexpr double kLeastShare = 0.65;
    std::size_t all = 0U;
    std::size_t on_surface = 0U;
    for (long k = 0; k < kSlicesPerRegion; ++k) {
      const MeasuredSurface::Slice slice = model_.measured.slice(kSlicesPerRegion * index_ + k);
      all += slice.points;
      on_surface += slice.on_surface;
    }
    return all < kEnough ||
           static_cast<double>(on_surface) >= kLeastShare * static_cast<double>(all);
  }

  /// All of the map but the deviation, and where that is to be read. The variance is that of the
  /// prior, and of the deviation from it, of which less is known the farther the nearest measured
  /// point is.
  void describe() {
    RbfSystem system(thinSamples(samples_, model_.lattice), model_.prior.meanRadius(),
                     model_.surface);
    const double width = system.kernelWidth();
    const double amplitude = model_.surface.amplitude;
    const double weight = std::max(model_.prior_weight, kLeastPriorWeight);
    // Of what deviates from the prior Eq 20 leaves out a share wherever it was measured, and all of
    // it is unknown where nothing was.
    const double left_out = (1.0 - model_.prior_weight) / weight;
    std::vector<Vector3> places;
    for (std::size_t i = 0; i < map_.nodes().size(); ++i) {
      CoarseMap::Node& node = map_.nodes()[i];
      const SurfacePosition position = map_.placeOf(i);
      const Vector3 place = index_of_cells_.embed(position);
      const auto nearest = index_of_cells_.nearestWithin<1>(place, 2.0 * width);
      double known = 0.0;
      if (nearest.count > 0) {
        known = std::exp(-2.0 * nearest.squared_distance[0] / (width * width));
        read_nodes_.push_back(i);
        places.push_back(place);
      }
      const double bias = model_.prior.noiseBias(position.s);
      const double unknown = known * left_out * left_out + (1.0 - known) / (weight * weight);
      node.variance = model_.prior.variance(position.theta, position.s) +
                      amplitude * amplitude * unknown + 0.25 * bias * bias;
      if (model_.measured.hasColors()) {
        node.rgb = blendColors(cells_, index_of_cells_.nearest<kColorNeighbors>(place));
      }
    }
    if (!places.empty()) surface_.emplace(RbfToRead{std::move(system), std::move(places)});
  }

  /// What the points, leaf bases among them, scatter about the surface beyond the sensor's noise:
  /// of each patch and those round it, and of the stem as much as a few points have. And what that
  /// does to the coarse model.
  void setMisfit() {
    constexpr int kRows = MeasuredSurface::kPatchRows * static_cast<int>(kSlicesPerRegion);
    constexpr int kColumns = MeasuredSurface::kPatchColumns;
    constexpr double kOfStem = 10.0;  // points
    constexpr double kHeight = kRegionLength / kRows;
    const MeasuredSurface& measured = model_.measured;
    const double weight = std::max(model_.prior_weight, kLeastPriorWeight);
    std::array<MeasuredSurface::Patch, (kRows + 2) * kColumns> patches;
    for (int row = -1; row <= kRows; ++row) {
      const CoarseMap::Row surface = map_.rowAt(begin_ + (row + 0.5) * kHeight);
      for (int column = 0; column < kColumns; ++column) {
        MeasuredSurface::Patch patch = measured.patch(kSlicesPerRegion * index_, row, column);
        const double deviation =
            surface.at(2.0 * kPi * (column + 0.5) / kColumns - kPi).deviation / weight;
        patch.squares += deviation * (patch.points * deviation - 2.0 * patch.sum);
        patches[static_cast<std::size_t>((row + 1) * kColumns + column)] = patch;
      }
    }
    std::array<double, kRows * kColumns> misfit{};
    for (int row = 0; row < kRows; ++row) {
      for (int column = 0; column < kColumns; ++column) {
        double points = 0.0;
        double squares = 0.0;
        for (int r = row - 1; r <= row + 1; ++r) {
          for (int c = column - 1; c <= column + 1; ++c) {
            const int turned = (c + kColumns) % kColumns;
            const auto& patch = patches[static_cast<std::size_t>((r + 1) * kColumns + turned)];
            points += patch.points;
            squares += patch.squares;
          }
        }
        misfit[static_cast<std::size_t>(row * kColumns + column)] =
            (points * model_.scatter.beyondNoise(points, squares) +
             kOfStem * model_.scatter.misfit) /
            (points + kOfStem);
      }
    }
    for (std::size_t i = 0; i < map_.nodes().size(); ++i) {
      const SurfacePosition place = map_.placeOf(i);
      const auto row = static_cast<int>((place.s - begin_) / kHeight);
      const auto column = static_cast<int>((place.theta + kPi) / (2.0 * kPi) * kColumns);
      map_.nodes()[i].misfit =
          model_.prior.misfitVariance(place.theta, place.s) +
          misfit[static_cast<std::size_t>(std::clamp(row, 0, kRows - 1) * kColumns +
                                          std::clamp(column, 0, kColumns - 1))];
    }
  }

  /// Where points are missing. The places are there already.
  void describeGaps() {
    gaps_.range = model_.range;
    gaps_.range.begin = begin_;
    gaps_.range.end = end_;
    gaps_.density = model_.density;
    gaps_.shape.radius = [&prior = model_.prior](double s) { return prior.meanRadiusAt(s); };
    gaps_.shape.ellipse = model_.prior.ellipse();
    gaps_.mean_radius = model_.prior.meanRadius();
    gaps_.first_row = firstRow();
  }

  long firstRow() const {
    return index_ * std::lround(kRegionLength / rowHeight(kRegionLength, model_.density));
  }

  bool mayFill(double s) const { return s >= model_.range.begin && s <= model_.range.end; }

  bool isKnown(const CoarseMap::Node& node) const {
    const double most = model_.max_stddev;
    return !(most > 0.0) || node.variance <= most * most;
  }

  /// Step 3: the points that are missing, as far as the surface is known there.
  void fillGaps(const GapSamples& samples) {
    may_have_holes_ = samples.may_have_holes;
    filled_.reserve(samples.places.size());
    CoarseMap::Row row;
    double row_s = std::numeric_limits<double>::quiet_NaN();
    for (const SurfacePosition& place : samples.places) {
      if (!mayFill(place.s)) continue;
      if (place.s != row_s) {
        row_s = place.s;
        row = map_.rowAt(row_s);
      }
      const CoarseMap::Node node = row.at(place.theta);
      if (isKnown(node)) {
        filled_.push_back({place, node.deviation, node.variance + node.misfit});
      } else {
        ++region_.uncertain;
      }
    }
  }

  /// Step 6, topological repair. What was left open on purpose is no defect.
  void repair() {
    if (filled_.empty()) return;
    const double most_deviation = 4.0 * (model_.surface.amplitude + model_.surface.noise);
    const bool has_folds = std::any_of(filled_.begin(), filled_.end(), [&](const auto& point) {
      return !(std::abs(point.deviation) <= most_deviation);
    });
    if (!may_have_holes_ && !has_folds) return;
    const std::vector<GapRegion> defects = findDefects(gaps_, filled_, most_deviation);
    if (defects.empty()) return;
    std::vector<CompletedPoint> all = filled_;
    for (const SurfaceSample& sample : samples_) {
      all.push_back({sample.position, sample.value, 0.0});
    }
    std::vector<CompletedPoint> repaired;
    for (const GapRegion& defect : defects) {
      for (CompletedPoint& point :
           repairDefect(defect, all, model_.density, model_.prior.meanRadius(), model_.surface)) {
        const CoarseMap::Node node = map_.at(point.position);
        if (!mayFill(point.position.s) || !isKnown(node)) continue;
        if (!(std::abs(point.deviation) <= most_deviation)) continue;
        point.variance = node.variance + node.misfit;
        repaired.push_back(point);
      }
    }
    filled_.insert(filled_.end(), repaired.begin(), repaired.end());
  }

  /// Step 6, bilateral filter (Eq 25).
  void prepareFilter() {
    if (!(model_.smoothing > 0.0) || cells_.empty()) return;
    const MeasuredSurface& measured = model_.measured;
    const bool by_color = measured.hasColors();
    FilterToSolve& filter = filter_.emplace();
    filter.points.reserve(cells_.size());
    for (const MeasuredSurface::Cell* cell : cells_) {
      filter.points.push_back({{cell->position.theta, cell->position.s - begin_},
                               cell->deviation,
                               cell->weight,
                               by_color ? filterColorOf(cell->rgb) : FilterColor()});
    }
    filter.grid = {measured.rowHeight(),
                   static_cast<int>(kSlicesPerRegion) * measured.rowsPerSlice(),
                   measured.columns()};
    filter.radius = model_.prior.meanRadius();
    if (!by_color) addFilled(filter.grid, filter.points);  // it has no colour of its own
    filter.options.sigma_space = model_.smoothing;
    filter.options.attribute = by_color ? FilterAttribute::kColor : FilterAttribute::kNormal;
    filter.options.sigma_attribute = by_color ? kSigmaColor : kSigmaNormal;
  }

  /// What was filled into each cell of the grid, as one point: it lies on a smooth surface.
  void addFilled(const FilterGrid& grid, std::vector<FilterPoint>& points) const {
    const double turn_a_column = 2.0 * kPi / grid.columns;
    std::vector<double> counts(static_cast<std::size_t>(grid.rows * grid.columns), 0.0);
    double row_s = std::numeric_limits<double>::quiet_NaN();
    int at_row = 0;
    for (const CompletedPoint& point : filled_) {
      const double turn = (point.position.theta + kPi) / (2.0 * kPi);
      const auto column = static_cast<int>((turn - std::floor(turn)) * grid.columns);
      if (point.position.s != row_s) {
        row_s = point.position.s;
        at_row = static_cast<int>((row_s - begin_) / grid.row_height);
      }
      if (at_row < 0 || at_row >= grid.rows || column >= grid.columns) continue;
      counts[static_cast<std::size_t>(at_row * grid.columns + column)] += 1.0;
    }
    for (int row = 0; row < grid.rows; ++row) {
      const double s = (row + 0.5) * grid.row_height;
      const CoarseMap::Row deviations = map_.rowAt(begin_ + s);
      for (int column = 0; column < grid.columns; ++column) {
        const double count = counts[static_cast<std::size_t>(row * grid.columns + column)];
        if (!(count > 0.0)) continue;
        const double theta = (column + 0.5) * turn_a_column - kPi;
        FilterPoint point;
        point.position = {theta, s};
        point.deviation = deviations.at(theta).deviation;
        point.is_read = false;
        point.weight = count;
        points.push_back(point);
      }
    }
  }

  void makePoints() {
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
      if (model_.measured.hasColors()) region_.colors.push_back(packed(map_.at(place).rgb));
    }
  }

  const StemModel& model_;
  double begin_;
  double end_;
  long index_;
  std::vector<const MeasuredSurface::Cell*> cells_;
  GapsToFill gaps_;
  std::vector<SurfaceSample> samples_;
  SurfaceIndex index_of_cells_;
  CoarseMap map_;
  std::vector<std::size_t> read_nodes_;  // of the map, where the surface is read
  std::optional<RbfToRead> surface_;
  std::optional<FilterToSolve> filter_;
  std::vector<CompletedPoint> filled_;
  bool may_have_holes_ = false;
  StemRegion region_;
};

double ScatterModel::beyondNoise(double points, double squares) const {
  constexpr double kSignificant = 0.5;  // standard errors
  if (!(points > 1.0)) return 0.0;
  const double error = std::hypot(noise * std::sqrt(2.0 / points), noise_error);
  return std::max(squares / points - noise - kSignificant * error, 0.0);
}

FilterColor filterColorOf(const Eigen::Vector3f& rgb) {
  constexpr float kMost = 255.0F;
  return {rgb.x() / kMost, rgb.y() / kMost, rgb.z() / kMost};
}

long regionAt(const SurfacePrior& prior, double s) {
  const long slice = sliceAt(prior, s);
  return (slice - (slice % kSlicesPerRegion + kSlicesPerRegion) % kSlicesPerRegion) /
         kSlicesPerRegion;
}

double regionBegin(const SurfacePrior& prior, long index) {
  return sliceBegin(prior, kSlicesPerRegion * index);
}

RegionSolver::RegionSolver(const StemModel& model, long index)
    : work_(std::make_unique<Work>(model, index)) {}
RegionSolver::~RegionSolver() = default;
RegionSolver::RegionSolver(RegionSolver&&) noexcept = default;
RegionSolver& RegionSolver::operator=(RegionSolver&&) noexcept = default;

const RbfToRead* RegionSolver::surface() const {
  return work_->surface();
}

const GapsToFill* RegionSolver::gaps() const {
  return work_->gaps();
}

void RegionSolver::fill(const std::vector<double>& deviations, const GapSamples& samples) {
  withWideVectors([&] { work_->fill(deviations, samples); });
}

const FilterToSolve* RegionSolver::filter() const {
  return work_->filter();
}

StemRegion RegionSolver::finish(BilateralFilter filter) {
  return withWideVectors([&] { return work_->finish(std::move(filter)); });
}

StemRegion solveRegion(const StemModel& model, long index) {
  RegionSolver solver(model, index);
  const RbfToRead* surface = solver.surface();
  const GapsToFill* gaps = solver.gaps();
  solver.fill(surface != nullptr ? readSurface(*surface) : std::vector<double>(),
              gaps != nullptr ? sampleGaps(*gaps) : GapSamples());
  const FilterToSolve* filter = solver.filter();
  return solver.finish(filter != nullptr ? BilateralFilter(*filter) : BilateralFilter());
}

}  // namespace field_phenotyping
