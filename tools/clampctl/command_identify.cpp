#include <cmath>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/archive/json.hpp"
#include "clampd/base/json.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/identify/extended_identification.hpp"
#include "clampd/identify/profile.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "clampd/sheet/evaluation.hpp"
#include "clampd/station/verdict.hpp"
#include "clampd/views/check_table.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/clampctl/identify_drive.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct IdentifyOptions {
  std::vector<std::string> files;
  std::string method = "oem";
  std::string parameters;
  std::string model;
  std::vector<std::string> held;
  std::vector<std::string> profiles;
  bool robust = false;
  std::string sheet_file;
  std::string json;
  std::string save;
  EstimatorOptions estimator;
  std::optional<ExtendedParameters> extended;  ///< of the model file
  std::optional<Sheet> sheet;                  ///< of the sheet file
};

/// What the runs say of the sheet's characteristics.
SheetRecord judged_sheet(const Sheet& sheet, const Estimate& summary, const std::vector<Run>& runs,
                         const BrakeParameters& nominal) {
  const SystematicMisfit misfit = systematic_misfit(runs, summary);
  const bool is_marked = misfit.counts(summary.covariance_normalised.diagonal().cwiseSqrt());
  Posterior posterior =
      is_marked ? posterior_of(summary, misfit.covariance_normalised) : posterior_of(summary);
  posterior.contact = contact_point(runs, summary);
  return {
      sheet.file, sheet.revision, sheet.sha256, is_marked,
      judge_sheet(sheet.characteristics, evaluate(sheet.characteristics, posterior, nominal_drive(nominal)),
                  LimitSet{}.guard_band_k)};
}

/// Beyond this correlation two parameters are hard to tell apart.
constexpr double kHardToTellApart = 0.95;

struct Correlation {
  std::size_t first, second;
  double value;
};

std::vector<Correlation> strong_correlations(const ParameterMatrix& covariance) {
  std::vector<Correlation> strong;
  for (std::size_t i = 0; i < kParameterCount; ++i)
    for (std::size_t j = i + 1; j < kParameterCount; ++j) {
      const auto row = static_cast<Eigen::Index>(i);
      const auto column = static_cast<Eigen::Index>(j);
      const double value =
          covariance(row, column) / std::sqrt(covariance(row, row) * covariance(column, column));
      if (std::abs(value) > kHardToTellApart) strong.push_back({i, j, value});
    }
  return strong;
}

nlohmann::ordered_json matrix_json(const ParameterMatrix& matrix) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const auto& matrix_row : matrix.rowwise()) {
    nlohmann::ordered_json row = nlohmann::ordered_json::array();
    for (const double value : matrix_row) row.push_back(number_or_null(value));
    rows.push_back(std::move(row));
  }
  return rows;
}

nlohmann::ordered_json profile_json(const Profile& profile) {
  nlohmann::ordered_json points = nlohmann::ordered_json::array();
  for (const ProfilePoint& point : profile.points)
    points.push_back({{"value", point.value},
                      {"deviance", number_or_null(point.deviance)},
                      {"converged", point.converged}});
  return {{"name", kParameterTable[profile.parameter].name},
          {"lower", number_or_null(profile.lower)},
          {"upper", number_or_null(profile.upper)},
          {"converged", profile.converged},
          {"message", profile.message},
          {"points", std::move(points)}};
}

/// One entry an effect of the model; none if there is no estimate.
nlohmann::ordered_json effects_json(const Estimate& summary, const ExtendedParameters& model) {
  nlohmann::ordered_json effects = nlohmann::ordered_json::array();
  std::size_t next = 0;
  for (const EffectValues& values : model.effects) {
    const std::size_t count = info_of(*values.effect).parameters.size();
    if (next + count > summary.effects.size()) break;
    nlohmann::ordered_json parameters = nlohmann::ordered_json::array();
    for (std::size_t i = 0; i < count; ++i) {
      const EffectEstimate& estimate = summary.effects[next + i];
      parameters.push_back({{"name", estimate.parameter},
                            {"unit", estimate.unit},
                            {"value", number_or_null(estimate.value)},
                            {"sd", number_or_null(estimate.sd)}});
    }
    effects.push_back({{"name", info_of(*values.effect).name}, {"parameters", std::move(parameters)}});
    next += count;
  }
  return effects;
}

nlohmann::ordered_json identify_json(const Estimate& summary, const IdentifyOptions& options,
                                     const std::vector<Profile>& profiles) {
  const ParameterVector nominal = nominal_parameters();
  const ParameterMatrix& covariance = summary.covariance_normalised;
  nlohmann::ordered_json document{{"schema", "clampd.identify/1"},
                                  {"method", to_string(summary.method)},
                                  {"runs", options.files.size()},
                                  {"converged", summary.converged()},
                                  {"termination", to_string(summary.termination)},
                                  {"message", summary.message},
                                  {"iterations", summary.iterations},
                                  {"wall_s", summary.wall_s}};
  auto& parameters = document["parameters"] = nlohmann::ordered_json::array();
  for (Eigen::Index i = 0; i < nominal.size(); ++i) {
    const auto& info = kParameterTable[static_cast<std::size_t>(i)];
    const double normalised = summary.parameters.theta[i] / nominal[i];
    const double normalised_sd = std::sqrt(covariance(i, i));
    parameters.push_back({{"name", info.name},
                          {"unit", info.unit},
                          {"value", number_or_null(summary.parameters.theta[i])},
                          {"sd", number_or_null(normalised_sd * std::abs(nominal[i]))},
                          {"normalised", number_or_null(normalised)},
                          {"normalised_sd", number_or_null(normalised_sd)},
                          {"held", options.estimator.held[static_cast<std::size_t>(i)]}});
  }
  document["covariance_normalised"] = matrix_json(covariance);
  document["covariance_exact_torque"] = matrix_json(summary.covariance_exact_torque);
  document["runs_differ"] = summary.runs_differ;
  document["noise"] = {{"force_N", number_or_null(summary.noise_force_N)},
                       {"velocity_rad_s", number_or_null(summary.noise_velocity_rad_s)},
                       {"torque_Nm", number_or_null(summary.noise_torque_Nm)}};
  document["fit"] = {{"force_rms_N", number_or_null(summary.force_rms_N)},
                     {"velocity_rms_rad_s", number_or_null(summary.velocity_rms_rad_s)},
                     {"log_likelihood", number_or_null(summary.log_likelihood)}};
  if (options.extended) document["effects"] = effects_json(summary, *options.extended);
  if (!profiles.empty()) {
    auto& list = document["profiles"] = nlohmann::ordered_json::array();
    for (const Profile& profile : profiles) list.push_back(profile_json(profile));
  }
  return document;
}

void print_effects(const Estimate& summary) {
  if (summary.effects.empty()) return;
  fmt::print("\n");
  for (const EffectEstimate& effect : summary.effects) {
    const std::string name = fmt::format("{}.{}", effect.effect, effect.parameter);
    if (!std::isfinite(effect.value))
      fmt::print("  {:<32} not identifiable from these data\n", name);
    else if (!std::isfinite(effect.sd))
      fmt::print("  {:<32} {:>12.5g} {:>11}  {}\n", name, effect.value, "as given", effect.unit);
    else
      fmt::print("  {:<32} {:>12.5g} {:>11.2g}  {}\n", name, effect.value, effect.sd, effect.unit);
  }
}

void print_table(const Estimate& summary, const IdentifyOptions& options,
                 const std::vector<Profile>& profiles) {
  const ParameterVector nominal = nominal_parameters();
  const ParameterMatrix& covariance = summary.covariance_normalised;
  const std::size_t runs = options.files.size();
  fmt::print("{} error method on {} run{}: {} ({} iterations, {:.1f} ms)\n",
             summary.method == Method::OutputError ? "Output" : "Prediction", runs, runs == 1 ? "" : "s",
             summary.message, summary.iterations, 1e3 * summary.wall_s);
  if (!std::isfinite(summary.force_rms_N) || summary.termination == Termination::Unexplained) return;
  fmt::print("\n  {:<5} {:>12} {:>11}  {:<11} {:>11} {:>9}\n", "", "estimate", "± sd", "unit", "normalised",
             "± sd");
  for (Eigen::Index i = 0; i < nominal.size(); ++i) {
    const auto& info = kParameterTable[static_cast<std::size_t>(i)];
    const double value = summary.parameters.theta[i];
    const double sd = std::sqrt(covariance(i, i));
    if (!std::isfinite(value))
      fmt::print("  {:<5} not identifiable from these data\n", info.name);
    else if (options.estimator.held[static_cast<std::size_t>(i)])
      fmt::print("  {:<5} {:>12.5g} {:>11}  {:<11} {:>11.4f}\n", info.name, value, "held", info.unit,
                 value / nominal[i]);
    else if (!std::isfinite(sd))
      fmt::print("  {:<5} {:>12.5g} {:>11}  {:<11} {:>11.4f}\n", info.name, value, "", info.unit,
                 value / nominal[i]);
    else
      fmt::print("  {:<5} {:>12.5g} {:>11.2g}  {:<11} {:>11.4f} {:>9.4f}\n", info.name, value,
                 sd * std::abs(nominal[i]), info.unit, value / nominal[i], sd);
  }
  print_effects(summary);
  fmt::print("\n  noise: force {:.3g} N, velocity {:.3g} rad/s, torque {:.2g} N m\n", summary.noise_force_N,
             summary.noise_velocity_rad_s, summary.noise_torque_Nm);
  fmt::print("  {}: force {:.1f} N rms, velocity {:.3f} rad/s rms\n",
             summary.method == Method::OutputError ? "residuals" : "one-step prediction errors",
             summary.force_rms_N, summary.velocity_rms_rad_s);
  if (summary.runs_differ)
    fmt::print(
        "  the runs differ from each other by more than this noise: the uncertainty is from their scatter\n");
  for (const Correlation& correlation : strong_correlations(covariance))
    fmt::print("  {} and {} are hard to tell apart here (correlation {:+.3f})\n",
               kParameterTable[correlation.first].name, kParameterTable[correlation.second].name,
               correlation.value);
  for (const Profile& profile : profiles) {
    const ParameterInfo& info = kParameterTable[profile.parameter];
    const auto bound = [](double value) {
      return std::isfinite(value) ? fmt::format("{:.5g}", value) : std::string("not bounded");
    };
    fmt::print("\n  {} by profile likelihood, 95 %: {} ... {} {}\n", info.name, bound(profile.lower),
               bound(profile.upper), info.unit);
    for (const ProfilePoint& point : profile.points)
      fmt::print("  {:>12.5g}  deviance {:.2f}{}\n", point.value, point.deviance,
                 point.converged ? "" : ", the fit of the others did not converge");
    if (!profile.converged) fmt::print("  this interval cannot be relied on: {}\n", profile.message);
    if (!std::isfinite(profile.lower) || !std::isfinite(profile.upper))
      fmt::print("  the interval is not closed: these data do not bound {} {}\n", info.name,
                 std::isfinite(profile.lower)   ? "from above"
                 : std::isfinite(profile.upper) ? "from below"
                                                : "at all");
  }
}

Result<std::size_t> parameter_named(const std::string& name) {
  if (const auto found = find_parameter(name)) return *found;
  std::string known;
  for (const ParameterInfo& info : kParameterTable) known += fmt::format(" {}", info.name);
  return failure(fmt::format("there is no parameter '{}'; known are{}", name, known));
}

int identify_files(IdentifyOptions options) {
  if (const Result<void> writable = cli::check_document(options.json); !writable)
    return cli::refuse(writable.error());
  EstimatorOptions& settings = options.estimator;
  if (!options.model.empty()) {
    Result<ExtendedParameters> model = read_extended_parameters(options.model);
    if (!model) return cli::refuse(model.error());
    settings.start = model->base;
    options.extended = std::move(*model);
    options.method = to_string(Method::PredictionError);
  }
  if (!options.parameters.empty()) {
    Result<BrakeParameters> start = read_brake_parameters(options.parameters);
    if (!start) return cli::refuse(start.error());
    settings.start = *start;
  }
  if (!options.sheet_file.empty()) {
    Result<Sheet> sheet = read_sheet(options.sheet_file);
    if (!sheet) return cli::refuse(sheet.error());
    if (options.extended)
      if (const Result<void> countable = check_countable(options.extended->effects); !countable)
        return cli::refuse(Error{fmt::format("{}: {}: leave out one of --sheet and --model",
                                             options.sheet_file, countable.error().message)});
    options.sheet = std::move(*sheet);
  }
  settings.loss = options.robust ? Loss::Robust : Loss::Squared;
  for (const std::string& name : options.held) {
    const Result<std::size_t> parameter = parameter_named(name);
    if (!parameter) return cli::refuse(parameter.error());
    settings.held[*parameter] = true;
  }
  std::vector<Parameter> to_profile;
  for (const std::string& name : options.profiles) {
    const Result<std::size_t> parameter = parameter_named(name);
    if (!parameter) return cli::refuse(parameter.error());
    if (settings.held[*parameter])
      return cli::refuse(Error{fmt::format("{} is held: it has no profile", name)});
    to_profile.push_back(static_cast<Parameter>(*parameter));
  }
  if (const Result<void> valid = settings.validate(); !valid) return cli::refuse(valid.error());
  std::vector<Run> runs;
  for (const std::string& file : options.files) {
    Result<LoadedRun> loaded = read_run(file);
    if (!loaded) return cli::refuse(loaded.error());
    for (const std::string& notice : loaded->notices) cli::print_notice(notice);
    if (is_driven(loaded->run))
      runs.push_back(std::move(loaded->run));
    else
      cli::print_notice(fmt::format("{}: the drive is off in all rows; it is left out", file));
  }
  const Method method = *parse_method(options.method);
  const Estimate summary = options.extended ? identify_extended(runs, *options.extended, settings)
                                            : identify_brake(method, runs, settings);
  std::vector<Profile> profiles;
  if (summary.converged()) {
    cli::ProgressLine progress;
    for (const Parameter parameter : to_profile) {
      progress.show(static_cast<double>(profiles.size()) / static_cast<double>(to_profile.size()),
                    fmt::format("profile of {}", kParameterTable[parameter].name));
      profiles.push_back(profile_likelihood(parameter, summary.method, runs, settings, summary));
    }
  } else if (!to_profile.empty()) {
    cli::print_notice("no profile likelihood, since there is no estimate to start it from");
  }
  std::optional<SheetRecord> sheet;
  if (options.sheet)
    sheet = judged_sheet(*options.sheet, summary, runs, BrakeParameters{.fixed = settings.start.fixed});
  nlohmann::ordered_json document = identify_json(summary, options, profiles);
  if (sheet)
    for (const CharacteristicRecord& line : sheet->characteristics)
      document["sheet"].push_back(characteristic_json(line, sheet->misfit_marked));
  if (const Result<void> written = cli::write_json(options.json, document); !written)
    return cli::refuse(written.error());
  if (options.json != "-") {
    print_table(summary, options, profiles);
    if (sheet) fmt::print("\n{}", format_sheet(*sheet, cli::colours_wanted()));
  }
  if (summary.termination != Termination::Unexplained) return cli::kSuccess;
  cli::print_error(summary.message + "; `clampctl diagnose` looks for the cause");
  return cli::kStation;
}

}  // namespace

void add_identify_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<IdentifyOptions>();
  CLI::App* command = app.add_subcommand("identify", "parameters, covariance and fit from run files");
  command->add_option("runs", options->files, "run files (CSV), in chronological order")
      ->required()
      ->type_name("RUN.csv");
  command
      ->add_option(
          "--method", options->method,
          "oem: output error method; pem: prediction error method, better where the torque reading is "
          "noisy or the brake moves slowly under load")
      ->check(CLI::IsMember({"oem", "pem"}))
      ->capture_default_str();
  command
      ->add_option("--parameters", options->parameters,
                   "start values and fixed J, N (default: the paper's Table I)")
      ->type_name("FILE.toml");
  command
      ->add_option(
          "--model", options->model,
          "estimate the effects of this model too, as `clampctl diagnose --save` writes it: of a brake "
          "by the prediction error method, from the model's own values; of a drive all of its terms")
      ->type_name("MODEL.toml");
  command->add_option("--hold", options->held, "parameters that stay at their start value")
      ->type_name("NAME");
  command->add_flag(
      "--robust", options->robust,
      "spikes in the readings count little (Huber's loss); slightly less efficient without them");
  command->add_option("--noise-force", options->estimator.noise_force_N, "N, if known: standard deviation")
      ->type_name("N");
  command->add_option("--noise-velocity", options->estimator.noise_velocity_rad_s, "rad/s, if known")
      ->type_name("RAD/S");
  command
      ->add_option("--noise-torque", options->estimator.noise_torque_Nm,
                   "N m, if known: of the torque reading, per millisecond")
      ->type_name("NM");
  command
      ->add_option("--profile", options->profiles,
                   "profile likelihood of these parameters: an interval without the normal approximation")
      ->type_name("NAME");
  command
      ->add_option(
          "--sheet", options->sheet_file,
          "what a requirement sheet asks of this brake, response times, drag, holding, as the runs have it")
      ->type_name("SHEET.toml");
  command->add_option("--json", options->json, "write the result as clampd.identify/1; - for standard output")
      ->type_name("FILE");
  command->add_option("--save", options->save, "of a drive: the model with what these runs say")
      ->type_name("FITTED.toml");
  for (const char* other : {"--parameters", "--profile", "--robust"})
    command->get_option("--model")->excludes(command->get_option(other));
  command->callback([options, command, &exit_code] {
    if (const Result<std::string> text = read_file(options->model); text && is_drive_model(*text)) {
      for (const char* of_brakes :
           {"--method", "--hold", "--noise-force", "--noise-velocity", "--noise-torque"})
        if (command->count(of_brakes) > 0) {
          exit_code = cli::refuse(Error{fmt::format(
              "{} is a model of a drive, and {} is of brakes: leave it out", options->model, of_brakes)});
          return;
        }
      exit_code = identify_drive_files({options->files, options->model, *text, options->json, options->save});
      return;
    }
    if (!options->save.empty()) {
      exit_code = cli::refuse(Error{"--save is of drives: give --model with a saved model of one"});
      return;
    }
    if (!options->model.empty() && command->count("--method") > 0 &&
        options->method == to_string(Method::OutputError)) {
      exit_code = cli::refuse(
          Error{"--model and --method oem exclude each other: effects are estimated by the prediction error "
                "method; leave --method out"});
      return;
    }
    exit_code = identify_files(*options);
  });
}

}  // namespace clampd::ctl
