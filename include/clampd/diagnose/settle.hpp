#pragma once

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/diagnosis.hpp"

namespace clampd {

/// What would settle a diagnosis.
struct NextStep {
  std::optional<NextExperiment> experiment;  ///< empty: there are no rivals, or nothing tells them apart
  std::string words;                         ///< why, or why not; empty without rivals
};

/// Designs the manoeuvre between the rivals of the first group that can be told apart. `runs_so_far`: how
/// many runs were diagnosed, for effects that change from run to run. Takes some seconds where there are
/// rivals.
NextStep next_step_for(const Diagnosis& diagnosis, const BrakeParameters& nominal,
                       std::size_t runs_so_far = 0);

/// Only the experiment, as Diagnosis::next_experiment holds it.
std::optional<NextExperiment> next_experiment_for(const Diagnosis& diagnosis, const BrakeParameters& nominal);

/// What came of settling.
struct Settlement {
  Diagnosis diagnosis;  ///< of all runs
  std::vector<Run> runs;
  std::vector<NextExperiment> experiments;  ///< that were run, in this order
  std::string words;                        ///< how it ended
};

/// Runs a trajectory of the nominal brake on the brake so often. Errors end the settling.
using Drive = std::function<Result<std::vector<Run>>(const Run& trajectory, int repeats)>;

struct SettleOptions {
  DiagnoseOptions diagnose;
  int most_rounds = 3;
  /// Called before an experiment is run.
  std::function<void(const NextExperiment&)> announce;
};

/// As long as a diagnosis of these runs is ambiguous, and something can tell its rivals apart: runs that on
/// the brake and diagnoses all runs together. Errors: those of `drive` and of diagnose().
Result<Settlement> settle(Diagnosis diagnosis, std::span<const Run> runs, const Drive& drive,
                          const SettleOptions& options);

}  // namespace clampd
