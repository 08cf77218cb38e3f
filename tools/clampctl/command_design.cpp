#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/experiment/optimal_design.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

namespace fs = std::filesystem;

struct DesignCommandOptions {
  double duration_s = 0.3;
  DesignOptions design;
  std::string objective = "d";
  std::string parameters;
  std::string json;
  std::string trajectory;
};

Result<void> prepare(DesignCommandOptions& options) {
  DesignOptions& design = options.design;
  const double samples = options.duration_s / kLargestStep_s;
  if (!(samples >= static_cast<double>(kFewestSamples) && samples <= static_cast<double>(kMostSamples)))
    return failure(fmt::format("--duration {} s is not possible; {} to {} s are", options.duration_s,
                               static_cast<double>(kFewestSamples) * kLargestStep_s,
                               static_cast<double>(kMostSamples) * kLargestStep_s));
  if (std::abs(samples - std::round(samples)) > 1e-6)
    return failure(fmt::format("--duration {} s is not a whole number of milliseconds", options.duration_s));
  design.samples = static_cast<std::size_t>(std::llround(samples));
  design.objective = *parse_objective(options.objective);
  if (!options.parameters.empty()) {
    Result<BrakeParameters> brake = read_brake_parameters(options.parameters);
    if (!brake) return tl::unexpected(brake.error());
    design.brake = *brake;
  }
  if (const Result<void> valid = design.validate(); !valid) return valid;
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
          {"duration_s", static_cast<double>(design.samples) * kLargestStep_s},
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

/// The run that the brake would record without noise.
Run nominal_response(const DesignOptions& design, const DesignSummary& summary) {
  Run run;
  run.torque_Nm = expand_blocks(summary.block_torque_Nm, design.block_samples);
  Simulation simulation(run.torque_Nm.size());
  simulate(design.brake, design.initial, Excitation{.torque_Nm = run.torque_Nm}, simulation);
  for (std::size_t k = 0; k < run.torque_Nm.size(); ++k)
    run.time_s.push_back(static_cast<double>(k) / 1000.0);
  run.velocity_rad_s = std::move(simulation.velocity_rad_s);
  run.force_N = std::move(simulation.force_N);
  run.position_rad = std::move(simulation.position_rad);
  return run;
}

void print_summary(const DesignOptions& design, const DesignSummary& summary) {
  const Certification& certification = summary.certification;
  fmt::print("{}-optimal experiment of {:.3f} s, {} blocks of {} samples\n\n",
             design.objective == Objective::D ? "D" : "A",
             static_cast<double>(design.samples) * kLargestStep_s, summary.block_torque_Nm.size(),
             design.block_samples);
  fmt::print("  torque (N m)");
  for (std::size_t i = 0; i < summary.block_torque_Nm.size(); ++i)
    fmt::print("{}{:>8.3f}", i > 0 && i % 10 == 0 ? "\n              " : "", summary.block_torque_Nm[i]);
  fmt::print("\n\n");
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

int design(DesignCommandOptions options) {
  if (const Result<void> prepared = prepare(options); !prepared) return cli::refuse(prepared.error());
  cli::ProgressLine progress;
  options.design.progress = [&](double fraction, double best) {
    progress.show(fraction, std::isfinite(best) ? fmt::format("best so far {:.3f}", best) : std::string());
  };
  const DesignSummary summary = design_experiment(options.design);
  progress.clear();
  if (!summary.certified()) return cli::refuse(Error{fmt::format("no design: {}", summary.message)});
  if (!options.trajectory.empty())
    if (const Result<void> written = write_run(options.trajectory, nominal_response(options.design, summary));
        !written)
      return cli::refuse(written.error());
  if (!options.json.empty())
    if (const Result<void> written =
            write_file_atomically(options.json, design_json(options.design, summary).dump(2) + "\n");
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
      ->add_option("--objective", options->objective,
                   "what to minimise: d, -log det M, or a, the trace of the inverse of M")
      ->check(CLI::IsMember({"d", "a"}))
      ->capture_default_str();
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
  command->add_option("--seed", design_options.seed, "of the search; the same seed finds the same design")
      ->capture_default_str();
  command
      ->add_option("--starts", design_options.starts,
                   "local searches; more take longer and find better designs")
      ->capture_default_str();
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
