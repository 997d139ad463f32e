#include "completion_stage.hpp"

#include <boost/make_shared.hpp>
#include <cstdint>
#include <iterator>

#include "field_phenotyping/completion/completion.hpp"

namespace field_phenotyping {
namespace {

// An open block that was not heard of for so long is open no more: its last revision was dropped.
constexpr std::uint64_t kLongestOpen = 120'000'000'000U;  // [ns]

}  // namespace

CompletionStage::CompletionStage(const ros::NodeHandle& nh, const ros::NodeHandle& pnh,
                                 const std::string& name)
    : stage_(nh, pnh, name),
      done_(historyOf(pnh)),
      completed_(stage_.privateHandle(), "completed", addSynthetic) {
  using Outputs = std::vector<Stage::OutputPtr>;
  stage_.start([this](const auto& block, const auto& p) { return Outputs{work(block, p)}; },
               [this] { completed_.update(done_); }, Stage::Drafts::kBeside);
}

CompletionStage::~CompletionStage() {
  stage_.stop();
}

boost::shared_ptr<const CompletedBlock> CompletionStage::work(
    const boost::shared_ptr<const SegmentedBlock>& block, const CompletionParameters& parameters) {
  if (block->header.draft) {
    // No trait is measured from filled-in points, so first values need not wait for them.
    CompletionParameters as_measured = parameters;
    as_measured.enabled = false;
    return boost::make_shared<CompletedBlock>(completeBlock(toStd(block), as_measured));
  }
  const BlockIndex index = block->header.index;
  const boost::shared_ptr<const CompletedBlock> previous = latestOf(index);
  const auto completed = boost::make_shared<CompletedBlock>(
      completeBlock(toStd(block), parameters, previous.get(), stage_.device()));
  showDeviceUse(stage_.device(), stage_.health());
  keepLatest(index, completed);
  stage_.health().show("plants in the last block", static_cast<double>(block->plants.size()));
  stage_.health().show("synthetic points in the last block",
                       static_cast<double>(completed->synthetic.size()));
  done_.add(completed);
  completed_.changed();
  return completed;
}

boost::shared_ptr<const CompletedBlock> CompletionStage::latestOf(const BlockIndex& index) {
  const std::lock_guard<std::mutex> lock(latest_mutex_);
  const auto latest = latest_.find(index);
  return latest == latest_.end() ? nullptr : latest->second;
}

void CompletionStage::keepLatest(const BlockIndex& index,
                                 const boost::shared_ptr<const CompletedBlock>& block) {
  const std::lock_guard<std::mutex> lock(latest_mutex_);
  if (block->segmented->header.final) {
    latest_.erase(index);  // no newer revision will come
  } else {
    latest_[index] = block;
  }
  const std::uint64_t now = block->segmented->header.stamp_ns;
  for (auto entry = latest_.begin(); entry != latest_.end();) {
    const std::uint64_t then = entry->second->segmented->header.stamp_ns;
    const std::uint64_t apart = now > then ? now - then : then - now;
    entry = apart > kLongestOpen ? latest_.erase(entry) : std::next(entry);
  }
}

}  // namespace field_phenotyping
