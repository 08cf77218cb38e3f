#include <benchmark/benchmark.h>

#include "clampd/identify/output_error.hpp"
#include "support/excitation.hpp"

namespace clampd {
namespace {

std::vector<Run> noisy_repeats(std::size_t count) {
  // A brake away from nominal, so that the fit from nominal has its usual way to go.
  BrakeParameters truth;
  truth.theta =
      truth.theta.cwiseProduct((ParameterVector() << 0.9, 0.95, 1.2, 0.95, 1.3, 1.03, 0.8).finished());
  const auto torque = support::strong_torque();
  Simulation simulation(torque.size());
  simulate(truth, BrakeState::Zero(), {torque}, simulation);
  std::mt19937_64 generator(1);
  std::vector<Run> runs;
  for (std::size_t r = 0; r < count; ++r)
    runs.push_back(
        support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s, 75.0, 1.5, generator));
  return runs;
}

void output_error_fit(benchmark::State& state) {
  const auto runs = noisy_repeats(static_cast<std::size_t>(state.range(0)));
  int iterations = 0;
  for (auto _ : state) {
    const auto summary = identify_output_error(runs, {});
    if (!summary.converged()) state.SkipWithError(summary.message.c_str());
    iterations = summary.iterations;
  }
  state.counters["solver_iterations"] = iterations;
}
BENCHMARK(output_error_fit)->ArgName("runs")->Arg(1)->Arg(20)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace clampd
