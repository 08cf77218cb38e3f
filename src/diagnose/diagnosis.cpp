#include "clampd/diagnose/diagnosis.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/base/parallel.hpp"
#include "clampd/identify/residual_level.hpp"
#include "clampd/identify/validation.hpp"
#include "src/diagnose/evidence.hpp"
#include "src/diagnose/gain.hpp"
#include "src/diagnose/residuals.hpp"
#include "src/diagnose/selection.hpp"
#include "src/diagnose/words.hpp"

namespace clampd {

using namespace diagnosing;

namespace {

/// Of the tests of the residuals, that one of them speaks by chance.
constexpr double kFalseResidual = 0.003;
/// What no candidate explains must be worth so many nats before it counts, and so large a share of what the
/// named effects explain: a real effect never has quite the candidate's form.
constexpr double kLeastUnexplained_nats = 8.0;
constexpr double kUnexplainedShare = 0.04;
/// Effects that leave so many times what they explain are none of them what is wrong, the first or several,
/// nor are several with a torque noisier than any drive's: neither further ones nor the question which of
/// them help most are worth the time.
constexpr double kLostAtOnce = 10.0;
constexpr double kLost = 2.0;
constexpr std::size_t kSeveral = 2;
/// An effect whose strength these runs know no better than this, over the change that matters, was not seen.
constexpr double kBlind = 0.5;
constexpr std::size_t kMaxRivals = 3;
/// Dependences worth telling: no fainter than this share of the strongest, and no more than these.
constexpr double kFaint = 0.3;
constexpr std::size_t kMaxDependences = 8;
constexpr std::size_t kFewestRows = 30;

Result<void> check(std::span<const Run> runs) {
  if (runs.empty()) return failure("no run to diagnose");
  for (const Run& run : runs) {
    if (run.force_N.empty() || run.velocity_rad_s.empty())
      return failure(
          fmt::format("run {}: a diagnosis of the brake needs readings of force and velocity; describe a "
                      "drive without them "
                      "by a model file",
                      run.name));
    if (run.size() < kFewestRows)
      return failure(fmt::format("run {}: {} rows are too few; a diagnosis needs at least {}", run.name,
                                 run.size(), kFewestRows));
  }
  return check_runs(runs);
}

/// A standard deviation of so many times the nominal value says nothing; as where a brake is identified.
constexpr double kUndetermined = 3.0;

/// NaN where the runs do not determine a parameter.
std::vector<EstimatedParameter> base_parameters(const Hypothesis& hypothesis) {
  const ExtendedEstimate& estimate = hypothesis.estimate;
  constexpr auto kCount = static_cast<Eigen::Index>(kParameterCount);
  Eigen::VectorXd sds = Eigen::VectorXd::Constant(kCount, NAN);
  if (estimate.covariance.rows() >= kCount) sds = estimate.covariance.diagonal().head(kCount).cwiseSqrt();
  // A singular information has no inverse, but tells of some parameters all the same.
  if (!sds.allFinite())
    if (const StepForecast told = forecast(hypothesis.runs, estimate, hypothesis.threads);
        told.sd.size() >= kCount)
      sds = told.sd.head(kCount);
  std::vector<EstimatedParameter> list;
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    const double theta = estimate.parameters.base.theta[at];
    const double sd = sds[at];
    // What the runs do not determine stays where the search began: this is no estimate.
    const bool is_known = sd < kUndetermined * std::abs(kParameterTable[i].nominal);
    list.push_back({std::string(kParameterTable[i].name), std::string(kParameterTable[i].unit),
                    is_known ? theta : NAN, is_known ? sd : NAN});
  }
  return list;
}

/// Adds to the covariance of the model's own parameters how far they lie elsewhere under hypotheses that do
/// as well or nearly, by their likelihood: which of them is true is not known.
void count_alternatives(std::span<const Hypothesis* const> others, Hypothesis& chosen) {
  using Theta = Eigen::Matrix<double, kParameterCount, 1>;
  double weights = 1.0;
  Eigen::Matrix<double, kParameterCount, kParameterCount> spread = decltype(spread)::Zero();
  for (const Hypothesis* other : others) {
    const double weight = std::exp(std::min(0.0, other->log_likelihood() - chosen.log_likelihood()));
    const Theta apart = other->estimate.parameters.base.theta - chosen.estimate.parameters.base.theta;
    weights += weight;
    spread += weight * apart * apart.transpose();
  }
  Eigen::MatrixXd& covariance = chosen.estimate.covariance;
  if (covariance.rows() >= spread.rows())
    covariance.topLeftCorner<kParameterCount, kParameterCount>() += spread / weights;
}

std::vector<EstimatedParameter> effect_parameters(const ExtendedEstimate& estimate, std::size_t effect) {
  std::vector<EstimatedParameter> list;
  auto at = static_cast<Eigen::Index>(kParameterCount);
  Eigen::Index free_state = 2;
  for (std::size_t e = 0; e < effect; ++e) {
    for (const EffectParameter& parameter : info_of(*estimate.parameters.effects[e].effect).parameters)
      at += is_estimated(parameter);
    free_state += info_of(*estimate.parameters.effects[e].effect).free_states;
  }
  const EffectValues& values = estimate.parameters.effects[effect];
  const EffectInfo& info = info_of(*values.effect);
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    const bool chosen = !is_estimated(info.parameters[i]);
    list.push_back({std::string(info.parameters[i].name), std::string(info.parameters[i].unit),
                    values.values[i],
                    chosen || estimate.covariance.rows() <= at ? NAN : std::sqrt(estimate.covariance(at, at)),
                    std::string(choice_of(info.parameters[i], values.values[i]))});
    at += !chosen;
  }
  if (info.free_states > 0 && info.free_states_count) {
    // Its amplitude over all runs: the root of the mean square of the two phases.
    double square = 0.0;
    for (const Eigen::VectorXd& initial : estimate.initial_states)
      square += initial.segment(free_state, info.free_states).squaredNorm() /
                static_cast<double>(estimate.initial_states.size());
    list.push_back({"amplitude", "N", std::sqrt(square), NAN});
  }
  return list;
}

/// The chosen hypothesis, less sure of the seven parameters for all that does nearly as well.
Hypothesis averaged(const Selection& selection) {
  Hypothesis chosen = selection.chosen;
  const std::vector<Hypothesis> choices = otherwise_chosen(chosen);
  std::vector<const Hypothesis*> others;
  for (const Hypothesis& other : choices) others.push_back(&other);
  for (const Selected& selected : selection.effects)
    for (const Candidate& rival : selected.rivals) others.push_back(&rival.fitted);
  count_alternatives(others, chosen);
  return chosen;
}

CandidateSummary rung_of(const Candidate& candidate, int stage) {
  CandidateSummary summary;
  summary.stage = stage;
  summary.name = std::string(candidate.name());
  summary.location = info_of(*candidate.effect).location;
  summary.predicted_gain = candidate.predicted_gain;
  summary.parameters = static_cast<int>(candidate.degrees);
  summary.significance_nats =
      candidate.is_fitted ? candidate.significance_nats : candidate.predicted_significance_nats;
  summary.p_value = p_value_of(summary.significance_nats, static_cast<double>(effects().size()));
  if (candidate.is_fitted) {
    summary.gain = candidate.gain;
    if (candidate.fitted.possible())
      summary.values = effect_parameters(candidate.fitted.estimate,
                                         candidate.fitted.estimate.parameters.effects.size() - 1);
  }
  return summary;
}

/// Whether a brake is left with next to none of what every such brake has: then the effects beside it stand
/// for something else, as a friction of another law than the model's.
bool is_implausible(const ParameterVector& theta, const ParameterVector& nominal) {
  constexpr double kLeastShare = 0.1;
  for (std::size_t i = k2; i < kParameterCount; ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    if (theta[at] < kLeastShare * nominal[at]) return true;
  }
  return false;
}

/// Whether the runs alone show that the torque reading has not the offset of when the drive was off, nor any
/// other: as where a drive zeroes it whenever it is switched on.
bool contradicts(const TorqueWhileOff& off, const Hypothesis& base, std::span<const Run> runs) {
  constexpr double kPlainly_sds = 5.0, kNone_sds = 3.0;
  if (std::abs(off.mean_Nm) < kPlainly_sds * off.sd_Nm) return false;
  const auto catalogue = effects();
  const auto offset = std::find_if(catalogue.begin(), catalogue.end(), [](const Effect* effect) {
    return info_of(*effect).is_zero && info_of(*effect).location == Location::TorqueReading;
  });
  if (offset == catalogue.end()) return false;
  const EffectValues none{*offset, {0.0}};
  const StepForecast seen =
      forecast_each(fit_runs(runs), base.estimate, std::span(&none, 1), base.threads).front();
  if (seen.step.size() == 0) return false;
  const double offset_Nm = seen.step.tail(1)[0], sd_Nm = seen.sd.tail(1)[0];
  return std::abs(offset_Nm) < kNone_sds * sd_Nm &&
         std::abs(offset_Nm - off.mean_Nm) > kPlainly_sds * std::hypot(sd_Nm, off.sd_Nm);
}

/// An offset that the tare of these runs may well have left.
bool is_left_by_tare(const Selection& selection, std::size_t effect, const Eigen::MatrixXd& covariance,
                     const DiagnoseOptions& options) {
  const ExtendedParameters& model = selection.chosen.estimate.parameters;
  const EffectInfo& info = info_of(*model.effects[effect].effect);
  if (!info.is_zero || info.location == Location::TorqueReading || !options.tare_sd) return false;
  const ExtendedBrake brake(model);
  const auto places = brake.places();
  const auto at = std::find_if(places.begin(), places.end(),
                               [&](const ExtendedBrake::Place& place) {
                                 return place.effect == static_cast<int>(effect);
                               }) -
                  places.begin();
  const double tare_sd =
      info.location == Location::ForceReading ? options.tare_sd->force_N : options.tare_sd->velocity_rad_s;
  const double variance = covariance(at, at);
  // What an offset beyond the tare's explains better than one of the tare's, drawn from its distribution.
  const double gain = selection.effects[effect].gain * variance / (variance + tare_sd * tare_sd);
  return significance_of(gain, 1.0, 1.0) <= alarm_level(options.false_alarm);
}

class Progress {
 public:
  explicit Progress(const DiagnoseOptions& options) : options_(options) {}
  void operator()(double share, const std::string& words) const {
    if (options_.progress) options_.progress(share, words);
  }

 private:
  const DiagnoseOptions& options_;
};

/// What the search begins with.
struct Prepared {
  std::vector<Run> runs, heldout;  ///< with the drive on
  Hypothesis base;                 ///< the model without effects
  std::optional<TorqueWhileOff> torque_off;
  bool is_off_refuted =
      false;  ///< the runs show another offset of the torque reading than with the drive off
};

Result<Prepared> prepare(std::span<const Run> given, const DiagnoseOptions& options) {
  if (const auto valid = check(given); !valid) return tl::unexpected(valid.error());
  if (const auto valid = options.heldout.empty() ? Result<void>{} : check(options.heldout); !valid)
    return tl::unexpected(valid.error());
  Prepared prepared;
  prepared.runs = driven_runs(given);
  prepared.heldout = driven_runs(options.heldout);
  if (prepared.runs.empty())
    return failure("the drive was off in all runs (drive_enabled is 0): add runs in which the brake moves");

  Hypothesis& base = prepared.base;
  base.threads = ThreadBudget(threads_or_all(options.threads));
  prepared.torque_off = pooled(options.torque_while_off, torque_while_off(given));
  base.estimate = fit_base(prepared.runs, options.nominal, base.threads);
  if (!base.possible())
    return failure(
        "the base model cannot follow these runs at all: check columns and units, and that J and N are those "
        "of this brake");
  prepared.is_off_refuted = prepared.torque_off && contradicts(*prepared.torque_off, base, prepared.runs);
  if (prepared.is_off_refuted) prepared.torque_off.reset();
  base.runs = fit_runs(prepared.runs, prepared.torque_off);
  if (prepared.torque_off)
    base.estimate.log_likelihood = forecast(base.runs, base.estimate, base.threads).log_likelihood;
  settle(base);
  return prepared;
}

/// What the search ended with.
struct Found {
  Selection selection;
  Residuals before, after;  ///< what the base model leaves, and what the chosen one does
  double explained_nats = 0.0;
  bool lost = false;  ///< what is wrong is none of the candidates

  bool something_left() const {
    return after.neg_log_p > -std::log(kFalseResidual) && after.nats > kLeastUnexplained_nats;
  }
  bool much_left() const { return something_left() && after.nats > kUnexplainedShare * explained_nats; }
};

Result<Found> search(const Prepared& prepared, const DiagnoseOptions& options) {
  const Hypothesis& base = prepared.base;
  const auto given_up = [&] { return options.given_up && options.given_up(); };
  SelectionOptions selecting;
  selecting.most_effects = options.most_effects;
  selecting.false_alarm = options.false_alarm;
  selecting.progress = options.progress;
  selecting.given_up = options.given_up;

  Found found{Selection{base, base, {}, {}}, examine(base), {}};
  found.after = found.before;
  Selection& selection = found.selection;
  const auto look_at_the_rest = [&] {
    found.after = examine(selection.chosen);
    found.explained_nats = selection.chosen.log_likelihood() - base.log_likelihood();
  };
  while (!found.lost && !given_up() && add_effect(prepared.runs, selecting, selection)) {
    look_at_the_rest();
    const bool several = selection.effects.size() >= kSeveral;
    found.lost = found.after.nats > (several ? kLost : kLostAtOnce) * found.explained_nats ||
                 (several && is_torque_impossible(selection.chosen));
  }
  found.lost = found.lost || (selection.effects.size() >= kSeveral && found.much_left());
  if (!found.lost && !given_up() && reconsider(prepared.runs, selecting, selection)) look_at_the_rest();
  if (given_up()) return failure("the search was given up");
  // Where the base model got stuck, an effect may have explained no more than the way out.
  if (!selection.effects.empty() && is_stuck(base)) {
    const Hypothesis bare = without_any(selection.chosen, prepared.runs);
    if (bare.possible())
      found.explained_nats =
          std::min(found.explained_nats, selection.chosen.log_likelihood() - bare.log_likelihood());
  }
  return found;
}

/// Lists what the search named, but for offsets that the tare may have left, which become notices. True if
/// rivals are left, which the runs do not tell apart. `own_covariance`: of the chosen model by its
/// likelihood.
bool name_effects(const Selection& selection, const Eigen::MatrixXd& own_covariance,
                  const DiagnoseOptions& options, Diagnosis& diagnosis) {
  for (std::size_t e = 0; e < selection.effects.size(); ++e) {
    const Selected& selected = selection.effects[e];
    if (is_left_by_tare(selection, e, own_covariance, options)) {
      const EstimatedParameter offset = effect_parameters(selection.chosen.estimate, e).front();
      diagnosis.notices.push_back(
          fmt::format("{} of {:.2g} +- {:.1g} {} is no more than the tare may leave, and taken into account",
                      selected.name, offset.value, offset.sd, offset.unit));
      continue;
    }
    NamedEffect named;
    named.name = selected.name;
    named.location = info_of(*find_effect(selected.name)).location;
    named.parameters = effect_parameters(selection.chosen.estimate, e);
    named.log_likelihood_gain = selected.gain;
    named.p_value = p_value_of(selected.significance_nats, static_cast<double>(effects().size()));
    diagnosis.effects.push_back(std::move(named));
    if (selected.rivals.empty()) continue;
    std::vector<std::string> group{selected.name};
    std::vector<Diagnosis::Rival> models{
        {selected.name, selection.chosen.estimate.parameters, own_covariance}};
    for (const Candidate& rival : selected.rivals) {
      if (group.size() == kMaxRivals) break;
      group.emplace_back(rival.name());
      models.push_back(
          {std::string(rival.name()), rival.fitted.estimate.parameters, rival.fitted.estimate.covariance});
    }
    diagnosis.rivals.push_back(std::move(group));
    diagnosis.rival_models.push_back(std::move(models));
  }
  return !diagnosis.rivals.empty();
}

/// All candidates of all stages, after the effects were named; and what the runs could not have shown.
void list_candidates(const Selection& selection, Diagnosis& diagnosis) {
  for (std::size_t stage = 0; stage < selection.stages.size(); ++stage)
    for (const Candidate& candidate : selection.stages[stage]) {
      CandidateSummary summary = rung_of(candidate, static_cast<int>(stage) + 1);
      summary.chosen = stage < selection.effects.size() &&
                       std::any_of(diagnosis.effects.begin(), diagnosis.effects.end(),
                                   [&](const NamedEffect& named) { return named.name == summary.name; }) &&
                       &candidate == &selection.stages[stage].front();
      summary.rival = std::any_of(diagnosis.rivals.begin(), diagnosis.rivals.end(), [&](const auto& group) {
        return stage == 0 && std::find(group.begin(), group.end(), summary.name) != group.end();
      });
      diagnosis.candidates.push_back(std::move(summary));
    }
  if (!selection.stages.empty())
    for (const Candidate& candidate : selection.stages.front())
      if (candidate.blindness > kBlind && !candidate.is_fitted)
        diagnosis.unseen.push_back(
            {std::string(candidate.name()), unseen_words(*candidate.effect, candidate.blindness)});
}

/// Where the misfit is and what it depends on. `is_misplaced`: in no place that the named effects say.
void describe_misfit(const Found& found, bool is_misplaced, Diagnosis& diagnosis) {
  Misfit& misfit = diagnosis.misfit;
  const bool is_unexplained = diagnosis.verdict == DiagnosisVerdict::Unexplained;
  misfit.tests_before = found.before.tests;
  if (!found.selection.effects.empty()) misfit.tests_after = found.after.tests;
  misfit.explained_nats = found.explained_nats;
  if (found.something_left()) misfit.left_nats = found.after.nats;
  // Of what is left; if that tells nothing by itself, of what the base model leaves.
  const auto tells = [](const Residuals& residuals) {
    return !residuals.dependences.empty() && residuals.dependences.front().p_value < kFalseResidual;
  };
  const Residuals& told = is_unexplained && tells(found.after) ? found.after : found.before;
  // What is wrong in one place shows faintly in all others: the strongest say where.
  double strongest = 0.0;
  for (const Dependence& dependence : told.dependences) strongest = std::max(strongest, dependence.gain);
  for (const Dependence& dependence : told.dependences)
    if (dependence.p_value < kFalseResidual && dependence.gain > kFaint * strongest &&
        misfit.dependences.size() < kMaxDependences)
      misfit.dependences.push_back(dependence);
  if (diagnosis.verdict == DiagnosisVerdict::Adequate) return;
  if (!is_misplaced && !diagnosis.effects.empty())
    misfit.location = diagnosis.effects.front().location;
  else if (tells(told))
    misfit.location = told.dependences.front().location;
  else
    misfit.location = (is_unexplained ? found.after : found.before).hint;
}

/// What else a reader has to know of the runs and of the answer.
void add_notices(const Prepared& prepared, const Found& found, Diagnosis& diagnosis) {
  if (found.something_left() && diagnosis.verdict != DiagnosisVerdict::Unexplained &&
      !found.selection.effects.empty())
    diagnosis.notices.push_back(
        fmt::format("a little is left that these effects do not explain ({:.0f} of {:.0f} nats): they may "
                    "have another form than assumed",
                    found.after.nats, found.explained_nats));
  if (prepared.is_off_refuted)
    diagnosis.notices.push_back(
        "the torque reading with the drive off is left out: the runs show no such offset; does the drive set "
        "its zero when it is switched on?");
  if (const auto& off = prepared.torque_off)
    diagnosis.notices.push_back(fmt::format(
        "with the drive off, when no torque acts, its reading was {:.2f} +- {:.2f} mN m ({} rows)",
        1e3 * off->mean_Nm, 1e3 * off->sd_Nm, off->rows));
  if (prepared.runs.size() == 1)
    diagnosis.notices.push_back(
        "one run only: nothing that changes from run to run can be seen, and nothing could be held out");
}

/// What the search found, as it is reported: the verdict, names, misfit, models and parameters.
Diagnosis conclude(const Prepared& prepared, Found& found, const DiagnoseOptions& options,
                   const Progress& progress) {
  Selection& selection = found.selection;
  // The reported covariance is that over runs; rivals are compared by the models' own.
  const Eigen::MatrixXd own_covariance = selection.chosen.estimate.covariance;
  selection.chosen.estimate.covariance =
      covariance_over_runs(selection.chosen.runs, selection.chosen.estimate, selection.chosen.threads);
  const ResidualLevel level = residual_level(prepared.runs, selection.chosen.estimate.noise);
  const bool is_misplaced = found.lost || found.much_left() || level.far_above_noise;
  const bool is_unexplained = is_misplaced || (!selection.effects.empty() &&
                                               is_implausible(selection.chosen.estimate.parameters.base.theta,
                                                              options.nominal.theta));

  Diagnosis diagnosis;
  diagnosis.alarm_evidence = alarm_level(options.false_alarm);
  if (level.far_above_noise)
    diagnosis.notices.push_back(
        fmt::format("no model explains these runs, the best one takes for noise what is none ({}): its "
                    "numbers are no result",
                    level.words));
  const bool is_ambiguous = name_effects(selection, own_covariance, options, diagnosis);
  diagnosis.verdict = is_unexplained              ? DiagnosisVerdict::Unexplained
                      : diagnosis.effects.empty() ? DiagnosisVerdict::Adequate
                      : is_ambiguous              ? DiagnosisVerdict::Ambiguous
                                                  : DiagnosisVerdict::Explained;
  list_candidates(selection, diagnosis);
  describe_misfit(found, is_misplaced, diagnosis);

  diagnosis.model = selection.chosen.estimate.parameters;
  diagnosis.torque_while_off = prepared.torque_off;
  diagnosis.noise_before = prepared.base.estimate.noise;
  diagnosis.noise_after = selection.chosen.estimate.noise;
  diagnosis.parameters_before = base_parameters(prepared.base);
  // What no model explains makes no other form of one any likelier.
  diagnosis.parameters_after = base_parameters(is_unexplained ? selection.chosen : averaged(selection));
  progress(0.96, "judging by runs held out");
  diagnosis.gain =
      held_out_gain(prepared.runs, prepared.heldout, prepared.base, selection.chosen, diagnosis.notices);
  if (options.views) diagnosis.views = views_of(prepared.runs, prepared.base, selection.chosen);
  add_notices(prepared, found, diagnosis);
  diagnosis.summary = summary_words(diagnosis);
  return diagnosis;
}

}  // namespace

std::string_view to_string(DataFinding::Severity severity) noexcept {
  switch (severity) {
    case DataFinding::Severity::Note:
      return "note";
    case DataFinding::Severity::Mended:
      return "mended";
    case DataFinding::Severity::Stop:
      return "stop";
  }
  return "?";
}

std::string_view to_string(DiagnosisVerdict verdict) noexcept {
  switch (verdict) {
    case DiagnosisVerdict::Adequate:
      return "adequate";
    case DiagnosisVerdict::Explained:
      return "explained";
    case DiagnosisVerdict::Ambiguous:
      return "ambiguous";
    case DiagnosisVerdict::Unexplained:
      return "unexplained";
  }
  return "?";
}

Result<Diagnosis> diagnose(std::span<const Run> given, const DiagnoseOptions& options) {
  const auto began = std::chrono::steady_clock::now();
  const Progress progress(options);
  progress(0.0, "fitting the base model");
  const Result<Prepared> prepared = prepare(given, options);
  if (!prepared) return tl::unexpected(prepared.error());
  progress(0.12, "looking at what is left");
  Result<Found> found = search(*prepared, options);
  if (!found) return tl::unexpected(found.error());
  Diagnosis diagnosis = conclude(*prepared, *found, options, progress);
  diagnosis.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
  progress(1.0, "done");
  return diagnosis;
}

}  // namespace clampd
