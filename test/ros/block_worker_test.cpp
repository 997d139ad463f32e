// A stage's worker thread: order, what a newer revision replaces, and what is dropped when more
// comes than can be worked.
#include "block_worker.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <chrono>
#include <condition_variable>
#include <future>
#include <memory>
#include <mutex>
#include <set>
#include <thread>
#include <vector>

namespace field_phenotyping {
namespace {

constexpr std::uint64_t kSecond = 1000000000U;
constexpr std::uint64_t kBegan = 1700000000U * kSecond;

/// A worker that takes one block each time that it is let.
class SlowWorker {
 public:
  explicit SlowWorker(const OverloadLimits& limits,
                      BlockWorker<Block>::Drafts drafts = BlockWorker<Block>::Drafts::kInTurn) {
    BlockWorker<Block>::Calls calls;
    calls.ready = [] { return true; };
    calls.work = [this](const BlockWorker<Block>::Task& task) { work(task.block->header); };
    calls.idle = [] {};
    worker_ = std::make_unique<BlockWorker<Block>>(16U, limits, std::move(calls), drafts);
    worker_->start();
    // The first one keeps it busy, so that all others wait.
    push(100, 0U, false);
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return busy_; });
  }
  ~SlowWorker() {
    finishAll();
    worker_.reset();
  }

  BlockWorker<Block>::Arrival push(int x, std::uint64_t second, bool final,
                                   std::size_t points = 10U, std::uint64_t began = 0U,
                                   bool draft = false, std::uint32_t revision = 0U) {
    const auto block = boost::make_shared<Block>();
    block->header.draft = draft;
    block->header.index = {x, 0};
    block->header.began_ns = kBegan + began * kSecond;
    block->header.stamp_ns = kBegan + second * kSecond;
    block->header.final = final;
    block->header.revision = revision;
    block->cloud.points.resize(points, Eigen::Vector3f::Zero());
    return worker_->push(block);
  }

  BlockWorker<Block>::Arrival pushJoined(const std::vector<int>& tiles, std::uint64_t second) {
    const auto block = boost::make_shared<Block>();
    for (const int x : tiles) {
      BlockHeader tile;
      tile.index = {x, 0};
      tile.began_ns = kBegan;
      tile.stamp_ns = kBegan + second * kSecond;
      tile.final = true;
      block->joined.push_back(tile);
    }
    block->header = block->joined.front();
    return worker_->push(block);
  }

  BlockWorker<Block>::Arrival pushDraft(int x, std::uint64_t second, std::uint64_t began = 0U) {
    return push(x, second, false, 10U, began, true);
  }

  /// A draft of a part of the tile.
  BlockWorker<Block>::Arrival pushPart(int x, std::uint64_t second) {
    const auto block = boost::make_shared<Block>();
    block->header.draft = true;
    block->header.index = {x, 0};
    block->header.began_ns = kBegan;
    block->header.stamp_ns = kBegan + second * kSecond;
    block->header.part = {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(1.0, 1.0)};
    return worker_->push(block);
  }

  BlockWorker<Block>::Arrival pushRevision(int x, std::uint32_t revision, bool draft,
                                           std::uint64_t began = 0U) {
    return push(x, began + revision, !draft, 10U, began, draft, revision);
  }

  /// Whether it begins to work on a block soon.
  bool hasBegun(int x) {
    std::unique_lock<std::mutex> lock(mutex_);
    return changed_.wait_for(lock, std::chrono::milliseconds(500), [&] {
      return std::find(worked_.begin(), worked_.end(), x) != worked_.end();
    });
  }

  /// Lets it finish what it works on, and waits until it has begun the next.
  void finishOne() {
    std::unique_lock<std::mutex> lock(mutex_);
    const std::size_t begun = worked_.size();
    ++finished_;
    changed_.notify_all();
    changed_.wait(lock, [&] { return worked_.size() > begun; });
  }

  /// Lets it finish what it works on of that block.
  void finish(int x) {
    const std::lock_guard<std::mutex> lock(mutex_);
    may_finish_.insert(x);
    changed_.notify_all();
  }

  /// Lets it work all that waits. @return the blocks' x in the order of work, without the first
  std::vector<int> finishAll() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      open_ = true;
    }
    changed_.notify_all();
    EXPECT_TRUE(worker_->drain(std::chrono::seconds(10)));
    const std::lock_guard<std::mutex> lock(mutex_);
    return {worked_.begin() + 1, worked_.end()};
  }

  bool drain(std::chrono::milliseconds limit) { return worker_->drain(limit); }
  bool overloaded() const { return worker_->overloaded(); }
  std::size_t waiting() const { return worker_->waiting(); }

 private:
  void work(const BlockHeader& header) {
    std::unique_lock<std::mutex> lock(mutex_);
    worked_.push_back(header.index.x);
    const std::size_t number = worked_.size();
    busy_ = true;
    changed_.notify_all();
    changed_.wait(lock, [&] {
      return open_ || finished_ >= number || may_finish_.count(header.index.x) > 0U;
    });
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  bool busy_ = false;
  bool open_ = false;
  std::size_t finished_ = 0U;  // blocks that it may finish
  std::set<int> may_finish_;   // of these tiles
  std::vector<int> worked_;
  std::unique_ptr<BlockWorker<Block>> worker_;
};

const OverloadLimits kNever{ros::WallDuration(1000.0), 0U};
const OverloadLimits kAtOnce{ros::WallDuration(0.0), 1000U};

TEST(BlockWorker, WorksBlocksAsTheyComeWhileItKeepsUp) {
  SlowWorker worker(kNever);
  for (int x = 0; x < 5; ++x) {
    EXPECT_EQ(worker.push(x, static_cast<std::uint64_t>(x % 3), x % 2 == 0).dropped, 0U);
  }
  EXPECT_TRUE(worker.push(2, 9U, true).replaced);
  EXPECT_FALSE(worker.overloaded());
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{0, 1, 2, 3, 4}));
}

TEST(BlockWorker, WhatGivesFirstValuesGoesFirst) {
  SlowWorker worker(kNever);
  worker.push(101, 1U, false);
  worker.finishOne();  // now 101 is at work
  worker.push(101, 2U, false);
  worker.push(100, 3U, true);
  EXPECT_TRUE(worker.push(101, 4U, false).replaced);
  worker.push(0, 5U, false);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{101, 0, 100, 101})) << "an update comes last";

  SlowWorker other(kNever);
  other.push(101, 1U, false);
  other.finishOne();
  other.push(100, 2U, true);
  other.pushDraft(101, 3U);
  EXPECT_EQ(other.finishAll(), (std::vector<int>{101, 101, 100})) << "a draft comes first";
}

TEST(BlockWorker, ADraftIsReplacedByNewerDraftsAndFinalBlocksOnly) {
  SlowWorker worker(kNever);
  worker.pushDraft(100, 1U);
  EXPECT_TRUE(worker.pushDraft(100, 2U).replaced);
  EXPECT_FALSE(worker.push(100, 3U, false).replaced);
  EXPECT_EQ(worker.waiting(), 2U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{100, 100}));

  SlowWorker other(kNever);
  other.pushDraft(100, 1U);
  EXPECT_TRUE(other.push(100, 2U, true).replaced);
  EXPECT_EQ(other.finishAll(), (std::vector<int>{100}));
}

TEST(BlockWorker, ADraftOfAPartDoesNotTakeThePlaceOfADraftOfTheTile) {
  SlowWorker worker(kNever);
  worker.pushDraft(2, 2U);
  EXPECT_FALSE(worker.pushPart(2, 3U).replaced);
  EXPECT_TRUE(worker.pushDraft(2, 4U).replaced) << "but a whole one takes the place of both";
  worker.pushPart(2, 5U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{2, 2}));
}

TEST(BlockWorker, ADraftThatIsLaterThanANewerRevisionIsNotWorked) {
  SlowWorker worker(kNever, BlockWorker<Block>::Drafts::kBeside);
  worker.pushRevision(1, 2U, false);
  const auto late = worker.pushRevision(1, 1U, true);
  EXPECT_TRUE(late.replaced) << "a newer one waits";
  EXPECT_EQ(late.dropped, 0U);
  EXPECT_EQ(worker.waiting(), 1U);
  EXPECT_FALSE(worker.pushRevision(1, 1U, true, 1000U).replaced) << "another pass";
  worker.pushRevision(2, 1U, true);
  EXPECT_TRUE(worker.hasBegun(2));
  EXPECT_TRUE(worker.pushRevision(2, 0U, true).replaced) << "a newer one is at work";
  std::vector<int> worked = worker.finishAll();
  std::sort(worked.begin(), worked.end());
  EXPECT_EQ(worked, (std::vector<int>{1, 1, 2}));
}

TEST(BlockWorker, JoinedTilesReplaceWhatWaitsOfEachOfThem) {
  SlowWorker worker(kNever);
  worker.pushDraft(1, 1U);
  worker.push(2, 2U, false);
  worker.push(3, 3U, false);
  worker.push(2, 4U, false, 10U, 3U);  // of another pass
  EXPECT_TRUE(worker.pushJoined({1, 2}, 5U).replaced);
  EXPECT_EQ(worker.waiting(), 3U);
  EXPECT_TRUE(worker.pushJoined({1, 2, 4}, 6U).replaced);
  EXPECT_EQ(worker.waiting(), 3U);
  EXPECT_FALSE(worker.pushDraft(2, 7U).replaced) << "the others of them are still to be worked";
  EXPECT_TRUE(worker.push(2, 8U, true).replaced) << "the draft";
  EXPECT_EQ(worker.waiting(), 4U);
}

TEST(BlockWorker, JoinedTilesGiveFirstValuesIfOneOfThemDoes) {
  SlowWorker worker(kNever);
  worker.push(1, 1U, false);
  worker.finishOne();  // now 1 is at work, and known
  worker.push(100, 2U, true);
  worker.pushJoined({1, 2}, 3U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{1, 1, 100}));
}

TEST(BlockWorker, ADraftNeedNotWaitForTheBlockAtWork) {
  SlowWorker worker(kNever, BlockWorker<Block>::Drafts::kBeside);
  worker.push(1, 1U, false);
  worker.pushDraft(0, 2U);
  EXPECT_TRUE(worker.hasBegun(0)) << "while 100 is still at work";
  EXPECT_FALSE(worker.hasBegun(1));
  worker.pushDraft(2, 30U, 20U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{0, 1, 2})) << "of the next pass: it has to wait";
}

TEST(BlockWorker, WhereDraftsHaveAThreadTheOtherTakesFinalBlocksFirst) {
  SlowWorker worker(kNever, BlockWorker<Block>::Drafts::kBeside);
  worker.push(2, 2U, false);
  worker.push(50, 4U, true);
  worker.finishOne();
  EXPECT_TRUE(worker.hasBegun(50));
  EXPECT_FALSE(worker.hasBegun(2));
}

// Side by side both would be done when the second one is.
TEST(BlockWorker, DraftsAreWorkedOneAfterAnother) {
  SlowWorker worker(kNever, BlockWorker<Block>::Drafts::kBeside);
  worker.pushDraft(0, 1U);
  EXPECT_TRUE(worker.hasBegun(0));
  worker.pushDraft(1, 3U);
  worker.finish(100);
  EXPECT_FALSE(worker.hasBegun(1)) << "while 0 is at work, though the other thread is idle";
  worker.finish(0);
  EXPECT_TRUE(worker.hasBegun(1));
}

TEST(BlockWorker, NorForAnEarlierPassElsewhere) {
  SlowWorker worker(kNever, BlockWorker<Block>::Drafts::kBeside);
  worker.push(1, 1U, false);
  worker.pushDraft(99, 30U, 20U);
  EXPECT_FALSE(worker.hasBegun(99)) << "100 is at work";
  worker.pushDraft(50, 30U, 20U);
  EXPECT_TRUE(worker.hasBegun(50));
  worker.finishAll();
}

TEST(BlockWorker, AnEarlierPassIsFinishedFirst) {
  for (const OverloadLimits& limits : {kNever, kAtOnce}) {
    SlowWorker worker(limits);
    worker.push(101, 30U, false, 10U, 20U);  // of the next pass
    worker.push(100, 19U, true, 12U);
    worker.push(50, 25U, false, 10U, 20U);
    EXPECT_EQ(worker.finishAll(), (std::vector<int>{50, 100, 101}))
        << "what is elsewhere need not wait";
  }
}

TEST(BlockWorker, UnderOverloadWhatIsNewGoesFirst) {
  SlowWorker worker(kAtOnce);
  worker.push(100, 5U, false);  // an update: something of it has been worked
  worker.push(0, 1U, false);
  worker.push(1, 3U, true);
  worker.push(2, 2U, false);
  EXPECT_TRUE(worker.overloaded());
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{1, 2, 0, 100}));
  EXPECT_FALSE(worker.overloaded());
}

TEST(BlockWorker, UnderOverloadBlocksThatNothingIsKnownOfGoFirst) {
  SlowWorker worker(kAtOnce);
  worker.push(100, 2U, true);
  worker.push(0, 1U, false);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{0, 100}));
}

TEST(BlockWorker, UnderOverloadLastValuesComeInTheOrderInWhichBlocksWereLeft) {
  SlowWorker worker(kAtOnce);
  for (int x = 1; x <= 3; ++x) {
    worker.push(x, 1U, false);
    worker.finishOne();
  }
  for (int x = 1; x <= 3; ++x) worker.push(x, 1U + static_cast<std::uint64_t>(x), true);
  EXPECT_TRUE(worker.overloaded());
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{1, 2, 3, 1, 2, 3}));
}

TEST(BlockWorker, AFinalBlockDoesNotTakeThePlaceOfAnUpdateThatItReplaces) {
  SlowWorker worker(kNever);
  for (int x = 1; x <= 2; ++x) {
    worker.push(x, 1U, false);
    worker.finishOne();
  }
  worker.push(2, 2U, false);
  worker.push(1, 3U, true);
  EXPECT_TRUE(worker.push(2, 4U, true).replaced);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{1, 2, 1, 2}));
}

TEST(BlockWorker, UpdatesLeaveTimeForOtherBlocks) {
  constexpr std::chrono::milliseconds kTakes(200);
  SlowWorker worker(kNever);
  worker.push(101, 1U, false);
  worker.finishOne();
  worker.push(100, 2U, false);
  worker.push(101, 3U, false);
  worker.finishOne();  // now the update of 100 is at work
  std::this_thread::sleep_for(kTakes);
  const auto begin = std::chrono::steady_clock::now();
  worker.finishOne();  // until that of 101 is
  EXPECT_GE(std::chrono::steady_clock::now() - begin, 2 * kTakes);
}

TEST(BlockWorker, UpdatesThatWaitAreNoOverload) {
  SlowWorker worker(kAtOnce);
  worker.push(100, 2U, false);
  EXPECT_FALSE(worker.overloaded());
  worker.push(0, 3U, false);
  EXPECT_TRUE(worker.overloaded()) << "nothing is known of it";
}

TEST(BlockWorker, DropsTheOldestBeyondItsLimitAndKeepsWithinIt) {
  SlowWorker worker(kAtOnce);
  std::size_t dropped = 0U;
  for (int x = 0; x < 50; ++x) {
    dropped += worker.push(x, static_cast<std::uint64_t>(x), true, 300U).dropped;
    EXPECT_LE(worker.waiting(), 3U);
  }
  EXPECT_EQ(dropped, 47U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{47, 48, 49}));
}

TEST(BlockWorker, UpdatesAreDroppedBeforeBlocksThatNothingIsKnownOf) {
  SlowWorker worker(kAtOnce);
  worker.push(0, 1U, false, 600U);
  EXPECT_EQ(worker.push(100, 7U, false, 600U).dropped, 1U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{0}));
}

TEST(BlockWorker, OneBlockIsWorkedHoweverLargeItIs) {
  SlowWorker worker(kAtOnce);
  EXPECT_EQ(worker.push(0, 1U, true, 100000U).dropped, 0U);
  EXPECT_EQ(worker.finishAll(), (std::vector<int>{0}));
}

TEST(BlockWorker, DrainingTakesAsLongAsThereIsProgress) {
  constexpr std::chrono::milliseconds kLimit(400);
  SlowWorker worker(kNever);
  for (int x = 0; x < 8; ++x) worker.push(x, 0U, true);
  auto drained = std::async(std::launch::async, [&] { return worker.drain(kLimit); });
  for (int x = 0; x < 8; ++x) {  // twice the limit in all
    std::this_thread::sleep_for(kLimit / 4);
    worker.finishOne();
  }
  EXPECT_NE(drained.wait_for(std::chrono::seconds(0)), std::future_status::ready);
  // The last one takes longer than that.
  EXPECT_FALSE(drained.get());
}

}  // namespace
}  // namespace field_phenotyping
