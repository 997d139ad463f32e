// Far more scans than can be worked: the newest win, drops are counted, plants come out all the
// while, and all is well again by itself when the load falls.
#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/ros.h>

#include <boost/make_shared.hpp>

#include "block_serialization.hpp"
#include "field_client.hpp"
#include "in_process_chain.hpp"

namespace field_phenotyping {
namespace {

constexpr const char* kDrops = "scans dropped: queue full";

TEST(Overload, NewestWinDropsAreCountedAndItRecovers) {
  ros::param::set("/field_phenotyping/preprocessing/queue_size", 5);
  ros::param::set("/field_phenotyping/preprocessing/update_period", 1.0);
  nodelet::Loader loader(false);
  ASSERT_TRUE(testing::loadChain(loader));
  testing::FieldClient client;
  ASSERT_TRUE(client.waitForStages());
  std::size_t reports = 0U;
  ros::Time newest;  // scan that any report counts in
  const auto note = [&](const PlantPhenotypeArrayConstPtr& message) {
    ++reports;
    newest = std::max(newest, message->header.stamp);
  };
  const ros::Subscriber listener = client.nodeHandle().subscribe<PlantPhenotypeArray>(
      "/field_phenotyping/measurement/output", 200, note);
  const ros::Publisher points =
      client.nodeHandle().advertise<sensor_msgs::PointCloud2>("/points", 5);
  const auto field = boost::make_shared<sensor_msgs::PointCloud2>(
      testing::cloudOf(client.field(), Eigen::Isometry3d::Identity(), "map", ros::Time::now()));
  ASSERT_TRUE(client.waitFor([&] { return points.getNumSubscribers() > 0U; }, 10.0));

  // Ten at a time, some hundred million points a second, until something comes out all the same.
  ros::Time last;
  const auto survives = [&] {
    for (int k = 0; k < 10; ++k) {
      const auto scan = boost::make_shared<sensor_msgs::PointCloud2>(*field);
      scan->header.stamp = last = ros::Time::now();
      points.publish(boost::shared_ptr<const sensor_msgs::PointCloud2>(scan));
    }
    return reports > 0U && client.valueOf("preprocessing", kDrops) > 10.0;
  };
  EXPECT_TRUE(client.waitFor(survives, 60.0)) << "no drops, or nothing came out while scans came";
  EXPECT_GT(client.valueOf("preprocessing", "scans placed"), 0.0);
  EXPECT_TRUE(client.heardOf("preprocessing", "scans arrive faster than they are worked"));

  // What was seen last is worked soon, not after a backlog.
  EXPECT_TRUE(client.waitFor([&] { return newest == last; }, 20.0)) << "the newest scan was lost";
  EXPECT_TRUE(client.waitFor([&] { return client.foundEveryPlant(); }, 20.0));
  client.expectTruth();

  // And nothing is amiss any more.
  const double drops = client.valueOf("preprocessing", kDrops);
  EXPECT_TRUE(client.waitFor([&] { return client.isWell("preprocessing"); }, 20.0));
  client.forgetPlants();
  client.driveBy(20);
  EXPECT_TRUE(client.waitFor([&] { return client.foundEveryPlant(); }, 40.0));
  EXPECT_EQ(client.valueOf("preprocessing", kDrops), drops) << "scans are dropped still";
}

}  // namespace
}  // namespace field_phenotyping
