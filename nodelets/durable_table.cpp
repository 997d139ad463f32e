#include "durable_table.hpp"

#include <filesystem>
#include <utility>

namespace field_phenotyping {
namespace {

// About an hour of driving. Beyond it the oldest are given up.
constexpr std::size_t kMostWaiting = 5000U;

const ros::WallDuration kRetryInterval(1.0);

std::string journalOf(const ros::NodeHandle& pnh) {
  return pnh.param<std::string>("journal", "");
}

bool beginsAnew(const ros::NodeHandle& pnh) {
  return pnh.param("new_journal", false);
}

}  // namespace

DurableTable::DurableTable(const ros::NodeHandle& pnh, StageHealth& health)
    : path_(journalOf(pnh)), health_(health) {
  if (path_.empty()) return;
  try {
    if (beginsAnew(pnh)) {
      const std::string other = moveJournalAside(path_);
      if (!other.empty()) ROS_INFO_STREAM("the journal of an earlier run is now " << other);
    }
    open();
  } catch (const JournalError& error) {
    health_.trouble("journal", error.what());
  }
}

void DurableTable::open() {
  auto journal = std::make_unique<PhenotypeJournal>(path_, PhenotypeJournal::Access::kWrite);
  std::int64_t position = 0;
  PlantTable earlier;
  const bool fresh = readInto(earlier, *journal, position) == 0U;
  if (begun_ && !fresh) {
    throw JournalError(
        "the journal " + path_ +
        " could not be read at the start and turns out to hold plants, whose ids may "
        "have been given again meanwhile: nothing is written to it. Start again");
  }
  journal_ = std::move(journal);
  if (fresh) return;
  table_ = std::move(earlier);
  ROS_INFO_STREAM("going on with the " << table_.size() << " plants of " << path_);
}

PlantTable::Change DurableTable::update(const BlockHeader& header,
                                        const std::vector<Phenotype>& plants) {
  const ReportSource source(header);
  PlantTable::Change change = table_.update(source, plants);
  if (path_.empty() || !change.accepted) return change;
  begun_ = true;
  waiting_.push_back({source, plants});
  frame_id_ = header.frame_id;
  write();
  return change;
}

void DurableTable::retry() {
  if (!waiting_.empty() && ros::WallTime::now() - tried_ > kRetryInterval) write();
}

void DurableTable::write() {
  tried_ = ros::WallTime::now();
  try {
    if (!journal_) open();
    journal_->setFrameId(frame_id_);
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

void restorePlants(const ros::NodeHandle& pnh, StageHealth& health, PlantRegistry& registry) {
  const std::string path = journalOf(pnh);
  if (path.empty() || beginsAnew(pnh) || !std::filesystem::exists(path)) return;
  try {
    const PhenotypeJournal journal(path, PhenotypeJournal::Access::kRead);
    PlantTable table;
    std::int64_t position = 0;
    readInto(table, journal, position);
    registry.restore(table.known());
  } catch (const JournalError& error) {
    health.trouble("journal", std::string(error.what()) + ". Plants of earlier runs get new ids");
  }
}

}  // namespace field_phenotyping
