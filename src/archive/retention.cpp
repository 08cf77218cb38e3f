#include <algorithm>
#include <map>

#include "clampd/base/clock.hpp"
#include "clampd/record/utc.hpp"
#include "src/archive/amendments.hpp"
#include "src/archive/database.hpp"

namespace clampd {
namespace {

struct Kept {
  std::string id;
  std::string started;
  std::uint64_t bytes = 0;
};

/// Checks with raw runs, the oldest first.
std::vector<Kept> checks_with_runs(SQLite::Database& database) {
  SQLite::Statement statement(
      database,
      "SELECT c.id, c.started, r.bytes FROM checks c JOIN "
      "(SELECT check_id, SUM(bytes) AS bytes FROM runs WHERE removed = '' GROUP BY check_id) r "
      "ON r.check_id = c.id ORDER BY c.started, c.id");
  std::vector<Kept> checks;
  while (statement.executeStep()) {
    Kept& check = checks.emplace_back();
    sql::Columns(statement) >> check.id >> check.started >> check.bytes;
  }
  return checks;
}

/// The channel that a check still waits for; empty if none.
class Waiting {
 public:
  Waiting(SQLite::Database& database, const std::vector<std::string>& channels)
      : channels_(channels),
        statement_(database, "SELECT channel, state FROM publication WHERE check_id = ? ORDER BY channel") {}

  std::string channel_of(const std::string& id) {
    statement_.reset();
    statement_.bind(1, id);
    std::vector<std::string> published;
    while (statement_.executeStep()) {
      std::string channel;
      int state = 0;
      sql::Columns(statement_) >> channel >> state;
      if (state != static_cast<int>(PublicationState::Published)) return channel;
      published.push_back(std::move(channel));
    }
    for (const std::string& channel : channels_)
      if (std::find(published.begin(), published.end(), channel) == published.end()) return channel;
    return "";
  }

 private:
  const std::vector<std::string>& channels_;
  SQLite::Statement statement_;
};

RetentionSummary plan(SQLite::Database& database, const RetentionPolicy& policy, std::int64_t now_utc_ns,
                      std::size_t checks_max) {
  RetentionSummary summary;
  const std::vector<Kept> checks = checks_with_runs(database);
  std::uint64_t total = 0;
  for (const Kept& check : checks) total += check.bytes;
  summary.kept_bytes = total;
  const std::string oldest =
      policy.days == 0 ? ""
                       : format_utc(now_utc_ns - std::int64_t{policy.days} * 86'400 * kNanosecondsPerSecond);
  Waiting waiting(database, policy.published);
  std::map<std::string, std::size_t> waits;
  for (const Kept& check : checks) {
    const bool too_old = check.started < oldest;
    const bool too_much = policy.bytes > 0 && summary.kept_bytes > policy.bytes;
    if (!too_old && !too_much) break;  // what follows is younger
    if (const std::string channel = waiting.channel_of(check.id); !channel.empty()) {
      ++waits[channel];
      continue;
    }
    if (summary.checks.size() == checks_max) break;
    summary.checks.push_back(check.id);
    summary.bytes += check.bytes;
    summary.kept_bytes -= check.bytes;
  }
  summary.waiting.assign(waits.begin(), waits.end());
  return summary;
}

}  // namespace

Result<RetentionSummary> CheckStore::plan_retention(const RetentionPolicy& policy,
                                                    std::int64_t now_utc_ns) const {
  try {
    return plan(database_->handle, policy, now_utc_ns, std::numeric_limits<std::size_t>::max());
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

Result<RetentionSummary> CheckStore::apply_retention(const RetentionPolicy& policy, std::int64_t now_utc_ns,
                                                     std::size_t checks_max) {
  SQLite::Database& handle = database_->handle;
  if (const Result<void> there = database_->in_place(); !there) return tl::unexpected(there.error());
  try {
    SQLite::Transaction transaction(handle, SQLite::TransactionBehavior::IMMEDIATE);
    RetentionSummary summary = plan(handle, policy, now_utc_ns, checks_max);
    SQLite::Statement remove(
        handle, "UPDATE runs SET csv = '', data = NULL, removed = ? WHERE check_id = ? AND removed = ''");
    const std::string now = format_utc(now_utc_ns);
    for (const std::string& id : summary.checks) {
      remove.reset();
      remove.bind(1, now);
      remove.bind(2, id);
      remove.exec();
      amend(handle, id, kRunsRemoved, now, "");
    }
    transaction.commit();
    return summary;
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

}  // namespace clampd
