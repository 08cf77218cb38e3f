#include "clampd/identify/output_error.hpp"

#include <cmath>

#include "src/identify/conclusion.hpp"
#include "src/identify/output_error_search.hpp"

namespace clampd {

namespace identify {

Estimate output_error_estimate(OutputErrorSearch& search, OutputErrorAttempt& attempt,
                               const EstimatorOptions& options) {
  Estimate estimate = empty_estimate(options);
  estimate.iterations = search.iterations();
  if (!std::isfinite(attempt.score)) {
    estimate.message =
        "the model cannot follow the runs from any start: its simulation diverges under their torque";
  } else {
    const NoiseFit noise = search.noise_at(attempt);
    conclude(search.fit_at(attempt), attempt.unknowns, noise.variances, noise.torque_spread, attempt.settled,
             options, estimate);
  }
  return estimate;
}

}  // namespace identify

Estimate identify_output_error(std::span<const Run> runs, const EstimatorOptions& options) {
  const identify::Stopwatch stopwatch;
  if (const Result<void> valid = identify::check_input(runs, options); !valid) {
    Estimate estimate = identify::empty_estimate(options);
    estimate.message = valid.error().message;
    return estimate;
  }
  identify::OutputErrorSearch search(runs, options);
  Estimate estimate = identify::output_error_estimate(search, search.best(), options);
  estimate.wall_s = stopwatch.seconds();
  return estimate;
}

}  // namespace clampd
