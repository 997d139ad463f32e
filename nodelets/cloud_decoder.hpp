#pragma once

#include <sensor_msgs/PointCloud2.h>

#include <stdexcept>

#include "field_phenotyping/preprocessing/preprocessor.hpp"

// From PointCloud2 to the core's scan. Whatever the bytes say, nothing outside them is read.

namespace field_phenotyping {

/// A PointCloud2 that cannot be read; what() names the cause and what was found instead.
class CloudFormatError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// @throws CloudFormatError when the stamp's nanoseconds are no fraction of a second
void requireValidStamp(const sensor_msgs::PointCloud2& message);

/// Reads `x y z` (FLOAT32 or FLOAT64, any order, padding, byte order, organised or not) and, where
/// there is one, the colour in `rgb` or `rgba` (FLOAT32, UINT32 or INT32). All points are kept in
/// their order. Those of REP 117 (NaN, +Inf, -Inf) stay non-finite, as do coordinates too large for
/// single precision. A cloud far from its frame's origin gets a local origin amid its points.
///
/// Taken as it comes, because drivers do so: a `count` of 0 (for 1), no row_step where there is one
/// row, more data than is needed, other fields of whatever type.
/// @throws CloudFormatError when a coordinate is missing, is there twice or is no single number, or
/// when the layout does not fit the data
Scan toScan(const sensor_msgs::PointCloud2& message);

/// For scans of any sensor, however sparse: only what reaches farther than a sensor sees is
/// refused. A whole cloud has more to show, and phenotype_cloud asks more of it.
/// @throws CloudFormatError when its points lie so far apart that it cannot be in metres
void requireMetres(const Scan& scan);

/// Step [m] that the coarsest of x, y and z comes in, by its type and magnitude; 0: all FLOAT64.
double coordinateResolution(const sensor_msgs::PointCloud2& message, const Scan& scan);

/// The byte order of this machine, for messages that are made here.
bool hostIsBigEndian();

}  // namespace field_phenotyping
