#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/segmentation/stem_curve.hpp"

namespace field_phenotyping {

/// What the points between two nodes say about both, and about radius and taper: sums of
/// w r r^T, w r q^T, w q q^T and of the same with the target, for points with the row
/// r = ((1 - share) t, share t) in the nodes' unknowns and q in radius and taper.
struct CellSums {
  double points = 0.0;
  std::array<Eigen::Vector3d, 3> squares;            ///< xx, xy, yy of t: lower, across, upper node
  std::array<Eigen::Vector3d, 4> borders;            ///< of each unknown: target, radius, taper
  Eigen::Vector3d radius = Eigen::Vector3d::Zero();  ///< 1, height, height^2
  Eigen::Vector2d radius_target = Eigen::Vector2d::Zero();

  CellSums() {
    squares.fill(Eigen::Vector3d::Zero());
    borders.fill(Eigen::Vector3d::Zero());
  }

  /// Adds them to the equations of the curve.
  /// @param node the lower one
  /// @param factor on what they count
  void addTo(CurveEquations& equations, std::size_t node, double factor) const;
};

/// How a stem shows at some height: a normal density across its surface, or about its axis.
struct Skin {
  double spread = 0.0;  ///< standard deviation [m]
  double reach = 0.0;   ///< [m] from the axis, beyond which nothing is looked at
  double odds = 1.0;    ///< density of clutter against that of the stem's points [1/m^2]
  double trust = 1.0;   ///< what its points count
};

/// Samples by height, placed on the nodes and bands of a curve, also stored coordinate by
/// coordinate so that the processor looks at several at once. Immutable.
class CurveSamples {
 public:
  CurveSamples() = default;
  explicit CurveSamples(std::vector<Sample> placed);

  std::size_t size() const { return samples_.size(); }
  const Sample& operator[](std::size_t i) const { return samples_[i]; }
  std::vector<Sample>::const_iterator begin() const { return samples_.begin(); }
  std::vector<Sample>::const_iterator end() const { return samples_.end(); }

  /// Samples that follow one another, between the same nodes and of the same band.
  struct Run {
    std::size_t begin;
    std::size_t end;
  };
  /// Calls visit(run) for the runs that samples [first, end) are made of.
  template <class Visit>
  void forEachRun(std::size_t first, std::size_t end, Visit&& visit) const {
    for (std::size_t i = first; i < end;) {
      const std::size_t next = std::min(end, run_ends_[i]);
      visit(Run{i, next});
      i = next;
    }
  }

  /// How much of a run is a stem's.
  struct Share {
    double stem = 0.0;  ///< points, by their probabilities
    double all = 0.0;   ///< within reach
  };
  /// Expectation of a run: how probably each of its samples belongs to the surface of the curve,
  /// and what they then say.
  /// @param posterior of every sample; has space for padded() of them
  Share expectSurface(const Run& run, const StemCurve& curve, const Skin& skin, CellSums& cell,
                      std::vector<float>& posterior) const;
  /// The same of a blob of points about the axis.
  Share expectBlob(const Run& run, const StemCurve& curve, const Skin& skin, CellSums& cell,
                   std::vector<float>& posterior) const;
  std::size_t padded() const { return heights_.size(); }

  /// What samples of a run say that belong to the surface of the curve with those weights.
  /// @param weights of every sample; has space for padded() of them, none counts beyond the run
  void sumSurface(const Run& run, const StemCurve& curve, const std::vector<float>& weights,
                  CellSums& cell) const;

  /// kLanes samples.
  struct Lanes {
    Floats height;
    Floats share;
    Floats u;
    Floats v;
  };
  Lanes lanesFrom(std::size_t i) const {
    return {loadFloats(&heights_[i]), loadFloats(&shares_[i]), loadFloats(&u_[i]),
            loadFloats(&v_[i])};
  }

 private:
  template <bool kSurface>
  Share expect(const Run& run, const StemCurve& curve, const Skin& skin, CellSums& cell,
               std::vector<float>& posterior) const;

  std::vector<Sample> samples_;
  std::vector<std::size_t> run_ends_;  // of the run of each sample
  std::vector<float> heights_;         // padded, so that the last lanes can be loaded
  std::vector<float> u_;
  std::vector<float> v_;
  std::vector<float> shares_;
};

}  // namespace field_phenotyping
