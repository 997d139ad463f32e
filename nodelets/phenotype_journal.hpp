#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/segmentation/plant_registry.hpp"
#include "plant_table.hpp"

struct sqlite3;

namespace field_phenotyping {

class WriterLock;

/// A journal that cannot be read or written; what() names the file, the cause and the cure.
class JournalError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A journal that another process, or another object of this one, writes.
class JournalInUse : public JournalError {
 public:
  using JournalError::JournalError;
};

/// Everything that was ever reported about the plants of one map, as an SQLite file that only
/// grows. It has one writer at a time, for ids are given by it alone: the lock on the file beside
/// it, `-lock`, says whether there is one, and goes with its process. What append() has taken
/// survives the death of this process and of the machine. While it is written, other processes may
/// read it, with these functions or with `sqlite3`:
///
///     select plant_id, height, stem_diameter from plant order by report;
///
/// Not thread-safe: one object a thread.
class PhenotypeJournal {
 public:
  enum class Access { kRead, kWrite };

  /// Opens the journal; to write, it and its folder are made if need be. To write, the path may be
  /// empty: a temporary file that goes with this object.
  /// @throws JournalInUse where another writes it and does not end within some seconds
  /// @throws JournalError also where it was written by a version with other traits
  PhenotypeJournal(const std::string& path, Access access);
  ~PhenotypeJournal();
  PhenotypeJournal(const PhenotypeJournal&) = delete;
  PhenotypeJournal& operator=(const PhenotypeJournal&) = delete;

  /// The frame of all positions; empty until somebody has set it.
  std::string frameId() const;
  /// @throws JournalError where it holds positions of another frame, or cannot be written
  void setFrameId(const std::string& frame_id);

  /// Durable when it returns. @throws JournalError
  void append(const PlantReport& report);

  /// Whether what is at its path is not its file any more, for somebody has removed that: what it
  /// takes is lost with it, but for copyTo().
  bool isGone() const;
  /// Writes all of it, the identity too, to a new file, and the folder of that if need be.
  /// @throws JournalError
  void copyTo(const std::string& path) const;

  /// Another one for each journal ever made: tells whether the file was replaced.
  std::string identity() const;

  /// The reports after `position`, which is moved on: 0 for all. @throws JournalError
  std::vector<PlantReport> readAfter(std::int64_t& position) const;
  /// The plants that the block ever named. @throws JournalError
  std::set<std::int32_t> plantsOf(const BlockIndex& block) const;
  /// For PlantTable::recall(). @throws JournalError
  std::vector<PlantReport> readAbout(const BlockIndex& block,
                                     const std::set<std::int32_t>& plants) const;

  /// Every plant that was ever reported, where it was last: for PlantRegistry::restore().
  /// @throws JournalError
  std::vector<KnownPlant> knownPlants() const;
  /// How many those are. @throws JournalError
  std::size_t plants() const;

 private:
  class Statement;

  static PlantReport reportOf(const Statement& row, int first_column);
  std::string setting(const std::string& name) const;
  void set(const std::string& name, const std::string& value);
  void execute(const char* sql);
  [[noreturn]] void fail(const std::string& doing) const;

  /// Which file is at its path: device and number; nothing where there is none.
  std::optional<std::pair<std::uint64_t, std::uint64_t>> fileAtPath() const;

  std::string path_;
  std::optional<std::pair<std::uint64_t, std::uint64_t>> file_;  // that was opened
  std::unique_ptr<WriterLock> lock_;  // before what it guards, so that it goes last
  std::unique_ptr<sqlite3, int (*)(sqlite3*)> database_;
};

/// Adds the reports after `position`, which is moved on, to `table`. @return how many there were.
/// @throws JournalError
std::size_t readInto(PlantTable& table, const PhenotypeJournal& journal, std::int64_t& position);

/// Makes `table` know all that the journal says of a block and of plants. @throws JournalError
void recallInto(PlantTable& table, const PhenotypeJournal& journal, const BlockIndex& block,
                const std::vector<Phenotype>& plants);

/// Gives the journal at `path` another name beside it, so that a new one begins; nothing where
/// there is none. @return the other name, or empty. @throws JournalInUse where it is written
/// @throws JournalError
std::string moveJournalAside(const std::string& path);

/// The first of `journal-1.sqlite`, `journal-2.sqlite`, ... beside `journal.sqlite` that nothing is
/// at.
std::string freeNameBeside(const std::string& path);

}  // namespace field_phenotyping
