#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/publish/wake_event.hpp"
#include "clampd/reanalysis/analysis.hpp"
#include "clampd/reanalysis/worker.hpp"
#include "src/publish/postgresql_connection.hpp"

namespace clampd::reanalysis {

/// A row of the queue that one worker has until its lease ends.
struct Claim {
  std::int64_t id = 0;
  std::string token;  ///< new with each claim: who has an old one has nothing
  std::int64_t job = 0;
  std::string check;
  std::string task_sha256;
};

/// What became of a row that a worker wanted to write.
enum class Written {
  Yes,
  Lost,  ///< the lease had ended, or the job was cancelled: nothing was written
};

/// A worker's side of the queue. All times are the server's, so that no clock of a worker matters. Errors are
/// those of the connection; after one, open() again.
class Queue {
 public:
  /// A task whose workers died so often is not claimed again.
  static constexpr int kMostAttempts = 5;

  explicit Queue(publish::PostgresqlSettings settings) : connection_(std::move(settings)) {}

  Result<void> open(const publish::WakeEvent& wake) { return connection_.open(wake); }
  void close() noexcept { connection_.close(); }
  std::string where() const { return connection_.where(); }

  /// Why this version cannot work with the database, and what to do; empty if it can.
  Result<std::string> refusal();
  /// Takes the oldest task that nobody has, and commits that; nothing: there is none.
  Result<std::optional<Claim>> claim(const std::string& worker, std::chrono::seconds lease);
  /// The task's document.
  Result<std::string> task(const std::string& sha256);
  Result<ArchivedCheck> check(const std::string& id);
  /// This version's result of the same task, if it is there; the claim is done with it.
  Result<bool> finish_with_known(const Claim& claim);
  Result<Written> renew(const Claim& claim, std::chrono::seconds lease);
  /// Result and row in one transaction. A result that is there already stays; if it is another one, the row
  /// fails.
  Result<Written> finish(const Claim& claim, const std::string& document, const std::string& worker);
  Result<Written> fail(const Claim& claim, const std::string& reason);
  Result<Written> give_back(const Claim& claim);
  Result<OpenTasks> open_tasks();

 private:
  publish::PostgresqlConnection connection_;
};

}  // namespace clampd::reanalysis
