#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/publish/backoff.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/publish/wake_event.hpp"

namespace clampd::reanalysis {

/// Of all jobs: tasks that nobody has yet, and those that a worker has.
struct OpenTasks {
  std::int64_t waiting = 0, claimed = 0;
};

struct WorkerSummary {
  std::int64_t done = 0;
  std::int64_t known = 0;  ///< of them, those that another job had a result of
  std::int64_t failed = 0;
  std::int64_t lost = 0;  ///< claims whose lease ended, or whose job was cancelled: their work was discarded
  std::int64_t given_back = 0;
};

/// What a worker is doing.
struct WorkerStatus {
  WorkerSummary summary;
  bool connected = false;
  double busy_s = 0.0;            ///< with tasks, from claim to result
  std::optional<OpenTasks> open;  ///< as the queue was when last looked at; nothing: not yet
};

struct WorkerOptions {
  publish::PostgresqlSettings database;
  std::string name;                ///< in the queue and with each result: host and process
  bool until_empty = false;        ///< ends once no task is waiting or claimed
  std::chrono::seconds lease{60};  ///< renewed three times as often; a worker that dies is missed for so long
  std::chrono::milliseconds pause{1000};  ///< between two looks into an empty queue
  publish::BackoffOptions backoff{std::chrono::milliseconds{500}, std::chrono::milliseconds{30'000}};
  /// What a log should say: connected, waiting for the server, a task that failed or was lost.
  std::function<void(const std::string&)> say = [](const std::string&) {};
  /// Who looks on hears of each change, on the worker's thread; must not wait. Empty: nobody does.
  std::function<void(const WorkerStatus&)> report = {};
  /// Between two counts of the open tasks for `report`; a count takes as long as the queue is.
  std::chrono::seconds count_every{60};
};

/// Takes tasks from the queue, one at a time, until the wake stops or, with until_empty, nothing is left. A
/// server that is away is waited for as long as it takes. A stop gives the claim back. Errors: the database
/// is of an older or newer schema, or the user lacks rights.
Result<WorkerSummary> work(const WorkerOptions& options, publish::WakeEvent& wake);

}  // namespace clampd::reanalysis
