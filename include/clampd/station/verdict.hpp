#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "clampd/identify/estimate.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/sheet/evaluation.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"

namespace clampd {

/// Half widths of guard bands, in the reported standard deviations.
struct GuardBands {
  ParameterVector parameters;
  double effects = 0.0;  ///< of every parameter of an effect

  double widest() const { return std::max(parameters.maxCoeff(), effects); }
};

/// What a check found out, as far as its verdict depends on it.
struct CheckFacts {
  FaultCause fault = FaultCause::None;
  Verdict fault_verdict = Verdict::Error;  ///< what that fault ends a check with
  std::string fault_text;  ///< a sentence for the technician; empty: a plain one is made from the cause
  std::string refusal;     ///< why the check never began; empty: it did
  std::string problem;     ///< why the recorded runs cannot be used; empty if they can
  std::uint32_t repeats_planned = 0;
  std::uint32_t repeats_recorded = 0;
  std::uint64_t ticks_skipped = 0;
  std::uint64_t samples_lost = 0;
  double tracking_rms_N = 0.0;
  bool estimated = false;     ///< the joint fit converged to an identifiable estimate
  std::string estimate_text;  ///< the estimator's own words
  bool unexplained = false;   ///< there is none since no method explains the runs
  /// Why the estimate is not the configured method's, and what to do; empty if it is.
  std::string other_method;
  ParameterVector estimate;             ///< SI
  ParameterVector sd;                   ///< SI
  std::vector<EffectEstimate> effects;  ///< of an extended model, their sd with the tare's part
  double misfit_force = 0.0;            ///< residual rms over what the known noise explains
  double misfit_velocity = 0.0;
  bool misfit_counts =
      false;  ///< in `sd`: what the runs show that the model lacks (SystematicRecord::marked)
  /// The sheet's lines as judge_sheet() has them; none where there is no estimate or no sheet.
  std::vector<CharacteristicRecord> characteristics;
  std::optional<GuardBands> guard_bands;  ///< nothing: those of the limits, for a fixed number of repeats
};

struct Judgement {
  Verdict verdict = Verdict::Error;
  bool marginal = false;
  std::string reason;                                 ///< one sentence
  std::vector<ParameterRecord> parameters;            ///< empty where there is no estimate
  std::vector<CharacteristicRecord> characteristics;  ///< of the sheet, as they were given
  bool unexplained = false;                           ///< an ERROR since the model does not explain the runs
  bool undecided = false;  ///< a parameter or a characteristic is marginal or too uncertain to be judged
};

/// One value against its interval by guard band (JCGM 106): inside of both limits by more than k sd passes,
/// outside of one by more than k sd fails, anything between is marginal.
ParameterVerdict judge_parameter(double value, double sd, const LimitInterval& limits, double guard_band_k);

/// The sheet's characteristics by the same rule. A brake that does not get there fails if there is a limit;
/// what is not known has no verdict.
std::vector<CharacteristicRecord> judge_sheet(const std::vector<Characteristic>& characteristics,
                                              const std::vector<CharacteristicEstimate>& estimates,
                                              double guard_band_k);

/// The verdict. In this order:
/// a fault: its own verdict (ABORTED for a stop, TIMEOUT for a phase and the deadline, ERROR for the rest); a
/// start that was refused: ERROR; lost samples, skipped ticks above the limit, missing repeats, no estimate,
/// a fit that does not explain the runs, a characteristic with limits that is not known: ERROR; a parameter
/// or characteristic that fails: FAIL; a marginal one: decided by its value alone, with `marginal` set,
/// unless its guard bands overlap, since then no value could pass: ERROR; a brake that passes but was not
/// driven along the trajectory: ERROR. A brake that fails may have been tracked badly for that very reason:
/// this stays a FAIL. Parameters of effects are judged where there are limits for them; a limit where no
/// value can lie beyond (no play is less than 0) leaves no doubt, and so needs no guard band.
Judgement judge(const CheckFacts& facts, const LimitSet& limits, const ValiditySettings& validity);

/// 0 pass, 1 fail, 3 error, 4 aborted, 5 timed out.
int exit_code(Verdict verdict);

}  // namespace clampd
