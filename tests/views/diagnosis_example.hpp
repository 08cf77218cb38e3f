#pragma once

#include <cmath>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"

namespace clampd {

/// White noise, and in the base model's residuals a ripple of six periods a revolution of the motor.
inline RunView rippling_view(const std::string& name, double amplitude_Nm, unsigned seed) {
  constexpr std::size_t kRows = 800;
  constexpr double kForceNoise_N = 30.0, kVelocityNoise_rad_s = 0.3, kTorqueNoise_Nm = 0.002;
  std::mt19937 generator(seed);
  std::normal_distribution<double> noise;
  RunView view;
  view.name = name;
  for (std::size_t k = 0; k < kRows; ++k) {
    const double time_s = 1e-3 * static_cast<double>(k);
    const double phase = 2.0 * std::numbers::pi * 4.0 * time_s;
    const double position_rad = 20.0 - 19.0 * std::cos(phase);
    const double ripple = std::cos(6.0 * position_rad);
    const double force_N = 35.0 * position_rad * position_rad;
    const double velocity_rad_s = 19.0 * 2.0 * std::numbers::pi * 4.0 * std::sin(phase);
    const double force_noise = noise(generator), velocity_noise = noise(generator);
    view.time_s.push_back(time_s);
    view.position_rad.push_back(position_rad);
    view.torque_Nm.push_back(0.1);
    const auto fill = [](RunView::Channel& channel, double value, double sd, double error, double missed) {
      channel.measured.push_back(value + sd * error);
      channel.before.push_back(value - sd * missed);
      channel.after.push_back(value);
      channel.simulated_before.push_back(value - 3.0 * sd * missed);
      channel.simulated_after.push_back(value);
      channel.residual_before.push_back(error + missed);
      channel.residual_after.push_back(error);
    };
    fill(view.force, force_N, kForceNoise_N, force_noise, 0.5 * ripple);
    fill(view.velocity, velocity_rad_s, kVelocityNoise_rad_s, velocity_noise, 2.0 * ripple);
    view.disturbance_before_Nm.push_back(amplitude_Nm * ripple + kTorqueNoise_Nm * noise(generator));
    view.disturbance_after_Nm.push_back(kTorqueNoise_Nm * noise(generator));
  }
  return view;
}

/// A brake whose torque ripples, as the diagnosis might find it; every field filled.
inline Diagnosis rippling_brake() {
  Diagnosis diagnosis;
  diagnosis.verdict = DiagnosisVerdict::Explained;
  diagnosis.summary = "The motor's torque ripples by 50 mN m, six times a revolution.";
  diagnosis.effects = {{.name = "cogging",
                        .location = Location::TorqueBalance,
                        .parameters = {{"amplitude", "N m", 0.05021, 0.0004}, {"order", "1", 6.0}},
                        .log_likelihood_gain = 532.4,
                        .p_value = 1e-200}};
  diagnosis.unseen = {{"backlash", "no reversal under load"},
                      {"stiffness-hysteresis", "no reversal under load"},
                      {"force-saturation", "the force stays below 25 kN"}};
  diagnosis.misfit.tests_before = {
      {"whiteness of the force", 8.1, 3e-9, "one error in the force tells the next"},
      {"lack of fit against repeats", 12.4, 1e-30, "the runs agree with each other, not with the model"}};
  diagnosis.misfit.tests_after = {{"whiteness of the force", 1.02, 0.31, "nothing is left in the force"}};
  diagnosis.misfit.dependences = {{"position", Location::TorqueBalance, 498.0, 1e-190},
                                  {"velocity", Location::TorqueBalance, 12.0, 2.3e-4},
                                  {"force", Location::ForceReading, 1.0, 0.4}};
  diagnosis.misfit.location = Location::TorqueBalance;
  diagnosis.alarm_evidence = 7.05;
  const auto summary = [](int stage, const char* name, Location location, double gain,
                          double significance_nats) {
    return CandidateSummary{.stage = stage,
                            .name = name,
                            .location = location,
                            .predicted_gain = 0.98 * gain,
                            .gain = gain,
                            .parameters = 2,
                            .significance_nats = significance_nats,
                            .values = {{"size", "N m", 0.01, 0.001}}};
  };
  diagnosis.candidates = {summary(1, "friction-asymmetry", Location::TorqueBalance, 31.0, 29.0),
                          summary(1, "cogging", Location::TorqueBalance, 532.4, 526.0),
                          summary(1, "force-lag", Location::ForceReading, 4.0, 3.2),
                          summary(1, "presliding", Location::TorqueBalance, 10.0, 8.4),
                          summary(2, "force-hum", Location::ForceReading, 2.1, 0.9),
                          summary(2, "quadratic-drag", Location::TorqueBalance, 1.3, 0.4)};
  diagnosis.candidates[1].chosen = true;
  CandidateSummary not_refitted;
  not_refitted.name = "velocity-lag";
  not_refitted.location = Location::VelocityReading;
  not_refitted.significance_nats = 0.2;
  diagnosis.candidates.push_back(not_refitted);
  HeldOutGain gain;
  gain.runs = {"optimal-003.csv", "staircase-002.csv"};
  gain.before = {.rms_force_N = 34.0,
                 .rms_velocity_rad_s = 0.71,
                 .simulated_rms_force_N = 212.0,
                 .simulated_rms_velocity_rad_s = 2.31,
                 .log_likelihood_per_sample = -6.21,
                 .whiteness_p_value = 1e-30,
                 .misfit = 3.4};
  gain.after = {.rms_force_N = 30.1,
                .rms_velocity_rad_s = 0.33,
                .simulated_rms_force_N = 33.0,
                .simulated_rms_velocity_rad_s = 0.42,
                .log_likelihood_per_sample = -5.02,
                .whiteness_p_value = 0.41,
                .misfit = 1.02};
  diagnosis.gain = gain;
  diagnosis.parameters_before = {
      {"k1", "N/rad^3", -0.361, 0.004}, {"TC", "N m", 0.0921, 0.0008}, {"mus", "N m/N", 3.6e-5, 2e-7}};
  diagnosis.parameters_after = {{"k1", "N/rad^3", -0.354, 0.003},
                                {"TC", "N m", 0.0766, 0.0007},
                                {"mus", "N m/N", 3.55e-5, 2e-7},
                                {"cogging.amplitude", "N m", 0.05021, 0.0004}};
  diagnosis.noise_before = {{31.0, 0.6}, 0.02};
  diagnosis.noise_after = {{30.0, 0.3}, 0.009};
  diagnosis.notices = {"one run was left out: it is shorter than 50 rows"};
  diagnosis.views = {rippling_view("set/optimal-001.csv", 0.05, 1),
                     rippling_view("set/optimal-002.csv", 0.05, 2),
                     rippling_view("set/staircase-001.csv", 0.05, 3)};
  diagnosis.wall_s = 12.3;
  return diagnosis;
}

/// Two causes that the runs cannot tell apart, and the run that would.
inline Diagnosis torn_brake() {
  Diagnosis diagnosis = rippling_brake();
  diagnosis.verdict = DiagnosisVerdict::Ambiguous;
  diagnosis.summary = "Either the pads creep or the reading of clamp force comes 3 ms late.";
  diagnosis.effects = {{.name = "force-lag",
                        .location = Location::ForceReading,
                        .parameters = {{"time constant", "s", 0.00302, 0.00005}},
                        .log_likelihood_gain = 60.0,
                        .p_value = 1e-12}};
  diagnosis.rivals = {{"force-lag", "pad-relaxation"}};
  NextExperiment next;
  next.manoeuvre = "step and hold";
  next.why = "a hold of 0.4 s at 20 kN tells creep from lag: 2 runs should give 41 nats";
  next.repeats = 2;
  next.expected_evidence_nats = 41.0;
  for (int k = 0; k < 400; ++k) {
    next.trajectory.time_s.push_back(1e-3 * k);
    next.trajectory.torque_Nm.push_back(k < 100 ? 1.0 : 0.5);
    next.trajectory.velocity_rad_s.push_back(k < 100 ? 100.0 : 0.0);
    next.trajectory.force_N.push_back(std::min(200.0 * k, 20e3));
  }
  diagnosis.next_experiment = next;
  return diagnosis;
}

}  // namespace clampd
