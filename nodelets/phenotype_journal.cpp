#include "phenotype_journal.hpp"

#include <fcntl.h>
#include <field_phenotyping/PlantPhenotype.h>
#include <ros/serialization.h>
#include <sqlite3.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <map>
#include <set>
#include <system_error>
#include <thread>
#include <utility>

#include "conversions.hpp"

namespace field_phenotyping {
namespace {

constexpr int kBusyTimeout = 5000;  // [ms] that another process may hold the file

// What a plant is, whole, is in `message`, as PlantPhenotype goes over the wire. The other columns
// are for people who look into the file.
constexpr const char* kSchema = R"(
CREATE TABLE IF NOT EXISTS setting (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS report (
  number INTEGER PRIMARY KEY AUTOINCREMENT,
  block_x INTEGER NOT NULL, block_y INTEGER NOT NULL,
  began_ns INTEGER NOT NULL, stamp_ns INTEGER NOT NULL, revision INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS plant (
  report INTEGER NOT NULL REFERENCES report (number),
  plant_id INTEGER NOT NULL,
  x REAL, y REAL, z REAL, height REAL, height_stddev REAL,
  stem_diameter REAL, stem_diameter_stddev REAL, flags INTEGER NOT NULL,
  message BLOB NOT NULL);
CREATE INDEX IF NOT EXISTS plant_of_report ON plant (report);
CREATE INDEX IF NOT EXISTS report_of_plant ON plant (plant_id);
CREATE INDEX IF NOT EXISTS report_of_block ON report (block_x, block_y);
)";

std::vector<std::uint8_t> bytesOf(const Phenotype& plant) {
  const PlantPhenotype message = toMessage(plant);
  std::vector<std::uint8_t> bytes(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ros::serialization::serialize(stream, message);
  return bytes;
}

Phenotype plantOf(const void* bytes, int size) {
  std::vector<std::uint8_t> copy(static_cast<std::size_t>(size));
  std::memcpy(copy.data(), bytes, copy.size());
  ros::serialization::IStream stream(copy.data(), static_cast<std::uint32_t>(copy.size()));
  PlantPhenotype message;
  ros::serialization::deserialize(stream, message);
  return fromMessage(message);
}

const char* messageVersion() {
  return ros::message_traits::MD5Sum<PlantPhenotype>::value();
}

void makeFolderOf(const std::string& path) {
  std::error_code error;
  const auto folder = std::filesystem::path(path).parent_path();
  if (!folder.empty()) std::filesystem::create_directories(folder, error);
  if (!error) return;
  throw JournalError("cannot make the folder of the journal " + path + ": " + error.message());
}

}  // namespace

/// Held by who writes a journal. A file of its own, for closing the journal's would take SQLite's
/// locks with it, and one that is moved aside stays locked.
class WriterLock {
 public:
  /// Waits for a writer that is about to end. @throws JournalInUse, JournalError
  explicit WriterLock(const std::string& journal) {
    const std::string path = journal + "-lock";
    file_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (file_ < 0) throwError(journal, path);
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(kBusyTimeout);
    while (::flock(file_, LOCK_EX | LOCK_NB) != 0) {
      if (errno != EWOULDBLOCK) throwError(journal, path);
      if (std::chrono::steady_clock::now() > end) {
        ::close(file_);
        throw JournalInUse("the journal " + journal + " is written by another nodelet manager");
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
  }
  ~WriterLock() { ::close(file_); }
  WriterLock(const WriterLock&) = delete;
  WriterLock& operator=(const WriterLock&) = delete;

 private:
  [[noreturn]] void throwError(const std::string& journal, const std::string& path) const {
    const std::string reason = std::strerror(errno);
    if (file_ >= 0) ::close(file_);
    throw JournalError("cannot lock " + path + " to write the journal " + journal + ": " + reason +
                       ". May the folder be written, is the disk full?");
  }

  int file_ = -1;
};

/// A prepared statement; parameters and columns count from 1 and from 0, as in SQLite.
class PhenotypeJournal::Statement {
 public:
  Statement(const PhenotypeJournal& journal, const char* sql) : journal_(journal) {
    if (sqlite3_prepare_v2(journal.database_.get(), sql, -1, &statement_, nullptr) != SQLITE_OK) {
      journal.fail("read");
    }
  }
  ~Statement() { sqlite3_finalize(statement_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  void bind(int k, std::int64_t value) { sqlite3_bind_int64(statement_, k, value); }
  void bind(int k, double value) {
    if (std::isfinite(value)) {
      sqlite3_bind_double(statement_, k, value);
    } else {
      sqlite3_bind_null(statement_, k);
    }
  }
  void bind(int k, const std::string& value) {
    sqlite3_bind_text(statement_, k, value.c_str(), -1, SQLITE_TRANSIENT);
  }
  void bind(int k, const std::vector<std::uint8_t>& bytes) {
    sqlite3_bind_blob(statement_, k, bytes.data(), static_cast<int>(bytes.size()),
                      SQLITE_TRANSIENT);
  }

  /// @return whether there is a row
  bool step() {
    const int result = sqlite3_step(statement_);
    if (result == SQLITE_ROW) return true;
    if (result != SQLITE_DONE) journal_.fail("use");
    return false;
  }
  /// Readies it for other values.
  void reset() { sqlite3_reset(statement_); }
  /// Runs a statement without rows, and readies it for other values.
  void run() {
    step();
    reset();
  }

  std::int64_t integer(int k) const { return sqlite3_column_int64(statement_, k); }
  /// Of columns block_x, block_y.
  BlockIndex block(int k) const {
    return {static_cast<std::int32_t>(integer(k)), static_cast<std::int32_t>(integer(k + 1))};
  }
  double real(int k) const { return sqlite3_column_double(statement_, k); }
  std::string text(int k) const {
    const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(statement_, k));
    return text == nullptr ? "" : text;
  }
  bool has(int k) const { return sqlite3_column_type(statement_, k) != SQLITE_NULL; }
  Phenotype plant(int k) const {
    return plantOf(sqlite3_column_blob(statement_, k), sqlite3_column_bytes(statement_, k));
  }

 private:
  const PhenotypeJournal& journal_;
  sqlite3_stmt* statement_ = nullptr;
};

PhenotypeJournal::PhenotypeJournal(const std::string& path, Access access)
    : path_(path), database_(nullptr, sqlite3_close) {
  if (access == Access::kWrite && !path.empty()) {
    makeFolderOf(path);
    lock_ = std::make_unique<WriterLock>(path);
  }
  sqlite3* database = nullptr;
  // A reader, too, must be able to take part in the write-ahead log.
  const int flags =
      access == Access::kWrite ? SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE : SQLITE_OPEN_READWRITE;
  const int result = sqlite3_open_v2(path.c_str(), &database, flags, nullptr);
  database_.reset(database);
  if (result != SQLITE_OK) fail("open");
  sqlite3_busy_timeout(database, kBusyTimeout);
  file_ = fileAtPath();
  if (access == Access::kWrite) {
    execute("PRAGMA journal_mode = WAL");
    execute("PRAGMA cache_size = -512");  // [KiB] pages are written and hardly read again
    execute("PRAGMA synchronous = FULL");
    execute(kSchema);
    if (setting("plant").empty()) {
      Statement statement(*this, "INSERT INTO setting VALUES ('identity', hex(randomblob(16)))");
      statement.run();
      set("plant", messageVersion());
    }
  }
  if (setting("plant") != messageVersion()) {
    throw JournalError("the journal " + path +
                       " was written by a version of field_phenotyping that measures other traits: "
                       "give another file, or read it with that version");
  }
}

PhenotypeJournal::~PhenotypeJournal() = default;

void PhenotypeJournal::fail(const std::string& doing) const {
  throw JournalError("cannot " + doing + " the journal " + path_ + ": " +
                     (database_ ? sqlite3_errmsg(database_.get()) : "out of memory") +
                     ". May the file and its folder be written, is the disk full?");
}

void PhenotypeJournal::execute(const char* sql) {
  if (sqlite3_exec(database_.get(), sql, nullptr, nullptr, nullptr) != SQLITE_OK) fail("write");
}

std::string PhenotypeJournal::setting(const std::string& name) const {
  Statement statement(*this, "SELECT value FROM setting WHERE name = ?");
  statement.bind(1, name);
  return statement.step() ? statement.text(0) : "";
}

void PhenotypeJournal::set(const std::string& name, const std::string& value) {
  Statement statement(*this, "INSERT OR REPLACE INTO setting VALUES (?, ?)");
  statement.bind(1, name);
  statement.bind(2, value);
  statement.run();
}

std::string PhenotypeJournal::frameId() const {
  return setting("frame_id");
}

void PhenotypeJournal::setFrameId(const std::string& frame_id) {
  const std::string known = frameId();
  if (known == frame_id) return;
  if (!known.empty()) {
    throw JournalError("the journal " + path_ + " holds positions in frame '" + known +
                       "', these are in '" + frame_id + "': give another file");
  }
  set("frame_id", frame_id);
}

std::optional<std::pair<std::uint64_t, std::uint64_t>> PhenotypeJournal::fileAtPath() const {
  struct stat file = {};
  if (path_.empty() || ::stat(path_.c_str(), &file) != 0) return std::nullopt;
  return std::make_pair(static_cast<std::uint64_t>(file.st_dev),
                        static_cast<std::uint64_t>(file.st_ino));
}

bool PhenotypeJournal::isGone() const {
  return file_ && fileAtPath() != file_;
}

void PhenotypeJournal::copyTo(const std::string& path) const {
  makeFolderOf(path);
  Statement copy(*this, "VACUUM INTO ?");
  copy.bind(1, path);
  copy.step();
}

std::string PhenotypeJournal::identity() const {
  return setting("identity");
}

void PhenotypeJournal::append(const PlantReport& report) {
  execute("BEGIN IMMEDIATE");
  try {
    Statement head(*this,
                   "INSERT INTO report (block_x, block_y, began_ns, stamp_ns, revision) "
                   "VALUES (?, ?, ?, ?, ?)");
    head.bind(1, std::int64_t{report.source.block.x});
    head.bind(2, std::int64_t{report.source.block.y});
    head.bind(3, static_cast<std::int64_t>(report.source.began_ns));
    head.bind(4, static_cast<std::int64_t>(report.source.stamp_ns));
    head.bind(5, std::int64_t{report.source.revision});
    head.run();
    const std::int64_t number = sqlite3_last_insert_rowid(database_.get());
    Statement row(*this, "INSERT INTO plant VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
    for (const Phenotype& plant : report.plants) {
      row.bind(1, number);
      row.bind(2, std::int64_t{plant.id});
      row.bind(3, plant.base.x());
      row.bind(4, plant.base.y());
      row.bind(5, plant.base.z());
      row.bind(6, plant.height.value);
      row.bind(7, plant.height.stddev);
      row.bind(8, plant.stem_diameter.value);
      row.bind(9, plant.stem_diameter.stddev);
      row.bind(10, std::int64_t{plant.flags});
      row.bind(11, bytesOf(plant));
      row.run();
    }
    execute("COMMIT");
  } catch (const JournalError&) {
    sqlite3_exec(database_.get(), "ROLLBACK", nullptr, nullptr, nullptr);
    throw;
  }
}

/// Of columns block_x, block_y, began_ns, stamp_ns, revision; without plants.
PlantReport PhenotypeJournal::reportOf(const Statement& row, int first_column) {
  PlantReport report;
  report.source.block = row.block(first_column);
  report.source.began_ns = static_cast<std::uint64_t>(row.integer(first_column + 2));
  report.source.stamp_ns = static_cast<std::uint64_t>(row.integer(first_column + 3));
  report.source.revision = static_cast<std::uint32_t>(row.integer(first_column + 4));
  return report;
}

std::vector<PlantReport> PhenotypeJournal::readAfter(std::int64_t& position) const {
  std::vector<PlantReport> reports;
  Statement rows(*this,
                 "SELECT number, block_x, block_y, began_ns, stamp_ns, revision, message "
                 "FROM report LEFT JOIN plant ON plant.report = report.number "
                 "WHERE number > ? ORDER BY number, plant.rowid");
  rows.bind(1, position);
  constexpr int kMessage = 6;
  while (rows.step()) {
    if (reports.empty() || rows.integer(0) != position) {
      position = rows.integer(0);
      reports.push_back(reportOf(rows, 1));
    }
    if (rows.has(kMessage)) reports.back().plants.push_back(rows.plant(kMessage));
  }
  return reports;
}

std::set<std::int32_t> PhenotypeJournal::plantsOf(const BlockIndex& block) const {
  Statement rows(*this,
                 "SELECT DISTINCT plant_id FROM report JOIN plant ON plant.report = number "
                 "WHERE block_x = ? AND block_y = ?");
  rows.bind(1, std::int64_t{block.x});
  rows.bind(2, std::int64_t{block.y});
  std::set<std::int32_t> plants;
  while (rows.step()) plants.insert(static_cast<std::int32_t>(rows.integer(0)));
  return plants;
}

std::vector<PlantReport> PhenotypeJournal::readAbout(const BlockIndex& block,
                                                     const std::set<std::int32_t>& plants) const {
  std::map<std::int64_t, std::vector<Phenotype>> said;  // by number of the report
  std::set<BlockIndex> blocks{block};
  Statement of_plant(*this,
                     "SELECT number, block_x, block_y, message "
                     "FROM plant JOIN report ON plant.report = number WHERE plant_id = ?");
  for (const std::int32_t id : plants) {
    of_plant.bind(1, std::int64_t{id});
    while (of_plant.step()) {
      said[of_plant.integer(0)].push_back(of_plant.plant(3));
      blocks.insert(of_plant.block(1));
    }
    of_plant.reset();
  }
  std::map<std::int64_t, PlantReport> reports;  // by number
  Statement of_block(*this,
                     "SELECT number, block_x, block_y, began_ns, stamp_ns, revision FROM report "
                     "WHERE block_x = ? AND block_y = ?");
  for (const BlockIndex& index : blocks) {
    of_block.bind(1, std::int64_t{index.x});
    of_block.bind(2, std::int64_t{index.y});
    while (of_block.step()) {
      PlantReport report = reportOf(of_block, 1);
      report.plants = std::move(said[of_block.integer(0)]);
      reports.emplace(of_block.integer(0), std::move(report));
    }
    of_block.reset();
  }
  std::vector<PlantReport> in_order;
  for (auto& [number, report] : reports) in_order.push_back(std::move(report));
  return in_order;
}

std::vector<KnownPlant> PhenotypeJournal::knownPlants() const {
  // In a pass the newest report of a block holds. SQLite takes the columns that are not counted
  // from the row that has the maximum.
  Statement rows(*this,
                 "WITH holding AS (SELECT MAX(number) AS number FROM report "
                 "GROUP BY block_x, block_y, began_ns) "
                 "SELECT plant_id, x, y, stamp_ns, COUNT(holding.number), MAX(report.number) "
                 "FROM plant JOIN report ON plant.report = report.number "
                 "LEFT JOIN holding ON holding.number = report.number GROUP BY plant_id");
  std::vector<KnownPlant> known;
  while (rows.step()) {
    known.push_back({static_cast<std::int32_t>(rows.integer(0)),
                     {rows.real(1), rows.real(2)},
                     static_cast<std::uint64_t>(rows.integer(3)),
                     rows.integer(4) > 0});
  }
  return known;
}

std::size_t PhenotypeJournal::plants() const {
  Statement count(*this, "SELECT COUNT(DISTINCT plant_id) FROM plant");
  count.step();
  return static_cast<std::size_t>(count.integer(0));
}

std::size_t readInto(PlantTable& table, const PhenotypeJournal& journal, std::int64_t& position) {
  const std::vector<PlantReport> reports = journal.readAfter(position);
  for (const PlantReport& report : reports) table.update(report.source, report.plants);
  return reports.size();
}

void recallInto(PlantTable& table, const PhenotypeJournal& journal, const BlockIndex& block,
                const std::vector<Phenotype>& plants) {
  const bool new_block = !table.holds(block);
  std::set<std::int32_t> wanted;
  if (new_block) wanted = journal.plantsOf(block);
  for (const Phenotype& plant : plants) {
    if (!table.holds(plant.id)) wanted.insert(plant.id);
  }
  if (!new_block && wanted.empty()) return;
  table.recall(block, journal.readAbout(block, wanted));
}

std::string moveJournalAside(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  if (!fs::exists(path, error)) return "";
  const WriterLock lock(path);
  std::string other = freeNameBeside(path);
  fs::rename(path, other, error);
  if (error) throw JournalError("cannot rename the journal " + path + ": " + error.message());
  // A killed writer has left its newest reports in the log beside it.
  if (fs::exists(path + "-wal")) fs::rename(path + "-wal", other + "-wal", error);
  fs::remove(path + "-shm", error);
  return other;
}

std::string freeNameBeside(const std::string& path) {
  const std::filesystem::path file(path);
  std::string other;
  for (int k = 1; other.empty() || std::filesystem::exists(other); ++k) {
    other = (file.parent_path() / file.stem()).string() + "-" + std::to_string(k) +
            file.extension().string();
  }
  return other;
}

}  // namespace field_phenotyping
