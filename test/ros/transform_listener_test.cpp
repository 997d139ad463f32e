// What a tf2 buffer holds when transforms come again from the beginning. Needs no master.
#include "transform_listener.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace field_phenotyping {
namespace {

const ros::Time kBegin(1600000000.0);

/// A frame that goes on along x by one metre a second.
geometry_msgs::TransformStamped at(double seconds, const std::string& frame = "lidar") {
  geometry_msgs::TransformStamped transform;
  transform.header.stamp = kBegin + ros::Duration(seconds);
  transform.header.frame_id = "map";
  transform.child_frame_id = frame;
  transform.transform.translation.x = seconds;
  transform.transform.rotation.w = 1.0;
  return transform;
}

class TransformIntakeTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() { ros::Time::init(); }  // the log asks what time it is

  void add(const geometry_msgs::TransformStamped& transform) {
    tf2_msgs::TFMessage message;
    message.transforms.push_back(transform);
    intake_.add(message, "test");
  }

  bool has(double seconds, const std::string& frame = "lidar") const {
    return buffer_.canTransform("map", frame, kBegin + ros::Duration(seconds));
  }

  double placeAt(double seconds) const {
    const auto stamp = kBegin + ros::Duration(seconds);
    return buffer_.lookupTransform("map", "lidar", stamp).transform.translation.x;
  }

  tf2::BufferCore buffer_{ros::Duration(60.0)};
  std::vector<std::string> went_back_;
  TransformIntake intake_{buffer_, [this](const std::string& frame, double seconds) {
                            went_back_.push_back(frame);
                            EXPECT_GT(seconds, 1.0);
                          }};
};

// However late the last ones of the first time are: the ROS clock may have gone back before.
TEST_F(TransformIntakeTest, OfABagThatStartsAgainAreNotMixedWithItsEnd) {
  for (int k = 0; k < 30; ++k) add(at(0.1 * k));
  EXPECT_NEAR(placeAt(2.85), 2.85, 1e-9);
  EXPECT_TRUE(went_back_.empty());
  for (int k = 0; k < 3; ++k) add(at(0.1 * k));
  EXPECT_EQ(went_back_, std::vector<std::string>{"lidar"});
  EXPECT_NEAR(placeAt(0.15), 0.15, 1e-9);
  EXPECT_FALSE(has(0.25)) << "between the third one and the last one of the first time";
  EXPECT_FALSE(has(2.85));
}

// tf2 by itself refuses what is older than its memory.
TEST_F(TransformIntakeTest, OfALongBagThatStartsAgainAreTaken) {
  for (int k = 0; k <= 100; ++k) add(at(k));
  add(at(0.0));
  add(at(1.0));
  EXPECT_NEAR(placeAt(0.5), 0.5, 1e-9);
}

TEST_F(TransformIntakeTest, ThatChangePlacesOnTheWayAreTaken) {
  add(at(0.0));
  add(at(1.0));
  add(at(0.5));
  EXPECT_NEAR(placeAt(0.75), 0.75, 1e-9);
  EXPECT_TRUE(went_back_.empty());
}

// Frames have stamps of their own: one may lag behind another.
TEST_F(TransformIntakeTest, OfSlowFramesAreNoTimeJump) {
  for (int k = 0; k <= 50; ++k) {
    add(at(0.1 * k));
    if (k >= 30) add(at(0.1 * k - 3.0, "slow"));
  }
  EXPECT_TRUE(went_back_.empty());
  EXPECT_TRUE(has(1.95, "slow"));
}

TEST_F(TransformIntakeTest, WithoutAStampAndStaticOnesAreNoTimeJump) {
  tf2_msgs::TFMessage message;
  message.transforms.push_back(at(-1000.0, "mount"));
  intake_.addStatic(message, "test");
  add(at(10.0));
  auto unstamped = at(0.0, "odd");
  unstamped.header.stamp = ros::Time();
  add(unstamped);
  unstamped.child_frame_id = "lidar";
  add(unstamped);
  EXPECT_TRUE(went_back_.empty());
  add(at(0.0));
  EXPECT_EQ(went_back_.size(), 1U);
  EXPECT_TRUE(has(0.0, "mount")) << "holds at all times";
}

TEST_F(TransformIntakeTest, AtTheEndOfTimeAreNoTrouble) {
  auto late = at(0.0);
  late.header.stamp = ros::Time(0xffffffffU, 0U);
  add(late);
  add(at(0.0));
  add(at(1.0));
  EXPECT_EQ(went_back_.size(), 1U);
  EXPECT_TRUE(has(0.5));
}

}  // namespace
}  // namespace field_phenotyping
