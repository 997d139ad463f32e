#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "field_phenotyping/common/compute_device.hpp"
#include "field_phenotyping/parameters.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/preprocessing/thinning.hpp"

namespace field_phenotyping {

/// One sweep of the sensor, or one whole accumulated cloud.
struct Scan {
  PointCloud cloud;             ///< sensor frame [m]; non-finite points are allowed and dropped
  std::uint64_t stamp_ns = 0U;  ///< [ns since the epoch]
  /// Where the sensor was, in the scan's frame [m]; none: not known, as of registered scans. It is
  /// kept for the points' beams while the sensor moves by at most 1 cm from scan to scan.
  std::optional<Eigen::Vector3d> origin = {};
};

/// What became of the points of one scan.
struct ScanReport {
  std::size_t points = 0U;
  std::size_t non_finite = 0U;
  std::size_t out_of_range = 0U;  ///< by range from the sensor, or outside the crop box
  std::size_t used = 0U;
};

/// What has accumulated for one block, taken out of the map: all that finishBlock() needs.
struct BlockPoints {
  BlockHeader header;
  std::vector<BlockHeader> joined;  ///< as in Block
  PointCloud cloud;  ///< voxel centroids of the tile and its margin, soil and outliers among them

  /// As in Block.
  std::vector<BlockHeader> tiles() const {
    return joined.empty() ? std::vector<BlockHeader>{header} : joined;
  }
};

/// The steps of 2.3 that need no map: outliers and soil are taken out, and what is so dense that
/// more points tell little more is thinned. Thread-safe.
/// @param before_thinning is given the points that the block's are made of, for who labels them
Block finishBlock(BlockPoints points, const PreprocessingParameters& parameters,
                  const ComputeDevice& device = {}, DensePoints* before_thinning = nullptr);

/// Of what was taken out for one tile, what a draft of a part of it needs: the part's points and
/// those of its margin; all where `part` is empty.
BlockPoints partOf(const BlockPoints& tile, const Eigen::AlignedBox2d& part);

/// First stage: scans in, blocks out (paper 2.3). Scans accumulate in a voxel map that is kept tile
/// by tile; a tile that changed enough, or is final, is handed on as a block with outliers and soil
/// taken out.
///
/// Not thread-safe, except that several makeBlock() may run at once while nothing else does.
class Preprocessor {
 public:
  /// As much as is worked at once, for memory follows it.
  static constexpr std::size_t kMostJoined = 6U;

  /// @param frame_id frame of the map, written into every block
  /// @param tile_corner of tile (0, 0) [m]: where tiles begin is free, but must not change
  Preprocessor(const PreprocessingParameters& parameters, std::string frame_id,
               const Eigen::Vector2d& tile_corner = Eigen::Vector2d::Zero());
  ~Preprocessor();
  Preprocessor(Preprocessor&&) noexcept;
  Preprocessor& operator=(Preprocessor&&) noexcept;

  /// Parameters for all further scans and blocks. A new voxel or block size empties the map;
  /// returns whether it did.
  bool setParameters(const PreprocessingParameters& parameters);

  /// Transforms, crops and accumulates one scan. A GPU helps with large ones that have no colour
  /// and no sensor's place, as whole clouds.
  ScanReport addScan(const Scan& scan, const Eigen::Isometry3d& T_map_sensor,
                     const ComputeDevice& device = {});

  /// Blocks worth working now: changed enough since they were handed on, which makes drafts of
  /// them; handed on as drafts and settled since; or no longer reached by scans. `flush`: every
  /// block that changed at all, as final. Those that were handed on longest ago, or never, come
  /// first.
  std::vector<BlockIndex> dueBlocks(bool flush) const;

  /// How many of them no scan reaches any more: they are held only until they are handed on.
  std::size_t finishedBlocks() const;

  /// Time of the first scan that reached tile `index` [ns since the epoch]; 0 where none has.
  std::uint64_t beganAt(const BlockIndex& index) const;

  /// Whether no scan reaches block `index` any more.
  bool isFinished(const BlockIndex& index) const;

  /// Whether block `index` loses nothing by waiting for blocks to be joined with: the sensor is not
  /// farther away than `final_distance`, so that what it sees if it comes back is of the same pass,
  /// or not for long; and there is memory for it.
  bool mayWait(const BlockIndex& index) const;

  /// Whether what is handed on of block `index` now is a draft.
  bool isDraft(const BlockIndex& index, bool flush) const;

  /// The part of tile `index` [m], in the map frame, in which plants may be other than they were
  /// when it was last handed on, for much has been seen there since: all that a draft need be
  /// about. Empty where that is most of the tile, or nothing was handed on before: the whole tile;
  /// nothing where it is nowhere.
  std::optional<Eigen::AlignedBox2d> changedPart(const BlockIndex& index) const;

  /// The blocks that can be worked as one with block `first` of `due`: it alone, if scans still
  /// reach it; else with those others of `due` that no scan reaches either and that adjoin it or
  /// one another, up to kMostJoined of them. `first` comes first.
  std::vector<BlockIndex> joinedWith(const BlockIndex& first, const std::vector<BlockIndex>& due,
                                     bool flush) const;

  /// Takes out what has accumulated for these blocks, to be worked as one: a copy, much quicker
  /// than finishBlock().
  BlockPoints collect(const std::vector<BlockIndex>& indices, bool flush) const;

  /// Builds block `index` from what has accumulated. Thread-safe against other makeBlock().
  Block makeBlock(const BlockIndex& index, bool flush, const ComputeDevice& device = {},
                  DensePoints* before_thinning = nullptr) const;

  /// Notes that the tile `block` has been handed on, or collected to be: it is not due again until
  /// it changes; final tiles far from the sensor are forgotten.
  void markHandedOn(const BlockHeader& block);

  /// Forgets everything (time jumped back, frame changed).
  void reset();

  std::size_t openTiles() const;
  std::size_t voxels() const;
  const PreprocessingParameters& parameters() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace field_phenotyping
