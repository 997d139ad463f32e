// What PointCloud2 may look like, and what it looks like when it is broken.
#include "cloud_decoder.hpp"

#include <gtest/gtest.h>
#include <sensor_msgs/PointField.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <vector>

namespace field_phenotyping {
namespace {

using sensor_msgs::PointCloud2;
using sensor_msgs::PointField;

/// Puts clouds of any layout together, byte by byte.
class CloudMaker {
 public:
  CloudMaker& field(const std::string& name, std::uint32_t offset, std::uint8_t datatype) {
    PointField entry;
    entry.name = name;
    entry.offset = offset;
    entry.datatype = datatype;
    entry.count = 1U;
    cloud_.fields.push_back(entry);
    return *this;
  }
  CloudMaker& layout(std::uint32_t width, std::uint32_t height, std::uint32_t point_step,
                     std::uint32_t row_padding = 0U) {
    cloud_.width = width;
    cloud_.height = height;
    cloud_.point_step = point_step;
    cloud_.row_step = width * point_step + row_padding;
    cloud_.data.assign(std::size_t{cloud_.row_step} * height, 0xCDU);
    return *this;
  }
  CloudMaker& bigEndian() {
    cloud_.is_bigendian = 1U;
    return *this;
  }
  template <class Value>
  CloudMaker& set(std::uint32_t column, std::uint32_t row, const std::string& name, Value value) {
    const auto entry = std::find_if(cloud_.fields.begin(), cloud_.fields.end(),
                                    [&](const PointField& f) { return f.name == name; });
    std::vector<std::uint8_t> raw(sizeof(Value));
    std::memcpy(raw.data(), &value, sizeof(Value));
    if (cloud_.is_bigendian != 0U) std::reverse(raw.begin(), raw.end());
    std::copy(raw.begin(), raw.end(),
              cloud_.data.begin() + std::ptrdiff_t{row} * cloud_.row_step +
                  std::ptrdiff_t{column} * cloud_.point_step + entry->offset);
    return *this;
  }
  template <class Value>
  CloudMaker& point(std::uint32_t column, std::uint32_t row, Value x, Value y, Value z) {
    return set(column, row, "x", x).set(column, row, "y", y).set(column, row, "z", z);
  }
  PointCloud2& cloud() { return cloud_; }

 private:
  PointCloud2 cloud_;
};

CloudMaker plainCloud(std::uint32_t width = 1U) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT32)
      .field("y", 4U, PointField::FLOAT32)
      .field("z", 8U, PointField::FLOAT32)
      .layout(width, 1U, 12U);
  return maker;
}

std::string errorOf(const PointCloud2& cloud) {
  try {
    toScan(cloud);
  } catch (const CloudFormatError& error) {
    return error.what();
  }
  return "";
}

TEST(ToScan, ReadsPlainFloatsAndTheStamp) {
  CloudMaker maker = plainCloud(2U);
  maker.point(0U, 0U, 1.0F, 2.0F, 3.0F).point(1U, 0U, -4.0F, 5.5F, 0.25F);
  maker.cloud().header.stamp = ros::Time(12U, 34U);
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), 2U);
  EXPECT_EQ(scan.cloud.mapPoint(0), Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_EQ(scan.cloud.mapPoint(1), Eigen::Vector3d(-4.0, 5.5, 0.25));
  EXPECT_FALSE(scan.cloud.hasColors());
  EXPECT_EQ(scan.stamp_ns, 12000000034U);
}

TEST(ToScan, ReadsAnyOrderPaddingTypeAndOrganisedRows) {
  CloudMaker maker;
  maker.field("z", 2U, PointField::FLOAT64)
      .field("intensity", 10U, PointField::UINT16)
      .field("x", 13U, PointField::FLOAT64)
      .field("y", 21U, PointField::FLOAT32)
      .layout(2U, 3U, 32U, 7U);
  for (std::uint32_t row = 0; row < 3U; ++row) {
    for (std::uint32_t column = 0; column < 2U; ++column) {
      maker.set(column, row, "x", 10.0 + column)
          .set(column, row, "y", 20.0F + static_cast<float>(row))
          .set(column, row, "z", 0.5);
    }
  }
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), 6U);
  EXPECT_EQ(scan.cloud.mapPoint(0), Eigen::Vector3d(10.0, 20.0, 0.5));
  EXPECT_EQ(scan.cloud.mapPoint(3), Eigen::Vector3d(11.0, 21.0, 0.5));
  EXPECT_EQ(scan.cloud.mapPoint(4), Eigen::Vector3d(10.0, 22.0, 0.5));
}

TEST(ToScan, ReadsBigEndian) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT32)
      .field("y", 4U, PointField::FLOAT64)
      .field("z", 12U, PointField::FLOAT32)
      .field("rgb", 16U, PointField::UINT32)
      .bigEndian()
      .layout(1U, 1U, 20U)
      .set(0U, 0U, "x", 1.5F)
      .set(0U, 0U, "y", -2.5)
      .set(0U, 0U, "z", 3.5F)
      .set(0U, 0U, "rgb", std::uint32_t{0x00102030U});
  const Scan scan = toScan(maker.cloud());
  EXPECT_EQ(scan.cloud.mapPoint(0), Eigen::Vector3d(1.5, -2.5, 3.5));
  EXPECT_EQ(scan.cloud.colors.at(0), 0x102030U);
}

TEST(ToScan, ReadsPackedColoursWithoutTheirAlpha) {
  for (const char* name : {"rgb", "rgba"}) {
    for (const std::uint8_t type : {PointField::FLOAT32, PointField::UINT32}) {
      CloudMaker maker = plainCloud();
      maker.field(name, 12U, type).layout(1U, 1U, 16U).point(0U, 0U, 0.0F, 0.0F, 0.0F);
      maker.set(0U, 0U, name, std::uint32_t{0x7f8090a0U});
      EXPECT_EQ(toScan(maker.cloud()).cloud.colors.at(0), 0x8090a0U) << name;
    }
  }
}

TEST(ToScan, KeepsNonFinitePointsInTheirPlaces) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  CloudMaker maker = plainCloud(3U);
  maker.point(0U, 0U, nan, nan, nan)
      .point(1U, 0U, 1.0F, std::numeric_limits<float>::infinity(), 0.0F)
      .point(2U, 0U, 1.0F, 1.0F, 1.0F);
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), 3U);
  EXPECT_FALSE(scan.cloud.points[0].allFinite());
  EXPECT_FALSE(scan.cloud.points[1].allFinite());
  EXPECT_EQ(scan.cloud.mapPoint(2), Eigen::Vector3d(1.0, 1.0, 1.0));
}

TEST(ToScan, KeepsMillimetresFarFromTheOrigin) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT64)
      .field("y", 8U, PointField::FLOAT64)
      .field("z", 16U, PointField::FLOAT64)
      .layout(3U, 1U, 24U)
      .point(0U, 0U, std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0)
      .point(1U, 0U, 448262.1234, 5411932.5678, 90.001)
      .point(2U, 0U, 448263.1234, 5411933.5688, 91.001);
  const Scan scan = toScan(maker.cloud());
  EXPECT_NEAR((scan.cloud.mapPoint(1) - Eigen::Vector3d(448262.1234, 5411932.5678, 90.001)).norm(),
              0.0, 1e-6);
  EXPECT_NEAR((scan.cloud.mapPoint(2) - Eigen::Vector3d(448263.1234, 5411933.5688, 91.001)).norm(),
              0.0, 1e-6);
  EXPECT_EQ(coordinateResolution(maker.cloud(), scan), 0.0);
}

TEST(ToScan, TellsHowCoarseFloatsAreFarFromTheOrigin) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 448262.0F, 5411932.0F, 90.0F);
  EXPECT_EQ(coordinateResolution(maker.cloud(), toScan(maker.cloud())), 0.5);
  maker.point(0U, 0U, 3.0F, 5.0F, 1.0F);
  EXPECT_LT(coordinateResolution(maker.cloud(), toScan(maker.cloud())), 1e-6);
}

TEST(ToScan, TakesEmptyClouds) {
  EXPECT_TRUE(toScan(plainCloud(0U).cloud()).cloud.empty());
}

TEST(ToScan, TakesOneRowWithoutARowStep) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 1.0F, 2.0F, 3.0F);
  maker.cloud().row_step = 0U;
  EXPECT_EQ(toScan(maker.cloud()).cloud.size(), 1U);
}

TEST(ToScan, NamesTheFieldsFoundWhenOneIsMissing) {
  CloudMaker maker;
  maker.field("y", 0U, PointField::FLOAT32).field("reflectivity", 4U, PointField::UINT8);
  maker.layout(1U, 1U, 8U);
  const std::string error = errorOf(maker.cloud());
  EXPECT_NE(error.find("no field 'x'"), std::string::npos) << error;
  EXPECT_NE(error.find("y (FLOAT32), reflectivity (UINT8)"), std::string::npos) << error;
  EXPECT_NE(errorOf(PointCloud2()).find("only: none"), std::string::npos);
}

// Every order of the coordinates, every mix of their types, both byte orders, one row or several,
// with and without padding of points and rows, other fields between them.
TEST(ToScan, ReadsEveryLegalLayout) {
  std::vector<std::string> order = {"x", "y", "z"};
  std::size_t layouts = 0U;
  do {
    for (unsigned choice = 0U; choice < 128U; ++choice) {
      const auto chosen = [&](unsigned bit) { return (choice >> bit & 1U) != 0U; };
      const bool big_endian = chosen(3U);
      const bool organised = chosen(4U);
      const bool padded_rows = chosen(5U);
      const bool padded_points = chosen(6U);
      CloudMaker maker;
      std::uint32_t offset = padded_points ? 3U : 0U;
      std::vector<bool> is_double;
      for (unsigned axis = 0U; axis < 3U; ++axis) {
        is_double.push_back(chosen(axis));
        maker.field(order[axis], offset, chosen(axis) ? PointField::FLOAT64 : PointField::FLOAT32);
        offset += chosen(axis) ? 8U : 4U;
        maker.field("ring" + std::to_string(axis), offset, PointField::UINT16);
        maker.cloud().fields.back().count = 3U;
        offset += padded_points ? 7U : 6U;
      }
      if (big_endian) maker.bigEndian();
      const std::uint32_t rows = organised ? 3U : 1U;
      maker.layout(2U, rows, offset, padded_rows ? 5U : 0U);
      // Without the padding of the last row, as some drivers have it.
      if (padded_rows) maker.cloud().data.resize(maker.cloud().data.size() - 5U);
      for (std::uint32_t row = 0; row < rows; ++row) {
        for (std::uint32_t column = 0; column < 2U; ++column) {
          for (unsigned axis = 0U; axis < 3U; ++axis) {
            const float value = static_cast<float>(order[axis][0]) +
                                0.25F * static_cast<float>(row) +
                                0.125F * static_cast<float>(column);
            if (is_double[axis]) maker.set(column, row, order[axis], double{value});
            if (!is_double[axis]) maker.set(column, row, order[axis], value);
          }
        }
      }
      const Scan scan = toScan(maker.cloud());
      ASSERT_EQ(scan.cloud.size(), std::size_t{2U} * rows);
      for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
        const double shift =
            0.25 * static_cast<double>(i / 2U) + 0.125 * static_cast<double>(i % 2U);
        ASSERT_EQ(scan.cloud.mapPoint(i), Eigen::Vector3d('x' + shift, 'y' + shift, 'z' + shift))
            << "order " << order[0] << order[1] << order[2] << ", choice " << choice;
      }
      ++layouts;
    }
  } while (std::next_permutation(order.begin(), order.end()));
  EXPECT_EQ(layouts, 6U * 128U);
}

TEST(ToScan, ReadsColoursOfEveryPackedTypeAndPassesOverOthers) {
  for (const std::uint8_t type : {PointField::FLOAT32, PointField::UINT32, PointField::INT32}) {
    CloudMaker maker = plainCloud();
    maker.field("rgb", 12U, type).layout(1U, 1U, 16U).point(0U, 0U, 0.0F, 0.0F, 0.0F);
    maker.set(0U, 0U, "rgb", std::uint32_t{0xff8090a0U});
    EXPECT_EQ(toScan(maker.cloud()).cloud.colors.at(0), 0x8090a0U) << int{type};
  }
  CloudMaker maker = plainCloud();
  maker.field("rgb", 12U, PointField::UINT8).layout(1U, 1U, 16U).point(0U, 0U, 1.0F, 2.0F, 3.0F);
  maker.cloud().fields.back().count = 3U;
  EXPECT_FALSE(toScan(maker.cloud()).cloud.hasColors());
  EXPECT_EQ(toScan(maker.cloud()).cloud.mapPoint(0), Eigen::Vector3d(1.0, 2.0, 3.0));
}

TEST(ToScan, TakesACountOfZeroForOne) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 1.0F, 2.0F, 3.0F);
  for (PointField& field : maker.cloud().fields) field.count = 0U;
  EXPECT_EQ(toScan(maker.cloud()).cloud.mapPoint(0), Eigen::Vector3d(1.0, 2.0, 3.0));
}

TEST(ToScan, PassesOverBrokenFieldsThatItDoesNotNeed) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 1.0F, 2.0F, 3.0F);
  maker.field("intensity", 0xffffffffU, 200U).field("intensity", 400U, 0U).field("", 0U, 0U);
  EXPECT_EQ(toScan(maker.cloud()).cloud.mapPoint(0), Eigen::Vector3d(1.0, 2.0, 3.0));
}

TEST(ToScan, DoesNotTrustIsDense) {
  CloudMaker maker = plainCloud();
  maker.point(0U, 0U, 1.0F, std::numeric_limits<float>::quiet_NaN(), 3.0F);
  for (const std::uint8_t dense : {std::uint8_t{0U}, std::uint8_t{1U}}) {
    maker.cloud().is_dense = dense;
    EXPECT_FALSE(toScan(maker.cloud()).cloud.points.at(0).allFinite());
  }
}

TEST(ToScan, TakesTheThreeWaysOfRep117NotToSeeAnything) {
  const double infinity = std::numeric_limits<double>::infinity();
  for (const double miss : {infinity, -infinity, std::numeric_limits<double>::quiet_NaN(), 1e300}) {
    for (unsigned axis = 0U; axis < 3U; ++axis) {
      CloudMaker maker;
      maker.field("x", 0U, PointField::FLOAT64)
          .field("y", 8U, PointField::FLOAT64)
          .field("z", 16U, PointField::FLOAT64)
          .layout(2U, 1U, 24U)
          .point(0U, 0U, 1.0, 1.0, 1.0)
          .point(1U, 0U, 2.0, 2.0, 2.0);
      maker.set(0U, 0U, std::string(1U, static_cast<char>('x' + axis)), miss);
      const Scan scan = toScan(maker.cloud());
      EXPECT_FALSE(scan.cloud.points.at(0).allFinite()) << miss;
      EXPECT_EQ(scan.cloud.mapPoint(1), Eigen::Vector3d(2.0, 2.0, 2.0));
    }
  }
}

TEST(ToScan, LetsNoStrayPointDecideTheOrigin) {
  CloudMaker maker;
  maker.field("x", 0U, PointField::FLOAT64)
      .field("y", 8U, PointField::FLOAT64)
      .field("z", 16U, PointField::FLOAT64)
      .layout(9U, 1U, 24U);
  for (const double stray : {0.0, 1e9, 1e38}) {
    for (std::uint32_t i = 0; i < 9U; ++i) {
      maker.point(i, 0U, 448262.1234, 5411932.5678, 90.001 + i);
    }
    maker.point(0U, 0U, stray, stray, stray);
    const Scan scan = toScan(maker.cloud());
    for (std::size_t i = 1; i < 9U; ++i) {
      const Eigen::Vector3d truth(448262.1234, 5411932.5678, 90.001 + static_cast<double>(i));
      EXPECT_LT((scan.cloud.mapPoint(i) - truth).norm(), 1e-6) << stray;
    }
  }
}

TEST(ToScan, TakesRowsOfNothingAtOnce) {
  CloudMaker maker = plainCloud(0U);
  maker.cloud().height = 0xffffffffU;
  EXPECT_TRUE(toScan(maker.cloud()).cloud.empty());
  maker.cloud().width = 0xffffffffU;
  maker.cloud().height = 0U;
  EXPECT_TRUE(toScan(maker.cloud()).cloud.empty());
}

TEST(ToScan, ReadsMillionsOfPoints) {
  constexpr std::uint32_t kColumns = 2048U;
  constexpr std::uint32_t kRows = 2048U;
  CloudMaker maker = plainCloud();
  maker.layout(kColumns, kRows, 16U, 8U);
  std::fill(maker.cloud().data.begin(), maker.cloud().data.end(), std::uint8_t{0U});
  maker.point(kColumns - 1U, kRows - 1U, 1.0F, 2.0F, 3.0F);
  const Scan scan = toScan(maker.cloud());
  ASSERT_EQ(scan.cloud.size(), std::size_t{kColumns} * kRows);
  EXPECT_EQ(scan.cloud.mapPoint(scan.cloud.size() - 1U), Eigen::Vector3d(1.0, 2.0, 3.0));
}

TEST(ToScan, RefusesWhatIsIllegalAndSaysWhy) {
  struct Fault {
    std::function<void(PointCloud2&)> make;
    const char* said;
  };
  const std::vector<Fault> faults = {
      {[](PointCloud2& c) { c.fields.erase(c.fields.begin() + 1); }, "no field 'y'"},
      {[](PointCloud2& c) { c.fields[0].name = "X"; }, "no field 'x', only: X (FLOAT32)"},
      {[](PointCloud2& c) { c.fields[1].datatype = PointField::INT16; }, "'y' is INT16"},
      {[](PointCloud2& c) { c.fields[1].datatype = 99U; }, "'y' is type 99"},
      {[](PointCloud2& c) { c.fields[1].datatype = 0U; }, "'y' is type 0"},
      {[](PointCloud2& c) { c.fields[2].count = 2U; }, "'z' holds 2 values"},
      {[](PointCloud2& c) { c.fields.push_back(c.fields[2]); }, "two fields 'z'"},
      {[](PointCloud2& c) { c.data.resize(47U); }, "holds 47 bytes, but 4 x 1 points need 48"},
      {[](PointCloud2& c) { c.data.clear(); }, "holds 0 bytes"},
      {[](PointCloud2& c) { c.point_step = 10U; }, "field z at offset 8"},
      {[](PointCloud2& c) { c.point_step = 0U; }, "field x at offset 0"},
      {[](PointCloud2& c) { c.fields[0].offset = 9U; }, "field x at offset 9"},
      {[](PointCloud2& c) { c.fields[0].offset = 0xfffffffeU; }, "field x at offset 4294967294"},
      {[](PointCloud2& c) { c.fields[0].datatype = PointField::FLOAT64, c.fields[0].offset = 5U; },
       "field x at offset 5"},
      {[](PointCloud2& c) { c.height = 2U, c.row_step = 13U; }, "row_step is 13"},
      {[](PointCloud2& c) { c.height = 2U, c.row_step = 0U; }, "row_step is 0"},
      {[](PointCloud2& c) { c.height = 2U, c.row_step = 48U; }, "points need 96"},
      {[](PointCloud2& c) { c.width = 0xffffffffU; }, "points need 51539607540"},
      {[](PointCloud2& c) { c.width = 0x40000001U; }, "points need 12884901900"},
      {[](PointCloud2& c) { c.width = c.point_step = 0xffffffffU; }, "points need 1844674406"},
      {[](PointCloud2& c) { c.width = c.height = c.row_step = 0xffffffffU; }, "row_step is"},
      {[](PointCloud2& c) { c.height = c.row_step = 0xffffffffU; }, "points need 1844674406"},
      {[](PointCloud2& c) {
         c.fields.push_back(c.fields[0]);
         c.fields.back().name = "rgb";
         c.fields.back().offset = 9U;
       },
       "field rgb at offset 9"},
      {[](PointCloud2& c) { c.header.stamp.nsec = 1000000000U; }, "1000000000 ns"},
      {[](PointCloud2& c) { c.header.stamp.sec = c.header.stamp.nsec = 0xffffffffU; }, "its stamp"},
  };
  for (const Fault& fault : faults) {
    PointCloud2 cloud = plainCloud(4U).cloud();
    ASSERT_EQ(errorOf(cloud), "");
    fault.make(cloud);
    EXPECT_NE(errorOf(cloud).find(fault.said), std::string::npos)
        << "expected: " << fault.said << "\nsaid: " << errorOf(cloud);
  }
}

TEST(ToScan, ListsNoMoreFieldsThanCanBeRead) {
  PointCloud2 cloud;
  cloud.fields.resize(10000U);
  EXPECT_LT(errorOf(cloud).size(), 500U);
}

}  // namespace
}  // namespace field_phenotyping
