// The D-optimal experiment of 0.3 s beside what a user would otherwise do: a genetic algorithm like the
// paper's, and scipy's SLSQP from random starts with numba. All for the same set-valued model and limits.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>

#include "clampd/experiment/optimal_design.hpp"
#include "tests/bench/genetic_algorithm.hpp"
#include "tests/bench/python.hpp"

namespace clampd::bench {
namespace {

constexpr double kScipyBudget_s = 30.0;
constexpr std::uint64_t kGeneticSeeds = 3;
constexpr double kTargetLogdet = -85.5;

double processor_seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

/// Prints a design as clampd sees it, whoever found it.
void print_line(const std::string& method, const DesignOptions& options, const std::vector<double>& blocks_Nm,
                double seconds, double reference_seconds) {
  const DesignEvaluation design = evaluate_design(options, blocks_Nm);
  const Certification certification =
      certify(options.brake, options.initial, expand_blocks(blocks_Nm, options.block_samples), options.noise,
              options.limits, design.criterion.logdet);
  fmt::print("  {:<46}{:>9.2f}{:>10.1f} s{:>8.1f}   {}\n", method, design.criterion.logdet, seconds,
             seconds / reference_seconds, certification.granted() ? "yes" : "no: " + certification.objection);
  std::fflush(stdout);
}

void compare() {
  DesignOptions options;
  fmt::print("{:<48}{:>9}{:>12}{:>8}   {}\n", "D design, 300 samples in blocks of 20", "-log det",
             "processor", "ratio", "certified");
  double reference = 0.0;
  std::string wall;
  for (const double caution : {options.caution, 0.0}) {
    DesignOptions chosen = options;
    chosen.caution = caution;
    const double before = processor_seconds();
    const DesignSummary design = design_experiment(chosen);
    const double seconds = processor_seconds() - before;
    if (!design.certified()) {
      fmt::print("  clampd: {}\n", design.message);
      continue;
    }
    if (reference == 0.0) reference = seconds;
    wall += fmt::format("{}{:.1f} s", wall.empty() ? "" : " and ", design.wall_s);
    print_line(caution > 0.0 ? "clampd" : "clampd, at any price (caution 0)", chosen, design.block_torque_Nm,
               seconds, reference);
  }
  if (reference == 0.0) return;

  const std::size_t blocks = options.samples / options.block_samples;
  const auto scaled = [&](std::span<const double> x) {
    std::vector<double> blocks_Nm(x.begin(), x.end());
    for (double& value : blocks_Nm) value *= options.limits.torque_Nm;
    return blocks_Nm;
  };
  for (std::uint64_t seed = 1; seed <= kGeneticSeeds; ++seed) {
    const double before = processor_seconds();
    const GeneticResult result =
        minimise_genetically(blocks,
                             [&](std::span<const double> x) {
                               const DesignEvaluation design = evaluate_design(options, scaled(x));
                               return Fitness{design.criterion.logdet, design.violation};
                             },
                             {.seed = seed});
    const double seconds = processor_seconds() - before;
    print_line(fmt::format("genetic algorithm, seed {}, {} generations", seed, result.generations), options,
               scaled(result.best), seconds, reference);
  }

  const support::TemporaryDirectory directory;
  const nlohmann::json task = {{"blocks", blocks},
                               {"block_samples", options.block_samples},
                               {"torque_limit_Nm", options.limits.torque_Nm},
                               {"force_limit_N", options.limits.force_N},
                               {"speed_limit_rad_s", options.limits.velocity_rad_s},
                               {"noise_force_N", options.noise.force_N},
                               {"noise_velocity_rad_s", options.noise.velocity_rad_s},
                               {"target_logdet", kTargetLogdet},
                               {"budget_s", kScipyBudget_s},
                               {"seed", 1}};
  directory.write("task.json", task.dump());
  const auto slsqp = run_baseline("design.py", directory, "slsqp.json");
  if (slsqp) {
    const double total_s = (*slsqp)["total_seconds"];
    const int successes = (*slsqp)["successes"];
    print_line(
        fmt::format("scipy SLSQP, best of {} starts in {:.0f} s", (*slsqp)["starts"].get<int>(), total_s),
        options, (*slsqp)["blocks_Nm"], (*slsqp)["seconds"], reference);
    fmt::print("\n{} of those starts reached {}: {} of processor time for each.\n", successes, kTargetLogdet,
               successes > 0 ? fmt::format("{:.0f} s", total_s / successes) : "no limit known");
  }
  fmt::print(
      "\nclampd's wall time: {}. processor: until the design was there; for SLSQP, until its best start "
      "ended.\n"
      "certified: limits and criterion confirmed by another integrator.\n",
      wall);
}

}  // namespace
}  // namespace clampd::bench

int main() {
  clampd::bench::compare();
}
