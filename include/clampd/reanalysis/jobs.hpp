#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/base/result.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/reanalysis/population.hpp"
#include "clampd/reanalysis/task.hpp"

namespace clampd::reanalysis {

/// Which checks of the archive. Empty: any.
struct Selection {
  std::vector<std::string> serials = {};
  std::string part_number = {};
  std::string batch = {};
  std::string station = {};
  std::string since = {};  ///< as is_filter_time() has them
  std::string until = {};  ///< a date includes its whole day
};

struct SubmittedJob {
  std::int64_t id = 0;
  std::int64_t tasks = 0;
  std::int64_t known = 0;  ///< of them, those whose result is there from another job
  std::int64_t without_runs =
      0;  ///< checks of the selection whose raw runs are not in the database: left out
};

struct JobStatus {
  std::int64_t id = 0;
  std::string name;
  std::string submitted;  ///< RFC 3339, UTC
  std::string submitted_by;
  std::string task_sha256;
  std::int64_t waiting = 0;
  std::int64_t claimed = 0;
  std::int64_t done = 0;
  std::int64_t failed = 0;
  std::int64_t cancelled = 0;
  std::int64_t workers = 0;      ///< that hold a claim now
  double done_per_s = 0.0;       ///< over the last ten minutes at most; 0: nothing was done
  std::optional<double> left_s;  ///< at that rate; nothing: it cannot be told, or nothing is left
  std::string end;               ///< when that is, RFC 3339, UTC; empty as well
  std::vector<std::pair<std::string, std::int64_t>>
      failures;  ///< reasons with the name of one check, and how many

  std::int64_t all() const { return waiting + claimed + done + failed + cancelled; }
};

struct JobResult {
  std::string check;
  std::string state;
  std::string reason;    ///< why it failed; empty otherwise
  std::string document;  ///< clampd.reanalysis/2; empty if there is none (yet)
};

/// As clampd.archive_status/1 has it.
nlohmann::ordered_json job_json(const JobStatus& status);

/// What a check says now and said before.
struct ComparedCheck {
  std::string check;
  std::string serial;
  std::string document;  ///< of the job
  std::string
      before;  ///< the same keys verdict, parameters (name, unit, value, sd), stopping, sheet, as recorded or by another job
};

/// The archive's jobs, as whoever asks for them sees them. A job is named by its number, or "last". Errors:
/// no connection, an older or newer schema, no such job.
class Jobs {
 public:
  /// `may_migrate`: an older schema is brought up to date, otherwise it is refused.
  static Result<Jobs> open(const publish::PostgresqlSettings& settings, bool may_migrate);
  ~Jobs();
  Jobs(Jobs&&) noexcept;

  Result<SubmittedJob> submit(const std::string& name, const Task& task, const Selection& selection);
  Result<std::int64_t> find(const std::string& job);
  /// The newest first, at most so many.
  Result<std::vector<JobStatus>> list(int most = std::numeric_limits<int>::max());
  Result<JobStatus> status(std::int64_t job);
  /// In the order of the checks' names.
  Result<std::vector<JobResult>> results(std::int64_t job);
  /// Those checks that both have. `with`: another job; nothing: as it was recorded.
  Result<std::vector<ComparedCheck>> compared(std::int64_t job, std::optional<std::int64_t> with);
  /// Those checks of a job of the kind score-effects that are done, in the order in which they were started. Errors also: those of parse_scores().
  Result<std::vector<ScoredCheck>> scored(std::int64_t job);
  /// Tasks that failed, and those that were cancelled, wait again. How many.
  Result<std::int64_t> retry(std::int64_t job);
  /// Tasks that are not done; what workers make of those that they have is discarded. How many.
  Result<std::int64_t> cancel(std::int64_t job);

 private:
  class Connection;
  explicit Jobs(std::unique_ptr<Connection> connection);
  std::unique_ptr<Connection> connection_;
};

}  // namespace clampd::reanalysis
