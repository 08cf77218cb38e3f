#include "tools/reproduce/study.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/identify/output_error.hpp"
#include "clampd/identify/prediction_error.hpp"

namespace clampd::reproduce {
namespace {

constexpr std::size_t kShortest_samples = 100;
constexpr std::size_t kLongest_samples = 400;

using Estimator = Estimate (*)(std::span<const Run>, const EstimatorOptions&);

/// Reports progress as shares of what the whole study takes.
class Progress {
 public:
  explicit Progress(const StudyOptions& options) : report_(options.progress) {}

  void begin(std::string stage, double share) {
    done_ += share_;
    share_ = share;
    stage_ = std::move(stage);
    update(0.0);
  }
  void update(double fraction) const {
    if (report_) report_(done_ + share_ * fraction, stage_);
  }

 private:
  const std::function<void(double, std::string_view)>& report_;
  std::string stage_;
  double done_ = 0.0;
  double share_ = 0.0;
};

/// Nine tenths of the paper's, for a brake with more friction than the nominal one and for what the closed
/// loop needs to correct.
DesignLimits limits_with_headroom() {
  DesignLimits limits;
  limits.torque_Nm *= kHeadroom;
  limits.force_N *= kHeadroom;
  limits.velocity_rad_s *= kHeadroom;
  limits.end_velocity_rad_s = 20.0;
  limits.amplification_rad_s_Nm = kBenchAmplification_rad_s_Nm;
  return limits;
}

Run response_to(const std::vector<double>& torque_Nm) {
  Run run;
  run.name = "optimal";
  run.torque_Nm = torque_Nm;
  Simulation simulation(torque_Nm.size());
  simulate(BrakeParameters{}, BrakeState::Zero(), Excitation{.torque_Nm = run.torque_Nm}, simulation);
  for (std::size_t k = 0; k < torque_Nm.size(); ++k)
    run.time_s.push_back(static_cast<double>(k) * kMaxStep_s);
  run.velocity_rad_s = std::move(simulation.velocity_rad_s);
  run.force_N = std::move(simulation.force_N);
  run.position_rad = std::move(simulation.position_rad);
  return run;
}

Design design(const StudyOptions& study, std::size_t samples, Objective objective,
              const DesignLimits& limits) {
  DesignOptions options;
  options.samples = samples;
  options.block_samples = kBlock_samples;
  options.objective = objective;
  options.noise = kDesignNoise;
  options.limits = limits;
  options.seed = study.seed;
  // Longer experiments have more local optima.
  const double share = static_cast<double>(samples) / static_cast<double>(kDesignLength_samples);
  // A-optimal experiments are the easier ones to find.
  const double ease = objective == Objective::D ? 1.0 : 0.5;
  options.starts = std::max(1, static_cast<int>(std::lround(study.starts * share * ease)));
  Design result;
  result.samples = samples;
  result.summary = design_experiment(options);
  if (result.summary.certified())
    result.response = response_to(expand_blocks(result.summary.block_torque_Nm, kBlock_samples));
  return result;
}

Result<Design> needed(Design found) {
  if (found.summary.certified()) return found;
  return failure(fmt::format("no design of {} s: {}; more --starts find one", found.duration_s(),
                             found.summary.message));
}

std::vector<Design> designs_over_length(const StudyOptions& options, Objective objective,
                                        Progress& progress) {
  std::vector<Design> designs;
  for (std::size_t samples = kShortest_samples; samples <= kLongest_samples; samples += kBlock_samples) {
    progress.update(static_cast<double>(samples - kShortest_samples) /
                    static_cast<double>(kLongest_samples - kShortest_samples + kBlock_samples));
    Design found = design(options, samples, objective, DesignLimits{});
    if (found.summary.certified()) designs.push_back(std::move(found));
  }
  return designs;
}

sim::PlantConfiguration plant(std::uint64_t seed) {
  sim::PlantConfiguration configuration;
  configuration.brake = true_brake();
  configuration.sensors.force_noise_N = kBenchNoise.sensors.force_N;
  configuration.sensors.velocity_noise_rad_s = kBenchNoise.sensors.velocity_rad_s;
  configuration.sensors.torque_noise_Nm = kBenchNoise.torque_Nm;
  configuration.seed = seed;
  return configuration;
}

Result<Experiment> drive(const Run& trajectory, std::uint16_t repeats, std::uint64_t seed) {
  const BrakeParameters nominal;
  const Result<Reference> reference = build_reference(trajectory, nominal);
  if (!reference) return tl::unexpected(reference.error());
  SimulatedCheck check = simulate_check(plant(seed), *reference, nominal, {.repeats = repeats});
  if (check.fault != FaultCause::None)
    return failure(
        fmt::format("the simulated brake could not be driven along the {} trajectory: {} after {:.1f} s",
                    trajectory.name, to_string(check.fault), check.duration_s));
  return Experiment{std::move(check.runs), check.duration_s, check.force_max_N, check.speed_max_rad_s};
}

Result<Experiment> drive_manoeuvre(const char* name, std::uint16_t repeats, std::uint64_t seed,
                                   std::size_t rows = std::numeric_limits<std::size_t>::max()) {
  Result<Run> trajectory = make_manoeuvre(name, BrakeParameters{}, Run{});
  if (!trajectory) return tl::unexpected(trajectory.error());
  for (std::vector<double>* column :
       {&trajectory->time_s, &trajectory->torque_Nm, &trajectory->velocity_rad_s, &trajectory->force_N,
        &trajectory->position_rad})
    column->resize(std::min(column->size(), rows));
  return drive(*trajectory, repeats, seed);
}

void compute_scatter(Column& column) {
  column.mean.setConstant(kNaN);
  column.covariance.setConstant(kNaN);
  const auto count = static_cast<double>(column.estimates.size());
  if (column.estimates.size() < 2) return;
  const auto normalised = [](const Estimate& estimate) -> ParameterVector {
    return estimate.parameters.theta.cwiseQuotient(nominal_parameters());
  };
  column.mean.setZero();
  for (const Estimate& estimate : column.estimates) column.mean += normalised(estimate) / count;
  column.covariance.setZero();
  for (const Estimate& estimate : column.estimates) {
    const ParameterVector deviation = normalised(estimate) - column.mean;
    column.covariance += deviation * deviation.transpose() / (count - 1.0);
  }
}

enum class Keep { Converged, Finite };

Column estimate_each(std::string name, Estimator estimator, const Experiment& experiment, Progress& progress,
                     Keep keep = Keep::Converged) {
  Column column;
  column.name = std::move(name);
  std::vector<double> walls_s;
  for (std::size_t i = 0; i < experiment.runs.size(); ++i) {
    progress.update(static_cast<double>(i) / static_cast<double>(experiment.runs.size()));
    Estimate estimate = estimator(std::span(&experiment.runs[i].readings, 1), EstimatorOptions{});
    if (!estimate.converged()) ++column.failed;
    if (keep == Keep::Converged ? !estimate.converged() : !estimate.parameters.theta.allFinite()) continue;
    walls_s.push_back(estimate.wall_s);
    column.estimates.push_back(std::move(estimate));
  }
  compute_scatter(column);
  column.bound.setConstant(kNaN);
  column.bound_exact.setConstant(kNaN);
  if (!walls_s.empty()) {
    const auto middle = walls_s.begin() + static_cast<std::ptrdiff_t>(walls_s.size() / 2);
    std::nth_element(walls_s.begin(), middle, walls_s.end());
    column.median_wall_s = *middle;
  }
  return column;
}

/// Mean over the repeats of the bounds at what the brake really did.
void compute_bounds(Column& column, const Experiment& experiment) {
  column.bound.setZero();
  column.bound_exact.setZero();
  for (const SimulatedRun& run : experiment.runs) {
    std::vector<double> torque_Nm;
    for (const sim::Truth& truth : run.truth) torque_Nm.push_back(truth.torque_Nm);
    const BrakeState initial(run.truth.front().position_rad, run.truth.front().velocity_rad_s);
    const auto bound = [&](double torque_noise_Nm) -> ParameterMatrix {
      return cramer_rao(initial_state_unknown(joint_information(true_brake(), initial,
                                                                Excitation{.torque_Nm = torque_Nm},
                                                                {kBenchNoise.sensors, torque_noise_Nm}))) /
             static_cast<double>(experiment.runs.size());
    };
    column.bound += bound(kBenchNoise.torque_Nm);
    column.bound_exact += bound(0.0);
  }
}

BrakeParameters brake_of(const Column& column) {
  BrakeParameters brake;
  brake.theta = column.mean.cwiseProduct(nominal_parameters());
  return brake;
}

/// The repeats start at rest; the encoder says where.
BrakeState start_of(const Run& run) {
  return {run.position_rad.front(), 0.0};
}

Prediction predict(std::string name, const Run& run, const BrakeParameters& brake) {
  Prediction prediction;
  prediction.name = std::move(name);
  prediction.simulation.resize(run.size());
  simulate(brake, start_of(run), excitation_of(run), prediction.simulation);
  double force = 0.0, velocity = 0.0;
  for (std::size_t k = 0; k < run.size(); ++k) {
    force += std::pow(run.force_N[k] - prediction.simulation.force_N[k], 2);
    velocity += std::pow(run.velocity_rad_s[k] - prediction.simulation.velocity_rad_s[k], 2);
  }
  const auto rows = static_cast<double>(run.size());
  prediction.force_rms_N = std::sqrt(force / rows);
  prediction.velocity_rms_rad_s = std::sqrt(velocity / rows);
  return prediction;
}

Replay replay(std::string name, const Experiment& experiment, const BrakeParameters& brake) {
  Replay result;
  for (const SimulatedRun& run : experiment.runs)
    result.repeats.push_back(predict(run.readings.name, run.readings, brake));
  result.name = std::move(name);
  return result;
}

Result<void> compute_designs(Study& study, Progress& progress) {
  progress.begin("D-optimal experiments of 0.1 to 0.4 s", 0.4);
  study.d_designs = designs_over_length(study.options, Objective::D, progress);
  progress.begin("A-optimal experiments of 0.1 to 0.4 s", 0.4);
  study.a_designs = designs_over_length(study.options, Objective::A, progress);
  progress.begin("the experiment for the bench", 0.04);
  Result<Design> tracked =
      needed(design(study.options, kDesignLength_samples, Objective::D, limits_with_headroom()));
  if (!tracked) return tl::unexpected(tracked.error());
  study.tracked = std::move(*tracked);
  if (study.d_designs.size() < 2 || study.a_designs.size() < 2)
    return failure("hardly any design was found; more --starts find them");
  return {};
}

Result<void> compute_table(Study& study, Progress& progress) {
  progress.begin("repeats on the simulated brake", 0.02);
  const StudyOptions& options = study.options;
  Result<Experiment> optimal = drive(study.tracked.response, options.repeats, options.seed + 1);
  if (!optimal) return tl::unexpected(optimal.error());
  study.optimal = std::move(*optimal);
  Result<Experiment> step = drive_manoeuvre("step", options.repeats, options.seed + 2, kDesignLength_samples);
  if (!step) return tl::unexpected(step.error());
  study.step = std::move(*step);

  progress.begin("output error method", 0.01);
  study.oem_optimal = estimate_each("OEM, optimal", identify_output_error, study.optimal, progress);
  study.oem_step = estimate_each("OEM, step", identify_output_error, study.step, progress);
  progress.begin("prediction error method", 0.02);
  study.pem_optimal = estimate_each("PEM, optimal", identify_prediction_error, study.optimal, progress);
  std::vector<Run> runs;
  for (const SimulatedRun& run : study.optimal.runs) runs.push_back(run.readings);
  study.pooled = identify_prediction_error(runs, EstimatorOptions{});
  for (Column* column : {&study.oem_optimal, &study.pem_optimal}) compute_bounds(*column, study.optimal);
  compute_bounds(study.oem_step, study.step);
  for (const Column* column : {&study.oem_optimal, &study.pem_optimal, &study.oem_step})
    if (column->estimates.size() < 2)
      return failure(fmt::format("{}: only {} of {} repeats could be estimated; try another --seed",
                                 column->name, column->estimates.size(), options.repeats));
  return {};
}

Result<void> compute_validation(Study& study, Progress& progress) {
  progress.begin("validation", 0.11);
  const StudyOptions& options = study.options;
  Result<Experiment> validation = drive_manoeuvre("apply-release", 1, options.seed + 3);
  if (!validation) return tl::unexpected(validation.error());
  study.validation = std::move(validation->runs.front());
  const BrakeParameters oem = brake_of(study.oem_optimal), pem = brake_of(study.pem_optimal);
  const Run& run = study.validation.readings;
  study.validation_predictions = {predict("nominal", run, BrakeParameters{}),
                                  predict("OEM, optimal", run, oem), predict("PEM, optimal", run, pem),
                                  predict("OEM, step", run, brake_of(study.oem_step))};

  Result<Experiment> sinusoid = drive_manoeuvre("slow-sinusoid", options.repeats, options.seed + 4);
  if (!sinusoid) return tl::unexpected(sinusoid.error());
  study.sinusoid = std::move(*sinusoid);
  study.sinusoid_replays = {replay("OEM", study.sinusoid, oem), replay("PEM", study.sinusoid, pem),
                            replay("true parameters", study.sinusoid, true_brake())};
  const std::vector<Prediction>& by_oem = study.sinusoid_replays.front().repeats;
  study.shown_repeat =
      static_cast<std::size_t>(std::max_element(by_oem.begin(), by_oem.end(),
                                                [](const Prediction& a, const Prediction& b) {
                                                  return a.force_rms_N < b.force_rms_N;
                                                }) -
                               by_oem.begin());
  const Run& shown = study.sinusoid.runs[study.shown_repeat].readings;
  study.kalman = kalman_views(
      shown, pem, start_of(shown),
      {{study.pooled.noise_force_N, study.pooled.noise_velocity_rad_s}, study.pooled.noise_torque_Nm});
  study.oem_sinusoid =
      estimate_each("OEM, sinusoid", identify_output_error, study.sinusoid, progress, Keep::Finite);
  study.pem_sinusoid =
      estimate_each("PEM, sinusoid", identify_prediction_error, study.sinusoid, progress, Keep::Finite);
  return {};
}

}  // namespace

Result<void> StudyOptions::validate() const {
  if (repeats < 3 || repeats > 1000)
    return failure("repeats must be 3 to 1000: variances are taken over them");
  if (starts < 1) return failure("starts must be at least 1");
  return {};
}

BrakeParameters true_brake() {
  BrakeParameters brake;
  ParameterVector normalised;
  normalised << 0.844, 0.936, 1.668, 0.921, 2.450, 0.875, 0.406;
  brake.theta = normalised.cwiseProduct(nominal_parameters());
  return brake;
}

Result<Study> compute_study(const StudyOptions& options) {
  if (const Result<void> valid = options.validate(); !valid) return tl::unexpected(valid.error());
  const auto started = std::chrono::steady_clock::now();
  Study study;
  study.options = options;
  Progress progress(study.options);
  for (const auto stage : {compute_designs, compute_table, compute_validation})
    if (const Result<void> done = stage(study, progress); !done) return tl::unexpected(done.error());
  study.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return study;
}

}  // namespace clampd::reproduce
