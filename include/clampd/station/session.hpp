#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/experiment/next_run.hpp"
#include "clampd/ports/brake_port.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/record/sample.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/evidence.hpp"
#include "clampd/station/limits.hpp"
#include "clampd/station/run_collector.hpp"
#include "clampd/station/stopping.hpp"
#include "clampd/station/verdict.hpp"
#include "clampd/station/worker.hpp"

namespace clampd {

/// What the operator asks for. Empty texts: as configured.
struct CheckRequest {
  std::string serial = {};
  std::uint32_t repeats = 0;  ///< 0: as configured
  std::string operator_name = {};
  std::string part_number = {};
  std::string batch = {};
  bool repeats_auto =
      false;  ///< as many as this brake needs, the configured most at most; `repeats` is 0 then
};

/// How many runs a request asks for, where the station is configured like that.
struct PlannedRepeats {
  std::uint32_t most = 0;
  bool automatic = false;  ///< fewer, if fewer decide every limit
};
PlannedRepeats planned_repeats(const CheckRequest& request, const CheckSettings& settings);

/// The same without white space around its texts: " X " and "X" are one brake, whoever asks.
CheckRequest normalised(CheckRequest request);

/// Bounds of a request, checked before anything moves: a serial of 1 to 80 printable characters in UTF-8, 1
/// to 200 repeats.
Result<void> validate(const CheckRequest& request);

/// What was prepared for this check.
struct CheckContext {
  std::size_t trajectory_rows = 0;
  std::string trajectory_sha256;
  /// Those that a run can follow, where there is a choice: the one above first.
  TrajectorySet trajectories = {};
  std::vector<std::string> trajectories_sha256 = {};
  std::string software_version;
  std::int64_t started_utc_ns = 0;
  std::optional<TorqueWhileOff> torque_while_off = {};  ///< before the check, if there was time for it
  std::optional<Sheet> sheet = {};                      ///< what is asked of the brake beside its parameters
  std::optional<RecipeRecord> recipe = {};              ///< that all of this comes from
};

/// What the station knows when the check has ended.
struct CheckOutcome {
  FaultCause fault = FaultCause::None;
  Verdict fault_verdict = Verdict::Error;  ///< by the supervisor's table
  std::string fault_text;                  ///< the supervisor's sentence; may be empty
  std::string refusal;                     ///< why the check never began; empty: it did
  TimingRecord timing;  ///< ticks, skips and lateness of this check; lost_samples: dropped by the ring
  PortHealth health;    ///< counts of this check alone, not since start
  std::int64_t stopped_utc_ns = 0;
  std::vector<Sample> flight_recorder;
};

/// How runs that the model does not explain get their cause: diagnose(), or another in tests.
using Diagnoser = std::function<Result<Diagnosis>(std::span<const Run>, const DiagnoseOptions&)>;

/// While the cause of a misfit is searched for, which takes seconds, seldom a minute.
struct CauseSearch {
  std::function<void(double share, const std::string& words)> progress = {};
  /// Asked now and then, from any thread: true ends the search, and the verdict stands without a cause.
  std::function<bool()> given_up = {};
};

/// One check from its first sample to its record. consume() and finish() belong to one thread, progress() to
/// any.
class CheckSession {
 public:
  struct Progress {
    std::uint64_t samples = 0;
    std::uint32_t repeats = 0;  ///< planned, or allowed at most
    bool repeats_auto = false;  ///< the latter
    std::uint32_t recorded = 0;
    std::uint32_t identified = 0;
    double cause_searched = 0.0;  ///< share of the search for a cause that is done; 0: none has begun
  };

  /// `request` must be valid.
  CheckSession(const StationConfiguration& configuration, const LimitSet& limits, const CheckRequest& request,
               const CheckContext& context, Estimator estimator, WorkerMode mode,
               Diagnoser diagnoser = diagnose);

  /// Who hears of the search for a cause and may end it; before finish().
  void watch_search(CauseSearch search) { search_ = std::move(search); }

  /// Every sample of the check, in the order of the ring.
  void consume(const Sample& sample);

  /// The record with its verdict. Once only. Takes some seconds more where the brake fails or the model does
  /// not explain the runs, which are then diagnosed if the configuration says so.
  CheckRecord finish(CheckOutcome outcome);

  /// What is known of the record before the first sample; empty after finish().
  const CheckRecord& head() const { return record_; }
  /// What finish() found out in that search, if there was one.
  std::optional<Diagnosis> take_diagnosis() { return std::exchange(diagnosis_, std::nullopt); }
  Progress progress() const;
  /// The runs so far decide every limit: no further one is needed. Any thread.
  bool has_enough() const { return worker_.has_enough(); }
  /// The trajectory that the next run should follow, as far as is known by now. Any thread.
  std::uint8_t next_trajectory() const { return worker_.next_trajectory(); }

 private:
  const Diagnosis* name_cause(CheckRecord& record);
  void question_failure(CheckRecord& record);
  std::string advice_on_method(const CheckRecord& record, const ParameterVector& sd) const;
  Looks looks();
  Look look_at(const std::vector<RunRecord>& runs, const Estimate& joint) const;
  void record_stopping(const CheckFacts& facts, const Judgement& judgement, const Estimate& joint,
                       CheckRecord& record) const;
  EstimateReading reading() const;
  CheckFacts facts_of(CheckOutcome& outcome, const Estimate& joint, CheckRecord& record) const;
  bool is_by_output_errors() const;

  StationConfiguration configuration_;
  LimitSet limits_;
  std::optional<Sheet> sheet_;
  std::int64_t started_utc_ns_;
  PlannedRepeats repeats_;
  TrajectorySet trajectories_;
  std::vector<std::string> trajectories_sha256_;
  std::optional<StoppingRule> stopping_;  ///< nothing: a fixed number
  CheckRecord record_;
  RunCollector collector_;
  IdentificationWorker worker_;
  Diagnoser diagnoser_;
  CauseSearch search_;
  std::optional<Diagnosis> diagnosis_;
  std::atomic<double> cause_searched_{0.0};
  std::atomic<std::uint64_t> samples_{0};
  std::atomic<std::uint32_t> recorded_{0};
};

}  // namespace clampd
