#include "durable_table.hpp"

#include <filesystem>
#include <map>
#include <mutex>
#include <set>
#include <utility>

namespace field_phenotyping {
namespace {

// About an hour of driving. Beyond it the oldest are given up.
constexpr std::size_t kMostWaiting = 5000U;

const ros::WallDuration kRetryInterval(1.0);

// Of the last reports: about a megabyte, and more than are open at a time.
constexpr std::uint64_t kBlocksInMemory = 32U;

std::string journalOf(const ros::NodeHandle& pnh) {
  return pnh.param<std::string>("journal", "");
}

/// Obeyed once: a nodelet that starts again goes on.
bool beginsAnew(const ros::NodeHandle& pnh) {
  if (!pnh.param("new_journal", false)) return false;
  pnh.setParam("new_journal", false);
  return true;
}

}  // namespace

DurableTable::DurableTable(const ros::NodeHandle& pnh, StageHealth& health)
    : path_(journalOf(pnh)), health_(health) {
  try {
    open(!path_.empty() && beginsAnew(pnh));
  } catch (const JournalError& error) {
    health_.trouble("journal", error.what());
  }
}

void DurableTable::open(bool anew) {
  using Access = PhenotypeJournal::Access;
  std::unique_ptr<PhenotypeJournal> journal;
  try {
    if (anew) {
      const std::string other = moveJournalAside(path_);
      if (!other.empty()) ROS_INFO_STREAM("the journal of an earlier run is now " << other);
    }
    journal = std::make_unique<PhenotypeJournal>(path_, Access::kWrite);
  } catch (const JournalInUse& error) {
    path_ = freeNameBeside(path_);
    in_use_ = std::string(error.what()) + ": what is measured here goes to " + path_ +
              ", so that neither is lost. Give each manager an output folder of its own";
    tellInUse();
    journal = std::make_unique<PhenotypeJournal>(path_, Access::kWrite);
  }
  const std::size_t plants = journal->plants();
  if (begun_ && plants > 0U) {
    throw JournalError(
        "the journal " + path_ +
        " could not be read at the start and turns out to hold plants, whose ids may "
        "have been given again meanwhile: nothing is written to it. Start again");
  }
  journal_ = std::move(journal);
  size_ += plants;
  if (plants > 0U) ROS_INFO_STREAM("going on with the " << plants << " plants of " << path_);
}

PlantTable::Change DurableTable::update(const BlockHeader& header,
                                        const std::vector<Phenotype>& plants) {
  const ReportSource source(header);
  recall(source.block, plants);
  std::vector<Phenotype> all = table_.withUntouched(header, plants);
  PlantTable::Change change = table_.update(source, all);
  if (!change.accepted) return change;
  size_ += change.added.size();
  size_ -= change.removed.size();
  begun_ = true;
  waiting_.push_back({source, std::move(all)});
  frame_id_ = header.frame_id;
  write();
  tellInUse();
  used_[source.block] = ++reports_;
  forgetOldest();
  return change;
}

void DurableTable::tellInUse() {
  if (!in_use_.empty()) health_.trouble("journal in use", in_use_);
}

/// What was forgotten of a block and its plants, or is of an earlier run.
void DurableTable::recall(const BlockIndex& block, const std::vector<Phenotype>& plants) {
  if (!journal_) return;
  try {
    recallInto(table_, *journal_, block, plants);
  } catch (const JournalError& error) {
    health_.trouble("journal", std::string(error.what()) + ". Earlier passes do not count");
  }
}

/// Nothing is forgotten that is not in the journal.
void DurableTable::forgetOldest() {
  if (used_.size() < 2U * kBlocksInMemory || !waiting_.empty()) return;
  std::set<BlockIndex> kept;
  for (auto block = used_.begin(); block != used_.end();) {
    if (block->second + kBlocksInMemory > reports_) {
      kept.insert(block->first);
      ++block;
    } else {
      block = used_.erase(block);
    }
  }
  table_.keepOnly(kept);
}

std::vector<Phenotype> DurableTable::allPlants() const {
  if (!journal_) return table_.plants();
  try {
    PlantTable all;
    std::int64_t position = 0;
    readInto(all, *journal_, position);
    for (const PlantReport& report : waiting_) all.update(report.source, report.plants);
    return all.plants();
  } catch (const JournalError& error) {
    health_.trouble("journal", error.what());
    return table_.plants();
  }
}

void DurableTable::retry() {
  if (ros::SteadyTime::now() - tried_ > kRetryInterval) write();
}

/// The file is open still, though nobody can find it any more.
void DurableTable::writeAnewIfRemoved() {
  if (!journal_ || !journal_->isGone()) return;
  const std::string removed = path_;
  if (std::filesystem::exists(path_)) path_ = freeNameBeside(path_);  // somebody else's
  journal_->copyTo(path_);
  journal_ = std::make_unique<PhenotypeJournal>(path_, PhenotypeJournal::Access::kWrite);
  health_.count("journals removed by others");
  health_.trouble("journal removed", "the journal " + removed +
                                         " was removed or replaced while it was written: all that "
                                         "it held is in " +
                                         path_ +
                                         " now, nothing is lost. Leave the output folder where it "
                                         "is until the nodelets have ended");
}

void DurableTable::write() {
  tried_ = ros::SteadyTime::now();
  try {
    writeAnewIfRemoved();
    if (!journal_ && !waiting_.empty()) open(false);
    if (!waiting_.empty()) journal_->setFrameId(frame_id_);
    while (!waiting_.empty()) {
      journal_->append(waiting_.front());
      waiting_.pop_front();
      health_.count("reports in the journal");
    }
  } catch (const JournalError& error) {
    health_.trouble("journal", std::string(error.what()) +
                                   ". Measuring goes on; what is measured waits in memory");
  }
  if (waiting_.size() > kMostWaiting) {
    waiting_.pop_front();
    health_.count("reports lost to the journal");
  }
  health_.show("reports waiting for the journal", static_cast<double>(waiting_.size()));
}

std::shared_ptr<PlantRegistry> registryFor(const ros::NodeHandle& pnh, StageHealth& health) {
  using Key = std::pair<std::string, std::string>;
  static std::mutex mutex;
  static std::map<Key, std::shared_ptr<PlantRegistry>> registries;  // of this process
  const std::string path = journalOf(pnh);
  const bool anew = beginsAnew(pnh);
  const std::lock_guard<std::mutex> lock(mutex);
  std::shared_ptr<PlantRegistry>& registry = registries[{pnh.getNamespace(), path}];
  if (registry && !anew) return registry;
  registry = std::make_shared<PlantRegistry>();
  if (path.empty() || anew || !std::filesystem::exists(path)) return registry;
  try {
    registry->restore(PhenotypeJournal(path, PhenotypeJournal::Access::kRead).knownPlants());
  } catch (const JournalError& error) {
    health.trouble("journal", std::string(error.what()) + ". Plants of earlier runs get new ids");
  }
  return registry;
}

}  // namespace field_phenotyping
