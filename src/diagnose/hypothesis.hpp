#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/identify/extended_fit.hpp"

namespace clampd::diagnosing {

/// A model with the runs as it sees them: channels moved back that it says are late, readings left out that
/// it says are spikes.
struct Hypothesis {
  ExtendedEstimate estimate;
  std::vector<FitRun> runs;
  /// What the readings that the fit does not use add to its log-likelihood, so that hypotheses are judged by
  /// all readings.
  double unused_log_likelihood = 0.0;
  double degrees = 0.0;  ///< parameters that the effects add
  ThreadBudget threads;  ///< that its fits may use

  double log_likelihood() const { return estimate.log_likelihood + unused_log_likelihood; }
  bool possible() const { return estimate.possible; }
};

/// A first idea of an effect beside a hypothesis, and what a Gauss-Newton step promises from there.
struct Start {
  EffectValues values;
  double predicted_gain = 0.0;
  /// What the step moves the hypothesis's own parameters by, those of ExtendedBrake, SI; empty: they stay.
  Eigen::VectorXd step = {};
};

/// An effect judged beside a hypothesis.
struct Candidate {
  const Effect* effect = nullptr;
  double degrees = 1.0;       ///< parameters estimated for it, those of each run among them
  double alternatives = 1.0;  ///< tried for its choices
  std::vector<Start> starts;  ///< most promising first
  double predicted_gain = 0.0;
  double predicted_significance_nats = 0.0;
  /// The standard deviation of its strength at its neutral value over the change that matters.
  double blindness = 0.0;
  Hypothesis fitted;
  Hypothesis twice;  ///< the same effect once more beside it, if finish() found that both are needed
  double gain = 0.0;
  double significance_nats = 0.0;
  bool is_fitted = false;

  std::string_view name() const { return info_of(*effect).name; }
};

/// Fits it roughly, if it is fitted already as far as that may be better; several starts where the first does
/// not bring what it promised.
/// `also_afresh`: from the nominal brake as well.
void fit(Candidate& candidate, const Hypothesis& hypothesis, bool also_from_nominal);

/// The same with other choices of its refinements, from where fit() ended.
void refine(Candidate& candidate, const Hypothesis& hypothesis, bool also_from_nominal);

/// Once more, from these values beside another fit of the same hypothesis.
void fit_from(const EffectValues& values, const Hypothesis& elsewhere, const Hypothesis& hypothesis,
              Candidate& candidate);

/// Gain and evidence of a candidate that is fitted, beside this fit of the hypothesis.
void weigh(Candidate& candidate, const Hypothesis& hypothesis);

/// Nats that taking its strengths back to neutral would cost, by how well they are known: what the fit's
/// curvature says of an effect, however its likelihood came about. Infinite for one without strengths.
double known_strength(const Hypothesis& hypothesis, std::size_t effect);

/// Whether its own parameters have not found their best, as where an effect leads them far away.
bool is_stuck(const Hypothesis& hypothesis);

/// Whether its torque is noisier than any drive's: the model swallows by it what it does not know.
bool is_torque_impossible(const Hypothesis& hypothesis);

/// Fits to the end what fit() began.
void finish(Candidate& candidate, const Hypothesis& hypothesis);

/// Fits it to the end, if it is not there.
void settle(Hypothesis& hypothesis);

/// Fits the hypothesis anew with its effects as they are. `least`: the log-likelihood, of all readings, that
/// it is to get near to, or else be given up.
void refit(Hypothesis& hypothesis, int max_iterations = ExtendedFitOptions{}.max_iterations,
           double least = ExtendedFitOptions{}.least_log_likelihood);

/// The hypothesis without one of its effects, or without any, fitted: without one as near to the end as tells
/// what the effect is worth.
Hypothesis without(const Hypothesis& hypothesis, std::size_t effect, std::span<const Run> recorded);
Hypothesis without_any(const Hypothesis& hypothesis, std::span<const Run> recorded);

/// The hypothesis with one of its effects' choices made otherwise, each fitted; only choices that leave the
/// runs as they are.
std::vector<Hypothesis> otherwise_chosen(const Hypothesis& hypothesis);

/// Readings that are far off by themselves, as an effect that removes readings. `filtered`: the hypothesis's runs.
Candidate look_for_spikes(const Effect& effect, const Hypothesis& hypothesis, std::span<const FilteredRun> filtered);

}  // namespace clampd::diagnosing
