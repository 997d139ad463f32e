#include "phenotype_journal.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace field_phenotyping {
namespace {

namespace fs = std::filesystem;
using Access = PhenotypeJournal::Access;

class Journal : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("phenotype_journal_test_" + std::to_string(::getpid()));
    fs::remove_all(folder_);
    path_ = folder_ / "deep" / "journal.sqlite";
  }
  void TearDown() override { fs::remove_all(folder_); }

  static PlantReport report(std::uint32_t revision, int plants) {
    PlantReport result;
    result.source.block = {-3, 4};
    result.source.began_ns = 1604515190000000123U;
    result.source.stamp_ns = 1604515199000000456U;
    result.source.revision = revision;
    for (int k = 0; k < plants; ++k) {
      Phenotype plant;
      plant.id = k;
      plant.base = {448262.125, 5411932.5, 90.0};
      plant.height = {1.5 + 0.1 * k, 0.01};
      plant.flags = kArcBelow;
      plant.passes = 1U;
      result.plants.push_back(plant);
    }
    return result;
  }

  fs::path folder_;
  std::string path_;
};

TEST_F(Journal, GivesBackWhatItWasGiven) {
  {
    PhenotypeJournal journal(path_, Access::kWrite);
    journal.setFrameId("map");
    journal.append(report(1U, 2));
    journal.append(report(2U, 0));
    journal.append(report(3U, 1));
  }
  const PhenotypeJournal journal(path_, Access::kRead);
  EXPECT_EQ(journal.frameId(), "map");
  std::int64_t position = 0;
  const auto reports = journal.readAfter(position);
  ASSERT_EQ(reports.size(), 3U);
  EXPECT_EQ(reports[0].source.block.x, -3);
  EXPECT_EQ(reports[0].source.began_ns, 1604515190000000123U);
  EXPECT_EQ(reports[0].source.stamp_ns, 1604515199000000456U);
  EXPECT_EQ(reports[2].source.revision, 3U);
  EXPECT_TRUE(reports[1].plants.empty()) << "a block without plants is a report, too";
  ASSERT_EQ(reports[0].plants.size(), 2U);
  EXPECT_EQ(reports[0].plants[1].id, 1);
  EXPECT_EQ(reports[0].plants[1].base.x(), 448262.125);
  EXPECT_EQ(reports[0].plants[1].height.value, 1.6);
  EXPECT_EQ(reports[0].plants[1].flags, kArcBelow);
  EXPECT_TRUE(std::isnan(reports[0].plants[1].stem_diameter.value));
  EXPECT_TRUE(journal.readAfter(position).empty());
}

TEST_F(Journal, IsReadWhileItIsWritten) {
  PhenotypeJournal writer(path_, Access::kWrite);
  const PhenotypeJournal reader(path_, Access::kRead);
  std::int64_t position = 0;
  for (std::uint32_t revision = 1U; revision < 20U; ++revision) {
    writer.append(report(revision, 3));
    const auto news = reader.readAfter(position);
    ASSERT_EQ(news.size(), 1U);
    EXPECT_EQ(news[0].source.revision, revision);
  }
}

TEST_F(Journal, OutlivesAProcessThatIsKilledAnywhere) {
  // The child writes and says after each report that it is durable; it is killed at some moment.
  std::uint32_t written_before = 0U;
  for (int round = 0; round < 20; ++round) {
    int said[2];
    ASSERT_EQ(::pipe(said), 0);
    const pid_t child = ::fork();
    if (child == 0) {
      PhenotypeJournal journal(path_, Access::kWrite);
      for (std::uint32_t revision = written_before + 1U;; ++revision) {
        journal.append(report(revision, 5));
        if (::write(said[1], &revision, sizeof(revision)) < 0) ::_exit(1);
      }
    }
    ::close(said[1]);
    std::uint32_t last = written_before;
    for (int k = 0; k < 3; ++k) ASSERT_GT(::read(said[0], &last, sizeof(last)), 0);
    ::usleep(static_cast<useconds_t>(300 * round));
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    for (std::uint32_t heard = 0U; ::read(said[0], &heard, sizeof(heard)) > 0;) last = heard;
    ::close(said[0]);

    const PhenotypeJournal journal(path_, Access::kWrite);
    std::int64_t position = 0;
    const auto reports = journal.readAfter(position);
    ASSERT_GE(reports.size(), last);
    for (std::size_t k = 0; k < reports.size(); ++k) {
      EXPECT_EQ(reports[k].source.revision, k + 1U);
      EXPECT_EQ(reports[k].plants.size(), 5U) << "half a report";
    }
    written_before = static_cast<std::uint32_t>(reports.size());
  }
}

TEST_F(Journal, KnowsWhereEveryPlantWasLast) {
  PhenotypeJournal journal(path_, Access::kWrite);
  EXPECT_EQ(journal.plants(), 0U);
  EXPECT_TRUE(journal.knownPlants().empty());
  journal.append(report(1U, 3));
  PlantReport moved = report(2U, 1);
  moved.source.stamp_ns += 7U;
  moved.plants[0].base.x() += 0.03;
  journal.append(moved);
  EXPECT_EQ(journal.plants(), 3U);
  const std::vector<KnownPlant> known = journal.knownPlants();
  ASSERT_EQ(known.size(), 3U);
  EXPECT_EQ(known[0].id, 0);
  EXPECT_EQ(known[0].base.x(), 448262.125 + 0.03);
  EXPECT_EQ(known[0].stamp_ns, moved.source.stamp_ns);
  EXPECT_TRUE(known[0].reported);
  EXPECT_EQ(known[2].id, 2) << "also where it was not found any more";
  EXPECT_EQ(known[2].base.y(), 5411932.5);
  EXPECT_EQ(known[2].stamp_ns, moved.source.stamp_ns - 7U);
  EXPECT_FALSE(known[2].reported);

  // Another block, and the same one in another pass, name it: both reports hold.
  PlantReport again = report(1U, 3);
  again.plants.erase(again.plants.begin(), again.plants.begin() + 2);
  again.source.block = {77, 7};
  journal.append(again);
  EXPECT_TRUE(journal.knownPlants()[2].reported);
  again.source.revision = 2U;
  again.plants.clear();
  journal.append(again);
  EXPECT_FALSE(journal.knownPlants()[2].reported);
  PlantReport later = report(1U, 3);
  later.source.began_ns += 1'000'000'000'000U;
  later.source.stamp_ns += 1'000'000'000'000U;
  journal.append(later);
  for (const KnownPlant& plant : journal.knownPlants()) EXPECT_TRUE(plant.reported) << plant.id;
}

TEST_F(Journal, AnIdThatWasTakenBackIsNotRestored) {
  // The block names a plant anew, and hears later that it is one of an earlier pass.
  PhenotypeJournal journal(path_, Access::kWrite);
  PlantReport first = report(1U, 1);
  journal.append(first);
  PlantReport second = report(1U, 2);
  second.source.began_ns += 1'000'000'000'000U;
  second.source.stamp_ns += 1'000'000'000'000U;
  second.plants.erase(second.plants.begin());
  second.plants[0].base = first.plants[0].base + Eigen::Vector3d(0.04, 0.0, 0.0);
  journal.append(second);
  ++second.source.revision;
  second.plants[0].id = first.plants[0].id;
  journal.append(second);

  PlantRegistry registry;
  registry.restore(journal.knownPlants());
  EXPECT_EQ(registry.size(), 1U);
  SegmentedBlock block;
  block.cloud.origin = second.plants[0].base;
  block.header.index = {static_cast<std::int32_t>(std::floor(block.cloud.origin.x() / 4.0)),
                        static_cast<std::int32_t>(std::floor(block.cloud.origin.y() / 4.0))};
  block.header.began_ns = block.header.stamp_ns = second.source.stamp_ns + 1U;
  block.plants.resize(1U);
  registry.identify(block);
  EXPECT_EQ(block.plants[0].id, first.plants[0].id);
}

TEST_F(Journal, WithoutAPathItIsATemporaryFile) {
  PhenotypeJournal journal("", Access::kWrite);
  journal.setFrameId("map");
  journal.append(report(1U, 2));
  std::int64_t position = 0;
  EXPECT_EQ(journal.readAfter(position).size(), 1U);
  PhenotypeJournal other("", Access::kWrite);
  EXPECT_EQ(other.plants(), 0U);
}

/// All that is said of plants, as text.
std::string textOf(const std::vector<Phenotype>& plants) {
  std::ostringstream text;
  for (const Phenotype& plant : plants) {
    text << plant.id << " " << plant.passes << " " << plant.revision << " " << plant.height.value
         << " " << plant.height.stddev << "\n";
  }
  return text.str();
}

TEST_F(Journal, WhatATableForgotItRecallsWhenItIsNeeded) {
  // Blocks side by side that are passed again and again: plants on their borders change sides,
  // vanish and come back.
  for (unsigned seed = 1U; seed <= 10U; ++seed) {
    PhenotypeJournal journal("", Access::kWrite);
    PlantTable whole;
    PlantTable recent;
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    constexpr std::int32_t kBlocks = 6;
    constexpr std::int32_t kPlantsPerBlock = 4;
    std::uint64_t time = 1'000'000'000U;
    for (int pass = 0; pass < 4; ++pass) {
      const std::uint64_t began = time;
      for (std::uint32_t k = 0U; k < 40U; ++k) {
        PlantReport report;
        const auto x = static_cast<std::int32_t>(unit(random) * kBlocks);
        report.source.block = {x, 0};
        report.source.began_ns = began;
        report.source.stamp_ns = time += 1'000'000U;
        report.source.revision = k;
        // Its own, and the first of the next block.
        for (std::int32_t id = kPlantsPerBlock * x; id <= kPlantsPerBlock * (x + 1); ++id) {
          const bool on_border = id % kPlantsPerBlock == 0;
          if (unit(random) < (on_border ? 0.5 : 0.2)) continue;
          Phenotype plant;
          plant.id = id;
          plant.revision = k;
          plant.height = {1.0 + unit(random), 0.01 + 0.01 * unit(random)};
          report.plants.push_back(plant);
        }
        recallInto(recent, journal, report.source.block, report.plants);
        const PlantTable::Change expected = whole.update(report.source, report.plants);
        const PlantTable::Change change = recent.update(report.source, report.plants);
        ASSERT_TRUE(change.accepted);
        EXPECT_EQ(change.added, expected.added);
        EXPECT_EQ(change.removed, expected.removed);
        EXPECT_EQ(textOf(recent.plantsOf(report.source.block)),
                  textOf(whole.plantsOf(report.source.block)))
            << "seed " << seed << ", pass " << pass << ", report " << k;
        journal.append(report);
        if (unit(random) < 0.5) recent.keepOnly({report.source.block});
      }
      time += 1'000'000'000U;
      recent.keepOnly({});
      EXPECT_EQ(recent.size(), 0U);
    }
  }
}

TEST_F(Journal, RefusesAnotherFrame) {
  PhenotypeJournal journal(path_, Access::kWrite);
  journal.setFrameId("map");
  journal.setFrameId("map");
  try {
    journal.setFrameId("odom");
    FAIL();
  } catch (const JournalError& error) {
    EXPECT_NE(std::string(error.what()).find("'odom'"), std::string::npos) << error.what();
  }
}

TEST_F(Journal, IsMovedAsideWhole) {
  EXPECT_EQ(moveJournalAside(path_), "");
  std::string first;
  {
    PhenotypeJournal journal(path_, Access::kWrite);
    journal.append(report(1U, 2));
    first = journal.identity();
    EXPECT_FALSE(first.empty());
    // As a killed process leaves it: with a log beside it.
    fs::copy(path_, path_ + "-copy");
    fs::copy(path_ + "-wal", path_ + "-copy-wal");
  }
  fs::rename(path_ + "-copy", path_);
  fs::rename(path_ + "-copy-wal", path_ + "-wal");
  const std::string other = moveJournalAside(path_);
  EXPECT_EQ(fs::path(other).filename(), "journal-1.sqlite");
  PhenotypeJournal fresh(path_, Access::kWrite);
  EXPECT_NE(fresh.identity(), first);
  std::int64_t position = 0;
  EXPECT_TRUE(fresh.readAfter(position).empty());
  EXPECT_EQ(PhenotypeJournal(other, Access::kRead).readAfter(position).size(), 1U);
}

TEST_F(Journal, HasOneWriterAndIsNotMovedFromUnderIt) {
  auto writer = std::make_unique<PhenotypeJournal>(path_, Access::kWrite);
  writer->append(report(1U, 2));
  const auto write = [&] { PhenotypeJournal(path_, Access::kWrite).append(report(2U, 1)); };
  EXPECT_THROW(write(), JournalInUse);
  EXPECT_THROW(moveJournalAside(path_), JournalInUse);
  writer->append(report(2U, 2));
  EXPECT_EQ(freeNameBeside(path_), folder_ / "deep" / "journal-1.sqlite");
  // One that is about to end is waited for.
  std::thread ends([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    writer.reset();
  });
  EXPECT_NO_THROW(write());
  ends.join();
}

TEST_F(Journal, SaysWhatIsWrong) {
  fs::create_directories(folder_);
  const std::string file = folder_ / "notes.txt";
  std::ofstream(file) << "this is no journal, but long enough to be taken for one at first sight";
  const std::string missing = folder_ / "missing.sqlite";
  const std::string below_a_file = file + "/journal.sqlite";
  for (const std::string& path : {file, below_a_file}) {
    try {
      PhenotypeJournal journal(path, Access::kWrite);
      FAIL() << path;
    } catch (const JournalError& error) {
      EXPECT_NE(std::string(error.what()).find(path), std::string::npos) << error.what();
    }
  }
  EXPECT_THROW(PhenotypeJournal(missing, Access::kRead), JournalError);
  EXPECT_FALSE(fs::exists(missing)) << "reading makes no file";
}

}  // namespace
}  // namespace field_phenotyping
