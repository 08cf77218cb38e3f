#include <benchmark/benchmark.h>

#include "clampd/brake/simulation.hpp"
#include "support/excitation.hpp"

namespace clampd {
namespace {

void simulate_run(benchmark::State& state) {
  const auto torque = support::strong_torque();
  Simulation simulation(torque.size());
  for (auto _ : state) {
    simulate({}, BrakeState::Zero(), {torque}, simulation);
    benchmark::DoNotOptimize(simulation.force_N.data());
  }
}
BENCHMARK(simulate_run)->Unit(benchmark::kMicrosecond);

void simulate_run_with_sensitivities(benchmark::State& state) {
  const auto torque = support::strong_torque();
  SensitivitySimulation simulation(torque.size());
  for (auto _ : state) {
    simulate({}, BrakeState::Zero(), {torque}, simulation);
    benchmark::DoNotOptimize(simulation.force_sensitivity.data());
  }
}
BENCHMARK(simulate_run_with_sensitivities)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace clampd
