#include <unistd.h>

#include <cstdio>
#include <map>
#include <string>

#include <benchmark/benchmark.h>

#include "clampd/brake/simulation.hpp"
#include "clampd/experiment/optimal_design.hpp"
#include "clampd/identify/output_error.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "tests/benchmarks/workloads.hpp"

namespace clampd::bench {
namespace {

/// Data sets that a benchmark of single runs goes through in turn: no single draw of the noise decides.
constexpr std::size_t kDataSets = 20;

template <class Output>
void simulate_run(benchmark::State& state) {
  const auto torque = check_torque();
  Output simulation(torque.size());
  for (auto _ : state) {
    simulate({}, BrakeState::Zero(), {torque}, simulation);
    benchmark::DoNotOptimize(simulation.force_N.data());
  }
}
BENCHMARK(simulate_run<Simulation>)->Name("simulate")->Unit(benchmark::kMicrosecond);
BENCHMARK(simulate_run<SensitivitySimulation>)
    ->Name("simulate_with_sensitivities")
    ->Unit(benchmark::kMicrosecond);

void information_with_torque_noise(benchmark::State& state) {
  const auto torque = check_torque();
  for (auto _ : state)
    benchmark::DoNotOptimize(joint_information({}, BrakeState::Zero(), {torque}, kNoisyTorque));
}
BENCHMARK(information_with_torque_noise)->Unit(benchmark::kMicrosecond);

void oem_iteration(benchmark::State& state) {
  OutputErrorIteration iteration(simulated_runs(1, kQuietTorque, 1).front());
  for (auto _ : state) benchmark::DoNotOptimize(iteration());
}
BENCHMARK(oem_iteration)->Unit(benchmark::kMicrosecond);

void fit(benchmark::State& state, decltype(identify_output_error)* identify, NoiseLevels noise) {
  const auto runs_each = static_cast<std::size_t>(state.range(0));
  const std::size_t sets = runs_each == 1 ? kDataSets : 1;
  const std::vector<Run> runs = simulated_runs(sets * runs_each, noise, 1);
  std::size_t next = 0;
  std::int64_t solver_iterations = 0;
  std::int64_t converged = 0;
  for (auto _ : state) {
    const Estimate estimate = identify({runs.data() + next * runs_each, runs_each}, {});
    converged += estimate.converged();
    solver_iterations += estimate.iterations;
    next = (next + 1) % sets;
  }
  using benchmark::Counter;
  state.counters["solver_iterations"] =
      Counter(static_cast<double>(solver_iterations), Counter::kAvgIterations);
  state.counters["converged"] = Counter(static_cast<double>(converged), Counter::kAvgIterations);
}
BENCHMARK_CAPTURE(fit, oem, identify_output_error, kQuietTorque)
    ->Name("oem_fit")
    ->ArgName("runs")
    ->Arg(1)
    ->Arg(20)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(fit, oem_torque_noise, identify_output_error, kNoisyTorque)
    ->Name("oem_fit/torque_noise")
    ->ArgName("runs")
    ->Arg(1)
    ->Arg(20)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(fit, pem_torque_noise, identify_prediction_error, kNoisyTorque)
    ->Name("pem_fit/torque_noise")
    ->ArgName("runs")
    ->Arg(1)
    ->Arg(20)
    ->Unit(benchmark::kMillisecond);

void control_tick(benchmark::State& state) {
  ReplayedCheck check;
  std::size_t tick = 0;
  for (auto _ : state) {
    check.tick();
    if (++tick < check.ticks()) continue;
    state.PauseTiming();
    check.restart();
    tick = 0;
    state.ResumeTiming();
  }
}
BENCHMARK(control_tick)->Unit(benchmark::kMicrosecond);

void d_design(benchmark::State& state) {
  for (auto _ : state) {
    const DesignSummary design = design_experiment({});
    if (!design.certified()) state.SkipWithError(design.message.c_str());
    state.counters["logdet"] = design.criterion.logdet;
  }
}
BENCHMARK(d_design)->Unit(benchmark::kSecond)->Iterations(1)->MeasureProcessCPUTime()->UseRealTime();

/// The usual table, and then what matters of it.
class Reporter final : public benchmark::ConsoleReporter {
 public:
  using ConsoleReporter::ConsoleReporter;

  /// Without the library's context, which warns of how Debian built it.
  bool ReportContext(const Context& context) override {
    name_field_width_ = context.name_field_width;
    printed_header_ = false;
    return true;
  }

  void ReportRuns(const std::vector<Run>& reports) override {
    ConsoleReporter::ReportRuns(reports);
    for (const Run& run : reports)
      if (!run.error_occurred && run.run_type == Run::RT_Iteration)
        seconds_[run.benchmark_name()] = run.GetAdjustedCPUTime() / GetTimeUnitMultiplier(run.time_unit);
  }

  void print_ratios() const {
    for (const std::string runs : {"1", "20"}) {
      const auto oem = seconds_.find("oem_fit/torque_noise/runs:" + runs);
      const auto pem = seconds_.find("pem_fit/torque_noise/runs:" + runs);
      if (oem != seconds_.end() && pem != seconds_.end())
        std::printf("PEM / OEM, same %s x 300 samples: %.1f\n", runs.c_str(), pem->second / oem->second);
    }
  }

 private:
  std::map<std::string, double> seconds_;
};

}  // namespace
}  // namespace clampd::bench

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  clampd::bench::Reporter reporter(isatty(1) != 0 ? benchmark::ConsoleReporter::OO_Color
                                                  : benchmark::ConsoleReporter::OO_None);
  benchmark::RunSpecifiedBenchmarks(&reporter);
  reporter.print_ratios();
}
