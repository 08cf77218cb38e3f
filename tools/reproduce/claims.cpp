#include "tools/reproduce/claims.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include <fmt/format.h>

namespace clampd::reproduce {
namespace {

using report::Tone;

Claim judged(std::string where, std::string paper, std::string here, bool holds) {
  return {std::move(where), std::move(paper), std::move(here), holds ? "confirmed" : "not confirmed",
          holds ? Tone::Good : Tone::Bad};
}

/// For a statement of two halves.
Claim judged(std::string where, std::string paper, std::string here, bool first, bool second) {
  Claim claim = judged(std::move(where), std::move(paper), std::move(here), first && second);
  if (first != second) {
    claim.verdict = "partly";
    claim.tone = Tone::Mixed;
  }
  return claim;
}

/// "3.1 times smaller" of a ratio that says how much larger the other one is.
std::string times(double ratio, const char* above_one, const char* below_one) {
  return ratio >= 1.0 ? fmt::format("{:.1f} times {}", ratio, above_one)
                      : fmt::format("{:.1f} times {}", 1.0 / ratio, below_one);
}

void add_design_claims(const Study& study, const Findings& f, std::vector<Claim>& claims) {
  claims.push_back(judged(
      "Fig. 1", "The force resembles a step response; the speed rises to its maximum and falls to zero.",
      fmt::format("90 % of the peak force within {:.0f} % of the length, then never below {:.0f} % of the "
                  "peak; speed up to {:.0f} rad/s, at the end up to {:.0f} rad/s.",
                  100.0 * f.latest_rise, 100.0 * f.lowest_after_rise, f.speed_max_rad_s,
                  f.end_speed_max_rad_s),
      f.latest_rise <= 0.8 && f.lowest_after_rise >= 0.5,
      f.speed_max_rad_s >= 285.0 && f.end_speed_max_rad_s <= 30.0));
  claims.push_back(judged("Fig. 1", "From 0.18 s on the peak force stays at about 23 kN.",
                          fmt::format("It lies between {:.1f} and {:.1f} kN; the limit is 30 kN.",
                                      1e-3 * f.long_force_min_N, 1e-3 * f.long_force_max_N),
                          f.long_force_min_N >= 21e3 && f.long_force_max_N <= 25e3));
  claims.push_back(
      judged("Fig. 2", "Both criteria fall with the length of the experiment.",
             fmt::format("−log det M falls with {} of {} steps of 20 ms (D-optimal), the trace of M⁻¹ with "
                         "{} of {} (A-optimal).",
                         f.d_falls, study.d_designs.size() - 1, f.a_falls, study.a_designs.size() - 1),
             study.d_designs.size() - 1 - f.d_falls <= 1, study.a_designs.size() - 1 - f.a_falls <= 1));
  claims.push_back(
      judged("Fig. 2", "Beyond 0.18 s the gain is markedly smaller.",
             fmt::format("−log det M falls by {:.1f} per 20 ms just before 0.18 s and by {:.1f} just after.",
                         f.steepness_before, f.steepness_after),
             f.steepness_after < 0.6 * f.steepness_before));
}

void add_table_claims(const Study& study, const Findings& f, std::vector<Claim>& claims) {
  claims.push_back(
      judged("Table II", "OEM and PEM find closely matching means.",
             fmt::format("They differ by at most {:.3f} of nominal (the paper's own by {:.3f}).",
                         f.methods_mean_distance, mean_distance(kPaperOemOptimal, kPaperPemOptimal)),
             f.methods_mean_distance <= mean_distance(kPaperOemOptimal, kPaperPemOptimal)));
  claims.push_back(
      judged("Table II, Fig. 5", "PEM's estimates scatter less than OEM's.",
             fmt::format("PEM's variance is {} (geometric mean over the parameters; Table II: {}).",
                         times(f.methods_variance_ratio, "smaller", "larger"),
                         times(variance_ratio(kPaperOemOptimal, kPaperPemOptimal), "smaller", "larger")),
             f.methods_variance_ratio > 1.0));
  claims.push_back(
      judged("Table II, Fig. 5", "The optimal experiment beats a non-optimal one.",
             fmt::format("OEM's variance is {} than with a step; what is possible at all (Cramér-Rao) is {}. "
                         "By Table II itself it is {}.",
                         times(f.design_variance_ratio, "smaller", "larger"),
                         times(f.design_bound_ratio, "smaller", "larger"),
                         times(variance_ratio(kPaperOemStep, kPaperOemOptimal), "smaller", "larger")),
             f.design_variance_ratio > 1.0, f.design_bound_ratio > 1.0));
  Claim sums{
      "Section V", "Sums of variances 0.00480 (OEM), 0.00388 (PEM), 0.00729 (non-optimal).",
      fmt::format("Table II's variances sum to {:.4f}, {:.4f} and {:.4f}; ours to {:.4f}, {:.4f} and {:.4f}.",
                  sum_of_variances(kPaperOemOptimal), sum_of_variances(kPaperPemOptimal),
                  sum_of_variances(kPaperOemStep), f.oem_optimal.sum_of_variances,
                  f.pem_optimal.sum_of_variances, f.oem_step.sum_of_variances),
      "contradicts itself", Tone::Bad};
  claims.push_back(std::move(sums));
  claims.push_back(judged(
      "Section V", "PEM estimates the torque noise: 0.0142 N m (Q = 2.0154e-4).",
      fmt::format(
          "From {} repeats at once it finds {:.4f} N m where {:.4f} is true; repeats alone average {:.4f}.",
          study.options.repeats, study.pooled.noise_torque_Nm, kBenchNoise.torque_Nm, f.mean_torque_noise_Nm),
      std::abs(study.pooled.noise_torque_Nm / kBenchNoise.torque_Nm - 1.0) < 0.25));
}

void add_validation_claims(const Study& study, const Findings& f, std::vector<Claim>& claims) {
  const auto& [nominal, oem, pem, oem_step] =
      std::tie(study.validation_predictions[0], study.validation_predictions[1],
               study.validation_predictions[2], study.validation_predictions[3]);
  claims.push_back(judged(
      "Fig. 6",
      "With the estimates the simulation overlaps the measurement; with the nominal values it does not.",
      fmt::format("Force rms error {:.0f} N (OEM) and {:.0f} N (PEM) against {:.0f} N (nominal).",
                  oem.force_rms_N, pem.force_rms_N, nominal.force_rms_N),
      std::max(oem.force_rms_N, pem.force_rms_N) < nominal.force_rms_N / 3.0));
  claims.push_back(judged(
      "Fig. 6", "Estimates of the non-optimal experiment leave the measurement.",
      fmt::format("Force rms error {:.0f} N against {:.0f} N with those of the optimal one (both OEM).",
                  oem_step.force_rms_N, oem.force_rms_N),
      oem_step.force_rms_N > 1.5 * oem.force_rms_N));
  const ReplayFigures &by_oem = f.replays[0], &by_pem = f.replays[1], &by_truth = f.replays[2];
  claims.push_back(
      judged("Fig. 7", "Under a slow load the simulation locks up where the brake does not.",
             fmt::format("It does in {} of {} repeats with OEM's estimates, in {} with PEM's and in {} with "
                         "the true parameters, for up to {:.0f} ms; the brake rests for {:.0f} ms at most.",
                         by_oem.locked, study.options.repeats, by_pem.locked, by_truth.locked,
                         1e3 * std::max({by_oem.longest_s, by_pem.longest_s, by_truth.longest_s}),
                         1e3 * f.brake_longest_rest_s),
             by_oem.locked + by_pem.locked > 0));
  claims.push_back(judged(
      "Fig. 8",
      "The Kalman filter does not lock up; its force band is narrow, its velocity band widens at v = 0.",
      fmt::format("Force rms error {:.0f} N, band ±{:.0f} N; velocity band up to ±{:.2f} rad/s around v = 0, "
                  "±{:.2f} when moving.",
                  f.filter_force_error_N, 2.0 * f.filter_force_sd_N, 2.0 * f.velocity_sd_crossing_rad_s,
                  2.0 * f.velocity_sd_moving_rad_s),
      f.filter_force_error_N<100.0, f.velocity_sd_crossing_rad_s / f.velocity_sd_moving_rad_s> 1.2));
  claims.push_back(judged(
      "Section V", "PEM is more robust against torque noise.",
      fmt::format("Estimated from the sinusoid itself, PEM's parameters are {} than OEM's (median error).",
                  times(f.sinusoid_error_ratio, "closer to the truth", "further from the truth")),
      f.sinusoid_error_ratio > 1.0));
  claims.push_back(
      judged("Section V", "PEM takes ten times OEM's computing time.",
             fmt::format("{:.1f} times: {:.1f} ms against {:.1f} ms a repeat.", f.time_ratio,
                         1e3 * study.pem_optimal.median_wall_s, 1e3 * study.oem_optimal.median_wall_s),
             f.time_ratio > 7.0 && f.time_ratio < 15.0));
  claims.push_back(
      judged("Section V", "One minute of measuring replaces nine hours.",
             fmt::format("{} repeats take {:.0f} s on the bench, approaches and returns counted.",
                         study.options.repeats, study.optimal.bench_s),
             study.optimal.bench_s <= 60.0));
}

}  // namespace

std::vector<Claim> claims_of(const Study& study, const Findings& findings) {
  std::vector<Claim> claims;
  add_design_claims(study, findings, claims);
  add_table_claims(study, findings, claims);
  add_validation_claims(study, findings, claims);
  return claims;
}

}  // namespace clampd::reproduce
