#pragma once

#include <field_phenotyping/CompletedFieldBlock.h>
#include <field_phenotyping/FieldBlock.h>
#include <field_phenotyping/SegmentedFieldBlock.h>
#include <ros/message_traits.h>
#include <ros/serialization.h>
#include <std_msgs/Header.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/preprocessing/block.hpp"
#include "field_phenotyping/segmentation/segmented_block.hpp"

// Lets roscpp carry the core's own values. Nodelets of one manager hand on shared pointers to them,
// untouched; between processes they travel as FieldBlock, SegmentedFieldBlock and
// CompletedFieldBlock, byte for byte.

namespace field_phenotyping {

std_msgs::Header messageHeader(const BlockHeader& header);

/// What reading from the wire checks before a value reaches the algorithms.
/// @throws std::runtime_error naming what does not fit together
void checkConsistency(const PointCloud& cloud);
void checkConsistency(const Block& block);
void checkConsistency(const SegmentedBlock& block);
void checkConsistency(const CompletedBlock& block);

/// Parts of a GroundModel and of the axis of a plant, as the messages hold them.
struct SoilArrays {
  explicit SoilArrays(const GroundModel& ground);
  SoilArrays() = default;
  /// @throws std::runtime_error when the arrays do not fit the grid
  GroundModel model() const;

  float corner_x = 0.0F, corner_y = 0.0F, spacing = 1.0F;
  std::uint32_t columns = 0U, rows = 0U;
  bool observed = false;
  std::vector<float> height, stddev;
  std::vector<std::uint8_t> seen;
};

struct AxisArrays {
  explicit AxisArrays(const StemAxis& axis);
  AxisArrays() = default;
  /// @throws std::runtime_error when there is not one radius a node
  StemAxis axis() const;

  std::vector<Eigen::Vector3f> position;
  std::vector<float> radius;
};

}  // namespace field_phenotyping

namespace ros {
namespace message_traits {

/// The traits of the generated message `Wire`, for any type.
template <class Wire>
struct MD5SumOf {
  static const char* value() { return MD5Sum<Wire>::value(); }
  template <class Message>
  static const char* value(const Message&) {
    return value();
  }
};
template <class Wire>
struct DataTypeOf {
  static const char* value() { return DataType<Wire>::value(); }
  template <class Message>
  static const char* value(const Message&) {
    return value();
  }
};
template <class Wire>
struct DefinitionOf {
  static const char* value() { return Definition<Wire>::value(); }
  template <class Message>
  static const char* value(const Message&) {
    return value();
  }
};

template <>
struct IsMessage<field_phenotyping::Block> : TrueType {};
template <>
struct MD5Sum<field_phenotyping::Block> : MD5SumOf<field_phenotyping::FieldBlock> {};
template <>
struct DataType<field_phenotyping::Block> : DataTypeOf<field_phenotyping::FieldBlock> {};
template <>
struct Definition<field_phenotyping::Block> : DefinitionOf<field_phenotyping::FieldBlock> {};

template <>
struct IsMessage<field_phenotyping::SegmentedBlock> : TrueType {};
template <>
struct MD5Sum<field_phenotyping::SegmentedBlock>
    : MD5SumOf<field_phenotyping::SegmentedFieldBlock> {};
template <>
struct DataType<field_phenotyping::SegmentedBlock>
    : DataTypeOf<field_phenotyping::SegmentedFieldBlock> {};
template <>
struct Definition<field_phenotyping::SegmentedBlock>
    : DefinitionOf<field_phenotyping::SegmentedFieldBlock> {};

template <>
struct IsMessage<field_phenotyping::CompletedBlock> : TrueType {};
template <>
struct MD5Sum<field_phenotyping::CompletedBlock>
    : MD5SumOf<field_phenotyping::CompletedFieldBlock> {};
template <>
struct DataType<field_phenotyping::CompletedBlock>
    : DataTypeOf<field_phenotyping::CompletedFieldBlock> {};
template <>
struct Definition<field_phenotyping::CompletedBlock>
    : DefinitionOf<field_phenotyping::CompletedFieldBlock> {};

// geometry_msgs/Point32 and Eigen::Vector3f are the same twelve bytes.
template <>
struct IsFixedSize<Eigen::Vector3f> : TrueType {};
template <>
struct IsSimple<Eigen::Vector3f> : TrueType {};

}  // namespace message_traits

namespace serialization {

static_assert(sizeof(Eigen::Vector3f) == 12U, "points must lie on the wire as they do in memory");

template <>
struct Serializer<Eigen::Vector3f> {
  template <class Stream, class Vector>
  static void allInOne(Stream& stream, Vector v) {
    stream.next(v.x());
    stream.next(v.y());
    stream.next(v.z());
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

template <>
struct Serializer<Eigen::Vector3d> {
  template <class Stream, class Vector>
  static void allInOne(Stream& stream, Vector v) {
    stream.next(v.x());
    stream.next(v.y());
    stream.next(v.z());
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

/// Serializers that only define how to write and read; the length is that of what is written.
template <class Value, class Format>
struct MeasuredSerializer {
  static std::uint32_t serializedLength(const Value& value) {
    LStream stream;
    Format::write(stream, value);
    return stream.getLength();
  }
};

template <>
struct Serializer<field_phenotyping::BlockHeader>
    : MeasuredSerializer<field_phenotyping::BlockHeader,
                         Serializer<field_phenotyping::BlockHeader>> {
  template <class Stream>
  static void write(Stream& stream, const field_phenotyping::BlockHeader& header) {
    stream.next(field_phenotyping::messageHeader(header));
    stream.next(ros::Time().fromNSec(header.began_ns));
    stream.next(ros::Time().fromNSec(header.due_ns));
    rest(stream, header);
  }
  template <class Stream>
  static void read(Stream& stream, field_phenotyping::BlockHeader& header) {
    std_msgs::Header message;
    stream.next(message);
    header.stamp_ns = message.stamp.toNSec();
    header.frame_id = message.frame_id;
    ros::Time began;
    stream.next(began);
    header.began_ns = began.toNSec();
    ros::Time due;
    stream.next(due);
    header.due_ns = due.toNSec();
    rest(stream, header);
  }

 private:
  template <class Stream, class Header>
  static void rest(Stream& stream, Header& header) {
    stream.next(header.index.x);
    stream.next(header.index.y);
    stream.next(header.revision);
    stream.next(header.final);
    stream.next(header.draft);
    stream.next(header.tile_size);
    stream.next(header.tile_corner.x());
    stream.next(header.tile_corner.y());
    stream.next(header.margin);
    stream.next(header.part.min().x());
    stream.next(header.part.min().y());
    stream.next(header.part.max().x());
    stream.next(header.part.max().y());
  }
};

template <>
struct Serializer<field_phenotyping::PointCloud> {
  template <class Stream, class Cloud>
  static void allInOne(Stream& stream, Cloud cloud) {
    stream.next(cloud.origin);
    stream.next(cloud.points);
    stream.next(cloud.colors);
    stream.next(cloud.scan_origins);
    stream.next(cloud.scan_origin);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

template <>
struct Serializer<field_phenotyping::SoilArrays> {
  template <class Stream, class Soil>
  static void allInOne(Stream& stream, Soil soil) {
    stream.next(soil.corner_x);
    stream.next(soil.corner_y);
    stream.next(soil.spacing);
    stream.next(soil.columns);
    stream.next(soil.rows);
    stream.next(soil.observed);
    stream.next(soil.height);
    stream.next(soil.stddev);
    stream.next(soil.seen);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

template <>
struct Serializer<field_phenotyping::GroundModel>
    : MeasuredSerializer<field_phenotyping::GroundModel,
                         Serializer<field_phenotyping::GroundModel>> {
  template <class Stream>
  static void write(Stream& stream, const field_phenotyping::GroundModel& ground) {
    stream.next(field_phenotyping::SoilArrays(ground));
  }
  template <class Stream>
  static void read(Stream& stream, field_phenotyping::GroundModel& ground) {
    field_phenotyping::SoilArrays soil;
    stream.next(soil);
    ground = soil.model();
  }
};

template <>
struct Serializer<field_phenotyping::StemAxis>
    : MeasuredSerializer<field_phenotyping::StemAxis, Serializer<field_phenotyping::StemAxis>> {
  template <class Stream>
  static void write(Stream& stream, const field_phenotyping::StemAxis& axis) {
    const field_phenotyping::AxisArrays arrays(axis);
    stream.next(arrays.position);
    stream.next(arrays.radius);
  }
  template <class Stream>
  static void read(Stream& stream, field_phenotyping::StemAxis& axis) {
    field_phenotyping::AxisArrays arrays;
    stream.next(arrays.position);
    stream.next(arrays.radius);
    axis = arrays.axis();
  }
};

template <>
struct Serializer<field_phenotyping::Plant> {
  template <class Stream, class Plant>
  static void allInOne(Stream& stream, Plant plant) {
    stream.next(plant.id);
    stream.next(plant.owned);
    stream.next(plant.points.begin);
    stream.next(plant.points.end);
    stream.next(plant.stem.begin);
    stream.next(plant.stem.end);
    stream.next(plant.axis);
    stream.next(plant.base);
    stream.next(plant.top_stddev);
    stream.next(plant.growth.quality);
    stream.next(plant.growth.iterations);
    stream.next(plant.growth.r1);
    stream.next(plant.growth.M);
    stream.next(plant.growth.alpha);
    stream.next(plant.growth.beta);
  }
  ROS_DECLARE_ALLINONE_SERIALIZER
};

template <>
struct Serializer<field_phenotyping::Block>
    : MeasuredSerializer<field_phenotyping::Block, Serializer<field_phenotyping::Block>> {
  template <class Stream>
  static void write(Stream& stream, const field_phenotyping::Block& block) {
    fields(stream, block);
  }
  template <class Stream>
  static void read(Stream& stream, field_phenotyping::Block& block) {
    fields(stream, block);
    field_phenotyping::checkConsistency(block);
  }

 private:
  template <class Stream, class Block>
  static void fields(Stream& stream, Block& block) {
    stream.next(block.header);
    stream.next(block.joined);
    stream.next(block.cloud);
    stream.next(block.ground);
    stream.next(block.ground_points);
    stream.next(block.feet);
    stream.next(block.isolated);
  }
};

template <>
struct Serializer<field_phenotyping::SegmentedBlock>
    : MeasuredSerializer<field_phenotyping::SegmentedBlock,
                         Serializer<field_phenotyping::SegmentedBlock>> {
  template <class Stream>
  static void write(Stream& stream, const field_phenotyping::SegmentedBlock& block) {
    fields(stream, block);
  }
  template <class Stream>
  static void read(Stream& stream, field_phenotyping::SegmentedBlock& block) {
    fields(stream, block);
    field_phenotyping::checkConsistency(block);
  }

 private:
  template <class Stream, class Block>
  static void fields(Stream& stream, Block& block) {
    stream.next(block.header);
    stream.next(block.cloud);
    stream.next(block.ground);
    stream.next(block.plants);
    stream.next(block.source_index);
  }
};

template <>
struct Serializer<field_phenotyping::CompletedBlock>
    : MeasuredSerializer<field_phenotyping::CompletedBlock,
                         Serializer<field_phenotyping::CompletedBlock>> {
  template <class Stream>
  static void write(Stream& stream, const field_phenotyping::CompletedBlock& block) {
    std::vector<std::uint32_t> begin, end;
    for (const field_phenotyping::IndexSpan& span : block.synthetic_span) {
      begin.push_back(span.begin);
      end.push_back(span.end);
    }
    stream.next(*block.segmented);
    stream.next(block.synthetic);
    stream.next(block.synthetic_stddev);
    stream.next(begin);
    stream.next(end);
    std::vector<std::uint8_t> flags(begin.size(), 0U);
    for (std::size_t i = 0; i < std::min(flags.size(), block.stems.size()); ++i) {
      flags[i] = block.stems[i].flags;
    }
    stream.next(flags);
  }
  template <class Stream>
  static void read(Stream& stream, field_phenotyping::CompletedBlock& block) {
    auto segmented = std::make_shared<field_phenotyping::SegmentedBlock>();
    std::vector<std::uint32_t> begin, end;
    std::vector<std::uint8_t> flags;
    stream.next(*segmented);
    stream.next(block.synthetic);
    stream.next(block.synthetic_stddev);
    stream.next(begin);
    stream.next(end);
    stream.next(flags);
    block.segmented = std::move(segmented);
    block.stems.resize(flags.size());
    for (std::size_t i = 0; i < flags.size(); ++i) block.stems[i].flags = flags[i];
    block.synthetic_span.resize(begin.size());
    end.resize(begin.size());
    for (std::size_t i = 0; i < begin.size(); ++i) block.synthetic_span[i] = {begin[i], end[i]};
    field_phenotyping::checkConsistency(block);
  }
};

}  // namespace serialization
}  // namespace ros
