#include "clampd/station/evidence.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "clampd/experiment/reference.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/station/cause.hpp"

namespace clampd {

Eigen::Vector2d offset_sd(const Tare& tare) {
  const double mean_of = std::sqrt(static_cast<double>(std::max<std::uint64_t>(tare.samples, 1)));
  return {tare.force_sd_N / mean_of, tare.velocity_sd_rad_s / mean_of};
}

ParameterMatrix tare_covariance_normalised(const Estimate& joint, const Tare& tare) {
  return joint.offset_sensitivity * offset_sd(tare).cwiseAbs2().asDiagonal() *
         joint.offset_sensitivity.transpose();
}

Posterior posterior_of_check(const Estimate& joint, const ParameterMatrix& added, std::span<const Run> runs,
                             const Tare& tare, std::optional<double> found_rad) {
  Posterior posterior = posterior_of(joint, added, offset_sd(tare));
  posterior.found_rad = found_rad;
  posterior.contact = contact_point(runs, joint);
  const double force_variance_N2 = std::pow(offset_sd(tare)[0], 2);
  const double by_offset = posterior.contact.by_force_offset;
  posterior.contact.variance_rad2 += by_offset * by_offset * force_variance_N2;
  posterior.covariance_with_contact = by_offset * force_variance_N2 * joint.offset_sensitivity.col(0);
  return posterior;
}

ParameterVector sd_with_tare(const Estimate& joint, const Tare& tare) {
  return (joint.covariance_normalised + tare_covariance_normalised(joint, tare))
      .diagonal()
      .cwiseSqrt()
      .cwiseProduct(nominal_parameters().cwiseAbs());
}

namespace {

/// From row to row, on average over the first run.
double period_of(const std::vector<RunRecord>& runs) {
  const Run& run = runs.front().run;
  return (run.time_s.back() - run.time_s.front()) / static_cast<double>(run.size() - 1);
}

struct ExpectedResidual {
  double force_N = 0.0;
  double velocity_rad_s = 0.0;
};

/// Residual rms that a true model leaves: sensor noise, and what white noise q of the torque reading (sd per
/// sample of length ts) makes of a prediction over n samples. As a random walk v grows by q ts/J a sample,
/// with the mean square (q ts/J)^2 n/2 over the run; x is its sum, with the mean square (q ts^2/J)^2 n^3/12;
/// F follows x by the stiffness, for which 2 sqrt(k2 F) is an upper bound as long as k1 <= 0.
ExpectedResidual expected_residual(const Tare& tare, const std::vector<RunRecord>& runs,
                                   const BrakeParameters& model, double torque_noise_Nm) {
  const double period_s = period_of(runs);
  double samples = 0.0, force_max_N = 0.0;
  for (const RunRecord& record : runs) {
    samples = std::max(samples, static_cast<double>(record.run.size()));
    force_max_N =
        std::max(force_max_N, *std::max_element(record.run.force_N.begin(), record.run.force_N.end()));
  }
  const double step_rad_s = torque_noise_Nm * period_s / model.fixed.inertia_kg_m2;
  const double stiffness_N_rad = 2.0 * std::sqrt(model.theta[k2] * std::max(force_max_N, 0.0));
  const double drift_N =
      stiffness_N_rad * step_rad_s * period_s * std::sqrt(samples * samples * samples / 12.0);
  return {std::hypot(tare.force_sd_N, drift_N),
          std::hypot(tare.velocity_sd_rad_s, step_rad_s * std::sqrt(samples / 2.0))};
}

/// 0 over 0 explains everything: a noiseless simulation that is fitted exactly.
double ratio(double residual, double expected) {
  return residual == 0.0 ? 0.0 : residual / expected;
}

/// With what the tare adds, as tare_covariance_normalised().
std::vector<EffectEstimate> with_tare_sd(std::vector<EffectEstimate> effects, const Tare& tare) {
  const Eigen::Vector2d offset = offset_sd(tare);
  for (EffectEstimate& effect : effects)
    effect.sd = std::hypot(effect.sd, effect.offset_sensitivity[0] * offset[0],
                           effect.offset_sensitivity[1] * offset[1]);
  return effects;
}

/// Tests whether the runs show something that the model lacks; where that may move a parameter by more than
/// its standard deviation, the deviations grow by as much, and so does what is `added` to the estimate's
/// covariance.
std::optional<SystematicRecord> count_misfit(const Estimate& joint, std::span<const Run> runs,
                                             std::span<const std::uint8_t> motions, ParameterVector& sd,
                                             ParameterMatrix& added) {
  const SystematicMisfit misfit = systematic_misfit(runs, joint, motions);
  if (!misfit.can_tell) return std::nullopt;
  const ParameterVector nominal = nominal_parameters().cwiseAbs();
  const ParameterVector sd_normalised = sd.cwiseQuotient(nominal);
  const bool is_marked = misfit.counts(sd_normalised);
  if (is_marked) {
    added += misfit.covariance_normalised;
    sd = (sd_normalised.cwiseAbs2() + misfit.covariance_normalised.diagonal().cwiseMax(0.0))
             .cwiseSqrt()
             .cwiseProduct(nominal);
  }
  return SystematicRecord{misfit.p_value, misfit.over_noise, misfit.moved_sd(sd_normalised), is_marked};
}

}  // namespace

std::optional<SystematicRecord> add_estimate(const Estimate& joint, const std::vector<RunRecord>& records,
                                             const EstimateReading& reading, CheckFacts& facts) {
  facts.estimate_text = joint.message;
  facts.estimated = !records.empty() && joint.converged();
  facts.unexplained = joint.termination == Termination::Unexplained;
  if (!facts.estimated) return std::nullopt;
  if (reading.is_by_output_errors && joint.method == Method::PredictionError)
    facts.other_method = fmt::format("No parameters could be identified as configured: {}: {}.",
                                     joint.message, kUsePredictionErrors);
  facts.estimate = joint.parameters.theta;
  facts.sd = sd_with_tare(joint, reading.tare);
  ParameterMatrix added = tare_covariance_normalised(joint, reading.tare);
  const std::vector<Run> runs = runs_of(records);
  std::vector<std::uint8_t> motions;
  for (const RunRecord& record : records) motions.push_back(record.trajectory);
  std::optional<SystematicRecord> systematic = count_misfit(joint, runs, motions, facts.sd, added);
  facts.misfit_counts = systematic && systematic->marked;
  const ExpectedResidual expected =
      expected_residual(reading.tare, records, reading.model, reading.torque_noise_Nm);
  facts.effects = with_tare_sd(joint.effects, reading.tare);
  facts.misfit_force = ratio(joint.force_rms_N, expected.force_N);
  facts.misfit_velocity = ratio(joint.velocity_rms_rad_s, expected.velocity_rad_s);
  if (reading.stopping) facts.guard_bands = reading.stopping->guard_bands(joint);
  if (reading.sheet) {
    const Posterior posterior = posterior_of_check(joint, added, runs, reading.tare, reading.found_rad);
    facts.characteristics = judge_sheet(
        reading.sheet->characteristics,
        evaluate(reading.sheet->characteristics, posterior, nominal_drive(reading.model, period_of(records))),
        facts.guard_bands ? facts.guard_bands->widest() : reading.guard_band_k);
  }
  return systematic;
}

}  // namespace clampd
