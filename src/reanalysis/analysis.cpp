#include "clampd/reanalysis/analysis.hpp"

#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/archive/compression.hpp"
#include "clampd/archive/json.hpp"
#include "clampd/base/json.hpp"
#include "clampd/base/version.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/identify/effect_scores.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/reanalysis/population.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/station/evidence.hpp"
#include "clampd/station/stopping.hpp"
#include "clampd/station/verdict.hpp"
#include "clampd/station/worker.hpp"
#include "clampd/views/diagnosis_json.hpp"

namespace clampd::reanalysis {
namespace {

using nlohmann::ordered_json;

constexpr const char* kGiveSheet = "submit the job with --sheet FILE";

Tare tare_of(const ArchivedCheck& check, const Task& task) {
  if (!check.tare_force_sd_N || !check.tare_velocity_sd_rad_s) return {};
  const double of_one = std::sqrt(static_cast<double>(task.tare_samples));
  return {.samples = task.tare_samples,
          .force_sd_N = *check.tare_force_sd_N * of_one,
          .velocity_sd_rad_s = *check.tare_velocity_sd_rad_s * of_one};
}

FaultCause fault_of(const std::string& name) {
  for (std::size_t i = 0; i < kFaultCauseCount; ++i)
    if (to_string(static_cast<FaultCause>(i)) == name) return static_cast<FaultCause>(i);
  return FaultCause::None;
}

/// What the station found out while the brake was driven stays as it was.
CheckFacts facts_of(const ArchivedCheck& check, const Tare& tare) {
  CheckFacts facts;
  facts.fault = fault_of(check.fault);
  facts.fault_verdict = check.verdict;
  if (facts.fault != FaultCause::None) facts.fault_text = check.reason;
  if (tare.samples == 0) facts.problem = "the sensors were not tared";
  facts.repeats_planned = check.repeats;
  facts.repeats_recorded = static_cast<std::uint32_t>(check.runs.size());
  facts.ticks_skipped = check.ticks_skipped;
  facts.samples_lost = check.samples_lost;
  facts.tracking_rms_N = check.tracking_rms_N;
  return facts;
}

ordered_json parameters_json(const std::vector<ParameterRecord>& parameters) {
  ordered_json list = ordered_json::array();
  for (const ParameterRecord& parameter : parameters)
    list.push_back({{"name", parameter.name},
                    {"unit", parameter.unit},
                    {"value", number_or_null(parameter.value)},
                    {"sd", number_or_null(parameter.sd)},
                    {"lower", number_or_null(parameter.lower)},
                    {"upper", number_or_null(parameter.upper)},
                    {"verdict", to_string(parameter.verdict)}});
  return list;
}

ordered_json runs_json(const std::vector<RunRecord>& runs) {
  ordered_json list = ordered_json::array();
  for (const RunRecord& run : runs) {
    ordered_json estimate = ordered_json::array();
    for (const double value : run.estimate) estimate.push_back(number_or_null(value));
    list.push_back({{"name", run.run.name},
                    {"sha256", run.checksum_sha256},
                    {"converged", run.converged},
                    {"estimate", std::move(estimate)},
                    {"fit",
                     {{"force_rms_N", number_or_null(run.fit_force_rms_N)},
                      {"velocity_rms_rad_s", number_or_null(run.fit_velocity_rms_rad_s)}}}});
  }
  return list;
}

ordered_json covariance_json(const Estimate& joint) {
  ordered_json rows = ordered_json::array();
  if (!joint.converged()) return rows;
  for (const auto& matrix_row : joint.covariance_normalised.rowwise()) {
    ordered_json row = ordered_json::array();
    for (const double value : matrix_row) row.push_back(number_or_null(value));
    rows.push_back(std::move(row));
  }
  return rows;
}

ordered_json effects_json(const std::vector<EffectEstimate>& effects) {
  ordered_json list = ordered_json::array();
  for (const EffectEstimate& effect : effects)
    list.push_back({{"name", effect.effect},
                    {"parameter", effect.parameter},
                    {"unit", effect.unit},
                    {"value", number_or_null(effect.value)},
                    {"sd", number_or_null(effect.sd)}});
  return list;
}

ordered_json systematic_json(const std::optional<SystematicRecord>& systematic) {
  if (!systematic) return nullptr;
  return {{"marked", systematic->marked},
          {"p_value", number_or_null(systematic->p_value)},
          {"over_noise", number_or_null(systematic->over_noise)},
          {"moved_sd", number_or_null(systematic->moved_sd)}};
}

ordered_json estimate_json(const Estimate& joint) {
  return {{"converged", joint.converged()},
          {"termination", to_string(joint.termination)},
          {"message", joint.message},
          {"iterations", joint.iterations},
          {"covariance_normalised", covariance_json(joint)},
          {"runs_differ", joint.runs_differ},
          {"noise",
           {{"force_N", number_or_null(joint.noise_force_N)},
            {"velocity_rad_s", number_or_null(joint.noise_velocity_rad_s)},
            {"torque_Nm", number_or_null(joint.noise_torque_Nm)}}},
          {"fit",
           {{"force_rms_N", number_or_null(joint.force_rms_N)},
            {"velocity_rms_rad_s", number_or_null(joint.velocity_rms_rad_s)},
            {"log_likelihood", number_or_null(joint.log_likelihood)}}}};
}

std::string text_of(const ordered_json& document) {
  return document.dump(-1, ' ', false, ordered_json::error_handler_t::replace);
}

std::vector<Run> taken_out(std::vector<CollectedRun> collected) {
  std::vector<Run> runs;
  for (CollectedRun& each : collected) runs.push_back(std::move(each.run));
  return runs;
}

/// Nothing if it was given up.
std::optional<IdentificationWorker::Outcome> identify_runs(std::vector<CollectedRun> runs, const Task& task,
                                                           const std::function<bool()>& given_up) {
  EstimatorOptions options;  // one thread: workers stand beside each other, not threads
  options.start = task.nominal;
  IdentificationWorker worker(task.model ? estimator_of(*task.model) : estimator_of(task.method), options,
                              std::max<std::size_t>(runs.size(), 1), WorkerMode::Synchronous);
  for (CollectedRun& run : runs) {
    if (given_up()) return std::nullopt;
    worker.submit(std::move(run));
  }
  if (given_up()) return std::nullopt;
  return worker.finish();
}

/// With a null diagnosis if it was given up.
Result<ordered_json> diagnosis_of(const ArchivedCheck& check, const std::vector<Run>& runs, const Task& task,
                                  const std::function<bool()>& given_up) {
  DiagnoseOptions options;
  options.nominal = task.nominal;
  options.threads = 1;
  options.given_up = given_up;
  if (check.tare_force_sd_N && check.tare_velocity_sd_rad_s)
    options.tare_sd = SensorNoise{*check.tare_force_sd_N, *check.tare_velocity_sd_rad_s};
  const Result<Diagnosis> diagnosis = diagnose(runs, options);
  if (given_up()) return ordered_json(nullptr);
  if (!diagnosis) return tl::unexpected(diagnosis.error());
  ordered_json document = diagnosis_json(*diagnosis, {.runs = runs.size()});
  document.erase("wall_s");
  return document;
}

Result<ordered_json> scores_of(const std::vector<Run>& runs, const Task& task) {
  return score_effects(runs, task.nominal).map(scores_json);
}

/// By what a check is judged beside the limits, as its station did.
struct Criteria {
  std::optional<StoppingRule> stopping;  ///< nothing: a fixed number of repeats
  std::optional<Sheet> sheet;
};

Result<Criteria> criteria_of(const ArchivedCheck& check, const Task& task) {
  Criteria criteria;
  if (check.stopping) {
    if (check.stopping->most < StoppingRule::kFirstLook)
      return failure(fmt::format("check {}: it was allowed {} repeats at most on record, and no station looks before {}: its row in "
                                 "clampd.checks was changed",
                                 check.id, check.stopping->most, StoppingRule::kFirstLook));
    criteria.stopping.emplace(task.limits.guard_band_k, check.stopping->most, check.chose_runs);
  }
  // No characteristic counts a model's effects.
  if (task.model) return criteria;
  criteria.sheet = task.sheet;
  if (task.sheet || !check.sheet) return criteria;
  Result<Sheet> sheet = sheet_of(*check.sheet);
  if (!sheet)
    return failure(fmt::format("check {}: {}: {}", check.id, sheet.error().message, kGiveSheet));
  criteria.sheet = std::move(*sheet);
  return criteria;
}

ordered_json stopping_json(const ArchivedCheck& check, const std::optional<StoppingRule>& rule) {
  if (!check.is_stopping_known) return {{"rule", "not on record"}};
  if (!rule) return nullptr;
  return {{"rule", "auto"},
          {"most", rule->most()},
          {"coverage_factor", rule->coverage_factor()},
          {"recorded_coverage_factor", number_or_null(check.stopping->coverage_factor)}};
}

ordered_json judged_sheet_json(const std::optional<Sheet>& sheet, const Judgement& judgement,
                               const std::optional<SystematicRecord>& systematic) {
  if (!sheet) return nullptr;
  return sheet_json(SheetRecord{sheet->file, sheet->revision, sheet->sha256, systematic && systematic->marked,
                                judgement.characteristics});
}

Result<std::optional<std::string>> identify_check(const ArchivedCheck& check, std::vector<CollectedRun> runs,
                                                  const Task& task, const std::string& task_sha256,
                                                  const std::function<bool()>& given_up) {
  const Result<Criteria> criteria = criteria_of(check, task);
  if (!criteria) return tl::unexpected(criteria.error());
  const std::optional<IdentificationWorker::Outcome> outcome = identify_runs(std::move(runs), task, given_up);
  if (!outcome) return std::nullopt;
  const Estimate& joint = outcome->joint;
  const Tare tare = tare_of(check, task);
  CheckFacts facts = facts_of(check, tare);
  const std::optional<SystematicRecord> systematic =
      add_estimate(joint, outcome->runs,
                   {.model = task.nominal,
                    .tare = tare,
                    .torque_noise_Nm = task.validity.torque_noise_Nm,
                    .is_by_output_errors = task.method == Method::OutputError && !task.model,
                    .guard_band_k = task.limits.guard_band_k,
                    .sheet = criteria->sheet ? &*criteria->sheet : nullptr,
                    .stopping = criteria->stopping ? &*criteria->stopping : nullptr,
                    .found_rad = check.found_rad},
                   facts);
  if (facts.estimated && facts.fault == FaultCause::None && criteria->sheet &&
      criteria->sheet->characteristics.empty())
    return failure(fmt::format("check {}: it had no estimate, so that the lines of its sheet {} are not on record: {}",
                               check.id, criteria->sheet->file, kGiveSheet));
  const Judgement judgement = judge(facts, task.limits, task.validity);
  ordered_json document{
      {"schema", "clampd.reanalysis/2"},
      {"record", check.id},
      {"serial", check.serial},
      {"verdict", to_string(judgement.verdict)},
      {"marginal", judgement.marginal},
      {"reason", judgement.reason},
      {"method", to_string(joint.method)},
      {"parameters", parameters_json(judgement.parameters)},
      {"effects", effects_json(facts.effects)},
      {"misfit",
       {{"force", number_or_null(facts.misfit_force)}, {"velocity", number_or_null(facts.misfit_velocity)}}},
      {"systematic_misfit", systematic_json(systematic)},
      {"stopping", stopping_json(check, criteria->stopping)},
      {"sheet", judged_sheet_json(criteria->sheet, judgement, systematic)},
      {"estimate", estimate_json(joint)},
      {"limits",
       {{"file", task.limits.file}, {"revision", task.limits.revision}, {"sha256", task.limits.sha256}}},
      {"task_sha256", task_sha256},
      {"software_version", kVersion},
      {"runs", runs_json(outcome->runs)}};
  return text_of(document);
}

}  // namespace

Result<std::vector<CollectedRun>> unpack_runs(const ArchivedCheck& check) {
  std::vector<CollectedRun> runs;
  for (const ArchivedRun& archived : check.runs) {
    const std::string where = fmt::format("check {}, {}", check.id, archived.name);
    if (!archived.data)
      return failure(where +
                     ": its raw data are not in the database: they were dropped, or never published "
                     "([postgresql] raw_runs)");
    const Result<std::string> text = decompressed(*archived.data);
    if (!text) return failure(fmt::format("{}: its raw data are damaged: {}", where, text.error().message));
    if (const std::string found = sha256_hex(*text); found != archived.sha256)
      return failure(
          fmt::format("{}: its raw data are not those of the check: their SHA-256 is {}, on record "
                      "is {}",
                      where, found, archived.sha256));
    Result<LoadedRun> run = parse_run(*text, archived.name);
    if (!run) return failure(fmt::format("check {}: {}", check.id, run.error().message));
    runs.push_back({.run = std::move(run->run),
                    .repeat = static_cast<std::uint16_t>(runs.size()),
                    .trajectory = archived.trajectory,
                    .tracking_rms_N = archived.tracking_rms_N,
                    .tracking_max_N = archived.tracking_max_N});
  }
  return runs;
}

Result<std::optional<std::string>> analyse(const ArchivedCheck& check, std::vector<CollectedRun> runs,
                                           const Task& task, const std::string& task_sha256,
                                           const std::function<bool()>& given_up) {
  if (task.kind == Task::Kind::Identify)
    return identify_check(check, std::move(runs), task, task_sha256, given_up);
  const std::vector<Run> recorded = taken_out(std::move(runs));
  const bool scores = task.kind == Task::Kind::ScoreEffects;
  const Result<ordered_json> found =
      scores ? scores_of(recorded, task) : diagnosis_of(check, recorded, task, given_up);
  if (!found) return tl::unexpected(found.error());
  if (given_up() || found->is_null()) return std::nullopt;
  return text_of({{"schema", scores ? "clampd.effect_scores/2" : "clampd.archived_diagnosis/1"},
                  {"record", check.id},
                  {"serial", check.serial},
                  {scores ? "scores" : "diagnosis", *found},
                  {"task_sha256", task_sha256},
                  {"software_version", kVersion}});
}

}  // namespace clampd::reanalysis
