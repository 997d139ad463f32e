#pragma once

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "field_phenotyping/measurement/phenotype.hpp"
#include "plant_table.hpp"

struct sqlite3;

namespace field_phenotyping {

/// A journal that cannot be read or written; what() names the file, the cause and the cure.
class JournalError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// What one revision of a block said about its plants.
struct JournalReport {
  ReportSource source;
  std::vector<Phenotype> plants;
};

/// Everything that was ever reported about the plants of one map, as an SQLite file that only
/// grows. What append() has taken survives the death of this process and of the machine. While it
/// is written, other processes may read it, with these functions or with `sqlite3`:
///
///     select plant_id, height, stem_diameter from plant order by report;
///
/// Not thread-safe: one object a thread.
class PhenotypeJournal {
 public:
  enum class Access { kRead, kWrite };

  /// Opens the journal; to write, it and its folder are made if need be.
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
  void append(const JournalReport& report);

  /// Another one for each journal ever made: tells whether the file was replaced.
  std::string identity() const;

  /// The reports after `position`, which is moved on: 0 for all. @throws JournalError
  std::vector<JournalReport> readAfter(std::int64_t& position) const;

 private:
  class Statement;

  std::string setting(const std::string& name) const;
  void set(const std::string& name, const std::string& value);
  void execute(const char* sql);
  [[noreturn]] void fail(const std::string& doing) const;

  std::string path_;
  std::unique_ptr<sqlite3, int (*)(sqlite3*)> database_;
};

/// Adds the reports after `position`, which is moved on, to `table`. @return how many there were.
/// @throws JournalError
std::size_t readInto(PlantTable& table, const PhenotypeJournal& journal, std::int64_t& position);

/// Gives the journal at `path` another name beside it, so that a new one begins; nothing where
/// there is none. @return the other name, or empty. @throws JournalError
std::string moveJournalAside(const std::string& path);

}  // namespace field_phenotyping
