#include <cmath>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/identify/output_error.hpp"
#include "clampd/record/run.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct IdentifyOptions {
  std::vector<std::string> files;
  std::string method = "oem";
  std::string parameters;
  std::string json;
};

nlohmann::ordered_json number_or_null(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}

nlohmann::ordered_json identify_json(const Estimate& summary, std::size_t runs) {
  const ParameterVector nominal = nominal_parameters();
  const ParameterMatrix& covariance = summary.covariance_normalised;
  nlohmann::ordered_json document{{"schema", "clampd.identify/1"},
                                  {"method", "oem"},
                                  {"runs", runs},
                                  {"converged", summary.converged()},
                                  {"termination", to_string(summary.termination)},
                                  {"message", summary.message},
                                  {"iterations", summary.iterations},
                                  {"wall_s", summary.wall_s}};
  auto& parameters = document["parameters"] = nlohmann::ordered_json::array();
  auto& matrix = document["covariance_normalised"] = nlohmann::ordered_json::array();
  for (Eigen::Index i = 0; i < nominal.size(); ++i) {
    const auto& info = kParameterTable[static_cast<std::size_t>(i)];
    const double normalised = summary.parameters.theta[i] / nominal[i];
    const double normalised_sd = std::sqrt(covariance(i, i));
    parameters.push_back({{"name", info.name},
                          {"unit", info.unit},
                          {"value", number_or_null(summary.parameters.theta[i])},
                          {"sd", number_or_null(normalised_sd * std::abs(nominal[i]))},
                          {"normalised", number_or_null(normalised)},
                          {"normalised_sd", number_or_null(normalised_sd)}});
    nlohmann::ordered_json row = nlohmann::ordered_json::array();
    for (Eigen::Index j = 0; j < nominal.size(); ++j) row.push_back(number_or_null(covariance(i, j)));
    matrix.push_back(std::move(row));
  }
  document["noise"] = {{"force_N", number_or_null(summary.noise_force_N)},
                       {"velocity_rad_s", number_or_null(summary.noise_velocity_rad_s)},
                       {"torque_Nm", nullptr}};
  document["fit"] = {{"force_rms_N", number_or_null(summary.force_rms_N)},
                     {"velocity_rms_rad_s", number_or_null(summary.velocity_rms_rad_s)}};
  return document;
}

void print_table(const Estimate& summary, std::size_t runs) {
  const ParameterVector nominal = nominal_parameters();
  const ParameterMatrix& covariance = summary.covariance_normalised;
  fmt::print("Output error method on {} run{}: {} ({} iterations, {:.1f} ms)\n\n", runs, runs == 1 ? "" : "s",
             summary.message, summary.iterations, 1e3 * summary.wall_s);
  fmt::print("  {:<5} {:>12} {:>11}  {:<11} {:>11} {:>9}\n", "", "estimate", "± sd", "unit", "normalised",
             "± sd");
  for (Eigen::Index i = 0; i < nominal.size(); ++i) {
    const auto& info = kParameterTable[static_cast<std::size_t>(i)];
    const double sd = std::sqrt(covariance(i, i));
    fmt::print("  {:<5} {:>12.5g} {:>11.2g}  {:<11} {:>11.4f} {:>9.4f}\n", info.name,
               summary.parameters.theta[i], sd * std::abs(nominal[i]), info.unit,
               summary.parameters.theta[i] / nominal[i], sd);
  }
  fmt::print("\n  residuals: force {:.1f} N rms, velocity {:.3f} rad/s rms\n", summary.force_rms_N,
             summary.velocity_rms_rad_s);
}

int identify(const IdentifyOptions& options) {
  if (const Result<void> writable = cli::check_writable(options.json); !writable)
    return cli::refuse(writable.error());
  std::vector<Run> runs;
  for (const std::string& file : options.files) {
    Result<LoadedRun> loaded = read_run(file);
    if (!loaded) return cli::refuse(loaded.error());
    for (const std::string& notice : loaded->notices) cli::print_notice(notice);
    runs.push_back(std::move(loaded->run));
  }
  EstimatorOptions settings;
  if (!options.parameters.empty()) {
    Result<BrakeParameters> start = read_brake_parameters(options.parameters);
    if (!start) return cli::refuse(start.error());
    settings.start = *start;
  }
  const Estimate summary = identify_output_error(runs, settings);
  if (const Result<void> written = cli::write_json(options.json, identify_json(summary, runs.size()));
      !written)
    return cli::refuse(written.error());
  if (options.json != "-") print_table(summary, runs.size());
  return cli::kSuccess;
}

}  // namespace

void add_identify_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<IdentifyOptions>();
  CLI::App* command = app.add_subcommand("identify", "parameters, covariance and fit from run files");
  command->add_option("runs", options->files, "run files (CSV), in chronological order")
      ->required()
      ->type_name("RUN.csv");
  command->add_option("--method", options->method, "oem: output error method")
      ->check(CLI::IsMember({"oem"}))
      ->capture_default_str();
  command
      ->add_option("--parameters", options->parameters,
                   "start values and fixed J, N (default: the paper's Table I)")
      ->type_name("FILE.toml");
  command->add_option("--json", options->json, "write the result as clampd.identify/1; - for standard output")
      ->type_name("FILE");
  command->callback([options, &exit_code] { exit_code = identify(*options); });
}

}  // namespace clampd::ctl
