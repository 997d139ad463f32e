#include "field_phenotyping/segmentation/organ_assignment.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <optional>
#include <queue>
#include <utility>

#include "field_phenotyping/common/lanes.hpp"
#include "field_phenotyping/common/median.hpp"
#include "field_phenotyping/common/minimum_cut.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/normal_distribution.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/common/robust_spread.hpp"
#include "field_phenotyping/segmentation/local_shape.hpp"
#include "field_phenotyping/segmentation/neighborhood.hpp"
#include "field_phenotyping/segmentation/stem_continuation.hpp"

namespace field_phenotyping {
namespace {

constexpr float kCell = 0.015F;       // [m] points this close are one cell
constexpr float kTouch = 0.03F;       // [m] cells this close touch
constexpr float kNearReach = 0.04F;   // [m] steps within one organ
constexpr float kWeedHeight = 0.25F;  // [m] below it an organ must touch its plant

constexpr std::size_t kChunk = 512U;  // cells of a task

/// Points gathered into cells: far fewer than points, and of even density.
struct Cells {
  std::vector<std::uint32_t> of_point;
  std::vector<Eigen::Vector3f> centers;
  std::vector<std::int32_t> owner;
  std::vector<std::uint8_t> is_stem;
  std::vector<std::uint8_t> is_low;  // where weeds grow
  std::vector<LocalShape> shapes;
  float shape_radius = 0.0F;  // [m] neighbourhood that shows which way an organ runs

  std::uint32_t size() const { return static_cast<std::uint32_t>(centers.size()); }
};

Cells gatherCells(const Block& block, const std::vector<std::int32_t>& owner, float shape_radius,
                  const ComputeDevice& device) {
  const std::vector<Eigen::Vector3f>& points = block.cloud.points;
  Eigen::Array3f low = points.front().array();
  for (const Eigen::Vector3f& p : points) low = low.min(p.array());
  constexpr unsigned kLevelBits = 42U;  // of a cell's number: its level, 21 bits each for y and x
  std::vector<std::uint64_t> number(points.size());  // of each point's cell
  constexpr std::size_t kPoints = 16384U;            // of a task
  parallelChunks(points.size(), kPoints, [&](std::size_t begin_point, std::size_t end_point) {
    for (std::size_t i = begin_point; i < end_point; ++i) {
      const Eigen::Array3i cell = ((points[i].array() - low) / kCell).cast<int>();
      number[i] = static_cast<std::uint64_t>(cell.z()) << kLevelBits |
                  static_cast<std::uint64_t>(cell.y()) << 21U |
                  static_cast<std::uint64_t>(cell.x());
    }
  });
  std::vector<std::size_t> begin;  // of each level
  for (const std::uint64_t of_point : number) {
    const std::size_t level = of_point >> kLevelBits;
    if (begin.size() < level + 2U) begin.resize(level + 2U, 0U);
    ++begin[level + 1U];
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order(points.size());  // by cell, point
  std::vector<std::size_t> next = begin;
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    order[next[number[i] >> kLevelBits]++] = {number[i], i};
  }
  const std::size_t levels = begin.size() - 1U;
  std::vector<std::uint32_t> first_cell(levels + 1U, 0U);  // of each level
  const auto beginsCell = [&](std::size_t level, std::size_t k) {
    return k == begin[level] || order[k].first != order[k - 1U].first;
  };
  parallelFor(levels, [&](std::size_t level) {
    std::sort(order.begin() + static_cast<std::ptrdiff_t>(begin[level]),
              order.begin() + static_cast<std::ptrdiff_t>(begin[level + 1U]));
    for (std::size_t k = begin[level]; k < begin[level + 1U]; ++k) {
      if (beginsCell(level, k)) ++first_cell[level + 1U];
    }
  });
  std::partial_sum(first_cell.begin(), first_cell.end(), first_cell.begin());

  Cells cells;
  cells.shape_radius = shape_radius;
  cells.of_point.resize(points.size());
  cells.centers.assign(first_cell.back(), Eigen::Vector3f::Zero());
  cells.owner.assign(cells.size(), -1);
  std::vector<float> counts(cells.size(), 0.0F);
  parallelFor(levels, [&](std::size_t level) {
    std::uint32_t after = first_cell[level];  // the cell that is being filled
    for (std::size_t k = begin[level]; k < begin[level + 1U]; ++k) {
      if (beginsCell(level, k)) ++after;
      const std::uint32_t cell = after - 1U;
      const std::uint32_t i = order[k].second;
      cells.of_point[i] = cell;
      cells.centers[cell] += points[i];
      counts[cell] += 1.0F;
      if (cells.owner[cell] < 0) cells.owner[cell] = owner[i];
    }
  });
  cells.is_stem.resize(cells.size());
  cells.is_low.resize(cells.size());
  parallelChunks(cells.size(), kChunk, [&](std::size_t begin_cell, std::size_t end_cell) {
    for (std::size_t n = begin_cell; n < end_cell; ++n) {
      cells.centers[n] /= counts[n];
      cells.is_stem[n] = cells.owner[n] >= 0 ? 1U : 0U;
      cells.is_low[n] = block.ground.heightAbove(cells.centers[n]) < kWeedHeight ? 1U : 0U;
    }
  });
  // Stems would pull the shape of what passes them towards their own.
  std::vector<Eigen::Vector3f> organs;
  for (std::size_t n = 0; n < cells.size(); ++n) {
    if (cells.is_stem[n] == 0U) organs.push_back(cells.centers[n]);
  }
  const NeighborGrid grid(organs, shape_radius);
  const std::vector<LocalShape> shapes = computeLocalShapes(organs, grid, shape_radius, device);
  LocalShape upright;
  upright.linearity = 1.0F;
  cells.shapes.assign(cells.size(), upright);
  for (std::size_t n = 0, organ = 0; n < cells.size(); ++n) {
    if (cells.is_stem[n] == 0U) cells.shapes[n] = shapes[organ++];
  }
  return cells;
}

// ---------------------------------------------------------------------------- pieces of leaves

/// Cells that run on smoothly: part of one leaf, rarely of two.
struct Pieces {
  std::vector<std::int32_t> of_cell;              // -1: in no piece
  std::vector<std::vector<std::uint32_t>> cells;  // of each piece
};

/// Which cells touch which, stems apart: looked up once, asked often.
class Contacts {
 public:
  Contacts(const Cells& cells, const NeighborGrid& grid) : begin_(cells.size() + 1U) {
    std::vector<std::vector<std::uint32_t>> touching(chunksOf(cells.size(), kChunk));
    parallelChunks(cells.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      std::vector<std::uint32_t>& of_chunk = touching[begin / kChunk];
      for (auto n = static_cast<std::uint32_t>(begin); n < end; ++n) {
        const std::size_t before = of_chunk.size();
        if (cells.is_stem[n] == 0U) {
          grid.forEachWithin(cells.centers[n], kTouch, [&](std::uint32_t other, float) {
            if (other != n && cells.is_stem[other] == 0U) of_chunk.push_back(other);
          });
        }
        begin_[n + 1U] = of_chunk.size() - before;
      }
    });
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    touching_.reserve(begin_.back());
    for (const std::vector<std::uint32_t>& of_chunk : touching) {
      touching_.insert(touching_.end(), of_chunk.begin(), of_chunk.end());
    }
  }

  /// Calls visit(cell) for the cells that touch that one.
  template <class Visit>
  void forEach(std::uint32_t cell, Visit&& visit) const {
    for (std::size_t k = begin_[cell]; k < begin_[cell + 1U]; ++k) visit(touching_[k]);
  }

 private:
  std::vector<std::size_t> begin_;  // of each cell's
  std::vector<std::uint32_t> touching_;
};

/// Joins touching cells that lie on one smooth ribbon. Where organs cross or touch, the cloud is
/// neither thin nor straight, and no piece reaches into it.
std::vector<std::int32_t> joinSmoothCells(const Cells& cells, const Contacts& contacts,
                                          float noise) {
  constexpr float kMostCurvature = 0.04F;  // of a leaf among others, without noise
  constexpr float kNoiseCurvature = 3.0F;  // of a leaf, per its squared thickness
  // A piece too many is linked again; one that runs from leaf to leaf is lost for one of them.
  constexpr float kLeastLinearity = 0.45F;
  constexpr std::uint32_t kLeastNeighbors = 6U;
  constexpr float kAlike = 0.94F;    // cosine of the largest bend from cell to cell
  constexpr float kOffset = 0.005F;  // [m] out of the ribbon
  // Noise thickens all leaves alike.
  const float thickness = noise / cells.shape_radius;
  const float most_curvature = kMostCurvature + kNoiseCurvature * thickness * thickness;
  std::vector<std::uint8_t> smooth(cells.size());
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    const LocalShape& shape = cells.shapes[n];
    smooth[n] = cells.is_stem[n] == 0U && shape.curvature < most_curvature &&
                shape.linearity > kLeastLinearity && shape.neighbors >= kLeastNeighbors;
  }
  std::vector<std::uint32_t> parent(cells.size());
  std::iota(parent.begin(), parent.end(), 0U);
  const auto root = [&](std::uint32_t n) {
    while (parent[n] != n) n = parent[n] = parent[parent[n]];
    return n;
  };
  for (std::uint32_t a = 0; a < cells.size(); ++a) {
    if (smooth[a] == 0U) continue;
    const LocalShape& shape = cells.shapes[a];
    contacts.forEach(a, [&](std::uint32_t b) {
      if (b <= a || smooth[b] == 0U) return;
      const LocalShape& other = cells.shapes[b];
      if (std::abs(shape.direction.dot(other.direction)) < kAlike) return;
      const Eigen::Vector3f step = cells.centers[b] - cells.centers[a];
      if (std::abs(step.dot(shape.normal)) > kOffset) return;
      if (std::abs(step.dot(other.normal)) > kOffset) return;
      const std::uint32_t one = root(a);
      const std::uint32_t two = root(b);
      parent[std::max(one, two)] = std::min(one, two);
    });
  }
  constexpr std::uint32_t kLeastCells = 4U;
  std::vector<std::uint32_t> count(cells.size(), 0U);
  for (std::uint32_t n = 0; n < cells.size(); ++n) ++count[root(n)];
  std::vector<std::int32_t> piece(cells.size(), -1);
  std::vector<std::int32_t> number(cells.size(), -1);
  std::int32_t next = 0;
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (smooth[n] == 0U || count[root(n)] < kLeastCells) continue;
    std::int32_t& of_root = number[root(n)];
    if (of_root < 0) of_root = next++;
    piece[n] = of_root;
  }
  return piece;
}

/// The ribbon that the cells of one piece form round a place.
struct Ribbon {
  bool known = false;
  Eigen::Vector3f mean = Eigen::Vector3f::Zero();
  Eigen::Vector3f direction = Eigen::Vector3f::UnitZ();
  Eigen::Vector3f normal = Eigen::Vector3f::UnitX();
  float linearity = 0.0F;
  float spread = 0.0F;  // [m] standard deviation of its width
};

/// @param piece its cells
Ribbon fitRibbon(const Neighborhood& piece, const Eigen::Vector3f& place, float radius) {
  const Moments moments = piece.momentsAbout(place, radius);
  Ribbon ribbon;
  constexpr float kLeastCells = 4.0F;
  if (moments.count < kLeastCells) return ribbon;
  const PrincipalAxes axes = principalAxes(moments.covariance());
  if (!(axes.values[2] > 0.0F)) return ribbon;
  const auto vector = [](const Place& p) { return Eigen::Vector3f(p.x, p.y, p.z); };
  const float width = std::max(axes.values[1], 0.0F);
  ribbon.known = true;
  ribbon.mean = place + vector(moments.mean());
  ribbon.direction = vector(axes.axes[2]);
  if (ribbon.direction.z() < 0.0F) ribbon.direction = -ribbon.direction;
  ribbon.normal = vector(axes.axes[0]);
  ribbon.linearity = (axes.values[2] - width) / axes.values[2];
  ribbon.spread = std::sqrt(width);
  return ribbon;
}

/// Carries each piece on into what touches it, as its own cells alone foretell: thus it passes
/// through crossings.
/// @param places the cells of each piece
void growPieces(const Cells& cells, const Contacts& contacts, std::vector<std::int32_t>& piece_of,
                std::vector<Neighborhood>& places) {
  constexpr float kOffset = 0.008F;   // [m] out of the ribbon
  constexpr float kHalfWidth = 1.7F;  // of an even ribbon, in standard deviations
  constexpr float kMargin = 0.01F;    // [m] beyond it
  constexpr int kMostRounds = 8;      // of one touch each
  std::vector<std::uint32_t> front;   // cells without a piece that touch one newly grown
  std::vector<std::uint8_t> listed(cells.size(), 0U);
  const auto listAround = [&](std::uint32_t n, std::vector<std::uint32_t>& list) {
    contacts.forEach(n, [&](std::uint32_t next) {
      if (piece_of[next] >= 0 || listed[next] != 0U) return;
      listed[next] = 1U;
      list.push_back(next);
    });
  };
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (piece_of[n] >= 0) listAround(n, front);
  }
  const auto pieceFor = [&](std::uint32_t n, std::vector<std::int32_t>& touching) {
    touching.clear();
    contacts.forEach(n, [&](std::uint32_t other) {
      const std::int32_t piece = piece_of[other];
      if (piece >= 0 && std::find(touching.begin(), touching.end(), piece) == touching.end()) {
        touching.push_back(piece);
      }
    });
    float least = kOffset;
    std::int32_t best = -1;
    for (const std::int32_t piece : touching) {
      const Ribbon ribbon =
          fitRibbon(places[static_cast<std::size_t>(piece)], cells.centers[n], cells.shape_radius);
      if (!ribbon.known) continue;
      const Eigen::Vector3f offset = cells.centers[n] - ribbon.mean;
      const float out = std::abs(offset.dot(ribbon.normal));
      const float aside = std::abs(offset.dot(ribbon.normal.cross(ribbon.direction)));
      if (out >= least || aside > kHalfWidth * ribbon.spread + kMargin) continue;
      least = out;
      best = piece;
    }
    return best;
  };
  std::vector<std::int32_t> pieces;  // of the front
  for (int round = 0; round < kMostRounds && !front.empty(); ++round) {
    pieces.resize(front.size());
    parallelChunks(front.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      std::vector<std::int32_t> touching;
      for (std::size_t k = begin; k < end; ++k) pieces[k] = pieceFor(front[k], touching);
    });
    std::vector<std::pair<std::uint32_t, std::int32_t>> grown;
    for (std::size_t k = 0; k < front.size(); ++k) {
      listed[front[k]] = 0U;
      if (pieces[k] >= 0) grown.emplace_back(front[k], pieces[k]);
    }
    front.clear();
    for (const auto& [n, piece] : grown) {
      piece_of[n] = piece;
      places[static_cast<std::size_t>(piece)].add(cells.centers[n]);
    }
    for (const auto& one : grown) listAround(one.first, front);
  }
}

/// Pieces of leaves; their cells get the shape of the piece alone.
Pieces findPieces(Cells& cells, float noise) {
  const Contacts contacts(cells, NeighborGrid(cells.centers, kTouch));
  Pieces pieces;
  pieces.of_cell = joinSmoothCells(cells, contacts, noise);
  std::vector<Neighborhood> places;  // of each piece
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (pieces.of_cell[n] < 0) continue;
    const auto piece = static_cast<std::size_t>(pieces.of_cell[n]);
    if (places.size() <= piece) places.resize(piece + 1U);
    places[piece].add(cells.centers[n]);
  }
  growPieces(cells, contacts, pieces.of_cell, places);
  pieces.cells.resize(places.size());
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (pieces.of_cell[n] < 0) continue;
    const auto piece = static_cast<std::size_t>(pieces.of_cell[n]);
    pieces.cells[piece].push_back(n);
  }
  parallelChunks(cells.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      if (pieces.of_cell[n] < 0) continue;
      const Ribbon ribbon = fitRibbon(places[static_cast<std::size_t>(pieces.of_cell[n])],
                                      cells.centers[n], cells.shape_radius);
      if (!ribbon.known) continue;
      cells.shapes[n].direction = ribbon.direction;
      cells.shapes[n].normal = ribbon.normal;
      cells.shapes[n].linearity = ribbon.linearity;
    }
  });
  return pieces;
}

/// A piece that may go on in another, and what that costs.
struct Link {
  std::uint32_t piece = 0U;
  float cost = 0.0F;
};

/// Every `stride`-th cell of each piece, to be looked up by place.
struct PlacesOfPieces {
  struct Place {
    std::uint32_t piece;
    std::uint32_t cell;
  };

  PlacesOfPieces(const Cells& cells, const Pieces& pieces, std::size_t every, float farthest)
      : stride(every), reach(farthest) {
    std::vector<Eigen::Vector3f> centers;
    for (std::uint32_t piece = 0; piece < pieces.cells.size(); ++piece) {
      for (std::size_t k = 0; k < pieces.cells[piece].size(); k += stride) {
        places.push_back({piece, pieces.cells[piece][k]});
        centers.push_back(cells.centers[places.back().cell]);
      }
    }
    grid.emplace(centers, reach);
  }

  std::size_t stride;
  float reach;  // [m] of the queries
  std::vector<Place> places;
  std::optional<NeighborGrid> grid;
};

/// Links pieces that lie in each other's continuation: dear over gaps, and dearer round bends.
std::vector<std::vector<Link>> linkPieces(const Cells& cells, const Pieces& pieces, float reach) {
  constexpr float kGapScale = 0.06F;   // [m] of gap that costs 1
  constexpr float kBendScale = 0.26F;  // [rad] standard deviation of a bend
  constexpr float kAside = 0.006F;     // [m] about half a cell: sideways steps that are no bend
  constexpr float kMostCost = 12.0F;
  // Across wide gaps one cell in a few tells enough.
  constexpr std::size_t kFarStride = 3U;
  const PlacesOfPieces all(cells, pieces, 1U, kNearReach);
  const PlacesOfPieces few(cells, pieces, kFarStride, reach);
  // [m^2] beyond which a gap alone costs more than the least so far.
  const auto squaredGap = [](float cost) { return cost * kGapScale * cost * kGapScale; };
  /// The cheapest ways from one piece to others.
  struct Least {
    std::vector<float> cost;      // to each
    std::vector<float> farthest;  // [m^2] its squaredGap()
    std::vector<std::uint32_t> touched;
  };
  const auto compare = [&](const PlacesOfPieces& among, std::uint32_t piece, std::uint32_t a,
                           Least& least) {
    const Eigen::Vector3f& center = cells.centers[a];
    const Eigen::Vector3f& direction = cells.shapes[a].direction;
    among.grid->forEachWithin(center, among.reach, [&](std::uint32_t k, float squared) {
      const auto [other, b] = among.places[k];
      if (other <= piece || squared >= least.farthest[other]) return;
      // What is cheap to know first, since few pairs are better than the best so far.
      const float gap = std::sqrt(squared);
      const float gap_cost = gap / kGapScale;
      const Eigen::Vector3f& onward = cells.shapes[b].direction;
      const float whole = 2.0F - 2.0F * std::abs(direction.dot(onward));
      constexpr float kPerBend = 0.5F / (kBendScale * kBendScale);
      if (gap_cost + kPerBend * whole >= least.cost[other]) return;
      const Eigen::Vector3f step = cells.centers[b] - center;
      // Squares of angles, nearly: 2 - 2 cos.
      const auto bend = [&](const Eigen::Vector3f& along) {
        const float ahead = std::abs(step.dot(along));
        const float aside = std::sqrt(std::max(0.0F, squared - ahead * ahead)) - kAside;
        return aside > 0.0F ? 2.0F - 2.0F * ahead / std::sqrt(ahead * ahead + aside * aside) : 0.0F;
      };
      const float cost = gap_cost + kPerBend * (bend(direction) + bend(onward) + whole);
      if (cost >= least.cost[other]) return;
      if (gap > kNearReach && (cells.is_low[a] | cells.is_low[b]) != 0) return;
      if (least.cost[other] == kMostCost) least.touched.push_back(other);
      least.cost[other] = cost;
      least.farthest[other] = squaredGap(cost);
    });
  };
  const std::size_t count = pieces.cells.size();
  std::vector<std::vector<Link>> onward(count);  // of each piece, to those after it
  constexpr std::size_t kTogether = 32U;         // pieces of a task
  parallelChunks(count, kTogether, [&](std::size_t begin, std::size_t end) {
    Least least{
        std::vector<float>(count, kMostCost), std::vector<float>(count, squaredGap(kMostCost)), {}};
    for (std::size_t p = begin; p < end; ++p) {
      const auto piece = static_cast<std::uint32_t>(p);
      const std::vector<std::uint32_t>& members = pieces.cells[p];
      for (const std::uint32_t a : members) compare(all, piece, a, least);
      for (std::size_t k = 0; k < members.size(); k += few.stride) {
        compare(few, piece, members[k], least);
      }
      for (const std::uint32_t other : least.touched) {
        onward[p].push_back({other, least.cost[other]});
        least.cost[other] = kMostCost;
        least.farthest[other] = squaredGap(kMostCost);
      }
      least.touched.clear();
    }
  });
  std::vector<std::vector<Link>> links(count);
  for (std::uint32_t piece = 0; piece < count; ++piece) {
    for (const Link& link : onward[piece]) {
      links[piece].push_back(link);
      links[link.piece].push_back({piece, link.cost});
    }
  }
  return links;
}

// ---------------------------------------------------------------------------- form of leaves

/// kLanes cells of organs.
struct OrganLanes {
  Floats x;
  Floats y;
  Floats z;
  Floats direction_x;
  Floats direction_y;
  Floats direction_z;  // >= 0
  Floats linearity;
};

OrganLanes lanesOf(const LocalShape& shape, const Eigen::Vector3f& center) {
  return {allOf(center.x()),          allOf(center.y()),          allOf(center.z()),
          allOf(shape.direction.x()), allOf(shape.direction.y()), allOf(shape.direction.z()),
          allOf(shape.linearity)};
}

/// Some cells of a piece, coordinate by coordinate.
class PieceSamples {
 public:
  /// Every `stride`-th cell.
  void take(const Cells& cells, const std::vector<std::uint32_t>& members, std::size_t stride) {
    count_ = (members.size() + stride - 1U) / stride;
    // Lanes beyond the last one repeat it, with no say.
    for (std::vector<float>& values : values_) values.resize(count_ + kLanes);
    for (std::size_t k = 0; k < count_ + kLanes; ++k) {
      const std::uint32_t n = members[std::min(k, count_ - 1U) * stride];
      const LocalShape& shape = cells.shapes[n];
      for (std::size_t axis = 0; axis < 3U; ++axis) {
        values_[axis][k] = cells.centers[n][static_cast<Eigen::Index>(axis)];
        values_[axis + 3U][k] = shape.direction[static_cast<Eigen::Index>(axis)];
      }
      values_[6][k] = k < count_ ? shape.linearity : 0.0F;
    }
  }
  std::size_t size() const { return count_; }
  OrganLanes lanesFrom(std::size_t k) const {
    const auto load = [&](std::size_t value) { return loadFloats(&values_[value][k]); };
    return {load(0U), load(1U), load(2U), load(3U), load(4U), load(5U), load(6U)};
  }

 private:
  std::size_t count_ = 0U;
  std::array<std::vector<float>, 7> values_;
};

/// How places on organs lie to an axis.
struct Pose {
  Integers known;   // does not hold where it is too near to the axis to tell
  Floats distance;  // [m] level distance from the axis
  Floats miss;      // [m] by which the organ points past the axis
  Floats slope;     // [rad] of the organ outwards, upwards positive
};

/// @param segment of the axis, where to look first
Pose poseOf(const OrganLanes& organ, const StemAxis& axis, std::size_t& segment) {
  constexpr float kOnStem = 0.025F;  // [m]
  constexpr float kUpright = 1e-3F;  // level share of a direction that points nowhere
  Floats away_x = organ.x;
  Floats away_y = organ.y;
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    const Eigen::Vector3f foot = axis.pointAtHeight(organ.z[lane], segment);
    away_x[lane] -= foot.x();
    away_y[lane] -= foot.y();
  }
  const Floats& run_x = organ.direction_x;
  const Floats& run_y = organ.direction_y;
  Pose pose;
  pose.distance = squareRootOf(away_x * away_x + away_y * away_y);
  const Floats level = squareRootOf(run_x * run_x + run_y * run_y);
  pose.known = (pose.distance >= kOnStem) & (level > kUpright);
  // What stands upright points nowhere.
  const Floats share = smallerOf(allOf(1.0F), 2.0F * level) / largerOf(level, allOf(kUpright));
  pose.miss = magnitudeOf(run_x * away_y - run_y * away_x) * share;
  const Floats outward = run_x * away_x + run_y * away_y;
  const Floats angle = arctangentOf(organ.direction_z * pose.distance, magnitudeOf(outward));
  pose.slope = outward < 0.0F ? -angle : angle;
  return pose;
}

/// What leaves are compared with.
struct Host {
  const StemAxis* axis = nullptr;
  float top = 0.0F;  // [m] height of the highest point of the stem and of what carries it on
  OrganEnd end;      // of what carries it on

  float height() const { return top - axis->nodes().front().position.z(); }  // [m]
  float tip() const { return top - axis->nodes().back().position.z(); }      // [m] above the axis
};

/// Form of the leaves of a stand, by the distance from their stem and by height. Maize leaves stay
/// in a vertical plane through their own stem, rise steeply from it and flatten, then droop; the
/// upper ones stand more upright. How much depends on age and variety, so it is learnt from the
/// block itself.
class LeafForm {
 public:
  /// Leaves about tasselling, loosely.
  LeafForm() {
    constexpr float kSlopeAtStem = 1.13F;  // [rad]
    constexpr float kSlopeLoss = 2.1F;     // [rad/m]
    Profile& usual = bands_.front();
    for (std::size_t k = 0; k < kBins; ++k) {
      const float distance = kBin * (static_cast<float>(k) + 0.5F);
      usual[k].slope = kSlopeAtStem - kSlopeLoss * distance;
      usual[k].slope_spread = 0.35F + 1.0F * distance;
      usual[k].miss_spread = 0.02F + 0.3F * distance;
    }
    bands_.fill(Profile(usual));
  }

  /// The form of the organs that have an owner; robust against a minority of wrong ones.
  static LeafForm learn(const Cells& cells, const std::vector<Host>& hosts) {
    constexpr float kLeastLinearity = 0.3F;
    std::vector<std::vector<float>> rises(hosts.size());  // [m]
    Samples whole;
    std::array<Samples, kBands> samples;
    for (std::uint32_t n = 0; n < cells.size(); ++n) {
      if (cells.is_stem[n] != 0U || cells.owner[n] < 0) continue;
      const auto plant = static_cast<std::size_t>(cells.owner[n]);
      const StemAxis& axis = *hosts[plant].axis;
      if (isBeside(cells.centers[n], hosts[plant])) {
        rises[plant].push_back(cells.centers[n].z() - hosts[plant].top);
      }
      if (cells.shapes[n].linearity < kLeastLinearity) continue;
      std::size_t segment = 0U;
      const OrganLanes organ = lanesOf(cells.shapes[n], cells.centers[n]);
      const Pose pose = poseOf(organ, axis, segment);
      const auto bin = static_cast<std::size_t>(pose.distance[0] / kBin);
      if (pose.known[0] == 0 || bin >= kBins) continue;
      for (Samples* of : {&whole, &samples[static_cast<std::size_t>(bandsOf(organ.z, axis)[0])]}) {
        of->slopes[bin].push_back(pose.slope[0]);
        of->misses[bin].push_back(pose.miss[0]);
      }
    }
    LeafForm form;
    const Profile usual = profileOf(whole, form.bands_.front());
    for (std::size_t band = 0; band < kBands; ++band) {
      form.bands_[band] = profileOf(samples[band], usual);
    }
    form.learnCeiling(std::move(rises));
    form.learnTips(hosts);
    return form;
  }

  /// How little a place on an organ looks like one of the plant with that axis, from 0. Leaves that
  /// cross from a neighbour point past the stem and rise the wrong way.
  float misfit(const LocalShape& shape, const Eigen::Vector3f& center, const Host& host) const {
    std::size_t segment = 0U;
    return misfitOf(lanesOf(shape, center), *host.axis, segment)[0];
  }
  /// How much too high a place stands to be an organ of that plant, from 0. In a stand with tassels
  /// leaves and side branches stay below the tops of their stems, by about as much everywhere, and
  /// nothing stands above a tip that is known.
  float tooHigh(const Eigen::Vector3f& place, const Host& host) const {
    constexpr float kWeight = 2.0F;       // of a squared standard deviation
    constexpr float kTail = 0.5F;         // a top that was not found is no more than odd
    constexpr float kTipStddev = 0.015F;  // [m]
    if (!ceiling_ || place.z() <= host.top + std::min(*ceiling_, 0.0F)) return 0.0F;
    float off = 0.0F;
    if (isBeside(place, host)) off = (place.z() - host.top - *ceiling_) / rise_spread_;
    if (hasTip(host) && !goesOn(host.end, place)) {
      off = std::max(off, (place.z() - host.top) / kTipStddev);
    }
    if (off <= 0.0F) return 0.0F;
    return kWeight * off * off / (1.0F + kTail * off * off);
  }
  /// The sum over samples of one piece.
  float misfit(const PieceSamples& samples, const Host& host) const {
    std::size_t segment = 0U;
    Floats sum{};
    for (std::size_t k = 0; k < samples.size(); k += kLanes) {
      sum += misfitOf(samples.lanesFrom(k), *host.axis, segment);
    }
    return total(sum);
  }

 private:
  /// Whether a place is too far from the stem to be its own spike, found or not.
  static bool isBeside(const Eigen::Vector3f& place, const Host& host) {
    constexpr float kSpike = 0.08F;  // [m] with its bend
    const Eigen::Vector3f foot = host.axis->pointAtHeight(place.z());
    return (place - foot).head<2>().squaredNorm() > kSpike * kSpike;
  }

  /// Whether the tip of what carries the stem on is known: it was seen well, and is not lower than
  /// others are, as where another organ was followed.
  bool hasTip(const Host& host) const {
    constexpr float kTipStddevs = 2.0F;
    constexpr float kHeightStddevs = 2.3F;
    return host.end.is_clear && host.tip() > tips_.middle - kTipStddevs * tips_.stddev &&
           host.height() > heights_.middle - kHeightStddevs * heights_.stddev;
  }
  /// Whether a place is where the organ may go on that was followed.
  static bool goesOn(const OrganEnd& end, const Eigen::Vector3f& place) {
    constexpr float kTube = 0.02F;     // [m]
    constexpr float kFarther = 0.08F;  // [m]
    const Eigen::Vector3f away = place - end.place;
    const float along = away.dot(end.direction);
    return along < kFarther && (away - along * end.direction).squaredNorm() < kTube * kTube;
  }

  void learnTips(const std::vector<Host>& hosts) {
    std::vector<float> tips;
    std::vector<float> heights;
    for (const Host& host : hosts) {
      if (host.axis->empty()) continue;
      tips.push_back(host.tip());
      heights.push_back(host.height());
    }
    if (tips.empty()) return;
    tips_ = robustSpreadOf(tips, kLeastSpread);
    heights_ = robustSpreadOf(heights, kLeastSpread);
  }
  /// @param rises of each plant's organs beside the stem above its top [m]
  void learnCeiling(std::vector<std::vector<float>> rises) {
    constexpr std::size_t kStray = 3U;    // cells of a plant that may be another's
    constexpr std::size_t kLeaves = 50U;  // cells of a plant that shows its leaves
    constexpr std::size_t kPlants = 5U;   // that make a stand
    std::vector<float> highest;
    for (std::vector<float>& of_plant : rises) {
      if (of_plant.size() < kLeaves) continue;
      const auto high = of_plant.begin() + kStray;
      std::nth_element(of_plant.begin(), high, of_plant.end(), std::greater<>());
      highest.push_back(*high);
    }
    if (highest.size() < kPlants) return;
    const auto [typical, spread] = robustSpreadOf(highest, kLeastSpread);
    rise_spread_ = spread;
    // Without tassels the top is no more than the leaf that was followed highest.
    constexpr float kSpreads = 2.0F;  // that hardly a plant's leaves exceed
    if (typical < -rise_spread_) ceiling_ = typical + kSpreads * rise_spread_;
  }

  Floats misfitOf(const OrganLanes& organ, const StemAxis& axis, std::size_t& segment) const {
    const Pose pose = poseOf(organ, axis, segment);
    if (!anyOf(pose.known)) return Floats{};
    const Floats at = clampedTo(pose.distance * (1.0F / kBin) - 0.5F, 0.0F, kBins - 1.001F);
    Floats slope{};
    Floats slope_spread{};
    Floats miss_spread{};
    const Integers bands = bandsOf(organ.z, axis);
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const Profile& profile = bands_[static_cast<std::size_t>(bands[lane])];
      const auto k = static_cast<std::size_t>(at[lane]);
      const float share = at[lane] - static_cast<float>(k);
      const auto between = [&](float Bin::*value) {
        return (1.0F - share) * profile[k].*value + share * profile[k + 1U].*value;
      };
      slope[lane] = between(&Bin::slope);
      slope_spread[lane] = between(&Bin::slope_spread);
      miss_spread[lane] = between(&Bin::miss_spread);
    }
    const Floats off_plane = pose.miss / miss_spread;
    const Floats off_slope = (pose.slope - slope) / slope_spread;
    // Not its square, since a leaf that is bent or torn is odd all along.
    constexpr float kTail = 2.0F;
    const Floats odd =
        logarithmOf(1.0F + 0.5F / kTail * (off_plane * off_plane + off_slope * off_slope));
    return pose.known ? organ.linearity * kTail * odd : Floats{};
  }

  static constexpr std::size_t kBins = 20U;
  static constexpr float kBin = 0.05F;                    // [m]
  static constexpr std::size_t kStemBands = 5U;           // of equal height up the stem
  static constexpr std::size_t kBands = kStemBands + 1U;  // and one above its end
  struct Bin {
    float slope = 0.0F;
    float slope_spread = 0.0F;
    float miss_spread = 0.0F;
  };
  using Profile = std::array<Bin, kBins>;
  struct Samples {
    std::array<std::vector<float>, kBins> slopes;
    std::array<std::vector<float>, kBins> misses;
  };

  static Integers bandsOf(const Floats& z, const StemAxis& axis) {
    const float low = axis.nodes().front().position.z();
    const float height = std::max(axis.nodes().back().position.z() - low, kBin);
    const Floats bands = (z - low) * (static_cast<float>(kStemBands) / height);
    return __builtin_convertvector(clampedTo(bands, 0.0F, static_cast<float>(kBands) - 0.5F),
                                   Integers);
  }

  /// Where a distance has few samples: `usual`, or what is known nearer to the stem.
  static Profile profileOf(Samples& samples, const Profile& usual) {
    constexpr std::size_t kEnough = 100U;
    constexpr float kLeastSlopeSpread = 0.15F;  // [rad]
    constexpr float kLeastMissSpread = 0.015F;  // [m]
    constexpr float kStddevOfMad = 1.48F;
    Profile profile = usual;
    for (std::size_t k = 0; k < kBins; ++k) {
      std::vector<float>& slopes = samples.slopes[k];
      if (slopes.size() < kEnough) continue;
      Bin& bin = profile[k];
      bin.slope = medianOf(slopes);
      for (float& slope : slopes) slope = std::abs(slope - bin.slope);
      bin.slope_spread = std::max(kLeastSlopeSpread, kStddevOfMad * medianOf(slopes));
      bin.miss_spread = std::max(kLeastMissSpread, kStddevOfMad * medianOf(samples.misses[k]));
    }
    return profile;
  }

  std::array<Profile, kBands> bands_;
  std::optional<float> ceiling_;  // [m] above the top, for organs beside the stem
  float rise_spread_ = 0.0F;      // [m] standard deviation, over plants, of their highest organ
  RobustSpread tips_{};           // [m] of what carries stems on, above their axes
  RobustSpread heights_{};        // [m] of plants
  static constexpr float kLeastSpread = 0.03F;  // [m] of plants
};

// ---------------------------------------------------------------------------- pieces to plants

struct Entry {
  float cost;
  std::uint32_t node;
  bool operator>(const Entry& other) const {
    return cost != other.cost ? cost > other.cost : node > other.node;
  }
};
using Queue = std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>>;

/// How much worse a piece fits a plant than the one that it fits best.
struct Misfit {
  std::uint32_t piece = 0U;
  float cost = 0.0F;
};

/// For every plant the pieces that stand near enough to be its own. What no plant explains well,
/// because it is bent or small, is so held against none of them, nor against what hangs on it.
std::vector<std::vector<Misfit>> compareForms(const Cells& cells, const Pieces& pieces,
                                              const std::vector<Host>& hosts, const LeafForm& form,
                                              float weight) {
  constexpr float kFarthest = 1.2F;      // [m] a leaf, and what its stem leans
  constexpr float kWholeCells = 30.0F;   // a piece of so many has its full say
  constexpr std::size_t kSamples = 64U;  // cells that show the form of a piece
  const auto level = [](const Eigen::Vector3f& p) { return Eigen::Vector3f(p.x(), p.y(), 0.0F); };
  std::vector<std::uint8_t> has_stem(hosts.size(), 0U);
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (cells.is_stem[n] != 0U) has_stem[static_cast<std::size_t>(cells.owner[n])] = 1U;
  }
  std::vector<Eigen::Vector3f> feet;
  for (const Host& host : hosts) feet.push_back(level(host.axis->nodes().front().position));
  const NeighborGrid grid(feet, 0.5F * kFarthest);
  const std::size_t count = pieces.cells.size();
  std::vector<std::vector<std::pair<std::uint32_t, float>>> of_plants(count);  // for each piece
  parallelFor(count, [&](std::size_t piece) {
    const std::vector<std::uint32_t>& members = pieces.cells[piece];
    const std::size_t stride = (members.size() + kSamples - 1U) / kSamples;
    PieceSamples samples;
    samples.take(cells, members, stride);
    const auto size = static_cast<float>(members.size());
    const float share =
        weight * size / (std::max(size, kWholeCells) * static_cast<float>(samples.size()));
    grid.forEachWithin(level(cells.centers[members[members.size() / 2U]]), kFarthest,
                       [&](std::uint32_t plant, float) {
                         if (has_stem[plant] == 0U) return;
                         const Host& host = hosts[plant];
                         // However small, what stands too high cannot be the plant's.
                         float high = 0.0F;
                         for (std::size_t k = 0; k < members.size(); k += stride) {
                           high += form.tooHigh(cells.centers[members[k]], host);
                         }
                         const float cost = share * form.misfit(samples, host) +
                                            weight * high / static_cast<float>(samples.size());
                         of_plants[piece].emplace_back(plant, cost);
                       });
  });
  std::vector<std::vector<Misfit>> misfits(hosts.size());
  for (std::uint32_t piece = 0; piece < count; ++piece) {
    float least = std::numeric_limits<float>::max();
    for (const auto& [plant, cost] : of_plants[piece]) least = std::min(least, cost);
    for (const auto& [plant, cost] : of_plants[piece])
      misfits[plant].push_back({piece, cost - least});
  }
  return misfits;
}

/// Where every plant in turn takes what makes the sum of all costs least, until nothing changes: a
/// piece costs what it costs the plant that has it, and a link between pieces of two plants costs
/// the more the likelier it is that one continues the other.
///
/// @param costs    of each plant: the pieces that it can get at
/// @param plant_of of each piece: a first choice among them, or -1 where no plant gets at it
void settlePieces(const std::vector<std::vector<Misfit>>& costs,
                  const std::vector<std::vector<Link>>& links,
                  std::vector<std::int32_t>& plant_of) {
  // Log odds that the pieces of a link are of one plant, roughly.
  constexpr float kSure = 4.0F;
  constexpr float kLinkScale = 2.0F;  // link cost that makes them e times less
  constexpr float kLeastOdds = 0.05F;
  constexpr int kMostRounds = 3;
  const auto whole = [](float cost) {
    constexpr float kUnit = 1000.0F;
    return static_cast<std::int64_t>(cost * kUnit);
  };
  const std::size_t count = plant_of.size();
  std::vector<std::vector<std::pair<std::uint32_t, std::int64_t>>> parting(count);
  for (std::size_t piece = 0; piece < count; ++piece) {
    for (const Link& link : links[piece]) {
      const float odds = kSure * std::exp(-link.cost / kLinkScale);
      if (odds > kLeastOdds && plant_of[link.piece] >= 0) {
        parting[piece].emplace_back(link.piece, whole(odds));
      }
    }
  }
  std::vector<float> cost(count, 0.0F);  // to the plant that has it
  for (std::size_t plant = 0; plant < costs.size(); ++plant) {
    for (const Misfit& of : costs[plant]) {
      if (plant_of[of.piece] == static_cast<std::int32_t>(plant)) cost[of.piece] = of.cost;
    }
  }
  constexpr std::size_t kNoNode = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> node(count, kNoNode);
  std::vector<Misfit> others;  // pieces that the plant may take
  bool changed = true;
  for (int round = 0; round < kMostRounds && changed; ++round) {
    changed = false;
    for (std::size_t plant = 0; plant < costs.size(); ++plant) {
      const auto taker = static_cast<std::int32_t>(plant);
      others.clear();
      for (const Misfit& of : costs[plant]) {
        if (plant_of[of.piece] == taker) continue;
        node[of.piece] = others.size();
        others.push_back(of);
      }
      MinimumCut cut(others.size());
      for (std::size_t n = 0; n < others.size(); ++n) {
        const std::uint32_t piece = others[n].piece;
        cut.addCost(n, whole(others[n].cost - cost[piece]));
        for (const auto& [next, odds] : parting[piece]) {
          const bool together = plant_of[next] == plant_of[piece];
          if (node[next] == kNoNode) {
            cut.addCost(n, odds * ((plant_of[next] == taker ? 0 : 1) - (together ? 0 : 1)));
          } else if (piece < next) {
            // What was parted stays so unless both are taken.
            cut.addPairCost(n, node[next], odds);
            if (together) {
              cut.addPairCost(node[next], n, odds);
            } else {
              cut.addCost(node[next], -odds);
            }
          }
        }
      }
      const std::vector<bool> taken = cut.solve();
      for (std::size_t n = 0; n < others.size(); ++n) {
        const Misfit& of = others[n];
        node[of.piece] = kNoNode;
        if (!taken[n]) continue;
        plant_of[of.piece] = taker;
        cost[of.piece] = of.cost;
        changed = true;
      }
    }
  }
}

/// Gives whole pieces to plants. A plant gets at a piece from its stem or through pieces that this
/// one continues; every piece on the way costs as much as its form does not fit that plant. The
/// plant with the cheapest way has it; `settle` then gives pieces that continue one another away
/// together, which is of use only once the form is known.
void assignPieces(Cells& cells, const Pieces& pieces, const std::vector<std::vector<Link>>& links,
                  const std::vector<Host>& hosts, float reach, const LeafForm& form,
                  float misfit_weight, bool settle) {
  constexpr float kMostCost = 60.0F;
  constexpr float kGapScale = 0.04F;  // [m] of gap between a stem and its leaf that costs 1
  constexpr float kNone = std::numeric_limits<float>::max();
  const std::size_t count = pieces.cells.size();
  const std::vector<std::vector<Misfit>> misfits_of =
      compareForms(cells, pieces, hosts, form, misfit_weight);
  const NeighborGrid grid(cells.centers, reach);
  std::vector<std::vector<Misfit>> ways(hosts.size());  // costs of the cheapest of each plant
  std::vector<std::vector<Misfit>> costs_of(hosts.size());
  constexpr std::size_t kTogether = 4U;  // plants of a task
  parallelChunks(hosts.size(), kTogether, [&](std::size_t begin, std::size_t end) {
    std::vector<float> cost(count, kNone);
    std::vector<float> start(count, kNone);    // at the stem
    std::vector<float> misfits(count, kNone);  // of pieces near the plant
    for (std::size_t plant = begin; plant < end; ++plant) {
      const StemAxis& axis = *hosts[plant].axis;
      if (misfits_of[plant].empty()) continue;
      for (const Misfit& misfit : misfits_of[plant]) misfits[misfit.piece] = misfit.cost;

      constexpr float kBeyondTop = 0.15F;  // [m] leaves of the whorl stand on above the end
      const float slab = 0.5F * reach;
      for (float s = 0.0F; s <= axis.length() + kBeyondTop; s += slab) {
        const Eigen::Vector3f middle = axis.pointAt(s);
        const float radius = axis.radiusAt(s);
        grid.forEachWithin(middle, reach, [&](std::uint32_t n, float) {
          if (pieces.of_cell[n] < 0) return;
          const Eigen::Vector3f& center = cells.centers[n];
          if (std::abs(center.z() - middle.z()) > 0.5F * slab) return;
          const auto piece = static_cast<std::uint32_t>(pieces.of_cell[n]);
          if (misfits[piece] == kNone) return;
          const float away = (center - axis.pointAtHeight(center.z())).head<2>().norm();
          const float gap = std::max(0.0F, away - radius);
          if (gap >= kGapScale * start[piece]) return;
          if (gap > kNearReach && cells.is_low[n] != 0U) return;
          start[piece] = std::min(
              start[piece], gap / kGapScale + form.misfit(cells.shapes[n], center, hosts[plant]));
        });
      }

      Queue open;
      const auto offer = [&](std::uint32_t piece, float through) {
        if (misfits[piece] == kNone) return;
        through += misfits[piece];
        if (through >= std::min(cost[piece], kMostCost)) return;
        cost[piece] = through;
        open.push({through, piece});
      };
      for (const Misfit& misfit : misfits_of[plant]) {
        if (start[misfit.piece] < kMostCost) offer(misfit.piece, start[misfit.piece]);
      }
      while (!open.empty()) {
        const Entry entry = open.top();
        open.pop();
        if (entry.cost > cost[entry.node]) continue;
        for (const Link& link : links[entry.node]) offer(link.piece, entry.cost + link.cost);
      }
      for (const Misfit& misfit : misfits_of[plant]) {
        if (cost[misfit.piece] < kMostCost) {
          ways[plant].push_back({misfit.piece, cost[misfit.piece]});
          // What the way costs says less of a piece than its own form does.
          constexpr float kWayShare = 0.5F;
          costs_of[plant].push_back(
              {misfit.piece, misfit.cost + kWayShare * (cost[misfit.piece] - misfit.cost)});
        }
        cost[misfit.piece] = start[misfit.piece] = misfits[misfit.piece] = kNone;
      }
    }
  });
  std::vector<float> least(count, kNone);
  std::vector<std::int32_t> plant_of(count, -1);
  for (std::size_t plant = 0; plant < hosts.size(); ++plant) {
    for (const Misfit& way : ways[plant]) {
      if (way.cost >= least[way.piece]) continue;
      least[way.piece] = way.cost;
      plant_of[way.piece] = static_cast<std::int32_t>(plant);
    }
  }
  if (settle) settlePieces(costs_of, links, plant_of);
  for (std::size_t piece = 0; piece < count; ++piece) {
    for (const std::uint32_t n : pieces.cells[piece]) cells.owner[n] = plant_of[piece];
  }
}

// ---------------------------------------------------------------------------- what is left

/// Cost of a step: its squared length, times more the less it follows the organs at both ends, and
/// more where the organ itself turns.
float stepCost(const Cells& cells, std::uint32_t from, std::uint32_t to, float squared) {
  constexpr float kAcrossCost = 60.0F;  // how much dearer a step across an organ is than along it
  constexpr float kTurnCost = 0.02F;    // [m^2] of a turn by a right angle
  if (!(squared > 0.0F)) return 0.0F;
  const Eigen::Vector3f step = cells.centers[to] - cells.centers[from];
  const LocalShape& a = cells.shapes[from];
  const LocalShape& b = cells.shapes[to];
  const auto across = [&](const LocalShape& shape) {
    const float along = step.dot(shape.direction);
    return shape.linearity * (1.0F - along * along / squared);
  };
  const float turn = a.linearity * b.linearity * (1.0F - std::abs(a.direction.dot(b.direction)));
  return squared * (1.0F + kAcrossCost * 0.5F * (across(a) + across(b))) + kTurnCost * turn * turn;
}

/// Shortest paths from all cells with an owner to those without; a path may step `reach` at most.
void growPaths(Cells& cells, const std::vector<Host>& hosts, const LeafForm& form, float reach,
               bool only_tall) {
  constexpr float kLeastMisfit = 0.1F;  // what a step costs through an organ that fits its plant
  constexpr float kFar = std::numeric_limits<float>::max();
  /// A cell without an owner.
  struct Way {
    float cost = kFar;
    std::int32_t owner = -1;
    // Paths of one plant come to a cell from many sides.
    std::int32_t compared = -1;  // plant that `misfit` is known for
    float misfit = 0.0F;
  };
  /// Leads a path of a plant that has cost so much on to a cell; false where that is no better.
  const auto lead = [&](std::int32_t plant, float cost, std::uint32_t from, std::uint32_t to,
                        float squared, Way& way) {
    if (way.cost <= cost) return false;
    const float step = stepCost(cells, from, to, squared);
    if (cost + kLeastMisfit * step >= way.cost) return false;
    if (way.compared != plant) {
      const Host& host = hosts[static_cast<std::size_t>(plant)];
      way.compared = plant;
      way.misfit = form.misfit(cells.shapes[to], cells.centers[to], host) +
                   form.tooHigh(cells.centers[to], host);
    }
    const float through = cost + step * (kLeastMisfit + way.misfit);
    if (through >= way.cost) return false;
    way.cost = through;
    way.owner = plant;
    return true;
  };

  std::vector<std::uint32_t> open_cells;
  constexpr std::uint32_t kOwned = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> number(cells.size(), kOwned);  // of each among the open ones
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (cells.owner[n] >= 0 || (only_tall && cells.is_low[n] != 0U)) continue;
    number[n] = static_cast<std::uint32_t>(open_cells.size());
    open_cells.push_back(n);
  }
  // First steps, out of cells that have an owner, and where paths may go on.
  struct Step {
    std::uint32_t way;
    float squared;  // [m^2]
  };
  const NeighborGrid grid(cells.centers, reach);
  std::vector<Way> ways(open_cells.size());
  std::vector<std::vector<Step>> steps(open_cells.size());
  parallelChunks(open_cells.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    std::vector<std::pair<std::uint32_t, float>> sources;
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint32_t n = open_cells[k];
      sources.clear();
      grid.forEachWithin(cells.centers[n], reach, [&](std::uint32_t near, float squared) {
        if (cells.owner[near] >= 0) {
          sources.emplace_back(near, squared);
        } else if (number[near] != kOwned && near != n) {
          steps[k].push_back({number[near], squared});
        }
      });
      std::sort(sources.begin(), sources.end());  // of equals the first
      for (const auto& [near, squared] : sources) {
        lead(cells.owner[near], 0.0F, near, n, squared, ways[k]);
      }
    }
  });
  Queue open;
  for (std::uint32_t k = 0; k < ways.size(); ++k) {
    if (ways[k].owner >= 0) open.push({ways[k].cost, k});
  }
  while (!open.empty()) {
    const auto [cost, from] = open.top();
    open.pop();
    if (cost > ways[from].cost) continue;
    for (const Step& step : steps[from]) {
      Way& way = ways[step.way];
      if (lead(ways[from].owner, cost, open_cells[from], open_cells[step.way], step.squared, way)) {
        open.push({way.cost, step.way});
      }
    }
  }
  for (std::size_t k = 0; k < ways.size(); ++k) {
    if (ways[k].owner >= 0) cells.owner[open_cells[k]] = ways[k].owner;
  }
}

/// Neighbourhood that shows which way an organ runs [m]: wider where noise thickens it.
float shapeRadius(float noise) {
  constexpr float kNarrow = 0.05F;  // [m]
  constexpr float kWide = 0.07F;    // [m]
  constexpr float kClear = 0.003F;  // [m] noise that hides no form
  constexpr float kPerNoise = 5.0F;
  return std::clamp(kNarrow + kPerNoise * (noise - kClear), kNarrow, kWide);
}

/// Standard deviation of the points across a surface [m], which the stems show.
float noiseOf(const Block& block, const std::vector<StemAxis>& axes,
              const std::vector<std::int32_t>& owner) {
  std::vector<float> off;
  for (std::size_t i = 0; i < owner.size(); ++i) {
    if (owner[i] < 0) continue;
    const StemAxis::Projection at =
        axes[static_cast<std::size_t>(owner[i])].project(block.cloud.points[i]);
    off.push_back(std::abs(at.distance - at.radius));
  }
  return off.empty() ? 0.0F : static_cast<float>(kMadToSigma) * medianOf(off);
}

/// @param owner of each point: the plant whose stem, or what carries that on, holds it, or -1
std::vector<Host> hostsOf(const Block& block, const std::vector<StemAxis>& axes,
                          const std::vector<OrganEnd>& ends,
                          const std::vector<std::int32_t>& owner) {
  std::vector<Host> hosts;
  for (std::size_t plant = 0; plant < axes.size(); ++plant) {
    const StemAxis& axis = axes[plant];
    hosts.push_back({&axis, axis.empty() ? 0.0F : axis.nodes().back().position.z(), ends[plant]});
  }
  for (std::size_t i = 0; i < owner.size(); ++i) {
    if (owner[i] < 0) continue;
    float& top = hosts[static_cast<std::size_t>(owner[i])].top;
    top = std::max(top, block.cloud.points[i].z());
  }
  return hosts;
}

}  // namespace

std::vector<std::int32_t> assignOrgans(const Block& block, const std::vector<StemAxis>& axes,
                                       std::vector<std::int32_t> owner,
                                       const SegmentationParameters& parameters,
                                       const ComputeDevice& device) {
  if (block.cloud.empty()) return owner;
  const auto reach = static_cast<float>(parameters.organ_reach);
  const float noise = noiseOf(block, axes, owner);
  const std::vector<OrganEnd> ends = followStemsUp(block, axes, noise, owner);
  const std::vector<Host> hosts = hostsOf(block, axes, ends, owner);
  Cells cells = gatherCells(block, owner, shapeRadius(noise), device);
  const Pieces pieces = findPieces(cells, noise);
  constexpr float kStraightOn = 1.6F;  // of the reach, along a leaf
  const std::vector<std::vector<Link>> links = linkPieces(cells, pieces, kStraightOn * reach);
  // First with leaves as they usually are, then with what that shows of these ones.
  constexpr float kLooseWeight = 5.0F;
  constexpr float kFirmWeight = 15.0F;
  LeafForm form;
  assignPieces(cells, pieces, links, hosts, 2.0F * reach, form, kLooseWeight, false);
  form = LeafForm::learn(cells, hosts);
  assignPieces(cells, pieces, links, hosts, 2.0F * reach, form, kFirmWeight, true);
  // Crossings, margins and what is too small or rough to be a piece.
  growPaths(cells, hosts, form, std::min(kNearReach, reach), false);
  // Gaps that leaves in front have torn; not near the soil, where weeds stand as close.
  if (reach > kNearReach) growPaths(cells, hosts, form, reach, true);
  for (std::size_t i = 0; i < owner.size(); ++i) {
    if (owner[i] < 0) owner[i] = cells.owner[cells.of_point[i]];
  }
  return owner;
}

}  // namespace field_phenotyping
