// The estimators beside what a user would otherwise do, on the same runs: scipy's least_squares with numba.

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <random>

#include "clampd/base/assert.hpp"
#include "clampd/identify/output_error.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "tests/benchmarks/python.hpp"
#include "tests/benchmarks/workloads.hpp"

namespace clampd::bench {
namespace {

constexpr std::size_t kDataSets = 20;

/// Two programs are one model if their outputs differ by no more.
constexpr double kSameForce_N = 1.0;
constexpr double kSameVelocity_rad_s = 0.05;

/// A squared error, in units of the Cramer-Rao bound, that an efficient estimator of seven parameters meets
/// once in a million.
constexpr double kLostSquare = 40.5;

struct Fit {
  double seconds;  ///< of the processor
  ParameterVector normalised;
};

struct Study {
  const char* title;
  const char* scipy_method;
  NoiseLevels noise;
  std::vector<Run> runs;
  std::vector<ParameterVector> starts;  ///< normalised, one a run
};

std::vector<ParameterVector> nominal_starts() {
  return std::vector<ParameterVector>(kDataSets, ParameterVector::Ones());
}

/// Within 50 % of the truth, each parameter on its own.
std::vector<ParameterVector> far_starts() {
  std::mt19937_64 generator(7);
  std::uniform_real_distribution<double> factor(0.5, 1.5);
  std::vector<ParameterVector> starts;
  for (std::size_t i = 0; i < kDataSets; ++i) {
    starts.push_back(true_brake().theta.cwiseQuotient(nominal_parameters()));
    for (double& value : starts.back()) value *= factor(generator);
  }
  return starts;
}

std::vector<Fit> fit_all(const Study& study, decltype(identify_output_error)* identify,
                         EstimatorOptions options) {
  std::vector<Fit> fits;
  for (std::size_t i = 0; i < study.runs.size(); ++i) {
    options.start.theta = study.starts[i].cwiseProduct(nominal_parameters());
    const std::clock_t before = std::clock();
    const Estimate estimate = identify({&study.runs[i], 1}, options);
    const double seconds = static_cast<double>(std::clock() - before) / CLOCKS_PER_SEC;
    fits.push_back({seconds, estimate.parameters.theta.cwiseQuotient(nominal_parameters())});
  }
  return fits;
}

std::vector<Fit> fits_from(const nlohmann::json& document) {
  std::vector<Fit> fits;
  for (const nlohmann::json& entry : document) {
    Fit fit{entry["seconds"], {}};
    for (std::size_t i = 0; i < kParameterCount; ++i)
      fit.normalised[static_cast<Eigen::Index>(i)] = entry["normalised"][i];
    fits.push_back(fit);
  }
  return fits;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return 0.5 * (values[(values.size() - 1) / 2] + values[values.size() / 2]);
}

/// Prints one method's line; its median time.
double print_line(const std::string& method, const std::vector<Fit>& fits, const ParameterMatrix& information,
                  double reference_seconds) {
  std::vector<double> seconds, errors;
  int lost = 0;
  for (const Fit& fit : fits) {
    const ParameterVector error = fit.normalised - true_brake().theta.cwiseQuotient(nominal_parameters());
    const double square = error.dot(information * error);
    seconds.push_back(fit.seconds);
    errors.push_back(std::sqrt(square / static_cast<double>(kParameterCount)));
    lost += !(square < kLostSquare);
  }
  const double time = median(seconds);
  fmt::print("  {:<44}{:>9.2f} ms{:>9.1f}{:>12.2f}{:>9} of {}\n", method, 1e3 * time,
             reference_seconds > 0.0 ? time / reference_seconds : 1.0, median(errors), lost, fits.size());
  return time;
}

nlohmann::json task_for(const std::vector<Study>& studies, const support::TemporaryDirectory& directory) {
  nlohmann::json task;
  const auto write = [&](const Run& run, const std::string& name) {
    CLAMPD_ASSERT(write_run(directory.path(name), run).has_value());
  };
  const auto as_list = [](const ParameterVector& vector) {
    return std::vector<double>(vector.begin(), vector.end());
  };
  Run noise_free = simulated_runs(1, {}, 1).front();
  Simulation simulation(noise_free.size());
  simulate(true_brake(), BrakeState::Zero(), excitation_of(noise_free), simulation);
  noise_free.force_N = simulation.force_N;
  noise_free.velocity_rad_s = simulation.velocity_rad_s;
  write(noise_free, "noise_free.csv");
  task["same_model"] = {{"run", "noise_free.csv"},
                        {"normalised", as_list(true_brake().theta.cwiseQuotient(nominal_parameters()))}};
  for (std::size_t s = 0; s < studies.size(); ++s) {
    const Study& study = studies[s];
    nlohmann::json fits;
    for (std::size_t i = 0; i < study.runs.size(); ++i) {
      const std::string name = fmt::format("{}-{}.csv", s, i);
      write(study.runs[i], name);
      fits.push_back({name, as_list(study.starts[i])});
    }
    task["cases"].push_back(
        {{"method", study.scipy_method},
         {"noise", {study.noise.sensors.force_N, study.noise.sensors.velocity_rad_s, study.noise.torque_Nm}},
         {"fits", fits}});
  }
  return task;
}

void compare() {
  const std::vector<Run> quiet = simulated_runs(kDataSets, kQuietTorque, 11);
  const std::vector<Run> noisy = simulated_runs(kDataSets, kNoisyTorque, 12);
  const std::vector<Study> studies = {
      {"no torque noise, from nominal", "oem", kQuietTorque, quiet, nominal_starts()},
      {"no torque noise, from within 50 % of the truth", "oem", kQuietTorque, quiet, far_starts()},
      {"torque noise, from nominal", "pem", kNoisyTorque, noisy, nominal_starts()},
      {"torque noise, from within 50 % of the truth", "pem", kNoisyTorque, noisy, far_starts()}};
  const support::TemporaryDirectory directory;
  directory.write("cases.json", task_for(studies, directory).dump());
  const auto scipy = run_baseline("estimation.py", directory, "scipy.json");
  if (scipy) {
    const double force_N = (*scipy)["differences"]["force_N"];
    const double velocity_rad_s = (*scipy)["differences"]["velocity_rad_s"];
    const bool same = force_N < kSameForce_N && velocity_rad_s < kSameVelocity_rad_s;
    fmt::print("same model: {} ({}; largest differences {:.1g} N, {:.1g} rad/s)\n", same ? "yes" : "NO",
               (*scipy)["versions"].get<std::string>(), force_N, velocity_rad_s);
  }
  const std::vector<double> torque_Nm = check_torque();
  for (std::size_t s = 0; s < studies.size(); ++s) {
    const Study& study = studies[s];
    const bool prediction = study.noise.torque_Nm > 0.0;
    const ParameterMatrix information =
        initial_state_unknown(joint_information(true_brake(), BrakeState::Zero(), {torque_Nm}, study.noise));
    fmt::print("\n{:<46}{:>12}{:>9}{:>12}{:>13}\n", study.title, "processor", "ratio", "error (sd)", "lost");
    const double reference = print_line(
        prediction ? "clampd PEM, noise estimated" : "clampd OEM, noise estimated",
        fit_all(study, prediction ? identify_prediction_error : identify_output_error, {}), information, 0.0);
    if (prediction) {
      print_line("clampd PEM, noise known", fit_all(study, identify_prediction_error, knowing(study.noise)),
                 information, reference);
      print_line("clampd OEM, noise estimated", fit_all(study, identify_output_error, {}), information,
                 reference);
    }
    if (scipy)
      print_line(fmt::format("scipy {}, noise known", prediction ? "PEM" : "OEM"),
                 fits_from((*scipy)["cases"][s]), information, reference);
  }
  fmt::print(
      "\n{} data sets each of 300 samples; medians. Sensors 75 N, 1.5 rad/s without torque noise; 30 N,\n"
      "0.3 rad/s with 0.0142 N m. error: root mean square over the parameters, in standard deviations of "
      "the\n"
      "Cramer-Rao bound; lost: further from the truth than an efficient estimator is once in a million "
      "times,\n"
      "a wrong optimum (or, for OEM under torque noise, its inefficiency).\n",
      kDataSets);
}

}  // namespace
}  // namespace clampd::bench

int main() {
  clampd::bench::compare();
}
