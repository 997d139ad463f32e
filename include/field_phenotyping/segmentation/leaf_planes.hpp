#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/segmentation/leaf_form.hpp"
#include "field_phenotyping/segmentation/leaf_pieces.hpp"
#include "field_phenotyping/segmentation/organ_cells.hpp"

namespace field_phenotyping {

/// The upright plane that each plant's leaves lie in. Maize sets its leaves in two rows, one to
/// this side of the stem, the next to that one (distichous phyllotaxis): of six real plants half of
/// the leaves' points are within 9 to 16 degrees of it, nine tenths within 21 to 46. How closely
/// leaves keep to it is learnt from the stand itself, below the ends of the stems and above; where
/// they do not, planes tell nothing. Metres and radians; thread-safe once made.
class LeafPlanes {
 public:
  /// From the pieces that have an owner, all cells of a piece the same one; robust against a
  /// minority of wrong ones.
  static LeafPlanes learn(const OrganCells& cells, const LeafPieces& pieces,
                          const std::vector<LeafHost>& hosts);

  /// Log of how much rarer pieces of that plant are where this one is than they would be without a
  /// plane: below 0 in the plane of the plant's other pieces, above 0 across it.
  ///
  /// @param samples some cells of the piece, at least one, looked at from that plant's axis
  /// @param host    the plant itself
  float misfit(const PieceSamples& samples, std::uint32_t piece, std::size_t plant,
               const LeafHost& host) const;

  /// How closely leaves keep to their plane, below the ends of the stems and above: mean cosine of
  /// twice the angle between a leaf and the plane; 0 where there is none, or too few leaves show
  /// it.
  const std::array<float, 2>& closeness() const { return closeness_; }

 private:
  /// A piece as its owner sees it.
  struct Bearing {
    std::int32_t plant = -1;
    std::size_t layer = 0U;                             // 1 above the end of the stem
    float say = 0.0F;                                   // 1: that of a leaf
    Eigen::Vector2f once = Eigen::Vector2f::Zero();     // mean cosine and sine of its azimuth
    Eigen::Vector2f doubled = Eigen::Vector2f::Zero();  // of twice its azimuth
  };

  static Bearing bearingOf(const OrganCells& cells, const std::vector<std::uint32_t>& members,
                           std::int32_t plant, const LeafHost& host);
  void learnCloseness(const std::vector<std::vector<std::uint32_t>>& of_plants);
  Eigen::Vector2f pullOf(const Bearing& bearing) const;

  std::array<float, 2> closeness_{};
  std::vector<Bearing> bearings_;       // of each piece
  std::vector<Eigen::Vector2f> pulls_;  // of each plant: what its pieces say of its plane, summed
};

}  // namespace field_phenotyping
