#include "field_phenotyping/preprocessing/preprocessor.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/spatial_order.hpp"
#include "field_phenotyping/preprocessing/ground_estimation.hpp"
#include "field_phenotyping/preprocessing/outlier_filter.hpp"
#include "field_phenotyping/preprocessing/voxel_map.hpp"

namespace field_phenotyping {
namespace {

constexpr double kNanosecond = 1e-9;

/// What the streaming side knows about one tile.
struct TileState {
  std::uint64_t began_ns = 0U;      // first scan that reached the tile
  std::uint64_t touched_ns = 0U;    // newest scan that reached the block (tile or margin)
  std::uint64_t handed_on_ns = 0U;  // newest scan when it was last handed on
  std::size_t new_voxels = 0U;      // of the tile, since it was last handed on
  std::size_t old_voxels = 0U;      // of the tile, when it was last handed on
  std::uint32_t revision = 0U;
  bool dirty = false;  // anything in the block changed since it was last handed on
  bool draft = false;  // handed on as a draft, and no better since
  bool final = false;  // handed on as final since its last change
  bool evict = false;  // to be finished and forgotten: memory is short
};

/// A tile that points of the scan that is being added have fallen into: most fall into the same as
/// the one before.
struct ReachedTile {
  BlockIndex index;
  TileState* state = nullptr;
  VoxelTile* tile = nullptr;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::set<BlockIndex> touched;  // blocks that these points have touched
};

/// What became of the points of a scan.
struct Tally {
  ScanReport report;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();  // of those that are kept [m]
};

/// Some points of a whole cloud, by tile.
struct PlacedPoints {
  struct InTile {
    std::vector<Eigen::Vector3f> points;  // from the tile's origin [m]
    std::vector<BlockIndex> around;       // other blocks in whose margins any of them lies
  };
  std::map<BlockIndex, InTile> tiles;
  Tally tally;
};

PointCloud select(const PointCloud& cloud, const std::vector<std::uint8_t>& flags,
                  std::uint8_t wanted) {
  return taken(cloud,
               indicesWhere(flags.size(), [&](std::size_t i) { return flags[i] == wanted; }));
}

/// How many of the tiles adjoin tile `index`.
std::ptrdiff_t sharedEdges(const BlockIndex& index, const std::vector<BlockIndex>& tiles) {
  return std::count_if(tiles.begin(), tiles.end(), [&](const BlockIndex& other) {
    return std::abs(index.x - other.x) + std::abs(index.y - other.y) == 1;
  });
}

/// Puts a thinned cloud in spatialOrder(): the stages that follow go from neighbour to neighbour,
/// and a large one does not fit the processor's cache.
void putInOrder(PointCloud& cloud, DensePoints& dense) {
  constexpr std::size_t kFitsCache = 65536U;
  if (cloud.size() <= kFitsCache) return;
  const std::vector<std::uint32_t> order = spatialOrder(cloud.points);
  cloud = taken(cloud, order);
  if (dense.empty()) return;
  std::vector<std::uint32_t> place(order.size());  // of each point in the order
  for (std::uint32_t k = 0; k < order.size(); ++k) place[order[k]] = k;
  constexpr std::size_t kChunk = 65536U;
  parallelChunks(dense.thinned.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      std::uint32_t& number = dense.thinned[i];
      if (number < place.size()) number = place[number];
    }
  });
}

}  // namespace

Block finishBlock(BlockPoints points, const PreprocessingParameters& parameters,
                  const ComputeDevice& device, DensePoints* before_thinning) {
  Block block;
  block.header = std::move(points.header);
  block.joined = std::move(points.joined);
  // 1. Without outliers; 2. the soil; 3. taken out; 4. thinned; 5. what is near lies side by side.
  const auto keep = radiusOutlierFilter(points.cloud, static_cast<float>(parameters.outlier_radius),
                                        parameters.outlier_min_neighbors, device);
  const PointCloud cloud = select(points.cloud, keep, 1U);
  block.ground = estimateGround(cloud, parameters, device);
  const auto is_ground = classifyGround(cloud, block.ground, parameters);
  block.cloud = select(cloud, is_ground, 0U);
  block.ground_points = static_cast<std::uint32_t>(cloud.size() - block.cloud.size());
  block.feet = select(cloud, soilAtFeet(cloud, block.ground, is_ground), 1U);
  const PointCloud outliers = select(points.cloud, keep, 0U);
  block.isolated = select(outliers, classifyGround(outliers, block.ground, parameters), 0U);
  const double density = block.header.draft ? parameters.draft_density : parameters.max_density;
  DensePoints dense = thin(block.cloud, block.feet, block.isolated, density, parameters.voxel_size);
  putInOrder(block.cloud, dense);
  if (before_thinning != nullptr) *before_thinning = std::move(dense);
  return block;
}

BlockPoints partOf(const BlockPoints& tile, const Eigen::AlignedBox2d& part) {
  if (part.isEmpty()) return tile;
  BlockPoints of_part;
  of_part.header = tile.header;
  of_part.header.part = part;
  const Eigen::Vector2d reach = Eigen::Vector2d::Constant(tile.header.margin);
  const Eigen::Vector2d origin = tile.cloud.origin.head<2>();
  const Eigen::AlignedBox2f box((part.min() - reach - origin).cast<float>(),
                                (part.max() + reach - origin).cast<float>());
  of_part.cloud = taken(tile.cloud, indicesWhere(tile.cloud.size(), [&](std::size_t i) {
                          return box.contains(tile.cloud.points[i].head<2>());
                        }));
  return of_part;
}

struct Preprocessor::Impl {
  Impl(const PreprocessingParameters& initial_parameters, std::string frame,
       const Eigen::Vector2d& corner)
      : parameters(initial_parameters),
        frame_id(std::move(frame)),
        tile_corner(corner),
        map(parameters.block_size, parameters.voxel_size, tile_corner) {}

  void clear() {
    map = VoxelMap(parameters.block_size, parameters.voxel_size, tile_corner);
    states.clear();
    voxel_count = 0U;
    newest_ns = 0U;
    has_datum = false;
    last_sensor.reset();
  }

  bool inRange(const Eigen::Vector3d& from_sensor) const {
    const double range = from_sensor.norm();
    return range >= parameters.min_range && range <= parameters.max_range;
  }

  bool inCropBox(const Eigen::Vector3d& p) const {
    return p.x() >= parameters.min_x && p.x() <= parameters.max_x && p.y() >= parameters.min_y &&
           p.y() <= parameters.max_y && p.z() >= parameters.min_z && p.z() <= parameters.max_z;
  }

  void chooseHeightDatum(const Scan& scan, const Eigen::Isometry3d& T_map_sensor);
  std::optional<Eigen::Vector3d> sensorOf(const Scan& scan, const Eigen::Isometry3d& T_map_sensor);
  ReachedTile& reach(const BlockIndex& index);
  template <class Visit>
  void forEachKept(const Scan& scan, const Eigen::Isometry3d& T_map_sensor, std::size_t begin,
                   std::size_t end, Tally& tally, const Visit& visit) const;
  void addOneByOne(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                   const std::optional<Eigen::Vector3d>& sensor, Tally& tally);
  PlacedPoints place(const Scan& scan, const Eigen::Isometry3d& T_map_sensor, std::size_t begin,
                     std::size_t end) const;
  void addWhole(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                const ComputeDevice& device, Tally& tally);
  void touch(TileState& state) const;
  void touchBlocksAround(ReachedTile& reached, const Eigen::Vector3f& local);
  template <class Visit>
  void forEachBlockAround(const BlockIndex& index, const Eigen::Vector3f& local,
                          Visit&& visit) const;
  void chooseEvictions();
  bool isFinal(const TileState& state) const;
  BlockHeader headerOf(const BlockIndex& index, bool flush, bool draft) const;
  bool hasChanged(const TileState& state) const;
  bool isFar(const BlockIndex& index) const;
  bool mayForget(const BlockIndex& index, const TileState& state) const;

  PreprocessingParameters parameters;
  std::string frame_id;
  Eigen::Vector2d tile_corner;
  VoxelMap map;
  std::map<BlockIndex, TileState> states;
  std::map<BlockIndex, ReachedTile> reached_tiles;  // by the scan that is being added
  ReachedTile* last_reached = nullptr;              // of those
  std::size_t voxel_count = 0U;
  std::uint64_t newest_ns = 0U;
  Eigen::Vector2d scan_center = Eigen::Vector2d::Zero();
  bool has_datum = false;
  std::optional<Eigen::Vector3d> last_sensor;  // where it was at the scan before
};

ReachedTile& Preprocessor::Impl::reach(const BlockIndex& index) {
  if (last_reached != nullptr && last_reached->index == index) return *last_reached;
  const auto [reached, first_of_scan] = reached_tiles.try_emplace(index);
  last_reached = &reached->second;
  if (!first_of_scan) return *last_reached;
  const auto [state, fresh] = states.try_emplace(index);
  if (fresh) state->second.began_ns = newest_ns;
  last_reached->index = index;
  last_reached->state = &state->second;
  last_reached->tile = &map.tile(index);
  last_reached->origin = map.originOf(index);
  return *last_reached;
}

void Preprocessor::Impl::touch(TileState& state) const {
  state.touched_ns = newest_ns;
  state.dirty = true;
  state.final = false;
}

/// Calls visit(block) for each other block whose margin holds a point of tile `index`.
template <class Visit>
void Preprocessor::Impl::forEachBlockAround(const BlockIndex& index, const Eigen::Vector3f& local,
                                            Visit&& visit) const {
  const auto half = static_cast<float>(0.5 * parameters.block_size);
  const auto size = static_cast<float>(parameters.block_size);
  const auto margin = static_cast<float>(parameters.block_margin);
  const bool inside = local.cwiseAbs().head<2>().maxCoeff() < half - margin;
  if (inside) return;
  const int rings = static_cast<int>(std::ceil(parameters.block_margin / parameters.block_size));
  for (int dy = -rings; dy <= rings; ++dy) {
    for (int dx = -rings; dx <= rings; ++dx) {
      const float away_x = std::abs(local.x() - static_cast<float>(dx) * size) - half;
      const float away_y = std::abs(local.y() - static_cast<float>(dy) * size) - half;
      if (away_x > margin || away_y > margin) continue;
      visit(BlockIndex{index.x + dx, index.y + dy});
    }
  }
}

/// Every block whose tile or margin holds the point has changed.
void Preprocessor::Impl::touchBlocksAround(ReachedTile& reached, const Eigen::Vector3f& local) {
  touch(*reached.state);
  forEachBlockAround(reached.index, local, [&](const BlockIndex& neighbor) {
    if (reached.touched.count(neighbor) > 0U) return;
    const auto found = states.find(neighbor);
    if (found == states.end()) return;
    touch(found->second);
    reached.touched.insert(neighbor);
  });
}

/// The datum is the median height of the first scan, so that no stray return can set it.
void Preprocessor::Impl::chooseHeightDatum(const Scan& scan,
                                           const Eigen::Isometry3d& T_map_sensor) {
  constexpr std::size_t kSamples = 1001U;
  const std::size_t step = std::max<std::size_t>(1U, scan.cloud.size() / kSamples);
  std::vector<double> heights;
  for (std::size_t i = 0; i < scan.cloud.size(); i += step) {
    const Eigen::Vector3d p = T_map_sensor * scan.cloud.mapPoint(i);
    if (p.allFinite() && inCropBox(p)) heights.push_back(p.z());
  }
  if (heights.empty()) return;
  // About whole metres, of whole voxels: wherever the datum lies, the voxels are the same.
  const double step_height =
      std::max(1.0, std::round(1.0 / parameters.voxel_size)) * parameters.voxel_size;
  map.setHeightDatum(std::floor(medianOf(std::move(heights)) / step_height) * step_height);
  has_datum = true;
}

/// Where the sensor was, if it stood about still: a scan has one pose, and a sensor that moves on
/// during it was elsewhere for most of its beams, which then seem to go through stems.
std::optional<Eigen::Vector3d> Preprocessor::Impl::sensorOf(const Scan& scan,
                                                            const Eigen::Isometry3d& T_map_sensor) {
  constexpr double kStill = 0.01;  // [m] from one scan to the next
  std::optional<Eigen::Vector3d> sensor;
  if (scan.origin) sensor = T_map_sensor * *scan.origin;
  const bool still = sensor && last_sensor && (*sensor - *last_sensor).norm() <= kStill;
  last_sensor = sensor;
  return still ? sensor : std::nullopt;
}

/// Calls visit(number, tile, place from the tile's origin [m]) for the points begin ... end - 1 of
/// a scan, but for those that are no numbers, out of range, or too far from the map's other points
/// to be kept.
template <class Visit>
void Preprocessor::Impl::forEachKept(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                                     std::size_t begin, std::size_t end, Tally& tally,
                                     const Visit& visit) const {
  for (std::size_t i = begin; i < end; ++i) {
    if (!scan.cloud.points[i].allFinite()) {
      ++tally.report.non_finite;
      continue;
    }
    const Eigen::Vector3d from_sensor = scan.cloud.mapPoint(i);
    const Eigen::Vector3d p = T_map_sensor * from_sensor;
    if (inRange(from_sensor) && inCropBox(p)) {
      const BlockIndex index = map.tileAt(p.x(), p.y());
      const Eigen::Vector3f local = (p - map.originOf(index)).cast<float>();
      if (hasVoxelKey(local, map.voxelSize())) {
        visit(i, index, local);
        tally.sum += p.head<2>();
        ++tally.report.used;
        continue;
      }
    }
    ++tally.report.out_of_range;
  }
}

/// @param sensor where it was, if known
void Preprocessor::Impl::addOneByOne(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                                     const std::optional<Eigen::Vector3d>& sensor, Tally& tally) {
  const bool with_color = scan.cloud.hasColors();
  const auto insert = [&](std::size_t i, const BlockIndex& index, const Eigen::Vector3f& local) {
    ReachedTile& reached = reach(index);
    touchBlocksAround(reached, local);
    const std::uint32_t color = with_color ? scan.cloud.colors[i] : 0U;
    if (!reached.tile->insert(local, map.voxelSize(), with_color, color)) return;
    if (sensor) reached.tile->noteOrigin((*sensor - reached.origin).cast<float>());
    ++reached.state->new_voxels;
    ++voxel_count;
  };
  forEachKept(scan, T_map_sensor, 0U, scan.cloud.size(), tally, insert);
}

/// Where the points number begin ... end - 1 of a scan without colours go.
PlacedPoints Preprocessor::Impl::place(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                                       std::size_t begin, std::size_t end) const {
  PlacedPoints placed;
  BlockIndex last_index;
  PlacedPoints::InTile* last = nullptr;  // most points fall into the same tile as the one before
  const auto note = [&](std::size_t, const BlockIndex& index, const Eigen::Vector3f& local) {
    if (last == nullptr || !(last_index == index)) {
      last_index = index;
      last = &placed.tiles[index];
    }
    last->points.push_back(local);
    forEachBlockAround(index, local, [&around = last->around](const BlockIndex& neighbor) {
      const bool known = std::find(around.begin(), around.end(), neighbor) != around.end();
      if (!known) around.push_back(neighbor);
    });
  };
  forEachKept(scan, T_map_sensor, begin, end, placed.tally, note);
  return placed;
}

/// A whole cloud has no sensor and may have many points: parts of it are placed, and its tiles
/// filled, side by side.
void Preprocessor::Impl::addWhole(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                                  const ComputeDevice& device, Tally& tally) {
  constexpr std::size_t kPart = 32768U;
  std::vector<PlacedPoints> parts(chunksOf(scan.cloud.size(), kPart));
  parallelChunks(scan.cloud.size(), kPart, [&](std::size_t begin, std::size_t end) {
    parts[begin / kPart] = place(scan, T_map_sensor, begin, end);
  });
  for (const PlacedPoints& part : parts) {
    for (const auto& [index, in_tile] : part.tiles) {
      touch(*reach(index).state);
      for (const BlockIndex& neighbor : in_tile.around) {
        const auto found = states.find(neighbor);
        if (found != states.end()) touch(found->second);
      }
    }
    tally.report.non_finite += part.tally.report.non_finite;
    tally.report.out_of_range += part.tally.report.out_of_range;
    tally.report.used += part.tally.report.used;
    tally.sum += part.tally.sum;
  }

  std::vector<ReachedTile*> work;
  for (auto& [index, reached] : reached_tiles) work.push_back(&reached);
  std::vector<std::size_t> added(work.size());
  parallelFor(work.size(), [&](std::size_t t) {
    std::vector<Eigen::Vector3f> points;
    for (PlacedPoints& part : parts) {
      const auto found = part.tiles.find(work[t]->index);
      if (found == part.tiles.end()) continue;
      points.insert(points.end(), found->second.points.begin(), found->second.points.end());
      found->second.points = {};
    }
    const std::size_t before = work[t]->tile->size();
    work[t]->tile->insertAll(points, map.voxelSize(), device);
    added[t] = work[t]->tile->size() - before;
  });
  for (std::size_t t = 0; t < work.size(); ++t) {
    work[t]->state->new_voxels += added[t];
    voxel_count += added[t];
  }
}

/// Past the memory limit the tiles that were not reached for longest go first.
void Preprocessor::Impl::chooseEvictions() {
  const auto limit = static_cast<std::size_t>(parameters.memory_limit);
  if (voxel_count <= limit) return;
  std::vector<std::pair<std::uint64_t, BlockIndex>> by_age;
  for (const auto& [index, state] : states) by_age.emplace_back(state.touched_ns, index);
  std::sort(by_age.begin(), by_age.end());
  std::size_t excess = voxel_count - limit;
  for (const auto& [touched, index] : by_age) {
    if (excess == 0U) break;
    states[index].evict = true;
    const VoxelTile* tile = map.find(index);
    excess -= std::min(excess, tile == nullptr ? 0U : tile->size());
  }
}

bool Preprocessor::Impl::isFinal(const TileState& state) const {
  return state.evict ||
         static_cast<double>(newest_ns - state.touched_ns) * kNanosecond >= parameters.final_after;
}

/// Whether so much is new that a draft of it is due.
bool Preprocessor::Impl::hasChanged(const TileState& state) const {
  const double least = parameters.update_min_change *
                       static_cast<double>(std::max<std::size_t>(state.old_voxels, 1U));
  return state.dirty && static_cast<double>(state.new_voxels) >= least;
}

bool Preprocessor::Impl::isFar(const BlockIndex& index) const {
  const Eigen::Vector2d away = map.originOf(index).head<2>() - scan_center;
  return away.norm() > parameters.final_distance;
}

bool Preprocessor::Impl::mayForget(const BlockIndex& index, const TileState& state) const {
  return state.evict || (state.final && !state.dirty && isFar(index));
}

Preprocessor::Preprocessor(const PreprocessingParameters& parameters, std::string frame_id,
                           const Eigen::Vector2d& tile_corner)
    : impl_(std::make_unique<Impl>(parameters, std::move(frame_id), tile_corner)) {}
Preprocessor::~Preprocessor() = default;
Preprocessor::Preprocessor(Preprocessor&&) noexcept = default;
Preprocessor& Preprocessor::operator=(Preprocessor&&) noexcept = default;

bool Preprocessor::setParameters(const PreprocessingParameters& parameters) {
  const bool new_grid = parameters.voxel_size != impl_->parameters.voxel_size ||
                        parameters.block_size != impl_->parameters.block_size;
  impl_->parameters = parameters;
  if (new_grid) impl_->clear();
  return new_grid;
}

ScanReport Preprocessor::addScan(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                                 const ComputeDevice& device) {
  Tally tally;
  tally.report.points = scan.cloud.size();
  impl_->newest_ns = std::max(impl_->newest_ns, scan.stamp_ns);
  if (!impl_->has_datum) impl_->chooseHeightDatum(scan, T_map_sensor);
  const std::optional<Eigen::Vector3d> sensor = impl_->sensorOf(scan, T_map_sensor);
  impl_->reached_tiles.clear();
  impl_->last_reached = nullptr;
  constexpr std::size_t kWholeCloud = 100000U;  // scans are too small to be worth it
  if (scan.cloud.size() >= kWholeCloud && !scan.cloud.hasColors() && !sensor) {
    impl_->addWhole(scan, T_map_sensor, device, tally);
  } else {
    impl_->addOneByOne(scan, T_map_sensor, sensor, tally);
  }
  if (tally.report.used > 0U) {
    impl_->scan_center = tally.sum / static_cast<double>(tally.report.used);
  }
  impl_->reached_tiles.clear();
  impl_->last_reached = nullptr;
  impl_->chooseEvictions();
  return tally.report;
}

std::vector<BlockIndex> Preprocessor::dueBlocks(bool flush) const {
  constexpr double kSettled = 2.5;  // update periods without much that is new
  const double period = impl_->parameters.update_period;
  std::vector<BlockIndex> due;
  for (const auto& [index, state] : impl_->states) {
    if (state.final && !state.dirty) continue;
    if (flush || impl_->isFinal(state)) {
      due.push_back(index);
      continue;
    }
    const double age = static_cast<double>(impl_->newest_ns - state.handed_on_ns) * kNanosecond;
    const bool has_settled = state.draft && age >= kSettled * period;
    if (has_settled || (impl_->hasChanged(state) && age >= period)) due.push_back(index);
  }
  std::stable_sort(due.begin(), due.end(), [this](const BlockIndex& a, const BlockIndex& b) {
    return impl_->states.at(a).handed_on_ns < impl_->states.at(b).handed_on_ns;
  });
  return due;
}

std::size_t Preprocessor::finishedBlocks() const {
  return static_cast<std::size_t>(
      std::count_if(impl_->states.begin(), impl_->states.end(), [this](const auto& entry) {
        const TileState& state = entry.second;
        return (state.dirty || !state.final) && impl_->isFinal(state);
      }));
}

Block Preprocessor::makeBlock(const BlockIndex& index, bool flush, const ComputeDevice& device,
                              DensePoints* before_thinning) const {
  return finishBlock(collect({index}, flush), impl_->parameters, device, before_thinning);
}

std::uint64_t Preprocessor::beganAt(const BlockIndex& index) const {
  const auto state = impl_->states.find(index);
  return state == impl_->states.end() ? 0U : state->second.began_ns;
}

bool Preprocessor::isFinished(const BlockIndex& index) const {
  const auto state = impl_->states.find(index);
  return state != impl_->states.end() && impl_->isFinal(state->second);
}

bool Preprocessor::mayWait(const BlockIndex& index) const {
  constexpr double kLongest = 4.0;  // times as long as makes it final
  const auto found = impl_->states.find(index);
  if (found == impl_->states.end() || found->second.evict) return false;
  const double age = static_cast<double>(impl_->newest_ns - found->second.touched_ns) * kNanosecond;
  return !impl_->isFar(index) || age < kLongest * impl_->parameters.final_after;
}

bool Preprocessor::isDraft(const BlockIndex& index, bool flush) const {
  const auto state = impl_->states.find(index);
  return state != impl_->states.end() && !flush && !impl_->isFinal(state->second) &&
         impl_->hasChanged(state->second);
}

std::optional<Eigen::AlignedBox2d> Preprocessor::changedPart(const BlockIndex& index) const {
  constexpr double kEdge = 1.0;            // [m] about, of the cells that are looked at
  constexpr double kGrown = 1.3;           // times as many voxels as before may tell other things
  constexpr double kLeastDensity = 100.0;  // [1/m^2] fewer show no plant
  constexpr double kMost = 0.7;            // of the work for the whole tile
  const auto state = impl_->states.find(index);
  const VoxelTile* tile = impl_->map.find(index);
  if (state == impl_->states.end() || tile == nullptr) return std::nullopt;
  const Eigen::AlignedBox2d all;
  if (state->second.revision == 0U) return all;
  const double size = impl_->parameters.block_size;
  const BlockHeader whole = impl_->headerOf(index, false, true);

  // Voxels lie in the order in which they were opened.
  const auto side = static_cast<int>(std::max(std::lround(size / kEdge), 1L));
  struct Voxels {
    std::size_t before = 0U;
    std::size_t now = 0U;
  };
  std::vector<Voxels> cells(static_cast<std::size_t>(side * side));
  const auto along = [&](float from_center) {
    const double at = (static_cast<double>(from_center) / size + 0.5) * side;
    return std::clamp(static_cast<int>(std::floor(at)), 0, side - 1);
  };
  for (std::size_t i = 0; i < tile->size(); ++i) {
    const Eigen::Vector3f p = tile->centroid(i);
    Voxels& cell = cells[static_cast<std::size_t>(along(p.y()) * side + along(p.x()))];
    ++cell.now;
    if (i < state->second.old_voxels) ++cell.before;
  }
  const double edge = size / side;
  Eigen::AlignedBox2d part;
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const Voxels& cell = cells[static_cast<std::size_t>(y * side + x)];
      const bool changed =
          static_cast<double>(cell.now) >= kGrown * static_cast<double>(cell.before) &&
          static_cast<double>(cell.now - cell.before) >= kLeastDensity * edge * edge;
      if (!changed) continue;
      part.extend(whole.lowCorner() + size * Eigen::Vector2d(x, y) / side);
      part.extend(whole.lowCorner() + size * Eigen::Vector2d(x + 1, y + 1) / side);
    }
  }
  if (part.isEmpty()) return std::nullopt;
  const auto workOf = [&](const Eigen::AlignedBox2d& box) {
    return (box.sizes().array() + 2.0 * whole.margin).prod();
  };
  return workOf(part) > kMost * workOf(whole.extent()) ? all : part;
}

std::vector<BlockIndex> Preprocessor::joinedWith(const BlockIndex& first,
                                                 const std::vector<BlockIndex>& due,
                                                 bool flush) const {
  const auto isFinal = [&](const BlockIndex& index) { return flush || isFinished(index); };
  std::vector<BlockIndex> joined{first};
  if (!isFinal(first)) return joined;
  std::vector<BlockIndex> others;
  std::copy_if(due.begin(), due.end(), std::back_inserter(others),
               [&](const BlockIndex& index) { return !(index == first) && isFinal(index); });
  // Margins are shorter the more edges a tile shares with these; of those that share as many the
  // one that would be left with the fewest goes with them.
  const auto isWorse = [&](const BlockIndex& a, const BlockIndex& b) {
    const auto edges_a = sharedEdges(a, joined);
    const auto edges_b = sharedEdges(b, joined);
    return edges_a != edges_b ? edges_a < edges_b : sharedEdges(a, others) > sharedEdges(b, others);
  };
  while (joined.size() < kMostJoined && !others.empty()) {
    const auto best = std::max_element(others.begin(), others.end(), isWorse);
    if (sharedEdges(*best, joined) == 0) break;
    joined.push_back(*best);
    others.erase(best);
  }
  return joined;
}

BlockHeader Preprocessor::Impl::headerOf(const BlockIndex& index, bool flush, bool draft) const {
  BlockHeader header;
  header.stamp_ns = newest_ns;
  header.frame_id = frame_id;
  header.index = index;
  header.tile_size = parameters.block_size;
  header.tile_corner = tile_corner;
  const auto state = states.find(index);
  if (state != states.end()) {
    header.began_ns = state->second.began_ns;
    header.revision = state->second.revision + 1U;
    header.final = flush || isFinal(state->second);
    header.draft = draft;
  }
  // Of the margin, while more is to come: a stem and what stands above it. The last word on long
  // leaves is the final block's.
  constexpr double kOpenMargin = 0.5;
  header.margin = (header.final ? 1.0 : kOpenMargin) * parameters.block_margin;
  return header;
}

BlockPoints Preprocessor::collect(const std::vector<BlockIndex>& indices, bool flush) const {
  BlockPoints block;
  for (const BlockIndex& index : indices) {
    block.joined.push_back(impl_->headerOf(index, flush, isDraft(index, flush)));
  }
  block.header = block.joined.front();
  block.cloud = impl_->map.extract(indices, block.header.margin);
  if (block.joined.size() == 1U) {
    block.joined.clear();
    return block;
  }
  for (const BlockHeader& tile : block.joined) {
    block.header.began_ns = std::max(block.header.began_ns, tile.began_ns);
  }
  return block;
}

void Preprocessor::markHandedOn(const BlockHeader& block) {
  const auto found = impl_->states.find(block.index);
  if (found == impl_->states.end()) return;
  TileState& handed = found->second;
  const VoxelTile* tile = impl_->map.find(block.index);
  handed.revision = block.revision;
  handed.handed_on_ns = impl_->newest_ns;
  handed.old_voxels = tile == nullptr ? 0U : tile->size();
  handed.new_voxels = 0U;
  handed.dirty = false;
  handed.draft = block.draft;
  handed.final = block.final;
  if (block.final && tile != nullptr) impl_->map.tile(block.index).rest();

  for (auto state = impl_->states.begin(); state != impl_->states.end();) {
    const bool forget = state->second.evict ? state->second.final && state->first == block.index
                                            : impl_->mayForget(state->first, state->second);
    if (!forget) {
      ++state;
      continue;
    }
    const VoxelTile* gone = impl_->map.find(state->first);
    impl_->voxel_count -= gone == nullptr ? 0U : gone->size();
    impl_->map.erase(state->first);
    state = impl_->states.erase(state);
  }
}

void Preprocessor::reset() {
  impl_->clear();
}

std::size_t Preprocessor::openTiles() const {
  return impl_->states.size();
}
std::size_t Preprocessor::voxels() const {
  return impl_->voxel_count;
}
const PreprocessingParameters& Preprocessor::parameters() const {
  return impl_->parameters;
}

}  // namespace field_phenotyping
