// Against any running set of the four stages: raw scans with tf must give every plant.
#include <gtest/gtest.h>

#include "field_client.hpp"

namespace field_phenotyping {
namespace {

TEST(RawScans, GiveEveryPlant) {
  testing::FieldClient client;
  ASSERT_TRUE(client.waitForStages());
  client.driveBy(20);
  EXPECT_TRUE(client.waitFor([&] { return client.foundEveryPlant(); }, 40.0));
  client.expectTruth();
}

}  // namespace
}  // namespace field_phenotyping
