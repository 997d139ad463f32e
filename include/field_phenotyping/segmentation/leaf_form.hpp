#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/robust_spread.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/organ_cells.hpp"
#include "field_phenotyping/segmentation/stem_axis.hpp"
#include "field_phenotyping/segmentation/stem_continuation.hpp"

namespace field_phenotyping {

/// A plant that organs are compared with.
struct LeafHost {
  const StemAxis* axis = nullptr;
  float top = 0.0F;  ///< [m] height of the highest point of the stem and of what carries it on
  OrganEnd end;      ///< of what carries it on

  float height() const { return top - axis->nodes().front().position.z(); }  ///< [m]
  float tip() const { return top - axis->nodes().back().position.z(); }      ///< [m] above the axis
};

/// kLanes cells of organs.
struct OrganLanes {
  Floats x;
  Floats y;
  Floats z;
  Floats direction_x;
  Floats direction_y;
  Floats direction_z;  ///< >= 0
  Floats linearity;
};

/// How far kLanes cells are from an axis at their own height [m], level.
struct AwayLanes {
  Floats x;
  Floats y;
};

/// Some cells of a piece, coordinate by coordinate, and where they are to a plant.
class PieceSamples {
 public:
  /// Every `stride`-th cell.
  void take(const OrganCells& cells, const std::vector<std::uint32_t>& members, std::size_t stride);
  void lookFrom(const StemAxis& axis);
  std::size_t size() const { return count_; }
  OrganLanes lanesFrom(std::size_t k) const;
  AwayLanes awayFrom(std::size_t k) const;  ///< of the axis that they were last looked at from
  /// Holds in the lanes from k on that are no repetition of the last cell.
  Integers areCells(std::size_t k) const { return lanesBefore(count_ - k); }

 private:
  std::size_t count_ = 0U;
  std::array<std::vector<float>, 7> values_;
  std::array<std::vector<float>, 2> away_;
};

/// Form of the leaves of a stand, by the distance from their stem and by height. Maize leaves stay
/// in a vertical plane through their own stem, rise steeply from it and flatten, then droop; the
/// upper ones stand more upright. How much depends on age and variety, so it is learnt from the
/// block itself. Metres and radians; thread-safe once made.
class LeafForm {
 public:
  /// Leaves about tasselling, loosely.
  LeafForm();

  /// The form of the organs that have an owner; robust against a minority of wrong ones.
  static LeafForm learn(const OrganCells& cells, const std::vector<LeafHost>& hosts);

  /// How little a place on an organ looks like one of the plant with that axis, from 0. Leaves that
  /// cross from a neighbour point past the stem and rise the wrong way.
  float misfit(const LocalShape& shape, const Eigen::Vector3f& center, const LeafHost& host) const;

  /// The sum over samples of one piece, looked at from that axis.
  float misfit(const PieceSamples& samples, const LeafHost& host) const;

  /// How much too high a place stands to be an organ of that plant, from 0. In a stand with tassels
  /// leaves and side branches stay below the tops of their stems, by about as much everywhere, and
  /// nothing stands above a tip that is known.
  float tooHigh(const Eigen::Vector3f& place, const LeafHost& host) const;

  /// How rarely organs of that height stand so far from the line of their stem, from 0: log of the
  /// ratio of densities. It says most above the stems, where tassels stand, and upper leaves that
  /// point nowhere; below, a leaf's direction tells more, but not how far off its stem may be.
  float tooFar(const Eigen::Vector3f& place, const LeafHost& host) const;

  /// The sum over samples of one piece, looked at from that axis.
  float tooFar(const PieceSamples& samples, const LeafHost& host) const;

 private:
  static constexpr std::size_t kBins = 20U;
  static constexpr float kBin = 0.05F;                    // [m]
  static constexpr std::size_t kFarBins = 24U;            // distances of organs above the stems
  static constexpr float kLayer = 0.10F;                  // [m] of height above the base
  static constexpr std::size_t kStemBands = 5U;           // of equal height up the stem
  static constexpr std::size_t kBands = kStemBands + 1U;  // and one above its end
  struct Bin {
    float slope = 0.0F;
    float slope_spread = 0.0F;
    float miss_spread = 0.0F;
  };
  using Profile = std::array<Bin, kBins>;
  using Reach = std::array<float, kFarBins>;  // by the distance from the stem's line
  struct Samples {
    std::array<std::vector<float>, kBins> slopes;
    std::array<std::vector<float>, kBins> misses;
  };

  static Integers bandsOf(const Floats& z, const StemAxis& axis);
  static Profile profileOf(Samples& samples, const Profile& usual);
  Floats misfitOf(const OrganLanes& organ, const AwayLanes& away, const StemAxis& axis) const;
  float tooFar(float height, float distance) const;
  bool hasTip(const LeafHost& host) const;
  void learnTips(const std::vector<LeafHost>& hosts);
  void learnCeiling(std::vector<std::vector<float>> rises);
  void learnReaches(const std::vector<Reach>& counts, const std::vector<LeafHost>& hosts);

  std::array<Profile, kBands> bands_;
  std::vector<Reach> reaches_;    // of each layer
  std::optional<float> ceiling_;  // [m] above the top, for organs beside the stem
  float rise_spread_ = 0.0F;      // [m] standard deviation, over plants, of their highest organ
  RobustSpread tips_{};           // [m] of what carries stems on, above their axes
  RobustSpread heights_{};        // [m] of plants
};

}  // namespace field_phenotyping
