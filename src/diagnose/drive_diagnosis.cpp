#include "clampd/diagnose/drive_diagnosis.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "src/diagnose/drive_fitted.hpp"
#include "src/diagnose/drive_residuals.hpp"
#include "src/diagnose/drive_ripple.hpp"
#include "src/diagnose/drive_search.hpp"

namespace clampd {
namespace {

using namespace drive;

struct UnseenReason {
  std::string_view name, reason;
};
constexpr std::string_view kNoForce = "a bare drive has no reading of clamp force";
constexpr std::array<UnseenReason, 18> kNeverSeen{{
    {"coulomb-load", kNoForce},
    {"stiffness-hysteresis", kNoForce},
    {"stiffness-shape", kNoForce},
    {"pad-damping", kNoForce},
    {"pad-relaxation", kNoForce},
    {"backlash", kNoForce},
    {"ratio-error", kNoForce},
    {"force-offset", kNoForce},
    {"force-lag", kNoForce},
    {"force-saturation", kNoForce},
    {"force-hum", kNoForce},
    {"torque-gain", "every parameter is in units of the torque reading and would scale with it"},
    {"torque-lag", "inverse dynamics takes torque and motion as simultaneous"},
    {"velocity-lag", "inverse dynamics takes torque and motion as simultaneous"},
    {"velocity-offset", "a bare drive's reading of velocity is taken as it is"},
    {"channel-skew", "inverse dynamics takes torque and motion as simultaneous"},
    {"inertia-error", "the inertia is estimated or off; give a known value in the model file to test it"},
    {"outliers", "rows are averages over several samples"},
}};

/// Effects that leave more than they explain are not the cause.
void reject_if_more_is_left(const Fitted& before, const DriveFit& fit, double false_alarm,
                            DriveSearchResult& found, std::vector<std::string>& notices) {
  if (found.chosen.empty()) return;
  std::vector<DriveComponent> components = found.base;
  components.insert(components.end(), found.chosen.begin(), found.chosen.end());
  const Fitted after = fitted(fit, components);
  const double explained = before.regression.residual_square - after.regression.residual_square;
  const std::vector<DependenceTest> left = dependences(after, fit, false_alarm);
  if (left.empty() || left.front().share * after.regression.residual_square < explained) return;
  std::vector<std::string_view> names;
  for (const DriveComponent& component : found.chosen) names.push_back(name_of(component.term));
  notices.push_back(fmt::format("{} would explain less than what would still depend on {}",
                                fmt::join(names, ", "), left.front().dependence.variable));
  found.chosen.clear();
  for (DriveSearchResult::Stage& stage : found.stages) {
    stage.winner.reset();
    stage.rivals.clear();
  }
}

/// Root mean square of the ripple's torque, and how unevenly the drive moves: the scatter of its speed about
/// its median, robustly, over that median.
std::pair<double, double> ripple_of(const DriveRows& run, const Eigen::VectorXd& ripple) {
  std::vector<double> speeds(run.velocity.data(), run.velocity.data() + run.velocity.size());
  const auto middle = [](std::vector<double>& values) {
    const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), at, values.end());
    return *at;
  };
  const double median = middle(speeds);
  for (double& speed : speeds) speed = std::abs(speed - median);
  return {std::sqrt(ripple.squaredNorm() / static_cast<double>(ripple.size())),
          1.4826 * middle(speeds) / std::abs(median)};
}

double variance_of(const Fitted& model) {
  return model.regression.residual_square /
         std::max(1.0, static_cast<double>(model.regression.residuals.size() - model.layout.count));
}

/// `best`: the model whose noise both are measured by.
GainFigures figures(const Fitted& model, const Fitted& best, double square, double torque_square,
                    double count) {
  GainFigures result;
  result.rms_force_N = result.rms_velocity_rad_s = kNaN;
  result.simulated_rms_force_N = result.simulated_rms_velocity_rad_s = kNaN;
  const double variance = variance_of(model);
  result.rms_torque_Nm = std::sqrt(square / count);
  result.torque_error_relative = std::sqrt(square / torque_square);
  result.log_likelihood_per_sample = -0.5 * std::log(2.0 * M_PI * variance) - 0.5 * square / count / variance;
  result.whiteness_p_value = whiteness(model.regression.residuals).p_value;
  result.misfit = square / count / variance_of(best);
  return result;
}

HeldOutGain heldout_gain(const Fitted& before, const Fitted& after, const DriveFit& fit,
                         const DriveData* heldout, std::vector<std::string>& notices) {
  HeldOutGain gain;
  if (heldout != nullptr) {
    const Eigen::VectorXd target = fit.target(*heldout);
    double torque_square = 0.0;
    for (const DriveRows& run : heldout->runs) {
      torque_square += run.torque.squaredNorm();
      gain.runs.push_back(run.name);
    }
    const auto square = [&](const Fitted& model) {
      return (target - DriveFit::columns(model.layout.components, *heldout) * model.regression.coefficients)
          .squaredNorm();
    };
    const auto count = static_cast<double>(target.size());
    gain.before = figures(before, after, square(before), torque_square, count);
    gain.after = figures(after, after, square(after), torque_square, count);
    return gain;
  }
  // Nothing to spare: one part left out after the other, the same parts before and after.
  for (const bool conditions : {true, false}) {
    const std::vector<int>& folds = conditions ? fit.conditions() : fit.blocks();
    const Regression first = regress(before.columns, fit.target(), folds);
    const Regression second = regress(after.columns, fit.target(), folds);
    double square_before = 0.0, square_after = 0.0, torque_square = 0.0, count = 0.0;
    int judged = 0;
    std::vector<bool> use;
    for (std::size_t f = 0; f < first.judged.size(); ++f) {
      use.push_back(first.judged[f] && second.judged[f]);
      if (!use.back()) continue;
      ++judged;
      square_before += first.heldout_square[f];
      square_after += second.heldout_square[f];
    }
    if (judged < 3 && conditions) continue;
    std::size_t row = 0;
    for (const DriveRows& run : fit.data().runs)
      for (Eigen::Index i = 0; i < run.torque.size(); ++i, ++row)
        if (use[static_cast<std::size_t>(folds[row])]) {
          torque_square += run.torque[i] * run.torque[i];
          count += 1.0;
        }
    gain.before = figures(before, after, square_before, torque_square, count);
    gain.after = figures(after, after, square_after, torque_square, count);
    notices.push_back(fmt::format(
        "no run was held out; the gain is judged by leaving out each of {} {} in turn", judged,
        fit.by_conditions() && conditions ? "combinations of direction and speed" : "parts of the runs"));
    break;
  }
  return gain;
}

std::vector<RunView> views_of(const DriveFit& fit, const Fitted& before, const Fitted& after) {
  std::vector<RunView> views;
  Eigen::Index row = 0;
  const auto list = [](const Eigen::VectorXd& values) {
    return std::vector<double>(values.data(), values.data() + values.size());
  };
  for (const DriveRows& run : fit.data().runs) {
    RunView view;
    const auto size = static_cast<Eigen::Index>(run.size());
    view.name = run.name;
    view.time_s = list(run.time_s);
    view.torque_Nm = list(run.torque);
    view.position_rad = list(run.position);
    view.velocity.measured = list(run.velocity);
    view.disturbance_before_Nm = list(before.regression.residuals.segment(row, size));
    view.disturbance_after_Nm = list(after.regression.residuals.segment(row, size));
    row += size;
    views.push_back(std::move(view));
  }
  return views;
}

/// While a drive slides, a difference of dry friction by direction and a constant torque are the same thing.
/// Where viscous friction is what makes the difference certain, that twin of its constant part is named all
/// the same.
void report_twin(const DriveSearchResult& found, const Fitted& after, const DriveFit& fit, const Units& units,
                 Diagnosis& diagnosis) {
  for (const std::vector<std::string>& group : diagnosis.rivals)
    for (const std::string& name : group)
      if (name == name_of(DriveTerm::TorqueOffset)) return;
  const Eigen::Index at = after.layout.at(DriveTerm::FrictionAsymmetry);
  const bool chosen = std::any_of(
      found.chosen.begin(), found.chosen.end(),
      [](const DriveComponent& component) { return component.term == DriveTerm::FrictionAsymmetry; });
  if (!chosen || after.layout.at(DriveTerm::TorqueOffset) >= 0 ||
      after.layout.at(DriveTerm::LoadPosition) >= 0)
    return;
  const EstimatedParameter offset = after.combined("offset", units.torque, {{at, 1.0}});
  std::vector<DriveComponent> alike = found.base;
  alike.push_back(shapes_of(DriveTerm::TorqueOffset, fit.range(), false).front());
  const Fitted symmetric = fitted(fit, alike);
  const EstimatedParameter alone =
      symmetric.combined("offset", units.torque, {{symmetric.layout.at(DriveTerm::TorqueOffset), 1.0}});
  diagnosis.rivals.push_back(
      {std::string(name_of(DriveTerm::FrictionAsymmetry)), std::string(name_of(DriveTerm::TorqueOffset))});
  diagnosis.notices.push_back(
      fmt::format("the viscous friction differs by direction for certain; the half difference of the dry "
                  "friction, {:.3g} +- "
                  "{:.2g} {}, may as well be a constant torque (with friction alike in both directions it "
                  "would be {:.3g} +- "
                  "{:.2g} {})",
                  offset.value, offset.sd, offset.unit, alone.value, alone.sd, alone.unit));
}

/// How evenly each run moves in spite of the ripple: a drive that compensates it moves evenly, while its
/// torque carries the ripple.
void report_ripple(const DriveFit& fit, const DriveData* heldout, const Fitted& after, const Units& units,
                   Diagnosis& diagnosis) {
  const Eigen::Index at = after.layout.at(DriveTerm::Cogging);
  if (at < 0) return;
  const DriveComponent* cogging = nullptr;
  for (const DriveComponent& component : after.layout.components)
    if (component.term == DriveTerm::Cogging) cogging = &component;
  const auto count = static_cast<Eigen::Index>(cogging->columns.size());
  const auto over = [&](const DriveData& data, const char* name) {
    const Eigen::VectorXd ripple =
        DriveFit::columns({*cogging}, data) * after.regression.coefficients.segment(at, count);
    Eigen::Index row = 0;
    double torque = 0.0;
    double unevenness = 0.0;
    for (const DriveRows& run : data.runs) {
      const auto size = static_cast<Eigen::Index>(run.size());
      const auto [rms, uneven] = ripple_of(run, ripple.segment(row, size));
      row += size;
      torque += rms / static_cast<double>(data.runs.size());
      unevenness += uneven / static_cast<double>(data.runs.size());
    }
    diagnosis.misfit.tests_after.push_back(
        {name, unevenness, kNaN,
         fmt::format("speed scatters by {:.3g} % of its median while the ripple takes {:.3g} {} rms",
                     100.0 * unevenness, torque, units.torque)});
    return unevenness;
  };
  // A speed that changes on purpose says nothing.
  if (fit.both_directions()) return;
  const double fitted_runs = over(fit.data(), "unevenness of the motion");
  if (heldout == nullptr || !fit.data().position_absolute) return;
  const double others = over(*heldout, "unevenness of the motion held out");
  if (others < 0.7 * fitted_runs)
    diagnosis.notices.push_back(fmt::format(
        "the held-out runs move {:.1f} times more evenly against the same ripple: there the drive "
        "compensates it",
        fitted_runs / others));
}

void add_steady_ripple(const SteadyRipple& ripple, const Units& units, int candidates, Diagnosis& diagnosis,
                       std::vector<std::string>& words) {
  const std::string name(name_of(DriveTerm::Cogging));
  if (!ripple.tested) {
    diagnosis.unseen.push_back({name, ripple.reason});
    return;
  }
  CandidateSummary summary;
  summary.name = name;
  summary.location = Location::TorqueBalance;
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
        fmt::format("within the steady runs, order {} makes {:.0f} % of the torque's variance", order.order,
                    100.0 * order.share));
  }
  if (summary.chosen) {
    NamedEffect effect;
    effect.name = name;
    effect.parameters = summary.values;
    effect.log_likelihood_gain = ripple.gain;
    effect.p_value = std::min(1.0, candidates * std::exp(-ripple.significance_nats));
    diagnosis.effects.push_back(std::move(effect));
    words.emplace_back(words_of(DriveTerm::Cogging));
  }
  diagnosis.candidates.push_back(std::move(summary));
}

NamedEffect named(const DriveComponent& component, const std::vector<DriveComponent>& components,
                  const DriveFit& fit, const Fitted& after, int candidates, const DriveModel& model,
                  const Units& units) {
  NamedEffect effect;
  effect.name = name_of(component.term);
  effect.location = Location::TorqueBalance;
  effect.parameters = effect_parameters(component, after, model, units);
  std::vector<DriveComponent> order;
  for (const DriveComponent& other : components)
    if (other.term != component.term) order.push_back(other);
  const Fitted without = fitted(fit, order);
  order.push_back(component);
  const Regression with = regress(fit.columns(order), fit.target(), fit.blocks());
  effect.log_likelihood_gain = 0.5 * effective_size(with.residuals) *
                               std::log(without.regression.residual_square / with.residual_square);
  effect.p_value =
      std::min(1.0, std::exp(-with.significance_of_last(static_cast<int>(component.columns.size()))) *
                        component.alternatives * candidates);
  return effect;
}

void add_ladder(const DriveSearchResult& found, const DriveFit& fit, const DriveModel& model,
                const Units& units, Diagnosis& diagnosis) {
  for (std::size_t s = 0; s < found.stages.size(); ++s) {
    const DriveSearchResult::Stage& stage = found.stages[s];
    for (std::size_t i = 0; i < stage.trials.size(); ++i) {
      const DriveTrial& trial = stage.trials[i];
      CandidateSummary summary;
      summary.stage = static_cast<int>(s) + 1;
      summary.name = name_of(trial.component.term);
      summary.location = Location::TorqueBalance;
      summary.predicted_gain = summary.gain = trial.gain;
      summary.parameters = static_cast<int>(trial.component.columns.size());
      summary.significance_nats = trial.significance_nats;
      summary.chosen = stage.winner == i;
      summary.rival = std::find(stage.rivals.begin(), stage.rivals.end(), i) != stage.rivals.end();
      std::vector<DriveComponent> alone = found.base;
      alone.push_back(trial.component);
      summary.values = effect_parameters(trial.component, fitted(fit, alone), model, units);
      diagnosis.candidates.push_back(std::move(summary));
    }
    if (!stage.winner || stage.rivals.empty()) continue;
    std::vector<std::string> group{std::string(name_of(stage.trials[*stage.winner].component.term))};
    for (const std::size_t rival : stage.rivals)
      group.emplace_back(name_of(stage.trials[rival].component.term));
    diagnosis.rivals.push_back(std::move(group));
  }
}

std::string listed(const std::vector<std::string>& words) {
  std::string text;
  for (std::size_t i = 0; i < words.size(); ++i)
    text += (i == 0 ? "" : i + 1 == words.size() ? "; and " : "; ") + words[i];
  return text;
}

}  // namespace

Result<Diagnosis> diagnose_drive(std::span<const Run> runs, const DriveModel& model,
                                 const DiagnoseOptions& options) {
  const auto started = std::chrono::steady_clock::now();
  const auto progress = [&](double share, const char* what) {
    if (options.progress) options.progress(share, what);
  };
  progress(0.0, "motion");
  const Result<DriveData> data = prepare(runs, model, kNaN);
  if (!data) return tl::unexpected(data.error());
  std::optional<DriveData> heldout;
  if (!options.heldout.empty()) {
    Result<DriveData> prepared = prepare(options.heldout, model, data->cut_off_Hz);
    if (!prepared) return tl::unexpected(prepared.error());
    heldout = std::move(*prepared);
  }
  const DriveData* judge = heldout ? &*heldout : nullptr;

  Diagnosis diagnosis;
  diagnosis.notices = data->notices;
  if (!model.steady)
    diagnosis.notices.push_back(
        fmt::format("both sides of the torque balance are filtered at {:.3g} Hz", data->cut_off_Hz));
  const DriveFit fit(*data, model);
  progress(0.3, "effects");
  DriveSearchResult found = search(fit, model, judge, {options.false_alarm, options.most_effects});
  if (found.base.empty() && found.chosen.empty())
    return failure(fmt::format("{}: the model has no part to estimate", model.file));
  diagnosis.notices.insert(diagnosis.notices.end(), found.notices.begin(), found.notices.end());
  progress(0.9, "gain");

  const Units units(model);
  const Fitted before = fitted(fit, found.base);
  reject_if_more_is_left(before, fit, options.false_alarm, found, diagnosis.notices);
  std::vector<DriveComponent> components = found.base;
  components.insert(components.end(), found.chosen.begin(), found.chosen.end());
  const Fitted after = fitted(fit, components);
  diagnosis.parameters_before = base_parameters(before, model, units);
  diagnosis.parameters_after = base_parameters(after, model, units);
  diagnosis.misfit.tests_before = tests_of(before, fit);
  diagnosis.misfit.tests_after = tests_of(after, fit);
  diagnosis.alarm_evidence = -std::log(options.false_alarm / std::max(1, found.candidates));

  // What the model file asks for is reported as a parameter, what the runs ask for as an effect.
  for (const DriveComponent& component : found.base)
    for (EstimatedParameter& parameter : effect_parameters(component, after, model, units)) {
      parameter.name = fmt::format("{}.{}", name_of(component.term), parameter.name);
      diagnosis.parameters_after.push_back(std::move(parameter));
    }
  std::vector<std::string> words;
  for (const DriveComponent& component : found.chosen) {
    diagnosis.effects.push_back(named(component, components, fit, after, found.candidates, model, units));
    words.emplace_back(words_of(component.term));
  }

  if (model.steady && model.part(DriveTerm::Cogging).use == PartUse::Candidate)
    add_steady_ripple(steady_ripple(runs, model, diagnosis.alarm_evidence), units, found.candidates,
                      diagnosis, words);

  add_ladder(found, fit, model, units, diagnosis);

  const std::vector<DependenceTest> left = dependences(after, fit, options.false_alarm);
  for (const DependenceTest& test : left.empty() ? dependences(before, fit, options.false_alarm) : left)
    diagnosis.misfit.dependences.push_back(test.dependence);
  if (!diagnosis.misfit.dependences.empty()) diagnosis.misfit.location = Location::TorqueBalance;

  const double error_before = 100.0 * relative_error(before, fit);
  const double error_after = 100.0 * relative_error(after, fit);
  if (!diagnosis.effects.empty()) {
    diagnosis.verdict = diagnosis.rivals.empty() ? DiagnosisVerdict::Explained : DiagnosisVerdict::Ambiguous;
    report_twin(found, after, fit, units, diagnosis);
    diagnosis.summary = fmt::format("{}: {}. Torque error {:.2f} % before, {:.2f} % after.", model.name,
                                    listed(words), error_before, error_after);
    if (!left.empty())
      diagnosis.notices.push_back(
          fmt::format("{:.0f} % of the squared error that is left still depends on {}",
                      100.0 * left.front().share, left.front().dependence.variable));
  } else if (!left.empty()) {
    diagnosis.verdict = DiagnosisVerdict::Unexplained;
    diagnosis.summary = fmt::format(
        "{}: the torque balance does not fit and no known effect explains it; the error depends on {}.",
        model.name, left.front().dependence.variable);
  } else {
    diagnosis.summary =
        fmt::format("{}: the base model explains the runs; torque error {:.2f} %.", model.name, error_before);
  }

  for (const auto& [term, reason] : found.unseen)
    diagnosis.unseen.push_back({std::string(name_of(term)), reason});
  for (const UnseenReason& each : kNeverSeen)
    diagnosis.unseen.push_back({std::string(each.name), std::string(each.reason)});

  diagnosis.gain = heldout_gain(before, after, fit, judge, diagnosis.notices);
  report_ripple(fit, judge, after, units, diagnosis);
  if (options.views) diagnosis.views = views_of(fit, before, after);
  diagnosis.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  progress(1.0, "done");
  return diagnosis;
}

}  // namespace clampd
