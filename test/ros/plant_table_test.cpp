#include "plant_table.hpp"

#include <gtest/gtest.h>

namespace field_phenotyping {
namespace {

Phenotype plant(std::int32_t id, double height) {
  Phenotype result;
  result.id = id;
  result.height = {height, 0.01};
  return result;
}

TEST(PlantTable, KeepsTheNewestRevision) {
  PlantTable table;
  EXPECT_TRUE(table.update({0, 0}, 1U, {plant(3, 1.0), plant(1, 2.0)}).accepted);
  EXPECT_TRUE(table.update({0, 0}, 2U, {plant(3, 1.5), plant(1, 2.0)}).removed.empty());
  ASSERT_EQ(table.size(), 2U);
  EXPECT_EQ(table.plants()[0].id, 1);
  EXPECT_EQ(table.plants()[1].height.value, 1.5);
}

TEST(PlantTable, TakesTheSameRevisionAgain) {
  PlantTable table;
  table.update({0, 0}, 2U, {plant(1, 1.0)});
  EXPECT_TRUE(table.update({0, 0}, 2U, {plant(1, 1.2)}).accepted) << "after a parameter changed";
  EXPECT_EQ(table.plants()[0].height.value, 1.2);
}

TEST(PlantTable, KeepsMeasuredPlantsWhenRevisionsStartAgain) {
  PlantTable table;
  table.update({0, 0}, 5U, {plant(1, 1.0)});
  EXPECT_FALSE(table.update({0, 0}, 1U, {}).accepted);
  EXPECT_EQ(table.size(), 1U);
}

TEST(PlantTable, ForgetsPlantsThatAreNoLongerFound) {
  PlantTable table;
  table.update({0, 0}, 1U, {plant(1, 1.0), plant(2, 1.0)});
  table.update({1, 0}, 1U, {plant(3, 1.0)});
  EXPECT_EQ(table.update({0, 0}, 2U, {plant(2, 1.0)}).removed, std::vector<std::int32_t>{1});
  EXPECT_EQ(table.size(), 2U);
}

TEST(PlantTable, CountsAPlantThatChangesItsBlockOnce) {
  PlantTable table;
  table.update({0, 0}, 1U, {plant(1, 1.0)});
  table.update({1, 0}, 1U, {plant(1, 1.1)});
  EXPECT_TRUE(table.update({0, 0}, 2U, {}).removed.empty()) << "the neighbour reports it now";
  ASSERT_EQ(table.size(), 1U);
  EXPECT_EQ(table.plants()[0].height.value, 1.1);
}

}  // namespace
}  // namespace field_phenotyping
