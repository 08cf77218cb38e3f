#include "clampd/identify/output_error.hpp"

#include <cmath>

#include "src/identify/conclusion.hpp"
#include "src/identify/output_error_search.hpp"

namespace clampd {

namespace identify {

Estimate output_error_estimate(std::span<const Run> runs, const EstimatorOptions& options, Starts starts,
                               bool* doubtful) {
  const identify::Stopwatch stopwatch;
  Estimate estimate = identify::empty_estimate(options);
  if (const Result<void> valid = identify::check_input(runs, options); !valid) {
    estimate.message = valid.error().message;
    return estimate;
  }
  identify::OutputErrorSearch search(runs, options);
  identify::OutputErrorAttempt attempt = starts == Starts::Several ? search.best() : search.first();
  if (doubtful != nullptr) *doubtful = !std::isfinite(attempt.score) || search.doubtful(attempt);
  estimate.iterations = search.iterations();
  if (!std::isfinite(attempt.score)) {
    estimate.message =
        "the model cannot follow the runs from any start: its simulation diverges under their torque";
  } else {
    const NoiseFit noise = search.noise_at(attempt);
    conclude(search.fit_at(attempt), attempt.unknowns, noise.variances, noise.torque_spread, attempt.settled,
             options, estimate);
  }
  estimate.wall_s = stopwatch.seconds();
  return estimate;
}

}  // namespace identify

Estimate identify_output_error(std::span<const Run> runs, const EstimatorOptions& options) {
  return identify::output_error_estimate(runs, options, identify::Starts::Several, nullptr);
}

}  // namespace clampd
