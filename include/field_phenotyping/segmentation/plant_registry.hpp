#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <memory_resource>
#include <mutex>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// A plant that has had its id before, for instance in a run that this one goes on with.
struct KnownPlant {
  std::int32_t id = -1;
  Eigen::Vector2d base = Eigen::Vector2d::Zero();  ///< x, y in the map frame [m]
  std::uint64_t stamp_ns = 0U;  ///< newest scan that it was seen in [ns since the epoch]
  bool reported = true;         ///< false: no report that holds names it any more
};

/// Gives each plant one id for as long as the map frame lasts: through every revision of its block,
/// and when it is passed again, be it minutes later from the other side of its row.
///
/// Between two passes the SLAM may have moved the map. Bases of the same plants then differ all in
/// the same way, so a block that begins a new pass is first laid over what is known of its place:
/// by the displacement, up to kMostShift, that brings the most bases together. How plants stand in
/// their rows tells it even where it is half of their spacing. What was named before enough of them
/// were seen gets its older id once they are.
///
/// It also settles which block reports a plant. Two blocks that share a border both see the plants
/// on it, and may place a base on either side; the first block to claim such a plant keeps it until
/// it no longer finds it, so no plant is reported twice or lost. A claim holds among blocks that
/// are seen at about the same time, kClaimHolds, and not against the block in whose tile the plant
/// stands in a later pass, or for the last time before the claim's own block. Where two blocks have
/// given one plant two ids, as they had placed it too far apart at first, one of them is given up
/// once the places have come together.
///
/// A draft of a part of a tile says nothing of the tile's other plants: these stay the block's.
///
/// An id that a block gave before it could know how the map has moved is provisional: a neighbour
/// that knows may take it back even after the block has spoken for the last time. What that block
/// said has then to be said once more, Outcome::taken_back.
///
/// Of each plant ever named it holds an id, a place and a time: about 40 bytes. Thread-safe.
class PlantRegistry {
 public:
  /// A block may claim plants this far outside its tile [m].
  static constexpr double kBorderTolerance = 0.10;
  /// The map moves by at most this between two passes [m].
  static constexpr double kMostShift = 0.15;
  /// What a block has claimed is free again so long after its newest scan [ns].
  static constexpr std::uint64_t kClaimHolds = 600'000'000'000U;

  /// An id that was given in doubt and is no plant's any more. Blocks that will report again need
  /// not be told.
  struct TakenBack {
    std::int32_t id = -1;
    std::int32_t older = -1;  ///< the plant's own id; -1: another block reports the plant
  };

  /// What became of a block's plants.
  struct Outcome {
    std::size_t known = 0U;                           ///< plants that had an id
    std::size_t added = 0U;                           ///< plants that were given one
    std::size_t provisional = 0U;                     ///< ids it reports that may be taken back
    Eigen::Vector2d shift = Eigen::Vector2d::Zero();  ///< of the map since the last pass [m]
    std::vector<TakenBack> taken_back;                ///< in what was said before
  };

  /// @param match_radius [m] two bases nearer than this are one plant
  explicit PlantRegistry(double match_radius = 0.06);

  /// Plants of an earlier run. New ids begin above theirs. Of those that are not reported any more
  /// only such come back as stand where no other does: the others are that plant's wrong ids.
  void restore(const std::vector<KnownPlant>& plants);

  /// Names the owned plants of `block`, each with an id of its own; plants that another block has
  /// claimed are marked as not owned.
  Outcome identify(SegmentedBlock& block);

  /// Plants ever named.
  std::size_t size() const;

 private:
  using Cell = std::pair<std::int64_t, std::int64_t>;
  /// As small as may be: there is one of each plant of the day.
  struct Entry {
    std::uint64_t stamp_ns = 0U;
    Eigen::Vector2f offset = Eigen::Vector2f::Zero();  // of its base at stamp_ns, in its cell [m]
    std::int32_t id = -1;
  };
  struct Known {
    Cell cell;  // where its entry is
    std::int32_t id = -1;
    std::uint64_t stamp_ns = 0U;
    Eigen::Vector2d base = Eigen::Vector2d::Zero();  // in the map as it was at stamp_ns [m]
    Eigen::Vector2d now = Eigen::Vector2d::Zero();   // in the map as the block sees it
  };
  static constexpr std::size_t kNone = ~std::size_t{0};
  /// Which of the known plants near a block its own are.
  struct Matches {
    std::vector<std::size_t> of_plant;  // number of the known one, or kNone
    std::vector<bool> given;            // of the known ones: not free any more
  };
  struct Claims {
    std::uint64_t stamp_ns = 0U;
    bool final = false;
    std::vector<std::int32_t> ids;
    std::set<std::int32_t> seen;  // those and the ones that other blocks have claimed
  };

  /// Ids of a block that a draft of a part of it says nothing of.
  struct Untouched {
    std::vector<std::int32_t> far;
    std::vector<std::int32_t> near;  // within reach of the part
  };

  struct FoundShift {
    Eigen::Vector2d shift;
    bool sure;  // no other fits nearly as well
  };
  struct ExpectedShift {
    Eigen::Vector2d shift;
    double stddev;
  };
  struct LastShift {
    Eigen::Vector2d shift = Eigen::Vector2d::Zero();
    std::uint64_t stamp_ns = 0U;  // newest scan that showed it
    std::uint64_t began_ns = 0U;  // what was seen since is in the map of now
  };

  std::vector<Known> findNear(const std::vector<Eigen::Vector2d>& bases, double reach) const;
  std::optional<FoundShift> findShift(const std::vector<Eigen::Vector2d>& bases,
                                      const std::vector<Eigen::Vector2d>& earlier,
                                      std::uint64_t stamp_ns) const;
  bool lastShiftHolds(std::uint64_t stamp_ns) const;
  ExpectedShift expectedShift(std::uint64_t stamp_ns) const;
  void noteShift(const BlockHeader& header, const Eigen::Vector2d& shift, bool since_known);
  bool layOver(const BlockHeader& header, const std::vector<Eigen::Vector2d>& bases,
               std::vector<Known>& near, Eigen::Vector2d& shift);
  Matches match(const std::vector<Eigen::Vector2d>& bases, const std::vector<Known>& near) const;
  std::int32_t nameAnew(const Eigen::Vector2d& base, const std::vector<Known>& near,
                        const BlockHeader& header, bool sure);
  bool claim(const Known& known, const Eigen::Vector2d& base, const std::vector<Known>& near,
             const BlockHeader& header, Matches& matches, std::vector<TakenBack>& taken_back);
  void file(std::int32_t id, const Eigen::Vector2d& base, std::uint64_t stamp_ns);
  void takeOut(const Known& known);
  void keepOwnPlants(SegmentedBlock& block) const;
  Untouched untouchedBy(const BlockHeader& header) const;
  void keepClaims(const std::vector<std::int32_t>& ids, const BlockIndex& index, Claims& claims);
  void releaseClaims(const BlockHeader& header);
  bool isInDoubt(std::int32_t id) const;
  template <class MayBe>
  std::size_t oneAt(const Eigen::Vector2d& place, const std::vector<Known>& near,
                    const MayBe& mayBe) const;
  void giveOlderIdsBack(const std::vector<Eigen::Vector2d>& bases, const std::vector<Known>& near,
                        std::uint64_t began_ns, Matches& matches,
                        std::vector<TakenBack>& taken_back);
  void giveOthersOlderIdsBack(std::vector<Known>& near, std::uint64_t began_ns, Matches& matches,
                              std::vector<TakenBack>& taken_back);
  const Claims* claimsOn(std::int32_t id) const;
  void releaseClaim(std::int32_t id);
  void takeOver(std::int32_t id, const Eigen::Vector2d& base, const BlockHeader& header);
  bool isSameAsAnothers(std::int32_t id, const Eigen::Vector2d& base,
                        const std::vector<Known>& near, std::vector<bool>& given,
                        std::vector<TakenBack>& taken_back);

  const double match_radius_;
  mutable std::mutex mutex_;
  // What stays for the day lies together: between what comes and goes with the blocks it would
  // leave gaps that larger pieces do not fit into.
  std::pmr::unsynchronized_pool_resource memory_;
  std::pmr::map<Cell, std::pmr::vector<Entry>> entries_{&memory_};
  std::size_t size_ = 0U;  // of all of them
  std::map<BlockIndex, Claims> claims_;
  std::map<std::int32_t, BlockIndex> claimed_;  // the ids of all of those, and by whom
  // Ids given near plants of an earlier pass before it was known how the map has moved, and when.
  std::map<std::int32_t, std::uint64_t> in_doubt_;
  LastShift last_shift_;
  std::int32_t next_id_ = 0;
};

}  // namespace field_phenotyping
