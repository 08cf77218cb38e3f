#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// Which checks to list, the last one saved first, whatever the clock said. Empty fields do not restrict.
struct CheckFilter {
  std::string serial = {};
  std::optional<Verdict> verdict = {};
  std::string since = {};  ///< RFC 3339 in UTC or a date: checks started then or later
  std::uint32_t limit = 50;
  std::string part_number = {};
  std::string batch = {};
  std::string operator_name = {};
  std::string until = {};  ///< as `since`: checks started then or earlier; a date includes its whole day
};

/// Whether a text can be `since` or `until` of a filter: 2026-11-21, or 2026-11-21T14:30Z, to the
/// millisecond.
bool is_filter_time(const std::string& text);

/// One line of a list of checks.
struct CheckSummary {
  std::string id;
  std::string serial;
  std::string started;
  Verdict verdict = Verdict::Error;
  bool marginal = false;
  bool simulated = false;
  std::uint32_t repeats = 0;
  double duration_s = 0.0;
  std::string reason;
  std::string part_number;
  bool is_void = false;  ///< it counts in no statistics
};

/// A limits file as the first check that was judged by it found it.
struct LimitsRevision {
  std::string sha256;  ///< of the contents
  std::string revision;
  std::string author;
  std::string changed;  ///< date in the file, YYYY-MM-DD
  std::string file;
  std::string contents;
  std::string first_used;  ///< RFC 3339, UTC: start of that check
};

/// What raw runs to keep. Results, parameters and checksums always stay.
struct RetentionPolicy {
  std::uint32_t days = 0;   ///< 0: however old
  std::uint64_t bytes = 0;  ///< of all raw runs together, the oldest go first; 0: however many
  std::vector<std::string> published =
      {};  ///< channels that must have published a check before its runs may go

  bool keeps_all() const { return days == 0 && bytes == 0; }
};

/// What was, or would be, removed.
struct RetentionSummary {
  std::vector<std::string> checks;  ///< ids whose raw runs go, the oldest first
  std::uint64_t bytes = 0;          ///< of their raw runs
  std::uint64_t kept_bytes = 0;     ///< of all others
  /// Checks that were due but wait for a channel, by channel.
  std::vector<std::pair<std::string, std::size_t>> waiting;
};

/// What verify() found.
struct Verification {
  struct Damage {
    std::string check;  ///< id; empty: not one check's
    std::string what;
  };
  std::size_t checks = 0;
  std::size_t amendments = 0;
  std::size_t runs = 0;          ///< whose data are there and match their checksum
  std::size_t runs_removed = 0;  ///< by retention
  /// SHA-256 of the chain's last entry: noted elsewhere, it shows later that nothing was taken off the end.
  std::string chain_sha256;
  std::vector<Damage> damage;
};

enum class PublicationState : std::uint8_t { Pending = 0, Published = 1 };

/// A check that a channel has yet to publish.
struct OutboxEntry {
  std::string check_id;
  std::int64_t sequence = 0;  ///< of the channel: 1, 2, ... in the order in which checks were saved
  std::string queued;         ///< RFC 3339, UTC
};

/// What waits in a channel's outbox.
struct OutboxState {
  std::size_t pending = 0;
  std::string oldest;  ///< RFC 3339, UTC: when the one that is next was queued; empty if none waits
};

/// Puts the backup in the place of the results at `path`, also while a station runs on them. The backup is
/// verified first, and what was there is kept beside it under the name that is returned (empty: nothing was
/// there). Errors: the backup is damaged, or no database of results; then everything stays as it is.
Result<std::string> restore_backup(const std::string& backup, const std::string& path,
                                   std::int64_t now_utc_ns);

/// The station's results: one SQLite file, write-ahead logged and synced at every commit, so that a saved
/// check survives a power cut. Several processes may read while one writes. Not for use by two threads at
/// once.
class CheckStore {
 public:
  enum class Access { ReadWrite, ReadOnly };

  /// Opens or (ReadWrite) creates the file and its folder, and brings its schema up to date. A lock held by
  /// another process is waited for as long as `busy_timeout_ms`. ReadOnly also opens what may only be read: a
  /// backup, a folder without write permission. Errors: it is a database of another program.
  static Result<CheckStore> open(const std::string& path, Access access = Access::ReadWrite,
                                 int busy_timeout_ms = 5000);

  CheckStore(CheckStore&&) noexcept;
  CheckStore& operator=(CheckStore&&) noexcept;
  ~CheckStore();

  /// Channels whose outbox gets every check that is saved from now on.
  void queue_for(std::vector<std::string> channels) { outbox_channels_ = std::move(channels); }

  /// The whole record, its entry in the chain of checksums and its entries in the outboxes, in one
  /// transaction. An id that is already there is an error; so is a file that was deleted, moved or replaced
  /// since it was opened: then nothing counts as saved.
  Result<void> save(const CheckRecord& record);

  /// Marks a check as void: it stays on record, but counts in no statistics. `id` as for load(). Errors: it
  /// is void already.
  Result<std::string> mark_void(const std::string& id, const VoidRecord& why);

  /// What further experiments after the check say of its cause, and its reason in these words: from now on
  /// the record's own.
  Result<void> save_settled_cause(const std::string& id, const std::optional<CauseRecord>& cause,
                                  const std::string& reason);

  /// Looks through everything: each record against its checksum, the chain of these from the first to the
  /// last, each raw run, and the file itself. What is damaged is named, and the rest gone on with.
  /// `progress`: share done.
  Result<Verification> verify(const std::function<void(double)>& progress = {}) const;

  /// Copies everything as it is now into a new file, also while others write. Errors: there is such a file.
  Result<void> back_up(const std::string& file) const;

  /// A record that is damaged is listed as an ERROR whose reason says so.
  Result<std::vector<CheckSummary>> list(const CheckFilter& filter) const;

  /// The same checks as whole records, but for runs, lateness histogram and flight recorder, which stay
  /// empty.
  Result<std::vector<CheckRecord>> load_results(const CheckFilter& filter) const;

  /// The whole record, its own checksum and its runs' verified; runs that retention removed have no rows.
  /// `id` may be shortened as long as it is unambiguous; "last" is the one saved last.
  Result<CheckRecord> load(const std::string& id) const;

  /// One check by its whole id, as `load_results` has it, and the names, figures and checksums of its runs.
  Result<CheckRecord> load_result(const std::string& id) const;

  /// Keeps a limits file; one that is already known (by its SHA-256) stays as it was first seen.
  Result<void> save_limits(const LimitsRevision& limits);
  /// All that were ever used, the first one first.
  Result<std::vector<LimitsRevision>> limits_history() const;

  /// The oldest check that the channel has not published; nothing if there is none.
  Result<std::optional<OutboxEntry>> next_in_outbox(const std::string& channel) const;
  Result<OutboxState> outbox(const std::string& channel) const;
  /// One more connection of the channel: 0 for the first one ever, then 1, 2, ...
  Result<std::uint64_t> count_connection(const std::string& channel);

  /// What a channel has done with a check. A check without an entry was not published by that channel.
  Result<void> mark_publication(const std::string& id, const std::string& channel, PublicationState state);

  /// Which raw runs the policy lets go at `now` (UTC, nanoseconds since 1970). A check that a channel of the
  /// policy has not published, or that any channel has pending, keeps its runs.
  Result<RetentionSummary> plan_retention(const RetentionPolicy& policy, std::int64_t now_utc_ns) const;
  /// Removes the raw runs of at most `checks_max` checks of the plan, in one transaction, each judged anew.
  /// The file does not shrink: the next checks use its space.
  Result<RetentionSummary> apply_retention(const RetentionPolicy& policy, std::int64_t now_utc_ns,
                                           std::size_t checks_max);

 private:
  struct Database;
  Result<std::string> whole_id(const std::string& id) const;
  Result<CheckRecord> load_whole(const std::string& id,
                                 const std::function<Result<void>(CheckRecord&)>& read_the_rest) const;
  explicit CheckStore(std::unique_ptr<Database> database);
  std::unique_ptr<Database> database_;
  std::vector<std::string> outbox_channels_;
};

}  // namespace clampd
