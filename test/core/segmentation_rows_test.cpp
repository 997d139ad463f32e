// Rows found in made places of plants, whose truth is exact.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include "field_phenotyping/segmentation/row_model.hpp"

namespace field_phenotyping {
namespace {

constexpr double kDegree = M_PI / 180.0;

/// A sown field.
struct Field {
  double azimuth = 0.0;  // [deg] of the rows
  double row_spacing = 0.75;
  double plant_spacing = 0.20;
  int rows = 4;
  int plants = 12;  // per row
  double scatter = 0.015;
  double missing = 0.0;  // share
  int anywhere = 0;      // plants, or false ones, between the rows
  Eigen::Vector2d origin{0.3, -0.2};

  Eigen::Vector2d along() const {
    return {std::cos(azimuth * kDegree), std::sin(azimuth * kDegree)};
  }
  Eigen::Vector2d across() const { return {-along().y(), along().x()}; }
  Eigen::Vector2d at(double row, double plant) const {
    return origin + row * row_spacing * across() + plant * plant_spacing * along();
  }

  std::vector<PlantPlace> places(unsigned seed) const {
    std::mt19937 random(seed);
    std::normal_distribution<double> off(0.0, scatter);
    std::uniform_real_distribution<double> uniform;
    std::vector<PlantPlace> places;
    for (int row = 0; row < rows; ++row) {
      for (int plant = 0; plant < plants; ++plant) {
        const double shift = off(random);
        const double aside = off(random);
        if (uniform(random) < missing) continue;
        places.push_back({at(row, plant) + shift * along() + aside * across(), 1.0});
      }
    }
    for (int k = 0; k < anywhere; ++k) {
      const double row = rows * uniform(random) - 0.5;
      places.push_back({at(row, plants * uniform(random)), 1.0});
    }
    return places;
  }
};

/// Angle between two undirected lines [deg].
double turn(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return std::acos(std::min(1.0, std::abs(a.dot(b)))) / kDegree;
}

void expectRows(const Field& field, const std::optional<RowModel>& rows) {
  ASSERT_TRUE(rows.has_value());
  EXPECT_LT(turn(rows->direction(), field.along()), 1.5);
  EXPECT_NEAR(rows->rowSpacing(), field.row_spacing, 0.03 * field.row_spacing);
  for (int row = 0; row < field.rows; ++row) {
    EXPECT_LT(std::abs(rows->offRow(field.at(row, 0.5 * field.plants))), 0.02);
  }
  EXPECT_NEAR(rows->plantSpacing(), field.plant_spacing, 0.12 * field.plant_spacing);
}

TEST(Rows, AreFoundAtAnyAngle) {
  for (double azimuth = 0.0; azimuth < 180.0; azimuth += 11.0) {
    SCOPED_TRACE(azimuth);
    Field field;
    field.azimuth = azimuth;
    expectRows(field, RowModel::find(field.places(1U), {}));
  }
}

TEST(Rows, AreFoundAtManySpacings) {
  for (const double row_spacing : {0.4, 0.5, 0.6, 0.75, 1.0}) {
    for (const double plant_spacing : {0.10, 0.15, 0.25}) {
      SCOPED_TRACE(std::to_string(row_spacing) + " x " + std::to_string(plant_spacing));
      Field field;
      field.azimuth = 23.0;
      field.row_spacing = row_spacing;
      field.plant_spacing = plant_spacing;
      expectRows(field, RowModel::find(field.places(2U), {}));
    }
  }
}

TEST(Rows, SurviveGapsAndWhatStandsBetweenThem) {
  for (unsigned seed = 0; seed < 8U; ++seed) {
    SCOPED_TRACE(seed);
    Field field;
    field.azimuth = 70.0;
    field.missing = 0.25;
    field.anywhere = 8;
    const auto rows = RowModel::find(field.places(seed), {});
    expectRows(field, rows);
    EXPECT_GT(rows->inRows(), 0.6);
    EXPECT_LT(rows->inRows(), 0.97);
  }
}

TEST(Rows, RunTowardsPositiveX) {
  Field field;
  field.azimuth = 150.0;
  const auto rows = RowModel::find(field.places(3U), {});
  ASSERT_TRUE(rows.has_value());
  EXPECT_LT((rows->direction() + field.along()).norm(), 0.03);
  field.azimuth = 90.0;
  const auto upright = RowModel::find(field.places(3U), {});
  ASSERT_TRUE(upright.has_value());
  EXPECT_GT(upright->direction().y(), 0.99);
}

TEST(Rows, AreNotMadeUp) {
  // Plants anywhere, sparse and dense.
  for (const int plants : {5, 8, 12, 20, 40, 80}) {
    int found = 0;
    for (unsigned seed = 0; seed < 20U; ++seed) {
      Field field;
      field.rows = 4;
      field.plants = 15;
      std::vector<PlantPlace> places;
      field.anywhere = plants;
      for (const PlantPlace& place : field.places(seed)) places.push_back(place);
      places.erase(places.begin(), places.end() - plants);
      if (RowModel::find(places, {})) ++found;
    }
    EXPECT_LE(found, 1) << plants << " plants anywhere";
  }
}

TEST(Rows, NeedMoreThanThreePlants) {
  EXPECT_FALSE(RowModel::find({}, {}));
  std::vector<PlantPlace> places;
  for (int k = 0; k < 3; ++k) {
    places.push_back({Eigen::Vector2d(0.2 * k, 0.0), 1.0});
    EXPECT_FALSE(RowModel::find(places, {})) << k + 1;
    EXPECT_FALSE(RowModel::find(places, {0.75, 0.2})) << k + 1;
  }
}

TEST(Rows, OneRowIsARow) {
  Field field;
  field.rows = 1;
  field.azimuth = 40.0;
  field.plants = 12;
  const auto rows = RowModel::find(field.places(4U), {});
  ASSERT_TRUE(rows.has_value());
  EXPECT_LT(turn(rows->direction(), field.along()), 2.0);
  EXPECT_GT(rows->rowOdds(field.at(0, 3.5)), 3.0);
  // Where the next row would be is not known.
  EXPECT_EQ(rows->rowOdds(field.at(0, 3.5) + rows->rowSpacing() * field.across()), 1.0);
}

TEST(Rows, HintsHelpWhereFewPlantsShowThem) {
  Field field;
  field.rows = 2;
  field.plants = 12;
  field.missing = 0.5;
  field.scatter = 0.03;
  int with = 0;
  int without = 0;
  for (unsigned seed = 0; seed < 20U; ++seed) {
    const std::vector<PlantPlace> places = field.places(seed);
    const auto right = [&](const std::optional<RowModel>& rows) {
      return rows && turn(rows->direction(), field.along()) < 4.0 &&
             std::abs(rows->rowSpacing() - field.row_spacing) < 0.05;
    };
    if (right(RowModel::find(places, {}))) ++without;
    if (right(RowModel::find(places, {field.row_spacing, field.plant_spacing}))) ++with;
  }
  EXPECT_GE(with, without);
  EXPECT_GE(with, 16);
  EXPECT_THROW(RowModel::find({}, {-0.5, 0.0}), std::invalid_argument);
  EXPECT_THROW(RowModel::find({}, {0.0, -0.1}), std::invalid_argument);
}

TEST(Rows, ArePriorForPlaces) {
  Field field;
  field.azimuth = 30.0;
  std::vector<PlantPlace> places = field.places(5U);
  const auto rows = RowModel::find(places, {});
  ASSERT_TRUE(rows.has_value());
  EXPECT_GT(rows->rowOdds(field.at(1, 4.5)), 3.0) << "on a row";
  EXPECT_LT(rows->rowOdds(field.at(1.5, 4.5)), 0.2) << "between rows";
  EXPECT_GT(rows->rowOdds(field.at(1.5, 4.5)), 0.0) << "never impossible";

  std::vector<Eigen::Vector2d> others;
  const std::size_t lost = 17U;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (i != lost) others.push_back(places[i].position);
  }
  EXPECT_GT(rows->spacingOdds(places[lost].position, others), 2.0) << "in a gap";
  EXPECT_LT(rows->spacingOdds(field.at(2, 4.5), others), 0.5) << "between neighbours";
  EXPECT_LT(rows->spacingOdds(places[3].position + 0.03 * field.along(), others), 0.5)
      << "beside a plant";
  EXPECT_GT(rows->spacingOdds(field.at(2, 12.0), others), 0.8) << "the row goes on";
  EXPECT_EQ(rows->spacingOdds(field.at(1, 4), {}), 1.0) << "the first of its row";
}

TEST(Rows, NoPlaceIsLikelierThanTheBounds) {
  Field field;
  field.azimuth = 70.0;
  field.missing = 0.2;
  const std::vector<PlantPlace> places = field.places(6U);
  const auto rows = RowModel::find(places, {});
  ASSERT_TRUE(rows.has_value());
  std::vector<Eigen::Vector2d> others;
  for (const PlantPlace& place : places) others.push_back(place.position);
  double most_row = 0.0;
  double most_interval = 0.0;
  for (double row = -0.5; row < 4.0; row += 0.02) {
    for (double plant = -1.0; plant < 13.0; plant += 0.1) {
      most_row = std::max(most_row, rows->rowOdds(field.at(row, plant)));
      most_interval = std::max(most_interval, rows->intervalOdds(field.at(row, plant), others));
    }
  }
  EXPECT_LE(most_row, rows->mostRowOdds());
  EXPECT_LE(most_interval, rows->mostIntervalOdds());
  EXPECT_GT(most_row, 0.5 * rows->mostRowOdds()) << "no looser than needed";
  EXPECT_GT(most_interval, 0.5 * rows->mostIntervalOdds()) << "no looser than needed";
}

}  // namespace
}  // namespace field_phenotyping
