#include "field_phenotyping/segmentation/leaf_pieces.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "field_phenotyping/common/indices_where.hpp"
#include "field_phenotyping/common/neighbor_grid.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/segmentation/neighborhood.hpp"

namespace field_phenotyping {
namespace {

constexpr float kTouch = 0.03F;  // [m] cells this close touch

/// How far more than without noise a cell may lie out of its ribbon [m].
float offsetByNoise(const OrganCells& cells) {
  constexpr float kClear = 0.003F;  // [m] noise that hides no form
  return std::max(0.0F, cells.noise - kClear);
}

/// Which cells touch which, stems apart: looked up once, asked often.
class Contacts {
 public:
  Contacts(const OrganCells& cells, const NeighborGrid& grid) : begin_(cells.size() + 1U) {
    std::vector<std::vector<std::uint32_t>> touching(chunksOf(cells.size(), kCellsOfTask));
    parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
      std::vector<std::uint32_t>& of_chunk = touching[begin / kCellsOfTask];
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
std::vector<std::int32_t> joinSmoothCells(const OrganCells& cells, const Contacts& contacts) {
  constexpr float kMostCurvature = 0.04F;  // of a leaf among others, without noise
  constexpr float kNoiseCurvature = 5.0F;  // of a leaf, per its squared thickness
  // A piece too many is linked again; one that runs from leaf to leaf is lost for one of them.
  constexpr float kLeastLinearity = 0.45F;
  constexpr std::uint32_t kLeastNeighbors = 6U;
  constexpr float kAlike = 0.94F;    // cosine of the largest bend from cell to cell
  constexpr float kOffset = 0.005F;  // [m] out of the ribbon, without noise
  const float most_offset = kOffset + offsetByNoise(cells);
  // Noise thickens all leaves alike.
  const float thickness = cells.noise / kOrganShape;
  const float most_curvature = kMostCurvature + kNoiseCurvature * thickness * thickness;
  std::vector<std::uint8_t> smooth(cells.size());
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      const LocalShape& shape = cells.shapes[n];
      smooth[n] = cells.is_stem[n] == 0U && shape.curvature < most_curvature &&
                  shape.linearity > kLeastLinearity && shape.neighbors >= kLeastNeighbors;
    }
  });
  std::vector<std::uint32_t> parent(cells.size());
  std::iota(parent.begin(), parent.end(), 0U);
  const auto root = [&](std::uint32_t n) {
    while (parent[n] != n) n = parent[n] = parent[parent[n]];
    return n;
  };
  using Pair = std::pair<std::uint32_t, std::uint32_t>;
  std::vector<std::vector<Pair>> alike(chunksOf(cells.size(), kCellsOfTask));
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    std::vector<Pair>& of_chunk = alike[begin / kCellsOfTask];
    for (auto a = static_cast<std::uint32_t>(begin); a < end; ++a) {
      if (smooth[a] == 0U) continue;
      const LocalShape& shape = cells.shapes[a];
      contacts.forEach(a, [&](std::uint32_t b) {
        if (b <= a || smooth[b] == 0U) return;
        const LocalShape& other = cells.shapes[b];
        if (std::abs(shape.direction.dot(other.direction)) < kAlike) return;
        const Eigen::Vector3f step = cells.centers[b] - cells.centers[a];
        if (std::abs(step.dot(shape.normal)) > most_offset) return;
        if (std::abs(step.dot(other.normal)) > most_offset) return;
        of_chunk.emplace_back(a, b);
      });
    }
  });
  for (const std::vector<Pair>& of_chunk : alike) {
    for (const auto& [a, b] : of_chunk) {
      const std::uint32_t one = root(a);
      const std::uint32_t two = root(b);
      parent[std::max(one, two)] = std::min(one, two);
    }
  }
  constexpr std::uint32_t kLeastCells = 4U;
  std::vector<std::uint32_t> count(cells.size(), 0U);
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    parent[n] = parent[parent[n]];  // the root, for those before are known
    ++count[parent[n]];
  }
  std::vector<std::int32_t> piece(cells.size(), -1);
  std::vector<std::int32_t> number(cells.size(), -1);
  std::int32_t next = 0;
  for (std::uint32_t n = 0; n < cells.size(); ++n) {
    if (smooth[n] == 0U || count[parent[n]] < kLeastCells) continue;
    std::int32_t& of_root = number[parent[n]];
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
void growPieces(const OrganCells& cells, const Contacts& contacts,
                std::vector<std::int32_t>& piece_of, std::vector<Neighborhood>& places) {
  constexpr float kOffset = 0.008F;   // [m] out of the ribbon, without noise
  constexpr float kHalfWidth = 1.7F;  // of an even ribbon, in standard deviations
  constexpr float kMargin = 0.01F;    // [m] beyond it
  constexpr int kMostRounds = 8;      // of one touch each
  const float most_offset = kOffset + offsetByNoise(cells);
  std::vector<std::uint32_t> front;  // cells without a piece that touch one newly grown
  std::vector<std::uint8_t> listed(cells.size(), 0U);
  const auto listAround = [&](const std::vector<std::uint32_t>& grown) {
    std::vector<std::vector<std::uint32_t>> around(chunksOf(grown.size(), kCellsOfTask));
    parallelChunks(grown.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        contacts.forEach(grown[k], [&](std::uint32_t next) {
          if (piece_of[next] < 0) around[begin / kCellsOfTask].push_back(next);
        });
      }
    });
    for (const std::vector<std::uint32_t>& of_chunk : around) {
      for (const std::uint32_t next : of_chunk) {
        if (listed[next] == 0U) front.push_back(next);
        listed[next] = 1U;
      }
    }
  };
  listAround(indicesWhere(cells.size(), [&](std::size_t n) { return piece_of[n] >= 0; }));
  const auto pieceFor = [&](std::uint32_t n, std::vector<std::int32_t>& touching) {
    touching.clear();
    contacts.forEach(n, [&](std::uint32_t other) {
      const std::int32_t piece = piece_of[other];
      if (piece >= 0 && std::find(touching.begin(), touching.end(), piece) == touching.end()) {
        touching.push_back(piece);
      }
    });
    float least = most_offset;
    std::int32_t best = -1;
    for (const std::int32_t piece : touching) {
      const Ribbon ribbon =
          fitRibbon(places[static_cast<std::size_t>(piece)], cells.centers[n], kOrganShape);
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
    parallelChunks(front.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
      std::vector<std::int32_t> touching;
      for (std::size_t k = begin; k < end; ++k) pieces[k] = pieceFor(front[k], touching);
    });
    std::vector<std::uint32_t> grown;
    for (std::size_t k = 0; k < front.size(); ++k) {
      const std::uint32_t n = front[k];
      listed[n] = 0U;
      if (pieces[k] < 0) continue;
      grown.push_back(n);
      piece_of[n] = pieces[k];
      places[static_cast<std::size_t>(pieces[k])].add(cells.centers[n]);
    }
    front.clear();
    listAround(grown);
  }
}

/// Every `stride`-th cell of each piece, to be looked up by place.
class PlacesOfPieces {
 public:
  /// @param reach [m] of the queries
  PlacesOfPieces(const OrganCells& cells, const LeafPieces& pieces, std::size_t stride, float reach)
      : stride_(stride), reach_(reach) {
    std::vector<Eigen::Vector3f> centers;
    std::vector<std::int32_t> piece_of;
    for (std::size_t piece = 0; piece < pieces.cells.size(); ++piece) {
      for (std::size_t k = 0; k < pieces.cells[piece].size(); k += stride) {
        cells_.push_back(pieces.cells[piece][k]);
        piece_of.push_back(static_cast<std::int32_t>(piece));
        centers.push_back(cells.centers[cells_.back()]);
      }
    }
    grid_.emplace(centers, reach);
    pieces_.resize(centers.size() + kLanes);
    for (std::size_t k = 0; k < centers.size(); ++k) pieces_[k] = piece_of[grid_->sorted(k)];
  }

  std::size_t stride() const { return stride_; }

  /// Calls visit(piece, cell, squared distance) for places about a center, of later pieces alone.
  template <class Visit>
  void forEachOfLater(std::uint32_t piece, const Eigen::Vector3f& center, Visit&& visit) const {
    const GridView view = grid_->view();
    const Place place = NeighborGrid::placeOf(center);
    const VectorLanes lanes;
    view.forEachRun(place, place, reach_, [&](const GridView::Run& run) {
      for (std::uint32_t k = run.begin; k < run.end; k += kLanes) {
        const Integers later = loadIntegers(&pieces_[k]) > static_cast<std::int32_t>(piece);
        unsigned near = bitsOf(later & nearAmong(lanes, view, place, reach_, run, k));
        for (; near != 0U; near &= near - 1U) {
          const std::uint32_t at = k + static_cast<std::uint32_t>(__builtin_ctz(near));
          visit(static_cast<std::uint32_t>(pieces_[at]), cells_[view.order[at]],
                (Eigen::Vector3f(view.x[at], view.y[at], view.z[at]) - center).squaredNorm());
        }
      }
      return true;
    });
  }

 private:
  std::size_t stride_;
  float reach_;
  std::vector<std::uint32_t> cells_;
  std::optional<NeighborGrid> grid_;
  std::vector<std::int32_t> pieces_;  // by cells of the grid, padded
};

}  // namespace

LeafPieces findLeafPieces(OrganCells& cells) {
  const Contacts contacts(cells, NeighborGrid(cells.centers, kTouch));
  LeafPieces pieces;
  pieces.of_cell = joinSmoothCells(cells, contacts);
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
  parallelChunks(cells.size(), kCellsOfTask, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      if (pieces.of_cell[n] < 0) continue;
      const Ribbon ribbon = fitRibbon(places[static_cast<std::size_t>(pieces.of_cell[n])],
                                      cells.centers[n], kOrganShape);
      if (!ribbon.known) continue;
      cells.shapes[n].direction = ribbon.direction;
      cells.shapes[n].normal = ribbon.normal;
      cells.shapes[n].linearity = ribbon.linearity;
    }
  });
  return pieces;
}

std::vector<std::vector<PieceLink>> linkLeafPieces(const OrganCells& cells,
                                                   const LeafPieces& pieces, float reach) {
  constexpr float kGapScale = 0.06F;   // [m] of gap that costs 1
  constexpr float kBendScale = 0.26F;  // [rad] standard deviation of a bend
  constexpr float kAside = 0.006F;     // [m] about half a cell: sideways steps that are no bend
  constexpr float kMostCost = 12.0F;
  // Across wide gaps one cell in a few tells enough.
  constexpr std::size_t kFarStride = 3U;
  const PlacesOfPieces all(cells, pieces, 1U, kOrganStep);
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
    among.forEachOfLater(piece, center, [&](std::uint32_t other, std::uint32_t b, float squared) {
      if (squared >= least.farthest[other]) return;
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
      if (gap > kOrganStep && (cells.is_low[a] | cells.is_low[b]) != 0) return;
      if (least.cost[other] == kMostCost) least.touched.push_back(other);
      least.cost[other] = cost;
      least.farthest[other] = squaredGap(cost);
    });
  };
  const std::size_t count = pieces.cells.size();
  std::vector<std::vector<PieceLink>> onward(count);  // of each piece, to those after it
  constexpr std::size_t kTogether = 8U;               // pieces of a task
  parallelChunks(count, kTogether, [&](std::size_t begin, std::size_t end) {
    Least least{
        std::vector<float>(count, kMostCost), std::vector<float>(count, squaredGap(kMostCost)), {}};
    for (std::size_t p = begin; p < end; ++p) {
      const auto piece = static_cast<std::uint32_t>(p);
      const std::vector<std::uint32_t>& members = pieces.cells[p];
      for (const std::uint32_t a : members) compare(all, piece, a, least);
      for (std::size_t k = 0; k < members.size(); k += few.stride()) {
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
  std::vector<std::vector<PieceLink>> links(count);
  for (std::uint32_t piece = 0; piece < count; ++piece) {
    for (const PieceLink& link : onward[piece]) {
      links[piece].push_back(link);
      links[link.piece].push_back({piece, link.cost});
    }
  }
  return links;
}

}  // namespace field_phenotyping
