#include "field_phenotyping/common/minimum_cut.hpp"

#include <algorithm>
#include <limits>

namespace field_phenotyping {

MinimumCut::MinimumCut(std::size_t nodes)
    : source_(nodes), sink_(nodes + 1U), first_(nodes + 2U, -1) {}

void MinimumCut::addCost(std::size_t node, std::int64_t cost) {
  if (cost > 0) addEdge(source_, node, cost);
  if (cost < 0) addEdge(node, sink_, -cost);
}

void MinimumCut::addPairCost(std::size_t left, std::size_t chosen, std::int64_t cost) {
  addEdge(left, chosen, cost);
}

std::vector<bool> MinimumCut::solve() {
  for (findLevels(); levels_[sink_] >= 0; findLevels()) {
    open_ = first_;
    while (push(source_, std::numeric_limits<std::int64_t>::max()) > 0) {
    }
  }
  std::vector<bool> chosen(source_);
  for (std::size_t n = 0; n < chosen.size(); ++n) chosen[n] = levels_[n] < 0;
  return chosen;
}

void MinimumCut::addEdge(std::size_t from, std::size_t to, std::int64_t room) {
  edges_.push_back({to, first_[from], room});
  first_[from] = static_cast<int>(edges_.size()) - 1;
  edges_.push_back({from, first_[to], 0});
  first_[to] = static_cast<int>(edges_.size()) - 1;
}

/// Steps from the source over edges that have room; -1 where none lead.
void MinimumCut::findLevels() {
  levels_.assign(first_.size(), -1);
  levels_[source_] = 0;
  std::vector<std::size_t> reached{source_};
  for (std::size_t k = 0; k < reached.size(); ++k) {
    const std::size_t node = reached[k];
    for (int e = first_[node]; e >= 0; e = edges_[static_cast<std::size_t>(e)].next) {
      const Edge& edge = edges_[static_cast<std::size_t>(e)];
      if (edge.room <= 0 || levels_[edge.to] >= 0) continue;
      levels_[edge.to] = levels_[node] + 1;
      reached.push_back(edge.to);
    }
  }
}

std::int64_t MinimumCut::push(std::size_t node, std::int64_t most) {
  if (node == sink_) return most;
  for (int& e = open_[node]; e >= 0; e = edges_[static_cast<std::size_t>(e)].next) {
    const auto there = static_cast<std::size_t>(e);
    const std::size_t to = edges_[there].to;
    if (edges_[there].room <= 0 || levels_[to] != levels_[node] + 1) continue;
    const std::int64_t flow = push(to, std::min(most, edges_[there].room));
    if (flow <= 0) continue;
    edges_[there].room -= flow;
    edges_[there ^ 1U].room += flow;
    return flow;
  }
  return 0;
}

}  // namespace field_phenotyping
