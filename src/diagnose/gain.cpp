#include "src/diagnose/gain.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "src/diagnose/evidence.hpp"
#include "src/diagnose/residuals.hpp"

namespace clampd::diagnosing {

namespace {

constexpr std::size_t kHeldOutEvery = 3;

/// The hypothesis on some of its runs only.
Hypothesis on_runs(const Hypothesis& hypothesis, const std::vector<std::size_t>& chosen) {
  Hypothesis part;
  part.threads = hypothesis.threads;
  part.estimate = hypothesis.estimate;
  part.estimate.initial_states.clear();
  for (const std::size_t r : chosen) {
    part.runs.push_back(hypothesis.runs[r]);
    part.estimate.initial_states.push_back(hypothesis.estimate.initial_states[r]);
  }
  return part;
}

/// Mean square innovation over what it would be by this noise.
double misfit_by(const NoiseLevels& noise, Hypothesis held) {
  held.estimate.noise = noise;
  double squares = 0.0, count = 0.0;
  const std::vector<FilteredRun> filtered = filter_runs(held.runs, held.estimate, held.threads);
  for (std::size_t r = 0; r < filtered.size(); ++r)
    for (std::size_t k = 0; k < held.runs[r].size(); ++k) {
      if (held.runs[r].use_force[k]) squares += std::pow(filtered[r].force[k], 2), count += 1.0;
      if (held.runs[r].use_velocity[k]) squares += std::pow(filtered[r].velocity[k], 2), count += 1.0;
    }
  return squares / count;
}

/// `noise`: what the misfit is measured by. Noise that a poorer model estimates takes up what it does not
/// explain, so that by its own it would look as good as a better one.
GainFigures judge(const Hypothesis& trained, Hypothesis held, const NoiseLevels& noise) {
  held.estimate.parameters = trained.estimate.parameters;
  held.estimate.noise = trained.estimate.noise;
  // Where a run starts is no property of the brake: it follows.
  ExtendedFitOptions starts_only;
  starts_only.hold_parameters = true;
  starts_only.estimate_noise = false;
  starts_only.threads = held.threads;
  held.estimate = fit_extended(held.runs, held.estimate, starts_only);
  GainFigures figures;
  const std::vector<FilteredRun> filtered = filter_runs(held.runs, held.estimate, held.threads);
  double force = 0.0, velocity = 0.0, forces = 0.0, velocities = 0.0, likelihood = 0.0;
  double simulated_force = 0.0, simulated_velocity = 0.0;
  for (std::size_t r = 0; r < filtered.size(); ++r) {
    const FilteredRun& view = filtered[r];
    const FitRun& run = held.runs[r];
    likelihood += view.log_likelihood;
    for (std::size_t k = 0; k < run.size(); ++k) {
      if (run.use_force[k]) {
        force += std::pow(run.force_N[k] - view.predicted_force_N[k], 2);
        simulated_force += std::pow(run.force_N[k] - view.simulated_force_N[k], 2);
        forces += 1.0;
      }
      if (run.use_velocity[k]) {
        velocity += std::pow(run.velocity_rad_s[k] - view.predicted_velocity_rad_s[k], 2);
        simulated_velocity += std::pow(run.velocity_rad_s[k] - view.simulated_velocity_rad_s[k], 2);
        velocities += 1.0;
      }
    }
  }
  figures.rms_force_N = std::sqrt(force / forces);
  figures.rms_velocity_rad_s = std::sqrt(velocity / velocities);
  figures.simulated_rms_force_N = std::sqrt(simulated_force / forces);
  figures.simulated_rms_velocity_rad_s = std::sqrt(simulated_velocity / velocities);
  figures.log_likelihood_per_sample = likelihood / (0.5 * (forces + velocities));
  figures.misfit = misfit_by(noise, std::move(held));
  figures.whiteness_p_value = p_value_of(neg_log_p_of_colour(filtered));
  return figures;
}

/// Rows of a channel that the model sees `late` rows earlier than it was recorded.
std::vector<double> as_recorded(const std::vector<double>& rows, int late) {
  std::vector<double> moved(rows.size(), std::numeric_limits<double>::quiet_NaN());
  const auto count = std::min<std::ptrdiff_t>(late, static_cast<std::ptrdiff_t>(rows.size()));
  std::copy(rows.begin(), rows.end() - count, moved.begin() + count);
  return moved;
}

}  // namespace

std::optional<HeldOutGain> held_out_gain(std::span<const Run> runs, std::span<const Run> heldout,
                                         const Hypothesis& base, const Hypothesis& extended,
                                         std::vector<std::string>& notices) {
  HeldOutGain gain;
  Hypothesis held_base, held_extended, trained_base = base, trained_extended = extended;
  if (!heldout.empty()) {
    const auto prepare = [&](const Hypothesis& model) {
      Hypothesis held;
      held.threads = model.threads;
      held.runs = fit_runs(heldout);
      for (FitRun& run : held.runs) run.number += static_cast<double>(runs.size());
      held.estimate = model.estimate;
      for (const EffectValues& values : model.estimate.parameters.effects)
        move_by(delays_of(values), held.runs);
      const ExtendedEstimate starts = fit_base(heldout, model.estimate.parameters.base);
      held.estimate.initial_states = starts.initial_states;
      for (Eigen::VectorXd& initial : held.estimate.initial_states) {
        const Eigen::Index free = model.estimate.initial_states.front().size() - initial.size();
        initial.conservativeResize(initial.size() + free);
        initial.tail(free).setZero();
      }
      return held;
    };
    held_base = prepare(base);
    held_extended = prepare(extended);
    for (const Run& run : heldout) gain.runs.push_back(run.name);
  } else {
    if (runs.size() < kHeldOutEvery) {
      notices.push_back("too few runs to hold one out: the gain is not judged by runs that were not fitted");
      return std::nullopt;
    }
    std::vector<std::size_t> training, held;
    for (std::size_t r = 0; r < runs.size(); ++r) (r % kHeldOutEvery == 1 ? held : training).push_back(r);
    for (const std::size_t r : held) gain.runs.push_back(runs[r].name);
    trained_base = on_runs(base, training);
    refit(trained_base);
    trained_extended = on_runs(extended, training);
    if (!extended.estimate.parameters.effects.empty())
      refit(trained_extended);
    else
      trained_extended = trained_base;
    held_base = on_runs(base, held);
    held_extended = on_runs(extended, held);
  }
  const NoiseLevels noise = trained_extended.estimate.noise;
  gain.before = judge(trained_base, held_base, noise);
  gain.after = extended.estimate.parameters.effects.empty() ? gain.before
                                                            : judge(trained_extended, held_extended, noise);
  return gain;
}

std::vector<RunView> views_of(std::span<const Run> runs, const Hypothesis& base, const Hypothesis& extended) {
  std::vector<RunView> views;
  const std::vector<FilteredRun> before = filter_runs(base.runs, base.estimate, base.threads);
  const std::vector<FilteredRun> after = filter_runs(extended.runs, extended.estimate, extended.threads);
  for (std::size_t r = 0; r < runs.size() && r < before.size() && r < after.size(); ++r) {
    RunView view;
    view.name = runs[r].name;
    view.time_s = runs[r].time_s;
    view.torque_Nm = runs[r].torque_Nm;
    view.position_rad = after[r].position_rad;
    const EffectDelays late = delays_of(extended.estimate.parameters);
    view.force = {runs[r].force_N,
                  before[r].predicted_force_N,
                  as_recorded(after[r].predicted_force_N, late.force),
                  before[r].simulated_force_N,
                  as_recorded(after[r].simulated_force_N, late.force),
                  before[r].force,
                  as_recorded(after[r].force, late.force)};
    view.velocity = {runs[r].velocity_rad_s,
                     before[r].predicted_velocity_rad_s,
                     as_recorded(after[r].predicted_velocity_rad_s, late.velocity),
                     before[r].simulated_velocity_rad_s,
                     as_recorded(after[r].simulated_velocity_rad_s, late.velocity),
                     before[r].velocity,
                     as_recorded(after[r].velocity, late.velocity)};
    view.disturbance_before_Nm = before[r].disturbance_Nm;
    view.disturbance_after_Nm = after[r].disturbance_Nm;
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace clampd::diagnosing
