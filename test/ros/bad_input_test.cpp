// Against field_phenotyping.launch: whatever comes in, the nodelets say what is wrong and live on.
#include <gtest/gtest.h>
#include <ros/master.h>

#include <limits>

#include "field_client.hpp"

namespace field_phenotyping {
namespace {

class BadInput : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    client_ = new testing::FieldClient();
    ASSERT_TRUE(client_->waitForStages());
  }
  static void TearDownTestSuite() { delete client_; }

  sensor_msgs::PointCloud2 goodCloud(const std::string& frame) const {
    return testing::cloudOf(client_->field(), Eigen::Isometry3d::Identity(), frame,
                            ros::Time::now());
  }

  void expectTrouble(const sensor_msgs::PointCloud2& cloud, const std::string& text) const {
    client_->publish(cloud);
    EXPECT_TRUE(client_->waitFor([&] { return client_->heardOf("preprocessing", text); }, 10.0))
        << "nothing in the diagnostics about: " << text;
  }

  static testing::FieldClient* client_;
};
testing::FieldClient* BadInput::client_ = nullptr;

TEST_F(BadInput, WithoutAnXFieldIsNamed) {
  auto cloud = goodCloud("map");
  cloud.fields[0].name = "range";
  expectTrouble(cloud, "no field 'x', only: range (FLOAT32), y (FLOAT32), z (FLOAT32)");
}

TEST_F(BadInput, CutShortIsNamed) {
  auto cloud = goodCloud("map");
  cloud.data.resize(cloud.data.size() - 5U);
  expectTrouble(cloud, "it was cut short");
}

TEST_F(BadInput, EmptyIsNamed) {
  auto cloud = goodCloud("map");
  cloud.width = 0U;
  cloud.row_step = 0U;
  cloud.data.clear();
  expectTrouble(cloud, "holds no point");
  expectTrouble(sensor_msgs::PointCloud2(), "frame_id is empty");
}

TEST_F(BadInput, AllNanIsNamed) {
  auto cloud = goodCloud("map");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (std::size_t i = 0; i < cloud.data.size(); i += cloud.point_step) {
    for (std::size_t k = 0; k < 3U; ++k) std::memcpy(cloud.data.data() + i + 4U * k, &nan, 4U);
  }
  expectTrouble(cloud, "not finite");
}

TEST_F(BadInput, InMillimetresIsNamed) {
  auto cloud = goodCloud("map");
  for (std::size_t i = 0; i < cloud.data.size(); i += cloud.point_step) {
    for (std::size_t k = 0; k < 3U; ++k) {
      float value = 0.0F;
      std::memcpy(&value, cloud.data.data() + i + 4U * k, 4U);
      value *= 1000.0F;
      std::memcpy(cloud.data.data() + i + 4U * k, &value, 4U);
    }
  }
  expectTrouble(cloud, "x y z must be in metres");
}

TEST_F(BadInput, InAnUnknownFrameIsNamed) {
  expectTrouble(goodCloud("nowhere"), "no transform from 'nowhere' to 'map'");
  EXPECT_TRUE(client_->heardOf("preprocessing",
                               "No transform has come at all: is the SLAM running? If it has "
                               "registered the scans, set target_frame to 'nowhere'"));
}

TEST_F(BadInput, InAMisspeltFrameIsNamedWithTheFramesThatThereAre) {
  client_->broadcast(Eigen::Isometry3d::Identity(), ros::Time::now());
  expectTrouble(goodCloud("lidra"), "tf knows no 'lidra', only 'lidar', 'map'; is 'lidar' meant?");
  EXPECT_TRUE(client_->heardOf("preprocessing", "the first alone may hold /tf_static"));
}

TEST_F(BadInput, WithABrokenStampIsNamed) {
  auto cloud = goodCloud("map");
  cloud.header.stamp.nsec = 2000000000U;
  expectTrouble(cloud, "its stamp is");
  cloud = goodCloud("lidar");
  cloud.header.stamp = ros::Time();
  expectTrouble(cloud, "its stamp is zero");
}

TEST_F(BadInput, BeforeItsTransformIsNamed) {
  const ros::Time now = ros::Time::now();
  client_->broadcast(Eigen::Isometry3d::Identity(), now - ros::Duration(5.0));
  auto cloud = goodCloud("lidar");
  cloud.header.stamp = now;
  expectTrouble(cloud,
                "no transform from 'lidar' to 'map' at its stamp within 1 s (Lookup would "
                "require extrapolation");
}

// What was placed before tells that both go by one clock.
TEST_F(BadInput, AfterTheSlamHasStoppedIsNamed) {
  const ros::Time stopped = ros::Time::now() - ros::Duration(100.0);
  client_->broadcast(Eigen::Isometry3d::Identity(), stopped, "stopped_lidar");
  auto cloud = goodCloud("stopped_lidar");
  cloud.header.stamp = stopped;
  client_->publish(cloud);
  cloud.header.stamp = stopped + ros::Duration(50.0);
  expectTrouble(cloud, "The newest one is 50 s older than the scan. Has the SLAM stopped?");
}

TEST_F(BadInput, ByAnotherClockThanTheTransformsIsNamed) {
  client_->broadcast(Eigen::Isometry3d::Identity(), ros::Time::now());
  auto cloud = goodCloud("lidar");
  cloud.header.stamp = ros::Time(1600000000.0);
  expectTrouble(cloud, "Scans and transforms go by different clocks: set use_sim_time");
  EXPECT_TRUE(client_->heardOf("preprocessing", "check_bag tells whether a bag was recorded so"));
}

// Without /clock, too; tf2 by itself refuses transforms that are older than its memory.
TEST_F(BadInput, OfABagThatStartsAgainIsPlaced) {
  const ros::Time end = ros::Time::now() + ros::Duration(1.0);
  const ros::Time begin = end - ros::Duration(100.0);
  const auto scanAt = [&](const ros::Time& stamp) {
    auto cloud = goodCloud("lidar");
    cloud.header.stamp = stamp;
    client_->broadcast(Eigen::Isometry3d::Identity(), stamp);
    client_->publish(cloud);
    client_->spinFor(0.3);
  };
  const auto placed = [] { return client_->valueOf("preprocessing", "scans placed"); };
  for (const ros::Time& stamp : {end, begin, begin + ros::Duration(5.0)}) {
    const double before = placed();
    scanAt(stamp);
    EXPECT_TRUE(client_->waitFor([&] { return placed() > before; }, 8.0)) << stamp;
  }
}

// The SLAM goes on as if nothing had happened.
TEST_F(BadInput, OfABagThatStartsAgainUnderASlamThatDoesNotIsNamed) {
  const ros::Time now = ros::Time::now();
  auto cloud = goodCloud("lidar");
  cloud.header.stamp = now;
  client_->broadcast(Eigen::Isometry3d::Identity(), now);
  client_->publish(cloud);
  cloud.header.stamp = now - ros::Duration(40.0);
  expectTrouble(cloud, "Or a bag was started again and who publishes transforms has not noticed");
}

// A stamp so late that a second more is too much for ros::Time.
TEST_F(BadInput, AtTheEndOfTimeDoesNotBlockTheQueue) {
  auto cloud = goodCloud("map");
  cloud.header.stamp = ros::Time(0xffffffffU, 0U);
  client_->publish(cloud);
  cloud = goodCloud("map");
  cloud.fields[0].name = "after the end of time";
  expectTrouble(cloud, "after the end of time");
}

// Last: after all of the above a whole cloud must still be measured.
TEST_F(BadInput, LeavesTheNodeletsAlive) {
  client_->publish(goodCloud("map"));
  EXPECT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 40.0));
  client_->expectTruth();
}

}  // namespace
}  // namespace field_phenotyping
