#include "clampd/reanalysis/worker.hpp"

#include <functional>
#include <map>
#include <memory>
#include <optional>

#include <fmt/format.h>

#include "clampd/record/checksum.hpp"
#include "src/reanalysis/heartbeat.hpp"
#include "src/reanalysis/queue.hpp"

namespace clampd::reanalysis {
namespace {

using Clock = std::chrono::steady_clock;

class Worker {
 public:
  Worker(const WorkerOptions& options, publish::WakeEvent& wake)
      : options_(options),
        wake_(wake),
        queue_(options.database),
        backoff_(options.backoff, std::hash<std::string>{}(options.name)) {}

  Result<WorkerSummary> run();

 private:
  enum class Step { Worked, Waiting, Empty };

  Result<std::string> connect();
  void wait_for_server(const Error& error);
  Result<Step> step();
  Result<void> perform(const Claim& claim);
  Result<const Task*> task_of(const Claim& claim);
  Result<void> settle(const Claim& claim, const std::function<Result<Written>()>& write, std::int64_t& count);
  Result<void> settle_failure(const Claim& claim, const std::string& reason);
  void report();

  const WorkerOptions& options_;
  publish::WakeEvent& wake_;
  Queue queue_;
  publish::Backoff backoff_;
  WorkerStatus status_;
  WorkerSummary& summary_ = status_.summary;
  Clock::time_point count_due_ = Clock::now();
  std::string task_sha256_;  ///< of the task that was read last; most claims in a row are of one job
  Result<Task> task_ = failure("none read");
};

/// Empty: connected, to a database that this version can work with.
Result<std::string> Worker::connect() {
  if (Result<void> opened = queue_.open(wake_); !opened) return tl::unexpected(opened.error());
  Result<std::string> refusal = queue_.refusal();
  if (refusal && refusal->empty()) {
    backoff_.reset();
    options_.say(fmt::format("{}: connected", queue_.where()));
  }
  return refusal;
}

void Worker::wait_for_server(const Error& error) {
  queue_.close();
  if (wake_.stopped()) return;
  const std::chrono::milliseconds pause = backoff_.next();
  options_.say(
      fmt::format("{}; trying again in {:.1f} s", error.message, static_cast<double>(pause.count()) / 1e3));
  wake_.wait(pause);
}

/// The document is read once for all claims of a job.
Result<const Task*> Worker::task_of(const Claim& claim) {
  if (claim.task_sha256 != task_sha256_) {
    const Result<std::string> document = queue_.task(claim.task_sha256);
    if (!document) return tl::unexpected(document.error());
    task_ = sha256_hex(*document) == claim.task_sha256
                ? parse_task(*document)
                : failure("the task's document was changed since it was submitted: submit the job again");
    task_sha256_ = claim.task_sha256;
  }
  return task_ ? &*task_ : nullptr;
}

/// Writes how a claim ended, also if the server goes away and comes back while the lease lasts. Errors: it
/// does not come back so soon.
Result<void> Worker::settle(const Claim& claim, const std::function<Result<Written>()>& write,
                            std::int64_t& count) {
  const Clock::time_point end = Clock::now() + options_.lease;
  while (true) {
    const Result<Written> written = write();
    if (written) {
      ++(*written == Written::Yes ? count : summary_.lost);
      if (*written == Written::Lost)
        options_.say(fmt::format(
            "check {}: the lease had ended or the job was cancelled; this work is discarded", claim.check));
      return {};
    }
    Result<std::string> refusal = tl::unexpected(written.error());
    while (!refusal) {
      if (wake_.stopped() || Clock::now() >= end) return tl::unexpected(refusal.error());
      wait_for_server(refusal.error());
      refusal = connect();
    }
    if (!refusal->empty()) return failure(*refusal);
  }
}

Result<void> Worker::settle_failure(const Claim& claim, const std::string& reason) {
  options_.say(fmt::format("check {}: {}", claim.check, reason));
  return settle(
      claim, [&] { return queue_.fail(claim, reason); }, summary_.failed);
}

Result<void> Worker::perform(const Claim& claim) {
  const Result<bool> known = queue_.finish_with_known(claim);
  if (!known) return tl::unexpected(known.error());
  if (*known) {
    ++summary_.done, ++summary_.known;
    return {};
  }
  const Result<const Task*> task = task_of(claim);
  if (!task) return tl::unexpected(task.error());
  if (*task == nullptr) return settle_failure(claim, task_.error().message);
  const Result<ArchivedCheck> check = queue_.check(claim.check);
  if (!check) return tl::unexpected(check.error());
  Result<std::vector<CollectedRun>> runs = unpack_runs(*check);
  if (!runs) return settle_failure(claim, runs.error().message);

  Result<std::optional<std::string>> document = std::nullopt;
  {
    const Heartbeat heartbeat(options_.database, claim, options_.lease);
    document = analyse(*check, std::move(*runs), **task, claim.task_sha256,
                       [&] { return heartbeat.lost() || wake_.stopped(); });
  }
  if (!document) return settle_failure(claim, document.error().message);
  if (*document)
    return settle(
        claim, [&] { return queue_.finish(claim, **document, options_.name); }, summary_.done);
  return settle(
      claim, [&] { return queue_.give_back(claim); }, summary_.given_back);
}

Result<Worker::Step> Worker::step() {
  const Result<std::optional<Claim>> claim = queue_.claim(options_.name, options_.lease);
  if (!claim) return tl::unexpected(claim.error());
  if (*claim) {
    const Clock::time_point begin = Clock::now();
    const Result<void> performed = perform(**claim);
    status_.busy_s += std::chrono::duration<double>(Clock::now() - begin).count();
    return performed.map([] { return Step::Worked; });
  }
  if (!options_.until_empty) return Step::Waiting;
  // What others have claimed may come back.
  return queue_.open_tasks().map(
      [](const OpenTasks& open) { return open.waiting + open.claimed == 0 ? Step::Empty : Step::Waiting; });
}

void Worker::report() {
  if (!options_.report) return;
  if (status_.connected && Clock::now() >= count_due_) {
    // Where the count fails, the next step says why.
    if (const Result<OpenTasks> open = queue_.open_tasks()) status_.open = *open;
    count_due_ = Clock::now() + options_.count_every;
  }
  options_.report(status_);
}

Result<WorkerSummary> Worker::run() {
  while (!wake_.stopped()) {
    report();
    if (!status_.connected) {
      const Result<std::string> refusal = connect();
      if (refusal && !refusal->empty()) return failure(*refusal);
      status_.connected = refusal.has_value();
      if (!status_.connected) wait_for_server(refusal.error());
      continue;
    }
    const Result<Step> step = this->step();
    if (!step) {
      status_.connected = false;
      report();
      wait_for_server(step.error());
    } else if (*step == Step::Empty) {
      break;
    } else if (*step == Step::Waiting) {
      wake_.wait(options_.pause);
    }
  }
  return summary_;
}

}  // namespace

Result<WorkerSummary> work(const WorkerOptions& options, publish::WakeEvent& wake) {
  return Worker(options, wake).run();
}

}  // namespace clampd::reanalysis
