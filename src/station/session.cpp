#include "clampd/station/session.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/record/text.hpp"
#include "clampd/record/utc.hpp"
#include "clampd/station/cause.hpp"
#include "clampd/station/evidence.hpp"
#include "clampd/station/verdict.hpp"

namespace clampd {
namespace {

constexpr std::uint32_t kMaxRepeats = 200;
constexpr std::size_t kMaxText = 80;

/// Another method is advised from such a gain in certainty on: half as many repeats would do.
constexpr double kWorthAdvice = 0.7;

std::string or_configured(const std::string& asked, const std::string& configured) {
  return asked.empty() ? configured : asked;
}

std::string json_text(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted + '"';
}

/// The configuration admits no control characters, so that quotes and backslashes are all there is to escape.
std::string instruments_json(const std::vector<Instrument>& instruments) {
  std::string text = "[";
  for (const Instrument& instrument : instruments) {
    if (text.size() > 1) text += ',';
    text += fmt::format(R"({{"name":{},"serial":{},"calibrated":{}}})", json_text(instrument.name),
                        json_text(instrument.serial), json_text(instrument.calibrated));
  }
  return text + "]";
}

EstimatorOptions estimator_options(const StationConfiguration& configuration) {
  EstimatorOptions options;
  options.start = configuration.model;
  return options;
}

/// Over all runs; 0 without any.
double tracking_rms_N(const std::vector<RunRecord>& runs) {
  double squares = 0.0;
  for (const RunRecord& run : runs) squares += run.tracking_rms_N * run.tracking_rms_N;
  return runs.empty() ? 0.0 : std::sqrt(squares / static_cast<double>(runs.size()));
}

}  // namespace

CheckRequest normalised(CheckRequest request) {
  for (std::string* text : {&request.serial, &request.operator_name, &request.part_number, &request.batch})
    *text = trimmed(*text);
  return request;
}

PlannedRepeats planned_repeats(const CheckRequest& request, const CheckSettings& settings) {
  if (request.repeats > 0) return {request.repeats, false};
  const bool automatic = request.repeats_auto || settings.repeats_auto;
  return {automatic ? settings.repeats_most : settings.repeats, automatic};
}

Result<void> validate(const CheckRequest& asked) {
  const CheckRequest request = normalised(asked);
  const auto check = [](std::string_view what, const std::string& text) -> Result<void> {
    if (text.size() > kMaxText)
      return failure(fmt::format("{} is longer than {} characters", what, kMaxText));
    for (const char c : text)
      if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f)
        return failure(fmt::format("{} contains control characters", what));
    if (!is_utf8(text))
      return failure(
          fmt::format("{} is no UTF-8: set the scanner or terminal to UTF-8, or type it again", what));
    return {};
  };
  if (request.serial.empty()) return failure("the serial number is empty; every check belongs to a brake");
  if (request.repeats_auto && request.repeats > 0)
    return failure(
        "a check takes either as many repeats as its brake needs or a number of them: ask for one of the "
        "two");
  if (request.repeats > kMaxRepeats)
    return failure(fmt::format("{} repeats are too many; at most {}", request.repeats, kMaxRepeats));
  for (const auto& [what, text] :
       {std::pair<std::string_view, const std::string&>{"the serial number", request.serial},
        {"the operator", request.operator_name},
        {"the part number", request.part_number},
        {"the batch", request.batch}})
    if (Result<void> checked = check(what, text); !checked) return checked;
  return {};
}

CheckSession::CheckSession(const StationConfiguration& configuration, const LimitSet& limits,
                           const CheckRequest& request, const CheckContext& context, Estimator estimator,
                           WorkerMode mode, Diagnoser diagnoser)
    : configuration_(configuration),
      limits_(limits),
      sheet_(context.sheet),
      started_utc_ns_(context.started_utc_ns),
      repeats_(planned_repeats(request, configuration.check)),
      trajectories_(context.trajectories),
      trajectories_sha256_(context.trajectories_sha256),
      stopping_(repeats_.automatic ? std::optional<StoppingRule>(std::in_place, limits.guard_band_k,
                                                                 repeats_.most, trajectories_.size() > 1)
                                   : std::nullopt),
      collector_(context.trajectory_rows),
      worker_(std::move(estimator), estimator_options(configuration), repeats_.most, mode, looks()),
      diagnoser_(std::move(diagnoser)) {
  CLAMPD_ASSERT(validate(request).has_value());
  record_.id = make_record_id(context.started_utc_ns);
  const CheckRequest asked = normalised(request);
  record_.serial = asked.serial;
  record_.part_number = or_configured(asked.part_number, configuration.part_number);
  record_.recipe = context.recipe;
  record_.batch = or_configured(asked.batch, configuration.batch);
  record_.station = configuration.name;
  record_.fixture = configuration.fixture;
  record_.operator_name = or_configured(asked.operator_name, configuration.operator_name);
  record_.software_version = context.software_version;
  record_.limits_file = limits.file;
  record_.limits_revision = limits.revision;
  record_.limits_sha256 = limits.sha256;
  if (sheet_) record_.sheet = SheetRecord{sheet_->file, sheet_->revision, sheet_->sha256, false, {}};
  record_.trajectory_sha256 = context.trajectory_sha256;
  record_.instruments = instruments_json(configuration.instruments);
  record_.method = std::string(to_string(configuration.check.method));
  record_.simulated = configuration.simulated_brake;
  record_.torque_while_off = context.torque_while_off;
  record_.started = format_utc(context.started_utc_ns);
  record_.repeats = repeats_.most;
}

Looks CheckSession::looks() {
  if (!stopping_) return {};
  return {StoppingRule::kFirstLook, [this](const std::vector<RunRecord>& runs, const Estimate& joint) {
            return look_at(runs, joint);
          }};
}

/// What the verdict would be if the check ended here and the station did its part. The tare, as the check's
/// first sample, was over before the first run, so that whoever identifies the runs may read it.
Look CheckSession::look_at(const std::vector<RunRecord>& runs, const Estimate& joint) const {
  CheckFacts facts;
  facts.tracking_rms_N = tracking_rms_N(runs);
  const std::optional<SystematicRecord> systematic = add_estimate(joint, runs, reading(), facts);
  const Judgement judgement = judge(facts, limits_, configuration_.validity);
  if (StoppingRule::is_enough(judgement, joint, systematic)) return {.is_enough = true};
  const std::span<const Characteristic> sheet =
      sheet_ ? std::span<const Characteristic>(sheet_->characteristics) : std::span<const Characteristic>();
  return {false, next_trajectory_for(judgement, joint, runs, trajectories_, sheet)};
}

void CheckSession::record_stopping(const CheckFacts& facts, const Judgement& judgement, const Estimate& joint,
                                   CheckRecord& record) const {
  if (!stopping_) return;
  std::string reason = "the check was ended before its time";
  const bool was_ended = facts.fault != FaultCause::None || !facts.refusal.empty();
  if (worker_.has_enough() && !was_ended) {
    record.repeats = static_cast<std::uint32_t>(record.runs.size());
    reason = fmt::format("every limit decided after {} runs", record.runs.size());
  } else if (record.runs.size() == repeats_.most && !was_ended) {
    reason = stopping_->why_most(judgement, joint, record.systematic);
  }
  const auto chosen = std::count_if(record.runs.begin(), record.runs.end(),
                                    [](const RunRecord& run) { return run.trajectory != 0; });
  if (chosen > 0) reason += fmt::format("; {} of the runs chosen for what was in doubt", chosen);
  record.stopping = StoppingRecord{repeats_.most, stopping_->coverage_factor(), std::move(reason), {}, {}};
  if (trajectories_.size() < 2) return;
  record.stopping->trajectories = trajectories_sha256_;
  for (const RunRecord& run : record.runs) record.stopping->followed.push_back(run.trajectory);
}

void CheckSession::consume(const Sample& sample) {
  std::optional<CollectedRun> run = collector_.consume(sample);
  samples_.store(collector_.samples(), std::memory_order_relaxed);
  if (run && recorded_.load(std::memory_order_relaxed) < repeats_.most && worker_.submit(std::move(*run)))
    recorded_.fetch_add(1, std::memory_order_relaxed);
}

CheckSession::Progress CheckSession::progress() const {
  return {samples_.load(std::memory_order_relaxed),
          repeats_.most,
          repeats_.automatic,
          recorded_.load(std::memory_order_relaxed),
          worker_.identified(),
          cause_searched_.load(std::memory_order_relaxed)};
}

const Diagnosis* CheckSession::name_cause(CheckRecord& record) {
  DiagnoseOptions options = diagnose_options(record, configuration_.model);
  options.progress = [this](double share, const std::string& words) {
    cause_searched_.store(share, std::memory_order_relaxed);
    if (search_.progress) search_.progress(share, words);
  };
  options.given_up = search_.given_up;
  Result<Diagnosis> diagnosis = diagnoser_(runs_of(record), options);
  if (!diagnosis) {
    record.reason += fmt::format(" The cause could not be sought: {}.", diagnosis.error().message);
    return nullptr;
  }
  diagnosis_ = std::move(*diagnosis);
  record.cause = cause_of(*diagnosis_);
  if (record.cause) record.reason += " " + diagnosis_->summary;
  return &*diagnosis_;
}

/// Where parameters are too near their limits for their uncertainty: whether the prediction error method,
/// tried on the same runs, knows one of them much better. `sd`: as judged, SI.
std::string CheckSession::advice_on_method(const CheckRecord& record, const ParameterVector& sd) const {
  const Estimate other =
      identify_brake(Method::PredictionError, runs_of(record), estimator_options(configuration_));
  if (!other.converged()) return {};
  const ParameterVector other_sd = sd_with_tare(other, collector_.tare());
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    if (record.parameters[i].verdict == ParameterVerdict::Marginal && other_sd[k] < kWorthAdvice * sd[k])
      return fmt::format(
          " The torque reading's noise makes the output error method so uncertain; by the prediction error "
          "method {} "
          "would be known to ± {:.2g} {} instead of ± {:.2g}: {}.",
          record.parameters[i].name, other_sd[k], record.parameters[i].unit, sd[k], kUsePredictionErrors);
  }
  return {};
}

/// A brake fails for what it is, not for how it was read: where readings or timing are at fault, and with
/// that taken into account no parameter fails any more, the verdict is the station's ERROR. So it is where
/// the force reading's scale is in doubt, by which stiffness and friction are read.
void CheckSession::question_failure(CheckRecord& record) {
  const std::string failure = record.reason;
  const Diagnosis* diagnosis = name_cause(record);
  if (diagnosis == nullptr) return;
  if (may_be_the_scale_of_force(*diagnosis)) {
    record.verdict = Verdict::Error;
    record.marginal = false;
    record.reason = fmt::format(
        "Force and torque contradict each other, so that nothing is said about the brake: {} Check the load "
        "cell's "
        "scale, then the gear. Read as if both were right: {}",
        diagnosis->summary, failure);
    return;
  }
  if (!is_in_the_readings(*diagnosis)) return;
  for (const ParameterRecord& failed : record.parameters) {
    if (failed.value >= failed.lower && failed.value <= failed.upper) continue;
    const auto index = find_parameter(failed.name);
    const auto after =
        std::find_if(diagnosis->parameters_after.begin(), diagnosis->parameters_after.end(),
                     [&](const EstimatedParameter& parameter) { return parameter.name == failed.name; });
    if (!index || after == diagnosis->parameters_after.end() ||
        judge_parameter(after->value, after->sd, limits_.intervals[*index], limits_.guard_band_k) ==
            ParameterVerdict::Fail)
      return;
  }
  record.verdict = Verdict::Error;
  record.marginal = false;
  record.reason = fmt::format(
      "The station reads the brake wrongly, so that nothing is said about the brake: {} "
      "Read as if that were right: {}",
      diagnosis->summary, failure);
}

EstimateReading CheckSession::reading() const {
  return {configuration_.model,
          collector_.tare(),
          configuration_.validity.torque_noise_Nm,
          is_by_output_errors(),
          limits_.guard_band_k,
          sheet_ ? &*sheet_ : nullptr,
          stopping_ ? &*stopping_ : nullptr,
          collector_.found_rad()};
}

/// What a verdict depends on. Takes the texts of `outcome`; what the estimate says of the record goes there.
CheckFacts CheckSession::facts_of(CheckOutcome& outcome, const Estimate& joint, CheckRecord& record) const {
  CheckFacts facts;
  facts.fault = outcome.fault;
  facts.fault_verdict = outcome.fault_verdict;
  facts.fault_text = std::move(outcome.fault_text);
  facts.refusal = std::move(outcome.refusal);
  facts.problem = collector_.problem();
  if (facts.problem.empty() && !record.runs.empty() && collector_.tare().samples == 0)
    facts.problem = "the sensors were not tared";
  facts.repeats_recorded = static_cast<std::uint32_t>(record.runs.size());
  facts.repeats_planned = worker_.has_enough() ? facts.repeats_recorded : repeats_.most;
  facts.ticks_skipped = record.timing.skipped;
  facts.samples_lost = record.timing.lost_samples;
  facts.tracking_rms_N = record.tracking_rms_N;
  record.systematic = add_estimate(joint, record.runs, reading(), facts);
  if (!facts.estimated) return facts;
  for (int row = 0; row < joint.covariance_normalised.rows(); ++row)
    for (int column = 0; column < joint.covariance_normalised.cols(); ++column)
      record.covariance_normalised.push_back(joint.covariance_normalised(row, column));
  record.noise_torque_Nm = joint.noise_torque_Nm;
  record.noise_force_N = joint.noise_force_N;
  record.noise_velocity_rad_s = joint.noise_velocity_rad_s;
  return facts;
}

bool CheckSession::is_by_output_errors() const {
  return configuration_.check.method == Method::OutputError && configuration_.check.model.empty();
}

CheckRecord CheckSession::finish(CheckOutcome outcome) {
  IdentificationWorker::Outcome identified = worker_.finish();
  const Estimate& joint = identified.joint;
  CheckRecord record = std::move(record_);
  record.runs = std::move(identified.runs);
  record.stopped = format_utc(std::max(outcome.stopped_utc_ns, started_utc_ns_));
  record.duration_s = collector_.duration_s();
  record.found_rad = collector_.found_rad();
  record.fault = outcome.fault;
  record.timing = std::move(outcome.timing);
  // A sample that the port or the ring lost is also a gap in what arrived here: the larger count is the true
  // one.
  record.timing.lost_samples =
      std::max({record.timing.lost_samples + outcome.health.lost_samples, collector_.samples_lost()});
  record.flight_recorder = std::move(outcome.flight_recorder);
  record.tracking_rms_N = tracking_rms_N(record.runs);

  if (collector_.tare().samples > 0) {
    const Eigen::Vector2d tare_sd = offset_sd(collector_.tare());
    record.tare_force_N = collector_.tare().force_offset_N;
    record.tare_velocity_rad_s = collector_.tare().velocity_offset_rad_s;
    record.tare_force_sd_N = tare_sd[0];
    record.tare_velocity_sd_rad_s = tare_sd[1];
  }

  const CheckFacts facts = facts_of(outcome, joint, record);
  Judgement judgement = judge(facts, limits_, configuration_.validity);
  record_stopping(facts, judgement, joint, record);
  record.verdict = judgement.verdict;
  record.marginal = judgement.marginal;
  record.reason = std::move(judgement.reason);
  record.parameters = std::move(judgement.parameters);
  if (record.sheet) {
    record.sheet->characteristics = std::move(judgement.characteristics);
    record.sheet->misfit_marked = facts.misfit_counts;
  }
  if (judgement.undecided && !facts.misfit_counts && is_by_output_errors())
    record.reason += advice_on_method(record, facts.sd);
  if (facts.misfit_counts && is_about_the_brake(record.verdict))
    record.reason += fmt::format(
        " Note: the model does not explain all of this brake's motion, and a parameter may be off by up to "
        "{:.2g} standard deviations of its noise; the uncertainties count it. `clampctl results {} --runs "
        "DIR` writes its runs for `clampctl diagnose`.",
        record.systematic->moved_sd, record.id);
  if (!configuration_.check.diagnose) return record;
  // Runs that nothing explains, or something else than the model, say nothing about limits: still an ERROR.
  if (judgement.unexplained && name_cause(record) && !record.cause && facts.other_method.empty())
    record.reason +=
        " A diagnosis finds no cause but noise: is validity.torque_noise_Nm too low, or do the runs differ?";
  // By the brake's motion alone it might have been judged, but for what the model lacks.
  if (judgement.undecided && facts.misfit_counts && record.verdict == Verdict::Error) name_cause(record);
  // An extended model already knows what is wrong with the readings.
  if (record.verdict == Verdict::Fail && configuration_.check.model.empty()) question_failure(record);
  return record;
}

}  // namespace clampd
