#include "field_phenotyping/completion/stem_completion.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/gap_sampling.hpp"
#include "field_phenotyping/completion/rbf_surface.hpp"
#include "field_phenotyping/completion/sight_lines.hpp"
#include "field_phenotyping/completion/stem_region.hpp"
#include "field_phenotyping/completion/surface_index.hpp"
#include "field_phenotyping/completion/surface_prior.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTwoPi = 6.28318530717958647692;
constexpr double kMaxPoints = 40000.0;        // made up per stem, whatever density is asked for
constexpr double kMaxDensity = 1e6;           // [1/m^2] finer than any sensor
constexpr double kMinPointsPerMetre = 100.0;  // six for each knot of the coarse model: with fewer
                                              // it cannot tell noise from shape
constexpr double kSoilStep = 0.005;           // [m]
constexpr double kSameModel = 5e-5;           // [m] half of what a region taken over may be off
constexpr double kLevel = 0.15;  // of a settings' logarithm: what follows from all points of a
                                 // stem moves in such steps, so that a few more change nothing

/// The level next to a positive value.
double levelled(double value) {
  return std::exp(kLevel * std::round(std::log(value) / kLevel));
}

}  // namespace

/// What a region was solved from, and the result.
struct SolvedRegion {
  std::uint64_t points = 0U;            ///< hash of the measured points in and round it
  std::array<Eigen::Vector3d, 3> axis;  ///< of the coarse model, ends and middle [m]
  std::array<double, 3> radius{};       ///< [m]
  std::array<double, 3>
      soil{};  ///< height of the axis above it [m]; what is high above does not matter
  std::vector<double> range;  ///< what may be filled of it, from its begin [m]
  StemRegion region;
};

struct StemState {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::vector<double> settings;  ///< all that regions share
  std::array<double, 2> ellipse{};
  ScatterModel scatter;
  std::map<long, std::shared_ptr<const SolvedRegion>> regions;
};

namespace {

/// Cells of the measured surface: fine against the bilateral filter, whatever the points' number.
double cellOf(const SurfacePrior& prior, const CompletionParameters& parameters) {
  constexpr double kOfFilter = 0.75;
  constexpr double kOfRadius = 0.225;  // where nothing is filtered
  constexpr double kLeast = 0.001;     // [m]
  constexpr double kMost = 0.015;      // [m]
  const double share = parameters.smoothing > 0.0 ? kOfFilter * parameters.smoothing : kOfRadius;
  return std::clamp(share * levelled(prior.meanRadius()), kLeast, kMost);
}

std::vector<SurfaceSample> surfaceSamples(const MeasuredSurface& measured, double prior_weight) {
  std::vector<SurfaceSample> samples;
  for (const MeasuredSurface::Cell& cell : measured.cells()) {
    samples.push_back({cell.position, prior_weight * cell.deviation, cell.weight});
  }
  return samples;
}

/// How far the stem may be carried on below its lowest measured point: a measured end bears half of
/// a gap, and the stem is known to reach the soil.
double lowerEnd(const SurfacePrior& prior, const GroundModel& ground, double lowest,
                double max_gap) {
  if (ground.empty()) return lowest;
  for (double s = lowest; s >= lowest - 0.5 * max_gap; s -= kSoilStep) {
    if (ground.heightAbove(prior.frame().at(s).position.cast<float>()) <= 0.0F) return s;
  }
  return lowest;
}

/// Of a stem with many points a part tells the density.
double ownDensity(const MeasuredSurface& measured, double radius) {
  constexpr std::size_t kMostPlaces = 4000;
  const std::size_t stride = 1U + measured.size() / kMostPlaces;
  std::vector<SurfacePosition> part;
  for (std::size_t i = 0; i < measured.size(); i += stride) part.push_back(measured.places()[i]);
  return static_cast<double>(stride) * medianDensity(SurfaceIndex(part, radius), part);
}

/// Stretches of the stem without any measured point that beams went right through.
/// @param begin where filling begins [m]
std::vector<std::pair<double, double>> seenEmpty(const PointCloud& cloud, IndexSpan stem,
                                                 const SurfacePrior& prior,
                                                 const MeasuredSurface& measured, double begin) {
  constexpr double kLeast = 0.02;  // [m] shorter ones are between points
  std::vector<std::pair<double, double>> unseen;
  double end = begin;
  for (const double s : measured.rowEnds()) {
    if (s - end > kLeast) unseen.emplace_back(end, s);
    end = s;
  }
  std::vector<std::pair<double, double>> empty;
  if (unseen.empty() || !cloud.hasScanOrigins()) return empty;
  for (const auto& [low, high] : emptyStretches(prior, sightLinesPast(cloud, stem, prior))) {
    for (const auto& [from, to] : unseen) {
      if (std::min(high, to) > std::max(low, from)) {
        empty.emplace_back(std::max(low, from), std::min(high, to));
      }
    }
  }
  return empty;
}

double densityOf(const MeasuredSurface& measured, const SurfacePrior& prior, double length,
                 const CompletionParameters& parameters) {
  double density = parameters.density;
  if (!(density > 0.0)) {
    const double around = parameters.points_around / (kTwoPi * prior.meanRadius());
    density = std::max(ownDensity(measured, prior.meanRadius()), around * around);
    if (density > 0.0) density = levelled(density);
  }
  const double area = kTwoPi * prior.meanRadius() * length;
  return std::min({density, kMaxDensity, area > 0.0 ? kMaxPoints / area : kMaxDensity});
}

/// Centres at fixed places, about as many as wanted.
CenterLattice latticeOf(const SurfacePrior& prior, double max_centers) {
  constexpr double kLeastCell = 0.008;  // [m] finer structure than noise lets through
  const double around = kTwoPi * levelled(prior.meanRadius());
  const double cell =
      std::max(kLeastCell, std::sqrt(around * levelled(prior.frame().length()) / max_centers));
  return {kRegionLength / std::max(1.0, std::floor(kRegionLength / cell)),
          std::max(3, static_cast<int>(std::floor(around / cell)))};
}

SolvedRegion describeRegion(const StemModel& model, long index) {
  SolvedRegion solved;
  const double begin = regionBegin(model.prior, index);
  for (long k = -1; k <= kSlicesPerRegion; ++k) {
    solved.points += model.measured.slice(kSlicesPerRegion * index + k).hash;
  }
  for (std::size_t k = 0; k < 3; ++k) {
    const double s = begin + 0.5 * kRegionLength * static_cast<double>(k);
    solved.axis[k] = model.prior.frame().at(s).position;
    solved.radius[k] = model.prior.meanRadiusAt(s);
    constexpr double kHigh = 0.2;  // [m] from there on no point can reach the soil
    solved.soil[k] =
        model.ground.empty()
            ? kHigh
            : std::min(kHigh,
                       static_cast<double>(model.ground.heightAbove(solved.axis[k].cast<float>())));
  }
  const auto within = [&](double s) { return std::clamp(s - begin, 0.0, kRegionLength); };
  solved.range = {within(model.range.begin), within(model.range.end)};
  for (const auto& [open_begin, open_end] : model.range.open) {
    if (open_end <= begin || open_begin >= begin + kRegionLength) continue;
    solved.range.push_back(within(open_begin));
    solved.range.push_back(within(open_end));
  }
  return solved;
}

bool isSame(const SolvedRegion& a, const SolvedRegion& b) {
  if (a.points != b.points || a.range.size() != b.range.size()) return false;
  for (std::size_t k = 0; k < a.range.size(); ++k) {
    if (std::abs(a.range[k] - b.range[k]) > kSameModel) return false;
  }
  for (std::size_t k = 0; k < a.axis.size(); ++k) {
    if (std::abs(a.soil[k] - b.soil[k]) > kSameModel) return false;
    if ((a.axis[k] - b.axis[k]).norm() + std::abs(a.radius[k] - b.radius[k]) > kSameModel) {
      return false;
    }
  }
  return true;
}

/// Whether standard deviations by either differ little.
bool isAbout(const ScatterModel& a, const ScatterModel& b) {
  constexpr double kShare = 0.2;   // of the variances
  constexpr double kLeast = 1e-8;  // [m^2]
  const double close = kShare * (a.noise + a.misfit) + kLeast;
  return std::abs(a.noise - b.noise) < close && std::abs(a.misfit - b.misfit) < close;
}

/// All that the regions share, beside the coarse model.
std::vector<double> settingsOf(const StemModel& model) {
  return {model.density,
          model.prior_weight,
          model.smoothing,
          model.max_stddev,
          model.scatter.noise,
          model.scatter.noise_error,
          model.scatter.misfit,
          model.lattice.row_height,
          static_cast<double>(model.lattice.columns),
          model.surface.kernel_scale,
          model.surface.ridge,
          model.surface.noise,
          model.surface.amplitude};
}

/// The measured points of the picture after the bilateral filter (Eq 25): each along its normal.
void smoothMeasured(const PointCloud& cloud, IndexSpan stem, const SurfacePrior& prior,
                    const MeasuredSurface& measured, const StemState& state,
                    std::vector<Eigen::Vector3f>& smoothed) {
  long index = 0;
  const StemRegion* region = nullptr;
  for (std::size_t i = 0; i < measured.points().size(); ++i) {
    const MeasuredSurface::Point& p = measured.points()[i];
    if (!p.on_surface) continue;
    const long at = regionAt(prior, p.position.s);
    if (region == nullptr || at != index) {
      region = &state.regions.at(at)->region;
      index = at;
    }
    if (!region->is_smoothed) continue;
    FilterColor color;
    if (cloud.hasColors()) color = filterColorOf(rgbOf(cloud.colors[stem.begin + i]));
    const SurfacePosition place{p.position.theta, p.position.s - regionBegin(prior, index)};
    const auto filtered = static_cast<float>(region->filter.at(place, color));
    smoothed[i] += (filtered - p.deviation - p.noise_bias) * p.outward;
  }
}

/// A stem while its regions are solved.
class StemInWork {
 public:
  /// @param cloud, ground, and what `to_complete` points to, must stay as long as this
  StemInWork(const PointCloud& cloud, const StemToComplete& to_complete, const GroundModel& ground,
             const CompletionParameters& parameters)
      : cloud_(cloud), stem_(to_complete.stem), is_last_(to_complete.is_last) {
    completed_.solution.smoothed.assign(cloud.points.begin() + stem_.begin,
                                        cloud.points.begin() + stem_.end);
    const auto min_points = static_cast<std::size_t>(parameters.min_points);
    if (stem_.size() < min_points) {
      completed_.solution.flags = kCompletionTooFewPoints;
      return;
    }
    completed_.solution.flags = kCompletionNoSurface;
    if (to_complete.prior == nullptr) return;
    const SurfacePrior& prior = *to_complete.prior;
    measured_.emplace(cloud, stem_, prior, cellOf(prior, parameters));
    if (measured_->size() < min_points) return;
    completed_.solution.flags = 0U;
    const double seen = measured_->highest() - measured_->lowest();
    if (static_cast<double>(measured_->size()) < kMinPointsPerMetre * seen) {
      completed_.solution.flags = kCompletionTooFewPoints;
      return;
    }
    describe(StemModel{prior, *measured_, ground}, parameters, to_complete.previous);
    listRegions(to_complete.previous);
  }
  StemInWork(const StemInWork&) = delete;
  StemInWork& operator=(const StemInWork&) = delete;

  /// A region that is to be solved anew.
  struct OpenRegion {
    long index;
    std::shared_ptr<SolvedRegion> solved;
  };
  const std::vector<OpenRegion>& open() const { return open_; }
  /// Of those.
  const StemModel& model() const { return *model_; }

  /// Once all open regions are solved.
  CompletedStem finish() {
    if (!model_) return std::move(completed_);
    for (const auto& [index, solved] : state_->regions) {
      const StemRegion& region = solved->region;
      completed_.points.insert(completed_.points.end(), region.points.begin(), region.points.end());
      completed_.colors.insert(completed_.colors.end(), region.colors.begin(), region.colors.end());
      completed_.stddev.insert(completed_.stddev.end(), region.stddev.begin(), region.stddev.end());
      if (region.uncertain > 0U) completed_.solution.flags |= kCompletionUncertain;
      if (region.no_surface) completed_.solution.flags |= kCompletionNoSurface;
    }
    smoothMeasured(cloud_, stem_, model_->prior, *measured_, *state_, completed_.solution.smoothed);
    if (!is_last_) completed_.solution.state = state_;
    return std::move(completed_);
  }

 private:
  void describe(StemModel model, const CompletionParameters& parameters,
                const StemState* previous) {
    const SurfacePrior& prior = model.prior;
    const MeasuredSurface& measured = model.measured;
    model.prior_weight = parameters.prior_weight;
    model.range = findFillRange(measured.rowEnds(), parameters.max_gap);
    model.range.begin = lowerEnd(prior, model.ground, model.range.begin, parameters.max_gap);
    if (!model.range.open.empty()) completed_.solution.flags |= kCompletionOpenGap;
    for (const auto& stretch : seenEmpty(cloud_, stem_, prior, measured, model.range.begin)) {
      model.range.open.push_back(stretch);
      completed_.solution.flags |= kCompletionSeenEmpty;
    }
    model.density = densityOf(measured, prior, model.range.end - model.range.begin, parameters);
    completed_.density = model.density;
    model.smoothing = parameters.smoothing * levelled(prior.meanRadius());
    model.max_stddev = parameters.max_stddev;
    model.lattice = latticeOf(prior, parameters.max_centers);
    model.surface.kernel_scale = parameters.kernel_scale;
    model.surface.ridge = parameters.ridge;
    model.surface.noise = parameters.prior_weight * levelled(prior.noise());
    model.surface.amplitude = levelled(
        amplitudeOf(thinSamples(surfaceSamples(measured, parameters.prior_weight), model.lattice),
                    parameters.prior_weight * prior.noise()));
    const double amplitude =
        model.surface.amplitude / std::max(parameters.prior_weight, kLeastPriorWeight);
    model.scatter = {measured.noiseVariance(), measured.noiseVarianceError(), 0.0};
    model.scatter.misfit =
        std::max(model.scatter.beyondNoise(measured.whole().points, measured.whole().squares) -
                     amplitude * amplitude,
                 0.0);
    if (previous != nullptr && isAbout(previous->scatter, model.scatter)) {
      model.scatter = previous->scatter;
    }
    model.surface.center_area =
        model.lattice.row_height * kTwoPi * levelled(prior.meanRadius()) / model.lattice.columns;
    model_.emplace(std::move(model));
  }

  void listRegions(const StemState* previous) {
    const SurfacePrior& prior = model_->prior;
    state_ = std::make_shared<StemState>();
    state_->origin = cloud_.origin;
    state_->settings = settingsOf(*model_);
    state_->ellipse = prior.ellipse();
    state_->scatter = model_->scatter;
    const bool may_take_over = previous != nullptr && previous->origin == cloud_.origin &&
                               previous->settings == state_->settings &&
                               std::hypot(previous->ellipse[0] - state_->ellipse[0],
                                          previous->ellipse[1] - state_->ellipse[1]) *
                                       prior.meanRadius() <
                                   kSameModel;
    const double low = std::min(model_->range.begin, measured_->lowest());
    const double high = std::max(model_->range.end, measured_->highest());
    for (long k = regionAt(prior, low); k <= regionAt(prior, high); ++k) {
      auto solved = std::make_shared<SolvedRegion>(describeRegion(*model_, k));
      ++completed_.solution.regions;
      const auto old = may_take_over ? previous->regions.find(k) : state_->regions.end();
      if (may_take_over && old != previous->regions.end() && isSame(*old->second, *solved)) {
        state_->regions.emplace(k, old->second);
        continue;
      }
      ++completed_.solution.regions_solved;
      state_->regions.emplace(k, solved);
      open_.push_back({k, std::move(solved)});
    }
  }

  const PointCloud& cloud_;
  IndexSpan stem_;
  bool is_last_;
  std::optional<MeasuredSurface> measured_;
  std::optional<StemModel> model_;
  std::shared_ptr<StemState> state_;
  std::vector<OpenRegion> open_;
  CompletedStem completed_;
};

/// What many solvers ask, so that all is answered at once; some ask nothing.
template <class Question>
struct Questions {
  std::vector<const Question*> all;
  std::vector<std::optional<std::size_t>> of_solver;

  Questions(const std::vector<std::optional<RegionSolver>>& solvers,
            const Question* (RegionSolver::*question)() const)
      : of_solver(solvers.size()) {
    for (std::size_t i = 0; i < solvers.size(); ++i) {
      const Question* asked = ((*solvers[i]).*question)();
      if (asked == nullptr) continue;
      of_solver[i] = all.size();
      all.push_back(asked);
    }
  }

  /// Takes what that solver gets; a default value where it has asked nothing.
  template <class Answer>
  Answer answer(std::size_t solver, std::vector<Answer>& answers) const {
    return of_solver[solver] ? std::move(answers[*of_solver[solver]]) : Answer();
  }
};

/// Solves open regions of many stems together.
void solveTogether(const std::vector<std::unique_ptr<StemInWork>>& stems,
                   const ComputeDevice& device) {
  struct Task {
    const StemInWork* stem;
    const StemInWork::OpenRegion* region;
  };
  std::vector<Task> tasks;
  for (const std::unique_ptr<StemInWork>& stem : stems) {
    for (const StemInWork::OpenRegion& region : stem->open()) {
      tasks.push_back({stem.get(), &region});
    }
  }
  std::vector<std::optional<RegionSolver>> solvers(tasks.size());
  parallelFor(tasks.size(), [&](std::size_t i) {
    solvers[i].emplace(tasks[i].stem->model(), tasks[i].region->index);
  });
  const Questions<RbfToRead> surfaces(solvers, &RegionSolver::surface);
  const Questions<GapsToFill> gaps(solvers, &RegionSolver::gaps);
  std::vector<std::vector<double>> deviations = readSurfaces(surfaces.all, device);
  std::vector<GapSamples> samples = sampleGaps(gaps.all, device);
  parallelFor(tasks.size(), [&](std::size_t i) {
    solvers[i]->fill(surfaces.answer(i, deviations), gaps.answer(i, samples));
  });
  const Questions<FilterToSolve> to_filter(solvers, &RegionSolver::filter);
  std::vector<BilateralFilter> filters = solveFilters(to_filter.all, device);
  parallelFor(tasks.size(), [&](std::size_t i) {
    tasks[i].region->solved->region = solvers[i]->finish(to_filter.answer(i, filters));
  });
}

}  // namespace

StemToModel stemToModel(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                        const CompletionParameters& parameters) {
  StemToModel to_model{{}, &axis, 0.5 * parameters.max_gap};
  if (stem.size() < static_cast<std::size_t>(parameters.min_points)) return to_model;
  to_model.points.reserve(stem.size());
  for (std::uint32_t i = stem.begin; i < stem.end; ++i) {
    to_model.points.push_back(cloud.points[i].cast<double>());
  }
  return to_model;
}

CompletedStem completeStem(const PointCloud& cloud, IndexSpan stem, const StemAxis& axis,
                           const GroundModel& ground, const CompletionParameters& parameters,
                           const StemState* previous) {
  const auto priors = fitSurfacePriors({stemToModel(cloud, stem, axis, parameters)}, {});
  const StemToComplete to_complete{stem, priors.front() ? &*priors.front() : nullptr, previous};
  return std::move(completeStems(cloud, {to_complete}, ground, parameters, {}).front());
}

std::vector<CompletedStem> completeStems(const PointCloud& cloud,
                                         const std::vector<StemToComplete>& stems,
                                         const GroundModel& ground,
                                         const CompletionParameters& parameters,
                                         const ComputeDevice& device) {
  std::vector<CompletedStem> completed(stems.size());
  if (device.hasGpu()) {
    // While some are on the GPU others are made ready for it, and read from it.
    constexpr std::size_t kAtOnce = 16U;
    parallelChunks(stems.size(), kAtOnce, [&](std::size_t begin, std::size_t end) {
      const auto first = stems.begin() + static_cast<std::ptrdiff_t>(begin);
      std::vector<CompletedStem> some =
          completeStemsTogether(cloud, {first, stems.begin() + static_cast<std::ptrdiff_t>(end)},
                                ground, parameters, device);
      std::move(some.begin(), some.end(), completed.begin() + static_cast<std::ptrdiff_t>(begin));
    });
    return completed;
  }
  parallelFor(stems.size(), [&](std::size_t i) {
    StemInWork stem(cloud, stems[i], ground, parameters);
    for (const StemInWork::OpenRegion& region : stem.open()) {
      region.solved->region = solveRegion(stem.model(), region.index);
    }
    completed[i] = stem.finish();
  });
  return completed;
}

std::vector<CompletedStem> completeStemsTogether(const PointCloud& cloud,
                                                 const std::vector<StemToComplete>& stems,
                                                 const GroundModel& ground,
                                                 const CompletionParameters& parameters,
                                                 const ComputeDevice& device) {
  std::vector<std::unique_ptr<StemInWork>> in_work(stems.size());
  parallelFor(stems.size(), [&](std::size_t i) {
    in_work[i] = std::make_unique<StemInWork>(cloud, stems[i], ground, parameters);
  });
  solveTogether(in_work, device);
  std::vector<CompletedStem> completed(stems.size());
  parallelFor(stems.size(), [&](std::size_t i) { completed[i] = in_work[i]->finish(); });
  return completed;
}

}  // namespace field_phenotyping
