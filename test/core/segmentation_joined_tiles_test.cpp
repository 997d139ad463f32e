// Tiles that were worked as one come apart as if each had been worked by itself.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <vector>

#include "field_phenotyping/segmentation/joined_tiles.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"

namespace field_phenotyping {
namespace {

constexpr double kTile = 2.0;
constexpr double kMargin = 0.4;

/// Three tiles in an L, near the origin of a map that is far from zero, and plants all over them
/// and their margin, each with stem points about its base and others farther away.
struct Joined {
  SegmentedBlock block;
  std::vector<BlockHeader> tiles;

  explicit Joined(unsigned seed) {
    std::uint32_t revision = 3U;
    for (const BlockIndex& index : {BlockIndex{500, 700}, {501, 700}, {501, 701}}) {
      BlockHeader tile;
      tile.index = index;
      tile.tile_size = kTile;
      tile.margin = kMargin;
      tile.final = true;
      tile.revision = revision++;
      tiles.push_back(tile);
    }
    block.header = tiles.front();
    block.cloud.origin = {1002.0, 1402.0, 50.0};
    block.cloud.scan_origins = {{1.0F, 2.0F, 3.0F}};
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> place(-2.4F, 2.4F);
    std::normal_distribution<float> near(0.0F, 0.3F);
    std::uniform_int_distribution<int> count(0, 30);
    const auto add = [&](const Eigen::Vector3f& point) {
      block.cloud.points.push_back(point);
      block.cloud.colors.push_back(static_cast<std::uint32_t>(block.cloud.size()));
      block.cloud.scan_origin.push_back(block.cloud.size() % 2U == 0U ? 0U : kNoScanOrigin);
      block.source_index.push_back(static_cast<std::uint32_t>(7U * block.cloud.size()));
    };
    const auto size = [&] { return static_cast<std::uint32_t>(block.cloud.size()); };
    for (int k = 0; k < 60; ++k) {
      Plant plant;
      plant.base = {place(random), place(random), 0.0F};
      plant.points.begin = plant.stem.begin = size();
      for (int i = count(random); i >= 0; --i)
        add(plant.base + 0.1F * near(random) * Eigen::Vector3f::Ones());
      plant.stem.end = size();
      for (int i = count(random); i > 0; --i) {
        add(plant.base + Eigen::Vector3f(near(random), near(random), 1.0F));
      }
      plant.points.end = size();
      plant.growth.quality = static_cast<float>(k);  // tells it
      block.plants.push_back(plant);
    }
    for (int k = 0; k < 500; ++k) add({place(random), place(random), place(random)});
  }
};

TEST(JoinedTiles, EachHasWhatIsInItAndInItsMargin) {
  for (unsigned seed = 0U; seed < 5U; ++seed) {
    const Joined joined(seed);
    const std::vector<SegmentedBlock> split = splitIntoTiles(joined.block, joined.tiles);
    ASSERT_EQ(split.size(), joined.tiles.size());
    for (std::size_t t = 0; t < split.size(); ++t) {
      const SegmentedBlock& tile = split[t];
      const BlockHeader& header = joined.tiles[t];
      EXPECT_TRUE(tile.header.index == header.index);
      EXPECT_EQ(tile.header.revision, header.revision);
      EXPECT_EQ(tile.cloud.origin, joined.block.cloud.origin);
      EXPECT_EQ(tile.cloud.scan_origins, joined.block.cloud.scan_origins);
      const auto isInside = [&](std::size_t i) {
        const Eigen::Vector3d p = joined.block.cloud.mapPoint(i);
        return header.holds(p.x(), p.y(), kMargin);
      };

      // Every point once, with all that is known of it.
      std::map<std::uint32_t, std::size_t> number_of;  // in the whole, by its source
      std::set<std::uint32_t> expected;
      for (std::size_t i = 0; i < joined.block.cloud.size(); ++i) {
        number_of[joined.block.source_index[i]] = i;
        if (isInside(i)) expected.insert(joined.block.source_index[i]);
      }
      EXPECT_EQ(std::set<std::uint32_t>(tile.source_index.begin(), tile.source_index.end()),
                expected);
      ASSERT_EQ(tile.source_index.size(), expected.size());
      ASSERT_EQ(tile.cloud.size(), expected.size());
      for (std::size_t i = 0; i < tile.cloud.size(); ++i) {
        const std::size_t whole = number_of.at(tile.source_index[i]);
        EXPECT_EQ(tile.cloud.points[i], joined.block.cloud.points[whole]);
        EXPECT_EQ(tile.cloud.colors[i], joined.block.cloud.colors[whole]);
        EXPECT_EQ(tile.cloud.scan_origin[i], joined.block.cloud.scan_origin[whole]);
      }

      // Every plant that stands there, with its points there.
      std::vector<const Plant*> plants;
      for (const Plant& plant : joined.block.plants) {
        const Eigen::Vector3d base = joined.block.cloud.origin + plant.base.cast<double>();
        if (header.holds(base.x(), base.y(), kMargin)) plants.push_back(&plant);
      }
      ASSERT_EQ(tile.plants.size(), plants.size());
      std::uint32_t end = 0U;
      for (std::size_t k = 0; k < plants.size(); ++k) {
        const Plant& own = tile.plants[k];
        EXPECT_EQ(own.growth.quality, plants[k]->growth.quality);
        const Eigen::Vector3d base = joined.block.cloud.origin + own.base.cast<double>();
        EXPECT_EQ(own.owned, header.holds(base.x(), base.y(), PlantRegistry::kBorderTolerance));
        EXPECT_EQ(own.points.begin, end) << "plant by plant";
        EXPECT_EQ(own.stem.begin, end);
        std::vector<std::uint32_t> stem, all;
        for (std::uint32_t i = plants[k]->points.begin; i < plants[k]->points.end; ++i) {
          if (!isInside(i)) continue;
          all.push_back(joined.block.source_index[i]);
          if (i < plants[k]->stem.end) stem.push_back(joined.block.source_index[i]);
        }
        const auto first = tile.source_index.begin() + own.points.begin;
        EXPECT_EQ(own.stem.size(), stem.size());
        ASSERT_EQ(own.points.size(), all.size());
        EXPECT_TRUE(std::equal(all.begin(), all.end(), first));
        end = own.points.end;
      }
    }
  }
}

TEST(JoinedTiles, OneTileComesBackAsItIs) {
  const Joined joined(1U);
  const std::vector<SegmentedBlock> split = splitIntoTiles(joined.block, {});
  ASSERT_EQ(split.size(), 1U);
  EXPECT_EQ(split[0].source_index, joined.block.source_index);
  EXPECT_EQ(split[0].plants.size(), joined.block.plants.size());
}

}  // namespace
}  // namespace field_phenotyping
