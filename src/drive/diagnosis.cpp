#include "clampd/drive/diagnosis.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>
#include <optional>
#include <set>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "clampd/drive/data_check.hpp"
#include "src/drive/gear.hpp"
#include "src/drive/next_motion.hpp"
#include "src/drive/parameters.hpp"
#include "src/drive/remainder.hpp"
#include "src/drive/steady_ripple.hpp"
#include "src/drive/withdrawal.hpp"

namespace clampd {
namespace {

using namespace drive;

struct UnseenReason {
  std::string_view name, reason;
};
constexpr std::array<UnseenReason, 4> kNeverSeen{{
    {"torque-gain", "every parameter is in units of the {} reading and would scale with it"},
    {"inertia-error", "the inertia is estimated or off; give a known value in the model file to test it"},
    {"velocity-lag", "position and velocity readings are compared before any model"},
    {"outliers", "single bad samples are looked for before any model"},
}};

/// A reading that is late by less than this many rows is put right without a word about the drive: a command
/// acts until the next row.
constexpr double kAlignedRows = 1.0;

/// Rows, their noise and the model that it was taken from.
struct Workshop {
  DriveData data;
  DriveRange range;
  std::unique_ptr<Design> design;
  SelectionOptions options;
};

Eigen::VectorXd known_torque(const DriveData& data, const DriveRange& range, const DriveModel& model) {
  const RowNoise white;
  const Design plain(data, white);
  Eigen::VectorXd known = Eigen::VectorXd::Zero(plain.rows());
  for (std::size_t t = 0; t < kDriveTermCount; ++t)
    if (model.parts[t].use == PartUse::Fixed)
      known +=
          model.parts[t].value *
          plain.rows_of(variants_of(static_cast<DriveTerm>(t), range, data, model).front().functions.front());
  for (std::size_t c = 0; c < model.regressors.size(); ++c)
    if (model.regressors[c].known_torque) known += plain.rows_of(known_torque_function(c));
  return known;
}

/// The shift within a row, if any, that makes the torque fit the motion.
double alignment_s(Selector& selector, const TorqueModel& rich, double sample_s) {
  double best_s = 0.0;
  TorqueModel best = rich;
  constexpr int kSteps = 8;
  for (int k = -kSteps; k <= kSteps; ++k) {
    if (k == 0) continue;
    std::vector<Variant> parts = rich.parts;
    Variant lag{DriveTerm::TorqueLag, "torque-lag", {}};
    lag.lag_s = k * kAlignedRows / kSteps * sample_s;
    parts.push_back(lag);
    TorqueModel shifted = selector.fitted(std::move(parts));
    if (shifted.ok() && shifted.fit.square < best.fit.square) {
      best = std::move(shifted);
      best_s = lag.lag_s;
    }
  }
  // At the end of what counts as aligned it is an effect, and looked for as such.
  const bool at_end = std::abs(best_s) > (kAlignedRows - 0.01) * sample_s;
  return at_end || selector.gain(best, rich) < 8.0 ? 0.0 : best_s;
}

void prepare_noise(Workshop& shop, const DriveModel& model, double false_alarm, int most_effects) {
  shop.range = range_of(shop.data);
  const Eigen::VectorXd known = known_torque(shop.data, shop.range, model);
  shop.options = {.false_alarm = false_alarm, .most_effects = most_effects};
  RowNoise noise;
  for (int round = 0; round < 2; ++round) {
    shop.design = std::make_unique<Design>(shop.data, noise);
    shop.design->set_known(known);
    Selector selector(*shop.design, shop.range, model, shop.options);
    const TorqueModel rich = selector.rich();
    if (!rich.ok()) return;
    if (round == 0) {
      noise = model.steady ? RowNoise{} : noise_of(shop.data, shop.design->residuals(rich.fit));
    } else {
      shop.options.overdispersion = shop.design->overdispersion(rich.fit);
      if (!model.steady && model.part(DriveTerm::TorqueLag).use != PartUse::Off &&
          rich.part(DriveTerm::TorqueLag) == nullptr)
        shop.options.lag_s = alignment_s(selector, rich, shop.data.sample_s);
    }
  }
}

GainFigures figures(const Design& design, const TorqueModel& model, const Remainder& remainder,
                    const Remainder& best) {
  GainFigures result;
  result.rms_force_N = result.rms_velocity_rad_s = kNaN;
  result.simulated_rms_force_N = result.simulated_rms_velocity_rad_s = kNaN;
  result.rms_torque_Nm = remainder.left;
  result.torque_error_relative = remainder.left / design.root_mean_square(model.fit.target);
  const double variance = remainder.left * remainder.left;
  result.log_likelihood_per_sample = -0.5 * (std::log(2.0 * M_PI * variance) + 1.0);
  const double z = remainder.correlation * std::sqrt(design.fitted_rows());
  result.whiteness_p_value = std::erfc(std::abs(z) / std::sqrt(2.0));
  result.misfit = variance / (best.left * best.left);
  return result;
}

std::vector<RunView> views_of(const Design& design, const TorqueModel& before, const TorqueModel& after) {
  std::vector<RunView> views;
  Eigen::Index row = 0;
  const auto list = [](const Eigen::VectorXd& values) {
    return std::vector<double>(values.data(), values.data() + values.size());
  };
  const Eigen::VectorXd left_before = design.residuals(before.fit), left_after = design.residuals(after.fit);
  for (const DriveRows& run : design.data().runs) {
    const auto size = static_cast<Eigen::Index>(run.size());
    if (!run.heldout) {
      RunView view;
      view.name = run.name;
      view.time_s = list(run.time_s);
      view.torque_Nm = list(run.torque);
      view.position_rad = list(run.position);
      view.velocity.measured = list(run.velocity);
      view.disturbance_before_Nm = list(left_before.segment(row, size));
      view.disturbance_after_Nm = list(left_after.segment(row, size));
      views.push_back(std::move(view));
    }
    row += size;
  }
  return views;
}

void add_ladder(const Selection& selection, Selector& selector, const Design& design, const DriveModel& model,
                Diagnosis& diagnosis) {
  std::set<std::string> rivals;
  for (const auto& group : diagnosis.rivals) rivals.insert(group.begin(), group.end());
  for (std::size_t s = 0; s < selection.stages.size(); ++s)
    for (std::size_t i = 0; i < selection.stages[s].trials.size(); ++i) {
      const Trial& trial = selection.stages[s].trials[i];
      CandidateSummary summary;
      summary.stage = static_cast<int>(s) + 1;
      summary.name = trial.variant.name;
      summary.location =
          trial.variant.term == DriveTerm::TorqueLag ? Location::Timing : Location::TorqueBalance;
      summary.predicted_gain = summary.gain = trial.gain;
      summary.parameters = static_cast<int>(std::max<std::size_t>(1, trial.variant.functions.size()));
      summary.significance_nats = std::max(0.0, trial.significance_nats);
      summary.p_value = std::min(1.0, selection.candidates * std::exp(-summary.significance_nats));
      summary.chosen = selection.stages[s].chosen == i;
      summary.rival = !summary.chosen && rivals.contains(summary.name);
      std::vector<Variant> parts = selection.base.parts;
      parts.push_back(trial.variant);
      if (const TorqueModel alone = selector.fitted(parts); alone.ok() && s == 0)
        summary.values = Estimate(design, alone, model).effect_parameters(alone.parts.back());
      diagnosis.candidates.push_back(std::move(summary));
      if (s == 0 && !trial.impossible.empty() && trial.significant)
        diagnosis.notices.push_back(
            fmt::format("{} is no explanation: {}", trial.variant.name, trial.impossible));
    }
}

NamedEffect named(const Variant& effect, const Selection& selection, Selector& selector,
                  const Estimate& estimate, std::string_view effort) {
  NamedEffect result;
  result.name = effect.name;
  result.words = words_of(effect.term, effort);
  result.location = effect.term == DriveTerm::TorqueLag ? Location::Timing : Location::TorqueBalance;
  result.parameters = estimate.effect_parameters(effect);
  std::vector<Variant> parts;
  for (const Variant& part : selection.best.parts)
    if (part.name != effect.name) parts.push_back(part);
  const TorqueModel without = selector.fitted(parts);
  if (!without.ok()) return result;
  result.log_likelihood_gain = selector.gain(selection.best, without);
  for (const Selection::Stage& stage : selection.stages)
    for (const Trial& trial : stage.trials)
      if (trial.variant.name == effect.name)
        result.p_value = std::min(result.p_value,
                                  selection.candidates * std::exp(-std::max(0.0, trial.significance_nats)));
  return result;
}

/// Periodic torques within runs at steady speeds, which count as one row each otherwise.
void add_steady_ripple(const SteadyRipple& ripple, const DriveModel& model, int candidates,
                       Diagnosis& diagnosis, std::vector<std::string>& words) {
  const std::string name(name_of(DriveTerm::Cogging));
  const Units units(model);
  if (!ripple.tested) {
    diagnosis.unseen.push_back({name, ripple.reason});
    return;
  }
  CandidateSummary summary;
  summary.name = name;
  summary.predicted_gain = summary.gain = ripple.gain;
  summary.parameters = static_cast<int>(2 * ripple.orders.size());
  summary.significance_nats = ripple.significance_nats;
  summary.chosen = !ripple.orders.empty();
  int number = 0;
  for (const SteadyRipple::Order& order : ripple.orders) {
    const std::string suffix = fmt::format("-{}", ++number);
    summary.values.push_back({"order" + suffix, units.order, order.order, kNaN});
    if (!std::isnan(order.forward))
      summary.values.push_back({"amplitude-forward" + suffix, units.torque, order.forward, order.forward_sd});
    if (!std::isnan(order.backward))
      summary.values.push_back(
          {"amplitude-backward" + suffix, units.torque, order.backward, order.backward_sd});
    diagnosis.notices.push_back(
        fmt::format("within the steady runs, order {} makes {:.0f} % of the {}'s variance", order.order,
                    100.0 * order.share, model.effort()));
  }
  if (summary.chosen) {
    NamedEffect effect;
    effect.name = name;
    effect.words = words_of(DriveTerm::Cogging, model.effort());
    effect.parameters = summary.values;
    effect.log_likelihood_gain = ripple.gain;
    effect.p_value = std::min(1.0, candidates * std::exp(-ripple.significance_nats));
    words.push_back(effect.words);
    diagnosis.effects.push_back(std::move(effect));
  }
  diagnosis.candidates.push_back(std::move(summary));
}

std::string listed(const std::vector<std::string>& words) {
  std::string text;
  for (std::size_t i = 0; i < words.size(); ++i)
    text += (i == 0 ? "" : i + 1 == words.size() ? "; and " : "; ") + words[i];
  return text;
}

/// What the rest is like, for the sentence that says why the verdict is what it is.
std::string rest_words(const Remainder& rest, const std::vector<DependenceTest>& left, const Units& units) {
  std::string names;
  for (std::size_t i = 0; i < std::min<std::size_t>(2, left.size()); ++i)
    if (left[i].dependence.variable != "time" && left[i].dependence.variable != "run")
      names += (names.empty() ? "" : " and ") + left[i].dependence.variable;
  if (rest.explainable >= 0.1 && !names.empty())
    return fmt::format("depends on {}: a function of the columns could take {:.0f} % of its square", names,
                       100.0 * rest.explainable);
  if (rest.correlation > 0.35)
    return "is smooth in time, but neither in position nor in velocity: no column shows it";
  return fmt::format("is irregular from row to row and more than the readings' own noise ({:.2g} {})",
                     rest.noise, units.torque);
}

struct RecordedRuns {
  std::vector<Run> runs;  ///< with the held-out ones behind, mended
  std::vector<DataFinding> findings;
};

Result<RecordedRuns> recorded_runs(std::span<const Run> runs, std::span<const Run> heldout,
                                   const DriveModel& model) {
  RecordedRuns readings;
  readings.runs.assign(runs.begin(), runs.end());
  readings.runs.insert(readings.runs.end(), heldout.begin(), heldout.end());
  for (const Run& run : readings.runs)
    if (run.size() < kLeastSamples)
      return failure(fmt::format("{}: {} rows are too few; a drive's run needs {}", run.name, run.size(),
                                 kLeastSamples));
  Result<CheckedData> checked = check_data(readings.runs, model);
  if (!checked) return tl::unexpected(checked.error());
  if (checked->stops()) return failure(stop_message(*checked));
  if (!checked->runs.empty()) readings.runs = std::move(checked->runs);
  readings.findings = std::move(checked->findings);
  return readings;
}

/// How much later than its reading the torque seems to act.
double delay_s(const std::vector<DataFinding>& findings) {
  const auto delay = std::ranges::find(findings, "torque-delay", &DataFinding::name);
  return delay == findings.end() ? 0.0 : -delay->size;
}

/// What was done to the readings before any model saw them.
void add_preparation(const Workshop& shop, const DriveModel& model, Diagnosis& diagnosis) {
  diagnosis.notices = shop.data.notices;
  diagnosis.rows = shop.data.rows;
  if (!model.steady)
    diagnosis.notices.push_back(fmt::format("both sides of the {} balance are filtered at {:.3g} Hz",
                                            model.effort(), shop.data.cut_off_Hz));
  if (shop.options.lag_s != 0.0)
    diagnosis.data.push_back(
        {"torque-delay", model.columns.torque->column, shop.data.runs.front().name, shop.options.lag_s, "s",
         DataFinding::Severity::Mended,
         fmt::format("the {} acts {:.2g} ms {} its reading, less than a row; it was shifted by that much",
                     model.effort(), 1e3 * std::abs(shop.options.lag_s),
                     shop.options.lag_s > 0.0 ? "after" : "before")});
}

FittedDrive fitted_drive(const Workshop& shop, const TorqueModel& best, const Selector& selector,
                         const Estimate& estimate, const DriveModel& model) {
  const Actuation actuation = selector.actuation_of(best.parts);
  FittedDrive fitted{model,
                     selector.terms_of(best),
                     estimate.covariance(),
                     actuation.lag_s,
                     actuation.settling_s,
                     shop.data.cut_off_Hz,
                     shop.data.slow_speed,
                     kNaN};
  if (!fitted.covariance.allFinite()) {  // too few rows to tell
    fitted.covariance.resize(0, 0);
    return fitted;
  }
  // Known values are certain.
  Eigen::Index coefficients = 0;
  for (const FittedTerm& term : fitted.terms)
    coefficients += static_cast<Eigen::Index>(term.coefficients.size());
  fitted.covariance.conservativeResizeLike(Eigen::MatrixXd::Zero(coefficients, coefficients));
  return fitted;
}

/// Parameters, named effects and the model that is saved. Returns the effects in words.
std::vector<std::string> add_model(const Workshop& shop, const Selection& selection, Selector& selector,
                                   const DriveModel& model, std::span<const Run> runs,
                                   DriveDiagnosis& diagnosis) {
  const Estimate before(*shop.design, selection.base, model), after(*shop.design, selection.best, model);
  diagnosis.parameters_before = before.base_parameters();
  diagnosis.parameters_after = after.base_parameters_with(selection.base.parts);
  std::vector<std::string> words;
  for (const Variant& effect : effects_of(selection)) {
    diagnosis.effects.push_back(named(effect, selection, selector, after, model.effort()));
    words.push_back(diagnosis.effects.back().words);
  }
  if (model.steady && model.part(DriveTerm::Cogging).use == PartUse::Candidate)
    add_steady_ripple(steady_ripple(runs, model, selection.alarm_nats), model, selection.candidates,
                      diagnosis, words);
  diagnosis.fitted = fitted_drive(shop, selection.best, selector, after, model);
  return words;
}

/// What the base model and the best one leave.
struct Rests {
  Remainder before, after;
  std::vector<DependenceTest> dependences;  ///< of what is left after
};

double inertia_in(const std::vector<EstimatedParameter>& parameters) {
  for (const EstimatedParameter& parameter : parameters)
    if (parameter.name == "inertia") return parameter.value;
  return 0.0;
}

Rests add_rests(const Design& design, const Selection& selection, const DriveModel& model,
                DriveDiagnosis& diagnosis) {
  Rests rests{remainder_of(design, selection.base, inertia_in(diagnosis.parameters_before)),
              remainder_of(design, selection.best, inertia_in(diagnosis.parameters_after)),
              dependences(design, selection.best, model)};
  rests.after.explainable = explainable_share(design, selection.best, model);
  diagnosis.share_left = rests.after.share;
  diagnosis.share_explainable = rests.after.explainable;
  diagnosis.fitted.error_rms = rests.after.left;
  diagnosis.misfit.tests_before = tests_of(design, selection.base, rests.before, model.effort());
  diagnosis.misfit.tests_after = tests_of(design, selection.best, rests.after, model.effort());
  for (const DependenceTest& test : rests.dependences)
    diagnosis.misfit.dependences.push_back(test.dependence);
  if (!rests.dependences.empty()) diagnosis.misfit.location = Location::TorqueBalance;
  return rests;
}

/// A negative inertia that is certain is none of a drive, however little is left. A torque that is read late
/// by tau loses tau times the viscous friction of it, to first order, so that the least such delay is known.
std::optional<DataFinding> negative_inertia(const DriveModel& model,
                                            const std::vector<EstimatedParameter>& parameters) {
  constexpr double kCertain_sds = 4.0;
  const auto inertia = std::ranges::find(parameters, "inertia", &EstimatedParameter::name);
  if (inertia == parameters.end() || !(inertia->value < -kCertain_sds * inertia->sd)) return std::nullopt;
  const auto viscous = std::ranges::find(parameters, "viscous", &EstimatedParameter::name);
  const std::string& column = model.columns.torque->column;
  const std::string what = fmt::format("with column {} the inertia would be negative, {:.3g} ± {:.1g} {}",
                                       column, inertia->value, inertia->sd, inertia->unit);
  if (viscous == parameters.end() || !(viscous->value > 0.0))
    return DataFinding{
        "negative-inertia",
        column,
        "",
        inertia->value,
        inertia->unit,
        DataFinding::Severity::Note,
        fmt::format("{}: {} and motion do not belong together, in time, sign or unit", what, model.effort())};
  const double delay_s = -inertia->value / viscous->value;
  return DataFinding{
      "torque-delay",
      column,
      "",
      delay_s,
      "s",
      DataFinding::Severity::Note,
      fmt::format("{}, as if it were recorded {:.2g} ms later than the motion, or more. Record both at the "
                  "same instant",
                  what, 1e3 * delay_s)};
}

/// Whether a model that leaves this explains the runs: as little as was asked for, or noise. Where the rows
/// are too few for the motion, their scatter tells no noise.
bool explains(const Remainder& rest, double good_enough, bool inertia_is_possible,
              const std::vector<DataFinding>& findings) {
  const bool noise_is_known = std::ranges::none_of(
      findings, [](const DataFinding& each) { return each.name == "sampling-too-slow"; });
  return inertia_is_possible && (rest.share < good_enough || (rest.is_noise() && noise_is_known));
}

void decide(const Rests& rests, const std::vector<std::string>& words, bool possible, const DriveModel& model,
            Diagnosis& diagnosis) {
  const Remainder& rest = rests.after;
  const bool enough = explains(rest, model.good_enough, possible, diagnosis.data);
  const bool structured = rest.explainable > kStructured && !rest.is_noise();
  const std::string what_is_left = rest_words(rest, rests.dependences, Units(model));
  const double percent = 100.0 * rest.share;
  const std::string share = fmt::format("{:.3g} % of the {}'s variation before, {:.3g} % after",
                                        100.0 * rests.before.share, model.effort(), percent);
  if (diagnosis.effects.empty() && enough) {
    diagnosis.verdict = DiagnosisVerdict::Adequate;
    diagnosis.summary = fmt::format(
        "{}: the base model explains the runs; {:.3g} % of the {}'s variation is left, {}.", model.name,
        percent, model.effort(),
        rest.is_noise() ? "no more than the readings' own noise" : "less than what is called good enough");
  } else if (diagnosis.effects.empty()) {
    diagnosis.verdict = DiagnosisVerdict::Unexplained;
    diagnosis.summary =
        !possible
            ? fmt::format(
                  "{}: the base model fits with a negative inertia only; {:.3g} % "
                  "of the {}'s variation is left.",
                  model.name, percent, model.effort())
            : fmt::format(
                  "{}: no known effect explains the {}; {:.3g} % of its variation is left, and that {}.",
                  model.name, model.effort(), percent, what_is_left);
  } else if (!enough) {
    diagnosis.verdict = DiagnosisVerdict::Unexplained;
    diagnosis.summary = fmt::format("{}: {}. Left: {}. The rest, {:.3g} %, {}.", model.name, listed(words),
                                    share, percent, what_is_left);
  } else {
    diagnosis.verdict = diagnosis.rivals.empty() ? DiagnosisVerdict::Explained : DiagnosisVerdict::Ambiguous;
    diagnosis.summary = fmt::format("{}: {}. Left: {}.", model.name, listed(words), share);
  }
  if (enough && structured) diagnosis.notices.push_back(fmt::format("what is left {}", what_is_left));
}

void add_gain(const Workshop& shop, const Selection& selection, const Rests& rests, Diagnosis& diagnosis) {
  HeldOutGain gain;
  gain.before = figures(*shop.design, selection.base, rests.before, rests.after);
  gain.after = figures(*shop.design, selection.best, rests.after, rests.after);
  for (const DriveRows& run : shop.data.runs)
    if (run.heldout) gain.runs.push_back(run.name);
  if (gain.runs.empty())
    diagnosis.notices.push_back(
        "no run was held out; the gain is judged by leaving out each fifth of the rows in turn");
  diagnosis.gain = std::move(gain);
}

/// Readings, checked and made into rows with their noise. The design refers to the data beside it.
Result<void> furnish(Workshop& shop, std::span<const Run> runs, const DriveModel& model,
                     const DiagnoseOptions& options, DriveDiagnosis& diagnosis) {
  const auto progress = [&](double share, const char* what) {
    if (options.progress) options.progress(share, what);
  };
  progress(0.0, "readings");
  Result<RecordedRuns> readings = recorded_runs(runs, options.heldout, model);
  if (!readings) return tl::unexpected(readings.error());
  progress(0.1, "motion");
  Result<DriveData> data = prepare(readings->runs, runs.size(), model, delay_s(readings->findings));
  if (!data) return tl::unexpected(data.error());
  readings->runs.clear();
  shop.data = std::move(*data);
  for (std::size_t c = 0; c < model.regressors.size(); ++c)
    if (model.regressors[c].use == PartUse::Estimate && is_constant(shop.data, c))
      return failure(fmt::format(
          "{}: {} is to be estimated, but is the same in all fitted runs; record runs that differ in "
          "it, or write use = \"candidate\"",
          model.file, model.regressors[c].name));
  progress(0.3, "noise");
  prepare_noise(shop, model, options.false_alarm, std::max(options.most_effects, 6));
  diagnosis.data = std::move(readings->findings);
  return {};
}

}  // namespace

Result<DriveDiagnosis> diagnose_drive(std::span<const Run> runs, const DriveModel& model,
                                      const DiagnoseOptions& options) {
  const auto started = std::chrono::steady_clock::now();
  const auto progress = [&](double share, const char* what) {
    if (options.progress) options.progress(share, what);
  };
  DriveDiagnosis diagnosis;
  Workshop shop;
  if (const Result<void> furnished = furnish(shop, runs, model, options, diagnosis); !furnished)
    return tl::unexpected(furnished.error());
  Design& design = *shop.design;
  Selector selector(design, shop.range, model, shop.options);
  add_preparation(shop, model, diagnosis);
  Selection selection = selected_effects(selector, design, shop.range, model, diagnosis.notices,
                                         [&](double share) { progress(0.4 + 0.5 * share, "effects"); });
  if (!selection.base.ok())
    return failure(fmt::format(
        "{}: the base model cannot be fitted: its parts are off, or the runs do not tell them apart; record "
        "both directions and several speeds, or give known values in [model]",
        model.file));
  progress(0.9, "what is left");

  selector.find_rivals(selection);
  diagnosis.rivals = selection.rivals;
  const std::vector<std::string> words = add_model(shop, selection, selector, model, runs, diagnosis);
  std::ranges::move(gear_findings(design, diagnosis.fitted, selector.actuation_of(selection.best.parts)),
                    std::back_inserter(diagnosis.data));
  diagnosis.alarm_evidence = selection.alarm_nats;
  add_ladder(selection, selector, design, model, diagnosis);
  const Rests rests = add_rests(design, selection, model, diagnosis);
  if (!std::isfinite(rests.after.share) || !std::isfinite(rests.before.share))
    return failure(fmt::format("{}: the {} does not change in the runs, so that nothing can be told of it",
                               model.name, model.effort()));
  const std::optional<DataFinding> negative = negative_inertia(model, diagnosis.parameters_after);
  if (negative) diagnosis.data.push_back(*negative);
  decide(rests, words, !negative, model, diagnosis);
  diagnosis.next_experiment = next_motion(diagnosis.fitted, diagnosis.rivals, selection.unseen, shop.range);
  for (const auto& [name, reason] : selection.unseen) diagnosis.unseen.push_back({name, reason.reason});
  for (const UnseenReason& each : kNeverSeen)
    diagnosis.unseen.push_back(
        {std::string(each.name), fmt::format(fmt::runtime(each.reason), model.effort())});
  add_gain(shop, selection, rests, diagnosis);
  if (options.views) diagnosis.views = views_of(design, selection.base, selection.best);
  diagnosis.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  progress(1.0, "done");
  return diagnosis;
}

Result<DriveIdentification> identify_drive(std::span<const Run> runs, const FittedDrive& saved) {
  const DriveModel& model = saved.model;
  if (const std::vector<std::string> names = terms_of_runs(saved); !names.empty())
    return failure(
        fmt::format("{}: {} differs from run to run of the fit, so that other runs have nothing of it; "
                    "`clampctl diagnose` looks at them anew",
                    model.file, fmt::join(names, ", ")));
  DriveDiagnosis diagnosis;
  Workshop shop;
  if (const Result<void> furnished = furnish(shop, runs, model, {}, diagnosis); !furnished)
    return tl::unexpected(furnished.error());
  shop.options.lag_s = 0.0;  // the saved model has its own
  Selector selector(*shop.design, shop.range, model, shop.options);
  const TorqueModel refitted = selector.refitted(saved);
  if (!refitted.ok())
    return failure(
        fmt::format("{}: these runs do not tell the terms of the model apart: record motion like that "
                    "of the fit, in both directions and at several speeds",
                    model.file));
  add_preparation(shop, model, diagnosis);
  const Estimate estimate(*shop.design, refitted, model);
  DriveIdentification result;
  result.parameters = estimate.base_parameters_with(refitted.parts);
  const Remainder rest = remainder_of(*shop.design, refitted, inertia_in(result.parameters));
  if (!std::isfinite(rest.share))
    return failure(fmt::format("{}: the {} does not change in the runs, so that nothing can be told of it",
                               model.name, model.effort()));
  result.share_left = rest.share;
  result.share_explainable = explainable_share(*shop.design, refitted, model);
  const std::optional<DataFinding> negative = negative_inertia(model, result.parameters);
  if (negative) diagnosis.data.push_back(*negative);
  result.is_enough = explains(rest, model.good_enough, !negative, diagnosis.data);
  result.data = std::move(diagnosis.data);
  result.notices = std::move(diagnosis.notices);
  result.fitted = fitted_drive(shop, refitted, selector, estimate, model);
  result.fitted.error_rms = rest.left;
  return result;
}

}  // namespace clampd
