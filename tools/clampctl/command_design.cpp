#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "clampd/base/json.hpp"
#include "clampd/experiment/optimal_design.hpp"
#include "clampd/experiment/robust_design.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

namespace fs = std::filesystem;

constexpr std::string_view kRobust = "robust";

struct DesignCommandOptions {
  double duration_s = 0.3;
  DesignOptions design;
  std::string objective = "d";
  RobustOptions robust;
  std::size_t starts = 0;  ///< 0: the objective's own default
  std::string parameters;
  std::string beside;
  std::vector<std::string> wanted;
  std::string json;
  std::string trajectory;
};

/// The robust design at the parameters of --for, if there are any.
Result<void> aim(DesignCommandOptions& options) {
  if (options.beside.empty()) return {};
  return read_run(options.beside).map([&](LoadedRun loaded) {
    RobustTarget& target = options.robust.target.emplace();
    target.beside = std::move(loaded.run);
    for (const std::string& name : options.wanted) target.parameters.push_back(static_cast<Parameter>(*find_parameter(name)));
  });
}

Result<void> prepare(DesignCommandOptions& options) {
  DesignOptions& design = options.design;
  const double samples = options.duration_s / kMaxStep_s;
  if (!(samples >= static_cast<double>(kFewestSamples) && samples <= static_cast<double>(kMaxSamples)))
    return failure(fmt::format("--duration {} s is not possible; {} to {} s are", options.duration_s,
                               static_cast<double>(kFewestSamples) * kMaxStep_s,
                               static_cast<double>(kMaxSamples) * kMaxStep_s));
  if (std::abs(samples - std::round(samples)) > 1e-6)
    return failure(fmt::format("--duration {} s is not a whole number of milliseconds", options.duration_s));
  design.samples = static_cast<std::size_t>(std::llround(samples));
  if (const std::optional<Objective> objective = parse_objective(options.objective))
    design.objective = *objective;
  if (!options.parameters.empty()) {
    Result<BrakeParameters> brake = read_brake_parameters(options.parameters);
    if (!brake) return tl::unexpected(brake.error());
    design.brake = *brake;
  }
  RobustOptions& robust = options.robust;
  if (options.starts > 0) design.starts = robust.starts = static_cast<int>(options.starts);
  if (const Result<void> valid = design.validate(); !valid) return valid;
  if (options.objective == kRobust) {
    if (!design.initial.isZero()) return failure("a robust design starts at contact and at rest");
    robust.nominal = design.brake;
    robust.samples = design.samples;
    robust.block_samples = design.block_samples;
    robust.noise.sensors = design.noise;
    // The loop's own, closer limits unless closer ones are wanted.
    robust.limits.torque_Nm = std::min(robust.limits.torque_Nm, design.limits.torque_Nm);
    robust.limits.force_N = std::min(robust.limits.force_N, design.limits.force_N);
    robust.limits.velocity_rad_s = std::min(robust.limits.velocity_rad_s, design.limits.velocity_rad_s);
    robust.limits.end_velocity_rad_s =
        std::min(robust.limits.end_velocity_rad_s, design.limits.end_velocity_rad_s);
    robust.seed = design.seed;
    robust.threads = design.threads;
    if (const Result<void> aimed = aim(options); !aimed) return aimed;
    if (const Result<void> valid = robust.validate(); !valid) return valid;
  }
  if (options.objective != kRobust && !options.beside.empty())
    return failure("--for and --beside are for a robust design: add --objective robust");
  for (const std::string* path : {&options.json, &options.trajectory}) {
    if (path->empty()) continue;
    if (const Result<void> writable = cli::check_writable(*path); !writable) return writable;
  }
  std::error_code failed;
  if (!options.json.empty() && !options.trajectory.empty() &&
      fs::weakly_canonical(options.json, failed) == fs::weakly_canonical(options.trajectory, failed))
    return failure("--json and --out name the same file");
  return {};
}

nlohmann::ordered_json design_json(const DesignOptions& design, const DesignSummary& summary) {
  const Certification& certification = summary.certification;
  return {{"schema", "clampd.design/1"},
          {"duration_s", static_cast<double>(design.samples) * kMaxStep_s},
          {"block_samples", design.block_samples},
          {"objective", to_string(design.objective)},
          {"criterion",
           {{"logdet", summary.criterion.logdet}, {"trace_inverse", summary.criterion.trace_inverse}}},
          {"torque_Nm", summary.block_torque_Nm},
          {"force_max_N", certification.force_max_N},
          {"velocity_max_rad_s", certification.velocity_max_rad_s},
          {"wall_s", summary.wall_s},
          {"seed", design.seed},
          {"starts", design.starts},
          {"caution", design.caution},
          {"noise", {{"force_N", design.noise.force_N}, {"velocity_rad_s", design.noise.velocity_rad_s}}},
          {"initial", {{"position_rad", design.initial[0]}, {"velocity_rad_s", design.initial[1]}}},
          {"certification",
           {{"logdet", certification.criterion.logdet},
            {"trace_inverse", certification.criterion.trace_inverse},
            {"end_velocity_rad_s", certification.end_velocity_rad_s},
            {"amplification_rad_s_Nm", certification.amplification_rad_s_Nm},
            {"coarse_logdet", certification.coarse_logdet},
            {"force_difference_N", certification.force_difference_N},
            {"velocity_difference_rad_s", certification.velocity_difference_rad_s}}}};
}

std::vector<std::string> names_of(const std::vector<Parameter>& parameters) {
  std::vector<std::string> names;
  for (const Parameter parameter : parameters) names.emplace_back(kParameterTable[parameter].name);
  return names;
}

nlohmann::ordered_json robust_json(const RobustOptions& options, const RobustSummary& summary) {
  const RobustEvaluation& evaluation = summary.evaluation;
  nlohmann::ordered_json ranges = nlohmann::ordered_json::array();
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double one = std::pow(kTableII[i], -kBeyondTableII);
    const double other = std::pow(kTableII[i], 1.0 + kBeyondTableII);
    ranges.push_back({{"name", kParameterTable[i].name},
                      {"lower_normalised", std::min(one, other)},
                      {"upper_normalised", std::max(one, other)}});
  }
  nlohmann::ordered_json document{
          {"schema", "clampd.design/1"},
          {"duration_s", static_cast<double>(options.samples) * kMaxStep_s},
          {"block_samples", options.block_samples},
          {"objective", kRobust},
          {"criterion",
           {{"logdet", number_or_null(summary.nominal.criterion.logdet)},
            {"trace_inverse", number_or_null(summary.nominal.criterion.trace_inverse)}}},
          {"torque_Nm", summary.block_torque_Nm},
          {"force_max_N", evaluation.force_max_N},
          {"velocity_max_rad_s", evaluation.velocity_max_rad_s},
          {"wall_s", summary.wall_s},
          {"seed", options.seed},
          {"starts", options.starts},
          {"noise",
           {{"force_N", options.noise.sensors.force_N},
            {"velocity_rad_s", options.noise.sensors.velocity_rad_s},
            {"torque_Nm", options.noise.torque_Nm}}},
          {"tracking_rms_N", evaluation.tracking_rms_N},
          {"prior", {{"brakes", options.verify_brakes}, {"log_uniform", ranges}}}};
  const nlohmann::ordered_json gain{{"mean", summary.gain.mean}, {"worst_decile", summary.gain.worst_decile}};
  if (const auto& target = options.target) {
    document["for"] = names_of(target->parameters);
    document["beside"] = {{"trajectory", target->beside.name}, {"runs", target->runs}};
    document["expected_log_variance"] = evaluation.expected_logdet;
    document["gain_over_more_of_it"] = gain;
    return document;
  }
  document["expected_logdet"] = evaluation.expected_logdet;
  document["worst_decile_logdet"] = evaluation.worst_decile_logdet;
  document["step"] = {{"force_N", summary.step.force_N},
                      {"rise_s", summary.step.rise_s},
                      {"expected_logdet", summary.step_evaluation.expected_logdet},
                      {"worst_decile_logdet", summary.step_evaluation.worst_decile_logdet}};
  document["gain_over_step"] = gain;
  return document;
}

void print_torques(const std::vector<double>& block_torque_Nm) {
  fmt::print("  torque (N m)");
  for (std::size_t i = 0; i < block_torque_Nm.size(); ++i)
    fmt::print("{}{:>8.3f}", i > 0 && i % 10 == 0 ? "\n              " : "", block_torque_Nm[i]);
  fmt::print("\n\n");
}

void print_robust_summary(const RobustOptions& options, const RobustSummary& summary) {
  const RobustEvaluation& evaluation = summary.evaluation;
  fmt::print("Robust experiment of {:.3f} s, {} blocks of {} samples\n\n",
             static_cast<double>(options.samples) * kMaxStep_s, summary.block_torque_Nm.size(),
             options.block_samples);
  print_torques(summary.block_torque_Nm);
  fmt::print(
      "Over {} brakes as far from nominal as the paper's Table II, tracked in closed loop, initial state\n"
      "unknown, noise {:g} N, {:g} rad/s, {:g} N m:\n\n",
      options.verify_brakes, options.noise.sensors.force_N, options.noise.sensors.velocity_rad_s,
      options.noise.torque_Nm);
  if (const auto& target = options.target) {
    fmt::print(
        "  variance of {:<13}{:>8.2f}x   smaller by {:g} runs of it, beside {:g} of {}, than by as many more of that;\n"
        "                           {:>8.2f}x   in the worst tenth\n",
        fmt::format("{}", fmt::join(names_of(target->parameters), ", ")), summary.gain.mean, target->runs,
        target->runs, target->beside.name, summary.gain.worst_decile);
  } else {
    fmt::print("  log det of the covariance{:>9.3f}   expected; {:.3f} in the worst tenth\n",
               evaluation.expected_logdet, evaluation.worst_decile_logdet);
    fmt::print(
        "  variance of a parameter  {:>8.2f}x   smaller than by a step to {:g} kN in {:g} s, held;\n"
        "                           {:>8.2f}x   in the worst tenth\n",
        summary.gain.mean, 1e-3 * summary.step.force_N, summary.step.rise_s, summary.gain.worst_decile);
  }
  fmt::print(
      "  force, largest           {:>8.0f} N\n  speed, largest           {:>8.1f} rad/s\n"
      "  tracking error           {:>8.1f} N rms\n",
      evaluation.force_max_N, evaluation.velocity_max_rad_s, evaluation.tracking_rms_N);
  fmt::print("  nominal -log det M       {:>9.3f}   open loop, initial state and torque known\n\n",
             summary.nominal.criterion.logdet);
  fmt::print("  {} ({} starts, {:.1f} s)\n", summary.message, options.starts, summary.wall_s);
}

void print_summary(const DesignOptions& design, const DesignSummary& summary) {
  const Certification& certification = summary.certification;
  fmt::print("{}-optimal experiment of {:.3f} s, {} blocks of {} samples\n\n",
             design.objective == Objective::D ? "D" : "A", static_cast<double>(design.samples) * kMaxStep_s,
             summary.block_torque_Nm.size(), design.block_samples);
  print_torques(summary.block_torque_Nm);
  fmt::print("  -log det M       {:>10.3f}   (smaller is better; independent check {:.3f})\n",
             summary.criterion.logdet, certification.criterion.logdet);
  fmt::print("  trace of M^-1    {:>10.4g}   (sum of the relative variances)\n",
             summary.criterion.trace_inverse);
  fmt::print("  force, largest   {:>10.1f} N        limit {:g}\n", certification.force_max_N,
             design.limits.force_N);
  fmt::print("  speed, largest   {:>10.2f} rad/s    limit {:g}\n", certification.velocity_max_rad_s,
             design.limits.velocity_rad_s);
  fmt::print("  speed at the end {:>10.2f} rad/s\n", certification.end_velocity_rad_s);
  fmt::print(
      "  Fragility: 1 mN m of torque error moves the velocity by up to {:.3g} rad/s; over parameter changes\n"
      "  of {:g} of nominal -log det M is {:.3f}.\n",
      1e-3 * certification.amplification_rad_s_Nm, kFragilityStep, certification.coarse_logdet);
  if (certification.amplification_rad_s_Nm > kEasyAmplification_rad_s_Nm)
    fmt::print(
        "  It is the optimum of the nominal brake and of exact torques. On a real one, run a robust design:\n"
        "  --objective robust\n");
  fmt::print("\n");
  fmt::print("  {} ({} starts, {:.1f} s)\n", summary.message, design.starts, summary.wall_s);
}

/// The files that were asked for.
Result<void> write_files(const DesignCommandOptions& options, const nlohmann::ordered_json& document,
                         const Run& trajectory) {
  if (!options.trajectory.empty())
    if (const Result<void> written = write_run(options.trajectory, trajectory); !written) return written;
  if (!options.json.empty()) return write_file_atomically(options.json, document.dump(2) + "\n");
  return {};
}

std::string found_text(double best) {
  return std::isfinite(best) ? fmt::format("best so far {:.3f}", best) : "searching";
}

int design_robust(DesignCommandOptions& options) {
  cli::ProgressLine progress;
  options.robust.progress = [&](double fraction, double best) { progress.show(fraction, found_text(best)); };
  progress.show(0.0, "searching");
  const RobustSummary summary = design_robust_experiment(options.robust);
  progress.clear();
  if (!summary.found) return cli::refuse(Error{fmt::format("no design: {}", summary.message)});
  if (const Result<void> written =
          write_files(options, robust_json(options.robust, summary), summary.trajectory);
      !written)
    return cli::refuse(written.error());
  print_robust_summary(options.robust, summary);
  return cli::kSuccess;
}

int design(DesignCommandOptions options) {
  if (const Result<void> prepared = prepare(options); !prepared) return cli::refuse(prepared.error());
  if (options.objective == kRobust) return design_robust(options);
  cli::ProgressLine progress;
  options.design.progress = [&](double fraction, double best) { progress.show(fraction, found_text(best)); };
  progress.show(0.0, "searching");
  const DesignSummary summary = design_experiment(options.design);
  progress.clear();
  if (!summary.certified()) return cli::refuse(Error{fmt::format("no design: {}", summary.message)});
  if (const Result<void> written =
          write_files(options, design_json(options.design, summary),
                      response_to(summary.block_torque_Nm, options.design.block_samples, options.design.brake,
                                  options.design.initial));
      !written)
    return cli::refuse(written.error());
  print_summary(options.design, summary);
  return cli::kSuccess;
}

}  // namespace

void add_design_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<DesignCommandOptions>();
  DesignOptions& design_options = options->design;
  DesignLimits& limits = design_options.limits;
  CLI::App* command = app.add_subcommand("design", "an optimal experiment within the limits of the brake");
  command->add_option("--duration", options->duration_s, "s, a whole number of blocks")
      ->capture_default_str();
  command->add_option("--block", design_options.block_samples, "samples of 1 ms that share one torque")
      ->check(CLI::Range(1, 10000))
      ->capture_default_str();
  command
      ->add_option(
          "--objective", options->objective,
          "what to minimise: d, -log det M of the nominal brake; a, the trace of its inverse; robust, "
          "the expected log det of the covariance over brakes as far from nominal as the paper's "
          "Table II, tracked in closed loop (a minute)")
      ->check(CLI::IsMember({"d", "a", "robust"}))
      ->capture_default_str();
  CLI::Option* beside =
      command
          ->add_option("--beside", options->beside,
                       "robust only: the check's trajectory, beside which the design is driven where the parameters of "
                       "--for are in doubt")
          ->type_name("TRAJ.csv");
  std::vector<std::string> names;
  for (const ParameterInfo& info : kParameterTable) names.emplace_back(info.name);
  command->add_option("--for", options->wanted, "parameters, as in TC,Tv")
      ->delimiter(',')
      ->check(CLI::IsMember(names))
      ->needs(beside);
  beside->needs("--for");
  command->add_option("--torque-limit", limits.torque_Nm, "N m")->capture_default_str();
  command->add_option("--force-limit", limits.force_N, "N")->capture_default_str();
  command->add_option("--speed-limit", limits.velocity_rad_s, "rad/s, both directions")
      ->capture_default_str();
  command->add_option("--end-speed-limit", limits.end_velocity_rad_s,
                      "rad/s, at the last sample (default: none)");
  command->add_option("--amplification-limit", limits.amplification_rad_s_Nm,
                      "rad/s per N m: how far a constant torque error may move the velocity (default: none)");
  command
      ->add_option("--caution", design_options.caution,
                   "price of the amplification: more finds designs that hang less on exact torques, 0 the "
                   "nominal optimum")
      ->capture_default_str();
  command->add_option("--noise-force", design_options.noise.force_N, "N, standard deviation of the reading")
      ->capture_default_str();
  command
      ->add_option("--noise-velocity", design_options.noise.velocity_rad_s,
                   "rad/s, standard deviation of the reading")
      ->capture_default_str();
  command
      ->add_option("--parameters", options->parameters,
                   "the brake to design for (default: the paper's Table I)")
      ->type_name("FILE.toml");
  command->add_option("--initial-position", design_options.initial[0], "rad from contact")
      ->capture_default_str();
  command->add_option("--initial-velocity", design_options.initial[1], "rad/s")->capture_default_str();
  command
      ->add_option("--noise-torque", options->robust.noise.torque_Nm,
                   "N m, standard deviation of the torque over each sample; robust only")
      ->capture_default_str();
  command->add_option("--seed", design_options.seed, "of the search; the same seed finds the same design")
      ->capture_default_str();
  command
      ->add_option(
          "--starts", options->starts,
          fmt::format("local searches; more take longer and find better designs (default: {}, robust {})",
                      design_options.starts, options->robust.starts))
      ->check(CLI::Range(1, 1000000));
  command->add_option("--threads", design_options.threads, "0: all of the machine; no effect on the design")
      ->capture_default_str();
  command
      ->add_option(
          "--json", options->json,
          "write the design as clampd.design/1, where criterion.logdet is -log det M of the normalised "
          "parameters")
      ->type_name("FILE");
  command
      ->add_option("--out", options->trajectory, "write the response of the brake, a run file without noise")
      ->type_name("TRAJ.csv");
  command->callback([options, &exit_code] { exit_code = design(*options); });
}

}  // namespace clampd::ctl
