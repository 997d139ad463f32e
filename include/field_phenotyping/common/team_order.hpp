#pragma once

#include <cstdint>
#include <cstring>

#include "field_phenotyping/common/team.hpp"

// Order among values, found by a team of threads (see team.hpp): the same whatever the team.

namespace field_phenotyping {

/// The value that `rank` others come before once they are sorted, by one member alone.
/// @param values at least one; left in another order
/// @param rank below their number
FIELD_PHENOTYPING_HD inline double selectAlone(double* values, int count, int rank) {
  const auto swap = [&](int a, int b) {
    const double value = values[a];
    values[a] = values[b];
    values[b] = value;
  };
  int low = 0;
  int high = count - 1;
  while (low < high) {
    // The middle one of three parts the range.
    const int middle = low + (high - low) / 2;
    if (values[middle] < values[low]) swap(middle, low);
    if (values[high] < values[low]) swap(high, low);
    if (values[high] < values[middle]) swap(high, middle);
    const double pivot = values[middle];
    int left = low;
    int right = high;
    while (left <= right) {
      while (values[left] < pivot) ++left;
      while (pivot < values[right]) --right;
      if (left > right) break;
      swap(left, right);
      ++left;
      --right;
    }
    if (rank <= right) {
      high = right;
    } else if (rank >= left) {
      low = left;
    } else {
      break;
    }
  }
  return values[rank];
}

/// The same of values that are 0 or more. All members get it, and must see the same memory, which
/// is complete when they come here.
/// @param values left in another order
/// @param counts one for each member
template <class Team>
FIELD_PHENOTYPING_HD double teamSelect(const Team& team, double* values, int count, int rank,
                                       int* counts) {
  if constexpr (Team::kAlone) return selectAlone(values, count, rank);
  // Bits of values that are not negative are in the order of the values: one is found bit by bit
  // from how many there are up to it.
  std::uint64_t low = 0U;
  std::uint64_t high = 0x7FF0000000000000U;  // infinity
  while (low < high) {
    const std::uint64_t middle = low + (high - low) / 2U;
    double most;
    std::memcpy(&most, &middle, sizeof most);
    int own = 0;
    for (int i = static_cast<int>(team.rank()); i < count; i += static_cast<int>(team.size())) {
      own += values[i] <= most ? 1 : 0;
    }
    counts[team.rank()] = own;
    team.sync();
    int all = 0;
    for (unsigned k = 0U; k < team.size(); ++k) all += counts[k];
    team.sync();
    if (all > rank) {
      high = middle;
    } else {
      low = middle + 1U;
    }
  }
  double value;
  std::memcpy(&value, &low, sizeof value);
  return value;
}

/// take(i, n) for those of 0 ... count - 1 for which holds(i), n counting them in their order.
/// @param counts one for each member
/// @return how many they are; all may read what was taken
template <class Team, class Holds, class Take>
FIELD_PHENOTYPING_HD int teamPick(const Team& team, int count, const Holds& holds, const Take& take,
                                  int* counts) {
  const int size = static_cast<int>(team.size());
  const int rank = static_cast<int>(team.rank());
  const int part = (count + size - 1) / size;
  const int begin = rank * part < count ? rank * part : count;
  const int end = count - begin < part ? count : begin + part;
  int taken = 0;
  int all = 0;
  if constexpr (!Team::kAlone) {
    int own = 0;
    for (int i = begin; i < end; ++i) own += holds(i) ? 1 : 0;
    counts[rank] = own;
    team.sync();
    for (int member = 0; member < size; ++member) {
      if (member == rank) taken = all;
      all += counts[member];
    }
  }
  for (int i = begin; i < end; ++i) {
    if (holds(i)) take(i, taken++);
  }
  team.sync();
  return Team::kAlone ? taken : all;
}

/// Sorts items by less(a, b), equal ones in the order that they come in.
/// @param items, other as many; all members must see the same memory, which is complete when they
///        come here
/// @return where the sorted ones are, of the two; all may read them
template <class Team, class Item, class Less>
FIELD_PHENOTYPING_HD Item* teamSort(const Team& team, Item* items, Item* other, int count,
                                    const Less& less) {
  const int rank = static_cast<int>(team.rank());
  const int size = static_cast<int>(team.size());
  constexpr int kRun = 16;  // sorted by one member
  for (int begin = rank * kRun; begin < count; begin += size * kRun) {
    const int end = begin + kRun < count ? begin + kRun : count;
    for (int i = begin + 1; i < end; ++i) {
      const Item item = items[i];
      int at = i;
      for (; at > begin && less(item, items[at - 1]); --at) items[at] = items[at - 1];
      items[at] = item;
    }
  }
  team.sync();
  if constexpr (Team::kAlone) {
    // Two runs become one, item by item.
    for (int width = kRun; width < count; width *= 2) {
      for (int begin = 0; begin < count; begin += 2 * width) {
        const int middle = count - begin < width ? count : begin + width;
        const int end = count - middle < width ? count : middle + width;
        int a = begin;
        int b = middle;
        for (int i = begin; i < end; ++i) {
          const bool takes_second = a == middle || (b < end && less(items[b], items[a]));
          other[i] = takes_second ? items[b++] : items[a++];
        }
      }
      Item* const sorted = other;
      other = items;
      items = sorted;
    }
    return items;
  }
  // Two runs become one: an item's place is where it is in its own run, and how many of the other
  // run come before it.
  for (int width = kRun; width < count; width *= 2) {
    for (int i = rank; i < count; i += size) {
      const int run = i / width;
      const bool is_second = run % 2 != 0;
      const int begin = (is_second ? run - 1 : run + 1) * width;
      const Item& item = items[i];
      int low = begin;
      int high = begin + width < count ? begin + width : count;
      while (low < high) {
        const int middle = low + (high - low) / 2;
        if (is_second ? !less(item, items[middle]) : less(items[middle], item)) {
          low = middle + 1;
        } else {
          high = middle;
        }
      }
      other[is_second ? i - width + (low - begin) : i + (low - begin)] = item;
    }
    team.sync();
    Item* const sorted = other;
    other = items;
    items = sorted;
  }
  return items;
}

}  // namespace field_phenotyping
