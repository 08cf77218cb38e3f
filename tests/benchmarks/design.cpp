// The D-optimal experiment of 0.3 s beside what a user would otherwise do: a genetic algorithm like the
// paper's, and scipy's SLSQP from random starts with numba. All for the same set-valued model and limits.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <limits>
#include <optional>

#include "clampd/experiment/optimal_design.hpp"
#include "tests/benchmarks/genetic_algorithm.hpp"
#include "tests/benchmarks/python.hpp"

namespace clampd::bench {
namespace {

constexpr double kScipyBudget_s = 30.0;
constexpr std::uint64_t kGeneticSeeds = 3;

double processor_seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

Certification certified(const DesignOptions& options, const std::vector<double>& blocks_Nm) {
  return certify(options.brake, options.initial, expand_blocks(blocks_Nm, options.block_samples),
                 options.noise, options.limits, evaluate_design(options, blocks_Nm).criterion.logdet);
}

/// A design as clampd sees it, whoever found it.
void print_line(const std::string& method, const DesignOptions& options, const std::vector<double>& blocks_Nm,
                double seconds, double reference_seconds) {
  const Certification certification = certified(options, blocks_Nm);
  fmt::print("  {:<48}{:>8.2f}{:>10.1f} s{:>8.1f}   {}\n", method,
             evaluate_design(options, blocks_Nm).criterion.logdet, seconds, seconds / reference_seconds,
             certification.granted() ? "yes" : "no: " + certification.objection);
  std::fflush(stdout);
}

/// Its processor time, for the ratios of the others; nothing if there is no design.
std::optional<double> design_by_clampd(const DesignOptions& options) {
  const double before = processor_seconds();
  const DesignSummary design = design_experiment(options);
  const double seconds = processor_seconds() - before;
  if (!design.certified()) {
    fmt::print("  clampd: {}\n", design.message);
    return std::nullopt;
  }
  print_line(fmt::format("clampd ({:.1f} s of wall time)", design.wall_s), options, design.block_torque_Nm,
             seconds, seconds);
  return seconds;
}

void design_genetically(const DesignOptions& options, const GeneticOptions& genetic,
                        double reference_seconds) {
  const auto torques_of = [&](std::span<const double> x) {
    std::vector<double> blocks_Nm(x.begin(), x.end());
    for (double& value : blocks_Nm) value *= options.limits.torque_Nm;
    return blocks_Nm;
  };
  const auto fitness = [&](std::span<const double> x) {
    const DesignEvaluation design = evaluate_design(options, torques_of(x));
    return Fitness{design.criterion.logdet, design.violation};
  };
  const double before = processor_seconds();
  const GeneticResult result =
      minimise_genetically(options.samples / options.block_samples, fitness, genetic);
  const double seconds = processor_seconds() - before;
  print_line(fmt::format("genetic algorithm, seed {}, {} generations", genetic.seed, result.generations),
             options, torques_of(result.best), seconds, reference_seconds);
}

void design_by_scipy(const DesignOptions& options, double reference_seconds) {
  const support::TemporaryDirectory directory;
  const nlohmann::json task = {{"blocks", options.samples / options.block_samples},
                               {"block_samples", options.block_samples},
                               {"torque_limit_Nm", options.limits.torque_Nm},
                               {"force_limit_N", options.limits.force_N},
                               {"speed_limit_rad_s", options.limits.velocity_rad_s},
                               {"noise_force_N", options.noise.force_N},
                               {"noise_velocity_rad_s", options.noise.velocity_rad_s},
                               {"budget_s", kScipyBudget_s},
                               {"seed", 1}};
  directory.write("task.json", task.dump());
  const auto answer = run_baseline("design.py", directory, "slsqp.json");
  if (!answer) return;
  nlohmann::json feasible;
  for (const nlohmann::json& design : *answer)
    if (design["feasible"]) feasible.push_back(design);
  if (feasible.empty()) {
    fmt::print("  scipy SLSQP: no start of {} ended within the limits\n", answer->size());
    return;
  }
  std::sort(feasible.begin(), feasible.end(),
            [](const nlohmann::json& a, const nlohmann::json& b) { return a["logdet"] < b["logdet"]; });
  const auto best_certified = std::find_if(
      feasible.begin(), feasible.end(),
      [&](const nlohmann::json& design) { return certified(options, design["blocks_Nm"]).granted(); });
  const double total_s = answer->back()["seconds"];
  const auto print_design = [&](const std::string& what, const nlohmann::json& design) {
    print_line(fmt::format("scipy SLSQP, {} of {} starts in {:.0f} s", what, answer->size(), total_s),
               options, design["blocks_Nm"], design["seconds"], reference_seconds);
  };
  print_design("best", feasible.front());
  if (best_certified != feasible.end() && best_certified != feasible.begin())
    print_design("best certified", *best_certified);
}

void compare() {
  const DesignOptions options;
  fmt::print("{:<50}{:>8}{:>12}{:>8}   {}\n", "D design, 300 samples in blocks of 20", "-log det",
             "processor", "ratio", "certified");
  std::fflush(stdout);
  const std::optional<double> reference_seconds = design_by_clampd(options);
  if (!reference_seconds) return;
  for (std::uint64_t seed = 1; seed <= kGeneticSeeds; ++seed)
    design_genetically(options, {.seed = seed}, *reference_seconds);
  design_genetically(options, {.stall_generations = std::numeric_limits<int>::max()}, *reference_seconds);
  design_by_scipy(options, *reference_seconds);
  fmt::print(
      "\nThe paper's brake; 75 N, 1.5 rad/s; |T| <= 3 N m, F <= 30 kN, |v| <= 300 rad/s. -log det by exact\n"
      "sensitivities, smaller is better; for SLSQP, which differentiates by differences, the best is the "
      "best by\n"
      "its own account, and its time is when that start ended. certified: another integrator confirms "
      "limits\n"
      "and criterion.\n");
}

}  // namespace
}  // namespace clampd::bench

int main() {
  clampd::bench::compare();
}
