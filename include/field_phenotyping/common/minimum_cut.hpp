#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace field_phenotyping {

/// Least sum of costs of binary choices, of single ones and of pairs: the minimum cut of a graph
/// (Kolmogorov and Zabih, "What energy functions can be minimized via graph cuts?", 2004), found
/// by Dinic's algorithm. Costs are whole numbers, so that the result is exact.
class MinimumCut {
 public:
  explicit MinimumCut(std::size_t nodes);

  /// Cost of choosing a node beyond that of leaving it; may be negative.
  void addCost(std::size_t node, std::int64_t cost);
  /// Cost, not negative, of leaving `left` while `chosen` is chosen.
  void addPairCost(std::size_t left, std::size_t chosen, std::int64_t cost);

  /// Which nodes to choose for the least sum; as many as possible of several such sets. To be
  /// called once.
  std::vector<bool> solve();

 private:
  struct Edge {
    std::size_t to = 0U;
    int next = -1;  // of the edges from the same node
    std::int64_t room = 0;
  };

  void addEdge(std::size_t from, std::size_t to, std::int64_t room);
  void findLevels();
  std::int64_t push(std::size_t node, std::int64_t most);

  std::size_t source_;
  std::size_t sink_;
  std::vector<Edge> edges_;  // every second one leads back
  std::vector<int> first_;   // edge of each node
  std::vector<int> open_;    // the same, without those that lead nowhere any more
  std::vector<int> levels_;
};

}  // namespace field_phenotyping
