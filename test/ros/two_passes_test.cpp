// The launch file as users start it: a second pass, after the SLAM has moved its map, adds to what
// is known of each plant; nothing is measured from both maps at once. All of it is in the journal.
#include <gtest/gtest.h>

#include <algorithm>

#include "field_client.hpp"
#include "phenotype_journal.hpp"

namespace field_phenotyping {
namespace {

TEST(TwoPasses, GiveOnePlantEachAndKnowMore) {
  testing::FieldClient client;
  ASSERT_TRUE(client.waitForStages());
  constexpr int kScans = 30;
  const Eigen::Vector3d shift(0.07, -0.05, 0.0);
  client.driveBy(kScans);
  // At once, in the same place: only the map jumps.
  client.driveBy(kScans, shift, true);
  const auto passedTwice = [&] {
    const auto plants = client.plants();
    return client.foundEveryPlant() &&
           std::all_of(plants.begin(), plants.end(),
                       [](const Phenotype& p) { return p.passes == 2U; });
  };
  EXPECT_TRUE(client.waitFor(passedTwice, 60.0));
  client.expectTruth(shift);
  EXPECT_TRUE(client.heardOf("preprocessing", "the SLAM has moved the map"));

  std::int64_t position = 0;
  const PhenotypeJournal journal(ros::param::param<std::string>("~journal", ""),
                                 PhenotypeJournal::Access::kRead);
  EXPECT_EQ(journal.frameId(), "map");
  PlantTable table;
  for (const PlantReport& report : journal.readAfter(position)) {
    table.update(report.source, report.plants);
  }
  EXPECT_EQ(table.size(), client.field().bases.size());
  const auto plants = client.plants();
  for (const Phenotype& plant : plants) {
    EXPECT_NEAR(plant.stem_diameter.value, 2.0 * client.field().stem_radius, 0.0015)
        << "of two half stems in two maps?";
  }
  ASSERT_EQ(table.plants().size(), plants.size());
}

}  // namespace
}  // namespace field_phenotyping
