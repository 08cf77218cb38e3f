#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <span>
#include <thread>
#include <utility>
#include <vector>

#include "clampd/brake/extended_brake.hpp"
#include "clampd/identify/extended_identification.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/station/run_collector.hpp"

namespace clampd {

/// How runs become parameters: identify_brake() with a method, identify_extended() with a model, or another
/// in tests.
using Estimator = std::function<Estimate(std::span<const Run>, const EstimatorOptions&)>;
inline Estimator estimator_of(Method method) {
  return [method](std::span<const Run> runs, const EstimatorOptions& options) {
    return identify_brake(method, runs, options);
  };
}
/// By identify_extended().
inline Estimator estimator_of(ExtendedParameters model) {
  return [model = std::move(model)](std::span<const Run> runs, const EstimatorOptions& options) {
    return identify_extended(runs, model, options);
  };
}

enum class WorkerMode {
  Background,   ///< a thread of its own, so that estimation runs beside the next repeats
  Synchronous,  ///< inside of submit() and finish(), for a station in virtual time
};

/// What a look at the runs so far finds.
struct Look {
  bool is_enough = false;
  std::uint8_t next_trajectory = 0;  ///< that a further run should follow
};

/// Looks at the runs so far, to end a check once they are enough.
struct Looks {
  std::size_t first = 1;  ///< runs before the first look
  /// At these, given their joint estimate. Called by whoever identifies them.
  std::function<Look(const std::vector<RunRecord>& runs, const Estimate& joint)> look;
};

/// Identifies each run as it arrives, and all of them jointly at the end; with looks, also jointly after each
/// run, unless the next one waits already. Runs that come after those that were enough are not taken.
class IdentificationWorker {
 public:
  /// `capacity`: runs that may wait at once, at least 1. With the number of repeats, submit() never has to
  /// refuse.
  IdentificationWorker(Estimator estimator, EstimatorOptions options, std::size_t capacity, WorkerMode mode,
                       Looks looks = {});
  ~IdentificationWorker();
  IdentificationWorker(const IdentificationWorker&) = delete;
  IdentificationWorker& operator=(const IdentificationWorker&) = delete;

  /// Never blocks on an estimate in the background mode. False if the queue is full, or if there are enough:
  /// the run is not taken.
  bool submit(CollectedRun run);

  struct Outcome {
    std::vector<RunRecord> runs;  ///< in the order of submission
    Estimate joint;  ///< over all runs; its start is the median of the runs' estimates, if there are any
  };
  /// Waits for what was submitted, then fits all runs jointly. Once only; submit() is over then.
  Outcome finish();

  /// Runs identified so far; from any thread.
  std::uint32_t identified() const { return identified_.load(std::memory_order_relaxed); }
  /// A look found them to be enough; from any thread.
  bool has_enough() const { return has_enough_.load(std::memory_order_acquire); }
  /// The trajectory that the last look asks for; from any thread.
  std::uint8_t next_trajectory() const { return next_trajectory_.load(std::memory_order_relaxed); }

 private:
  void work();
  RunRecord identify(CollectedRun run) const;
  void look();
  Estimate fit_jointly() const;

  const Estimator estimator_;
  const EstimatorOptions options_;
  const std::size_t capacity_;
  const WorkerMode mode_;
  const Looks looks_;
  std::vector<RunRecord> records_;  ///< the thread's until it is joined, as the next two
  Estimate joint_;                  ///< of the last look
  std::size_t joint_runs_ = 0;      ///< that it was of
  std::atomic<bool> has_enough_{false};
  std::atomic<std::uint8_t> next_trajectory_{0};
  std::atomic<std::uint32_t> identified_{0};
  std::mutex mutex_;
  std::condition_variable arrived_;
  std::deque<CollectedRun> queue_;
  bool closed_ = false;
  std::thread thread_;  ///< last: it uses all of the above
};

}  // namespace clampd
