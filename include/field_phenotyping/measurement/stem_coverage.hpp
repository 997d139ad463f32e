#pragma once

#include <vector>

#include "field_phenotyping/segmentation/segmented_block.hpp"

namespace field_phenotyping {

/// Share of the circumference that was seen: gaps of more than 40 degrees between neighbouring
/// points count as unseen, and points where there are five times fewer than elsewhere do not count:
/// the noise carries some round the ends of a half-seen arc. 0 without points.
/// @param angles [rad], any order, any turn
double arcCoverage(std::vector<double> angles);

/// Share of the stem's surface, between base and top of its axis, that carries measured points: the
/// unrolled surface is cut into cells of about 1 cm. NaN without an axis. Thread-safe.
double stemCompleteness(const SegmentedBlock& block, const Plant& plant);

}  // namespace field_phenotyping
