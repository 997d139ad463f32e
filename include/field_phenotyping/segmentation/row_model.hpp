#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <vector>

namespace field_phenotyping {

/// A place where a plant may stand.
struct PlantPlace {
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  ///< horizontal [m], any frame
  double weight = 1.0;                                 ///< how sure it is, in [0, 1]
};

/// What is known of the rows before they are looked for; 0: nothing.
struct RowHints {
  double row_spacing = 0.0;    ///< [m]
  double plant_spacing = 0.0;  ///< along a row [m]
};

/// Plants in a stand: most in parallel, evenly spaced rows with a typical spacing in each, the rest
/// anywhere. It says how much likelier a plant is at a place than in a field sown at random; the
/// share that stands anywhere keeps every place possible. Metres, frame of the places.
///
/// Immutable; thread-safe.
class RowModel {
 public:
  /// Finds the rows that places show, by maximum likelihood: of all directions and spacings those
  /// whose rows are sharpest. None where chance may have made them: too few plants, or no rows.
  /// @throws std::invalid_argument for a negative hint
  static std::optional<RowModel> find(const std::vector<PlantPlace>& places, const RowHints& hints);

  /// Unit vector along the rows, towards positive x (positive y for rows along y).
  const Eigen::Vector2d& direction() const { return direction_; }
  double rowSpacing() const { return row_spacing_; }  ///< undetermined where all stand in one row
  double rowScatter() const { return row_scatter_; }  ///< standard deviation about the row
  double plantSpacing() const { return plant_spacing_; }  ///< along a row; 0: none is typical
  double inRows() const { return in_rows_; }              ///< share of the plants

  int rowOf(const Eigen::Vector2d& position) const;        ///< the nearest row
  double offRow(const Eigen::Vector2d& position) const;    ///< signed distance from it
  double alongRow(const Eigen::Vector2d& position) const;  ///< coordinate along the rows

  /// How much likelier a plant is at that distance from its row than anywhere; 1: no difference.
  /// Rows that hold no plants yet tell nothing.
  double rowOdds(const Eigen::Vector2d& position) const;
  /// How much likelier the plants of a row are with one more there than without, as to their
  /// spacing. `others`: the plants, in any order; only those of its row count.
  double spacingOdds(const Eigen::Vector2d& position,
                     const std::vector<Eigen::Vector2d>& others) const;
  /// How much likelier a plant is there than anywhere in its row, as to how far from it the next of
  /// the row stand.
  double intervalOdds(const Eigen::Vector2d& position,
                      const std::vector<Eigen::Vector2d>& others) const;
  /// Bounds of rowOdds() and of intervalOdds() of any place.
  double mostRowOdds() const;
  double mostIntervalOdds() const;

 private:
  struct Fit;
  struct Neighbors {
    double before;  // [m] to the next plant of the row; infinite: none
    double after;
  };
  Neighbors neighborsOf(const Eigen::Vector2d& position,
                        const std::vector<Eigen::Vector2d>& others) const;

  RowModel() = default;
  /// Density of an interval of one, two, ... plant spacings [1/m].
  using Multiples = std::array<double, 8U>;
  Multiples multiplesOf(double interval) const;
  /// The same of two plants that follow in a row.
  double intervalDensity(double interval, const Multiples& multiples) const;
  void fitSpacing(const std::vector<PlantPlace>& places, double hint);

  Eigen::Vector2d direction_ = Eigen::Vector2d::UnitX();
  double row_spacing_ = 0.0;
  double row_offset_ = 0.0;
  double row_scatter_ = 0.0;
  double in_rows_ = 0.0;
  double plant_spacing_ = 0.0;
  double spacing_scatter_ = 0.0;  // share of the spacing
  double missing_ = 0.0;          // share of the plants of a row that are not there
  std::map<int, double> plants_;  // by row
};

}  // namespace field_phenotyping
