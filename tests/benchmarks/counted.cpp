// What callgrind counts: the instructions of each workload, warmed up, and nothing else. To be run under
//   valgrind --tool=callgrind --collect-atstart=no
// which writes one file for each workload, described as "<name>|<times it was done>".

#include <deque>
#include <string>

#include <fmt/format.h>
#include <valgrind/callgrind.h>

#include "clampd/base/assert.hpp"
#include "clampd/identify/output_error.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "tests/benchmarks/workloads.hpp"

namespace clampd::bench {
namespace {

template <class Workload>
void count(const char* name, std::size_t times, Workload workload) {
  static std::deque<std::string> labels;  // callgrind reads them after the request
  labels.push_back(fmt::format("{}|{}", name, times));
  CALLGRIND_ZERO_STATS;
  CALLGRIND_TOGGLE_COLLECT;
  for (std::size_t i = 0; i < times; ++i) workload();
  CALLGRIND_TOGGLE_COLLECT;
  CALLGRIND_DUMP_STATS_AT(labels.back().c_str());
}

void count_all() {
  const std::vector<Run> quiet = simulated_runs(1, kQuietTorque, 1);
  const std::vector<Run> noisy = simulated_runs(1, kNoisyTorque, 1);
  OutputErrorIteration iteration(quiet.front());
  iteration();
  count("OEM iteration, 300 samples", 10, [&] { iteration(); });
  count("OEM fit, 300 samples", 1, [&] { CLAMPD_ASSERT(identify_output_error(quiet, {}).converged()); });
  count("PEM fit, 300 samples", 1, [&] { CLAMPD_ASSERT(identify_prediction_error(noisy, {}).converged()); });
  ReplayedCheck check;
  count("control tick, mean of a check", check.ticks(), [&] { check.tick(); });
}

}  // namespace
}  // namespace clampd::bench

int main() {
  clampd::bench::count_all();
}
