#include "tools/clampctl/settle_check.hpp"

#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/archive/json.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/diagnose/settle.hpp"
#include "clampd/station/cause.hpp"
#include "clampd/station/session.hpp"
#include "clampd/station/verdict.hpp"
#include "clampd/views/diagnosis_text.hpp"
#include "tools/cli/exit_code.hpp"

namespace clampd::ctl {

namespace {

nlohmann::ordered_json experiments_json(const std::vector<NextExperiment>& experiments) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const NextExperiment& experiment : experiments)
    list.push_back({{"manoeuvre", experiment.manoeuvre},
                    {"repeats", experiment.repeats},
                    {"expected_evidence_nats", experiment.expected_evidence_nats}});
  return list;
}

/// The record's reason with what is known now in the place of what was known then.
std::string settled_reason(const CheckRecord& record, const Diagnosis& diagnosis) {
  std::string reason = record.reason;
  const std::size_t said = record.cause ? reason.find(record.cause->summary) : std::string::npos;
  if (said != std::string::npos)
    reason.replace(said, record.cause->summary.size(), diagnosis.summary);
  else if (diagnosis.verdict != DiagnosisVerdict::Adequate)
    reason += " " + diagnosis.summary;
  return reason;
}

/// Makes what the diagnosis found the record's own, here and in the store.
Result<void> adopt(const Diagnosis& diagnosis, CheckRecord& record, CheckStore& store) {
  std::optional<CauseRecord> cause = cause_of(diagnosis);
  std::string reason = settled_reason(record, diagnosis);
  if (cause == record.cause && reason == record.reason) return {};
  record.cause = std::move(cause);
  record.reason = std::move(reason);
  return store.save_settled_cause(record.id, record.cause, record.reason);
}

}  // namespace

SettledCheck settle_check(CheckRecord& record, bench::EmbeddedStation& station, CheckStore& store,
                          const BrakeParameters& nominal, const bench::EmbeddedStation::Progress& progress,
                          const CauseSearch& search, cli::ProgressLine& line) {
  SettledCheck settled;
  if (record.fault != FaultCause::None || record.verdict == Verdict::Timeout || record.runs.empty()) {
    settled.problem = "nothing to settle: the check did not end by itself";
    return settled;
  }
  const std::vector<Run> runs = runs_of(record);
  SettleOptions options;
  options.diagnose = diagnose_options(record, nominal);
  options.diagnose.progress = search.progress;
  options.diagnose.given_up = search.given_up;
  std::string announced;
  options.announce = [&](const NextExperiment& next) {
    line.clear();
    announced += fmt::format("Next experiment: {}.\n", next.why);
  };
  const Drive drive = [&](const Run& trajectory, int repeats) -> Result<std::vector<Run>> {
    if (!is_driven(trajectory))
      return station.stand_by(trajectory.size()).map([](Run&& off) { return std::vector{std::move(off)}; });
    CheckRequest request;
    request.serial = record.serial;
    request.repeats = static_cast<std::uint32_t>(repeats);
    if (const Result<void> usable = station.use_trajectory(trajectory); !usable)
      return tl::unexpected(usable.error());
    request.operator_name = record.operator_name;
    request.part_number = record.part_number;
    request.batch = record.batch;
    Result<CheckRecord> further = station.run_check(request, nullptr, progress);
    if (!further) return tl::unexpected(further.error());
    if (further->fault != FaultCause::None || further->verdict == Verdict::Timeout ||
        further->runs.size() < request.repeats) {
      settled.exit_code = exit_code(further->verdict);
      std::string why = "the experiment did not end by itself: " + further->reason;
      if (const Result<void> saved = store.save(*further); !saved)
        why += "; and its record could not be saved: " + saved.error().message;
      return failure(std::move(why));
    }
    std::vector<Run> driven;
    for (RunRecord& run : further->runs) driven.push_back(std::move(run.run));
    // The sensors' zeros are those of the first check: two tares differ by more than many runs overlook.
    for (Run& run : driven) {
      for (double& force_N : run.force_N) force_N += further->tare_force_N - record.tare_force_N;
      for (double& velocity_rad_s : run.velocity_rad_s)
        velocity_rad_s += further->tare_velocity_rad_s - record.tare_velocity_rad_s;
    }
    return driven;
  };

  // A check that the model did not explain has been diagnosed already, from the same runs.
  std::optional<Diagnosis> known = station.take_diagnosis();
  Result<Diagnosis> first = known ? Result<Diagnosis>(*std::move(known)) : diagnose(runs, options.diagnose);
  if (!first) {
    settled.problem = first.error().message;
    if (search.given_up()) settled.exit_code = cli::kAborted;
    return settled;
  }
  const auto take_over = [&](const Diagnosis& diagnosis, const std::vector<NextExperiment>& experiments) {
    const Result<void> adopted = adopt(diagnosis, record, store);
    if (!adopted)
      settled.problem = "what was found could not be saved with the record: " + adopted.error().message;
    if (record.cause) settled.experiments = experiments_json(experiments);
  };
  Result<Settlement> settlement = settle(*first, runs, drive, options);
  if (!settlement) {
    settled.text = announced + diagnosis_text(*first, {.runs = runs.size()}, cli::colours_wanted());
    take_over(*first, {});
    settled.problem = settlement.error().message;
    if (!settled.exit_code) settled.exit_code = cli::kStation;
    return settled;
  }
  settled.text = announced + diagnosis_text(settlement->diagnosis, {.runs = settlement->runs.size()},
                                            cli::colours_wanted());
  if (!settlement->experiments.empty() || settlement->diagnosis.verdict == DiagnosisVerdict::Ambiguous)
    settled.text += fmt::format("\nSettling: {}.\n", settlement->words);
  take_over(settlement->diagnosis, settlement->experiments);
  return settled;
}

}  // namespace clampd::ctl
