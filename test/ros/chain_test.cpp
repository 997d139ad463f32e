// The four nodelets loaded into this very process, so that addresses can be compared.
#include <dynamic_reconfigure/Reconfigure.h>
#include <dynamic_reconfigure/config_tools.h>
#include <gtest/gtest.h>
#include <nodelet/loader.h>
#include <ros/ros.h>
#include <sensor_msgs/PointCloud2.h>
#include <visualization_msgs/MarkerArray.h>

#include <algorithm>
#include <map>
#include <set>

#include "block_serialization.hpp"
#include "block_worker.hpp"
#include "field_client.hpp"
#include "field_phenotyping/parameters.hpp"
#include "in_process_chain.hpp"

namespace field_phenotyping {
namespace {

/// Everything of one type that arrived on a topic.
template <class T>
class Collector {
 public:
  Collector(ros::NodeHandle& nh, const std::string& topic)
      : subscriber_(nh.subscribe(topic, 200, &Collector::add, this)) {}
  std::vector<boost::shared_ptr<const T>> messages;

 private:
  void add(const boost::shared_ptr<const T>& message) { messages.push_back(message); }
  ros::Subscriber subscriber_;
};

/// What has come out of the completion.
struct Completed {
  std::size_t in_drafts = 0U;  // plants
  std::size_t in_others = 0U;
  std::size_t filled_in = 0U;  // points
};

/// Drafts pass as they are.
Completed countCompleted(const std::vector<boost::shared_ptr<const CompletedBlock>>& blocks) {
  Completed count;
  for (const auto& block : blocks) {
    const std::vector<Plant>& plants = block->segmented->plants;
    EXPECT_EQ(block->stems.size(), plants.size());
    EXPECT_EQ(block->synthetic_span.size(), plants.size());
    if (block->segmented->header.draft) {
      count.in_drafts += plants.size();
      EXPECT_EQ(block->synthetic.size(), 0U);
    } else {
      count.in_others += plants.size();
      count.filled_in += block->synthetic.size();
    }
  }
  return count;
}

class Chain : public ::testing::Test {
 protected:
  static constexpr const char* kSpace = "/field_phenotyping";

  static void SetUpTestSuite() {
    // Without a history of their own these two hold on to nothing that they have sent.
    ros::param::set("/field_phenotyping/preprocessing/history", 0);
    ros::param::set("/field_phenotyping/completion/history", 0);
    ros::param::set("/field_phenotyping/segmentation/r1", 0.045);
    ros::param::set("/field_phenotyping/segmentation/seed_min_hieght", 0.1);
    loader_ = new nodelet::Loader(false);
    ASSERT_TRUE(testing::loadChain(*loader_));
    client_ = new testing::FieldClient();
    ASSERT_TRUE(client_->waitForStages());
  }
  static void TearDownTestSuite() {
    delete client_;
    delete loader_;
  }

  static std::string topic(const std::string& name) { return std::string(kSpace) + "/" + name; }

  /// Sets one parameter of the segmentation and returns the values in force after that.
  static SegmentationParameters reconfigure(const std::string& name, double value) {
    dynamic_reconfigure::Reconfigure call;
    dynamic_reconfigure::ConfigTools::appendParameter(call.request.config, name, value);
    EXPECT_TRUE(ros::service::call(topic("segmentation/set_parameters"), call));
    SegmentationParameters in_force;
    SegmentationParameters::visit(
        in_force, [&](const ParameterInfo& info, auto& target, auto, auto) {
          dynamic_reconfigure::ConfigTools::getParameter(call.response.config, info.name, target);
        });
    return in_force;
  }

  static nodelet::Loader* loader_;
  static testing::FieldClient* client_;
};
nodelet::Loader* Chain::loader_ = nullptr;
testing::FieldClient* Chain::client_ = nullptr;

TEST_F(Chain, HandsOnAddressesNotCopiesAndDraftsAsTheyAre) {
  Collector<Block> blocks(client_->nodeHandle(), topic("preprocessing/output"));
  Collector<SegmentedBlock> segmented(client_->nodeHandle(), topic("segmentation/output"));
  Collector<CompletedBlock> completed(client_->nodeHandle(), topic("completion/output"));
  client_->driveBy(20);
  ASSERT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 40.0));
  client_->expectTruth();
  Completed count;
  EXPECT_TRUE(client_->waitFor(
      [&] {
        count = countCompleted(completed.messages);
        return count.in_drafts > 0U && count.in_others > 0U && count.filled_in > 0U;
      },
      40.0))
      << count.in_drafts << " plants in drafts, " << count.in_others << " in other blocks, "
      << count.filled_in << " points filled in";

  // Segmentation -> Completion: what was completed is the very object that was sent.
  std::set<const SegmentedBlock*> sent;
  for (const auto& block : segmented.messages) sent.insert(block.get());
  ASSERT_FALSE(completed.messages.empty());
  for (const auto& block : completed.messages) EXPECT_EQ(sent.count(block->segmented.get()), 1U);

  // Preprocessing -> Segmentation and Completion -> Measurement: the receiver holds the newest
  // revision of each block, the sender nothing. Somebody besides this test holds the object.
  std::map<BlockIndex, boost::shared_ptr<const Block>> newest_of_tile;
  for (const auto& block : blocks.messages) {
    for (const BlockHeader& tile : block->tiles()) newest_of_tile[tile.index] = block;
  }
  std::set<boost::shared_ptr<const Block>> newest_sent;
  for (const auto& entry : newest_of_tile) newest_sent.insert(entry.second);
  blocks.messages.clear();
  newest_of_tile.clear();
  for (const auto& block : newest_sent) EXPECT_EQ(block.use_count(), 2);
  std::map<BlockIndex, boost::shared_ptr<const CompletedBlock>> newest_completed;
  for (const auto& block : completed.messages) newest_completed[headerOf(*block).index] = block;
  completed.messages.clear();
  for (const auto& entry : newest_completed) {
    // One that is at work is also held by that.
    client_->waitFor([&] { return entry.second.use_count() == 2; }, 10.0);
    EXPECT_EQ(entry.second.use_count(), 2);
  }
}

TEST_F(Chain, TakesTheValuesOfTheParameterServerAndNamesMisspeltOnes) {
  EXPECT_EQ(reconfigure("alpha", 0.2).r1, 0.045) << "the .cfg default won over the given value";
  EXPECT_TRUE(client_->heardOf(
      "segmentation",
      "'segmentation/seed_min_hieght'; did you mean 'segmentation/seed_min_height'"));
}

TEST_F(Chain, ChangedMReachesTheBlocksAlreadySeen) {
  Collector<SegmentedBlock> segmented(client_->nodeHandle(), topic("segmentation/output"));
  EXPECT_EQ(reconfigure("M", 0.4).M, 0.4);
  const auto with_new_m = [&] {
    for (const auto& block : segmented.messages) {
      for (const Plant& plant : block->plants) {
        if (plant.growth.M == 0.4F) return true;
      }
    }
    return false;
  };
  EXPECT_TRUE(client_->waitFor(with_new_m, 10.0));
  EXPECT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 10.0));
  reconfigure("M", SegmentationParameters().M);
}

TEST_F(Chain, PutsContradictingParametersRight) {
  const auto in_force = reconfigure("seed_min_height", 1.9);
  EXPECT_LT(in_force.seed_min_height, in_force.seed_max_height);
  EXPECT_TRUE(client_->waitFor(
      [] { return client_->heardOf("segmentation", "must be below seed_max_height"); }, 5.0));
  EXPECT_EQ(reconfigure("M", 99.0).M, 1.0) << "out of range: moved into it";
  reconfigure("M", SegmentationParameters().M);
}

TEST_F(Chain, ShowsCloudsWhileSomeoneListensAndAgainLater) {
  for (const char* name : {"segmentation/stems", "segmentation/plants"}) {
    for (int time = 0; time < 2; ++time) {
      Collector<sensor_msgs::PointCloud2> clouds(client_->nodeHandle(), topic(name));
      ASSERT_TRUE(client_->waitFor([&] { return !clouds.messages.empty(); }, 10.0)) << name;
      EXPECT_GT(clouds.messages[0]->width, 1000U);
      EXPECT_EQ(clouds.messages[0]->header.frame_id, "map");
    }
  }
  Collector<visualization_msgs::MarkerArray> markers(client_->nodeHandle(),
                                                     topic("measurement/markers"));
  ASSERT_TRUE(client_->waitFor([&] { return markers.messages.size() >= 2U; }, 10.0));
  EXPECT_EQ(markers.messages[0]->markers[0].action, visualization_msgs::Marker::DELETEALL);
  EXPECT_EQ(markers.messages[1]->markers.size(), 3U * client_->field().bases.size());
}

TEST_F(Chain, KeepsItsPlantsWhenTimeGoesBack) {
  auto cloud = testing::cloudOf(client_->field(), Eigen::Isometry3d::Identity(), "map",
                                ros::Time::now() - ros::Duration(1000.0), 0U, 50U);
  client_->publish(cloud);
  EXPECT_TRUE(
      client_->waitFor([] { return client_->heardOf("preprocessing", "time went back"); }, 10.0));
  // The few points that came after the jump make poor blocks, once nothing follows them.
  client_->spinFor(4.0);
  EXPECT_TRUE(client_->foundEveryPlant());
  client_->expectTruth();
}

TEST_F(Chain, CanBeUnloadedAndLoadedAgain) {
  ASSERT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 40.0));
  const std::vector<Phenotype> before = client_->plants();
  client_->driveBy(5);  // so that there is something at work
  EXPECT_TRUE(loader_->unload("/field_phenotyping/segmentation"));
  client_->driveBy(2);
  EXPECT_TRUE(loader_->load(
      "/field_phenotyping/segmentation", "field_phenotyping/Segmentation",
      {{"/field_phenotyping/segmentation/input", "/field_phenotyping/preprocessing/output"}}, {}));
  client_->forgetPlants();
  client_->driveBy(20, Eigen::Vector3d::Zero(), true);  // so that it sees them in another order
  EXPECT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 40.0));
  for (const Phenotype& plant : client_->plants()) {
    const bool known = std::any_of(before.begin(), before.end(), [&](const Phenotype& other) {
      return other.id == plant.id && (other.base - plant.base).norm() < 0.05;
    });
    EXPECT_TRUE(known) << plant.id;
  }
}

}  // namespace
}  // namespace field_phenotyping
