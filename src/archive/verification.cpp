// Everything that can be checked about a database of results: `clampctl records verify`.

#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "clampd/record/checksum.hpp"
#include "src/archive/amendments.hpp"
#include "src/archive/chain.hpp"
#include "src/archive/record_rows.hpp"

namespace clampd {
namespace {

class Verifier {
 public:
  Verifier(SQLite::Database& database, const std::function<void(double)>& progress)
      : database_(database), progress_(progress) {}

  Verification verify() {
    guarded("", [&] { check_file(); });
    guarded("", [&] { walk_chain(); });
    guarded("", [&] { find_what_is_not_in_the_chain(); });
    guarded("", [&] { check_limits_files(); });
    return std::move(found_);
  }

 private:
  void damage(const std::string& check, std::string what) {
    found_.damage.push_back({check, std::move(what)});
  }

  /// What one part cannot read does not keep the others from being looked at.
  template <class Work>
  void guarded(const std::string& check, Work work) {
    try {
      work();
    } catch (const SQLite::Exception& exception) {
      damage(check, fmt::format("cannot be read: {}", exception.what()));
    } catch (const sql::Damaged& exception) {
      damage(check, exception.what());
    } catch (const nlohmann::json::exception& exception) {
      damage(check, fmt::format("cannot be understood: {}", exception.what()));
    }
  }

  /// SQLite's own structure: pages, indices.
  void check_file() {
    constexpr int kMessagesMax = 20;
    SQLite::Statement check(database_, fmt::format("PRAGMA integrity_check({})", kMessagesMax));
    while (check.executeStep())
      if (const std::string message = check.getColumn(0).getString(); message != "ok")
        damage("", "the file: " + with_replacement_marks(message));
  }

  void walk_chain() {
    const std::int64_t links = database_.execAndGet("SELECT COUNT(*) FROM chain").getInt64();
    ContentDigest digest(database_);
    SQLite::Statement all(database_, "SELECT * FROM chain ORDER BY position");
    std::int64_t position = 0;
    while (all.executeStep()) {
      const ChainLink link = read_link(all);
      const std::string id = with_replacement_marks(link.check_id);
      if (link.position != position + 1)
        damage("", fmt::format("entries {} to {} of the chain of checksums are missing", position + 1,
                               link.position - 1));
      else if (link_sha256(link, found_.chain_sha256) != link.chain_sha256)
        damage(id, fmt::format("its entry {} in the chain of checksums, or the one before, was changed",
                               link.position));
      position = link.position;
      found_.chain_sha256 = link.chain_sha256;
      guarded(id, [&] { link.amendment ? check_amendment(link, digest) : check_record(link, digest); });
      if (progress_ && links > 0) progress_(static_cast<double>(position) / static_cast<double>(links));
    }
  }

  void check_record(const ChainLink& link, ContentDigest& digest) {
    ++found_.checks;
    const std::string id = with_replacement_marks(link.check_id);
    const std::optional<std::string> content = digest.of_check(link.check_id, link.format);
    if (!content) return damage(id, "the check is gone");
    if (*content != link.content_sha256)
      damage(id, "the check was changed after it was recorded: its checksum does not match");
    SQLite::Statement row(database_, "SELECT rowid FROM checks WHERE id = ?");
    row.bind(1, link.check_id);
    row.executeStep();
    const std::int64_t rowid = row.getColumn(0).getInt64();
    if (rowid <= last_rowid_) damage(id, "the order of the checks was changed");
    last_rowid_ = rowid;
    check_runs(link.check_id);
  }

  void check_runs(const std::string& check_id) {
    const std::string id = with_replacement_marks(check_id);
    const std::string removal = removal_of(check_id);
    SQLite::Statement runs(
        database_, "SELECT name, sha256, removed, csv, data FROM runs WHERE check_id = ? ORDER BY position");
    runs.bind(1, check_id);
    while (runs.executeStep()) {
      sql::Columns columns(runs);
      std::string name, sha256, removed;
      columns >> name >> sha256 >> removed;
      const Result<std::string> text = read_run_text(columns);
      if (!removed.empty()) {
        ++found_.runs_removed;
        if (removed != removal || !text || !text->empty())
          damage(id, fmt::format("the data of {} were not removed by the station's retention", name));
      } else if (!text || sha256_hex(*text) != sha256) {
        damage(id, fmt::format("{} was changed after it was recorded: its checksum does not match", name));
      } else {
        ++found_.runs;
      }
    }
  }

  /// When retention removed the check's runs; empty: it did not.
  std::string removal_of(const std::string& check_id) {
    SQLite::Statement made(database_,
                           "SELECT made FROM amendments WHERE check_id = ? AND kind = ? ORDER BY id LIMIT 1");
    made.bind(1, check_id);
    made.bind(2, kRunsRemoved);
    return made.executeStep() ? made.getColumn(0).getString() : "";
  }

  void check_amendment(const ChainLink& link, ContentDigest& digest) {
    ++found_.amendments;
    if (digest.of_amendment(*link.amendment) != link.content_sha256)
      damage(with_replacement_marks(link.check_id),
             "what was said of the check later (void, settled, runs removed) was changed or taken out");
  }

  void find_what_is_not_in_the_chain() {
    const auto name_all = [&](const char* query, const char* what) {
      SQLite::Statement statement(database_, query);
      while (statement.executeStep())
        damage(with_replacement_marks(statement.getColumn(0).getString()), what);
    };
    name_all(
        "SELECT id FROM checks WHERE id NOT IN (SELECT check_id FROM chain WHERE amendment IS NULL) ORDER BY "
        "rowid",
        "the check is in no chain of checksums: clampd did not put it there");
    name_all(
        "SELECT check_id FROM amendments WHERE id NOT IN (SELECT amendment FROM chain WHERE amendment IS NOT "
        "NULL)",
        "something was said of the check that is in no chain of checksums: clampd did not put it there");
  }

  void check_limits_files() {
    SQLite::Statement limits(database_, "SELECT sha256, file, contents FROM limits_revisions");
    while (limits.executeStep()) {
      const std::string contents = limits.getColumn(2).getString();
      if (sha256_hex(contents) != limits.getColumn(0).getString())
        damage("", fmt::format("the limits file {} in the database was changed after it was used",
                               with_replacement_marks(limits.getColumn(1).getString())));
    }
  }

  SQLite::Database& database_;
  const std::function<void(double)>& progress_;
  Verification found_;
  std::int64_t last_rowid_ = std::numeric_limits<std::int64_t>::min();
};

}  // namespace

Result<Verification> CheckStore::verify(const std::function<void(double)>& progress) const {
  try {
    // One state of it, whatever is saved meanwhile.
    SQLite::Transaction snapshot(database_->handle);
    Verification found = Verifier(database_->handle, progress).verify();
    return found;
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

}  // namespace clampd
