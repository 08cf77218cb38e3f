#include "clampd/identify/output_error.hpp"

#include <cmath>

#include "src/identify/conclusion.hpp"
#include "src/identify/output_error_search.hpp"

namespace clampd {

Estimate identify_output_error(std::span<const Run> runs, const EstimatorOptions& options) {
  const identify::Stopwatch stopwatch;
  Estimate estimate = identify::empty_estimate(options);
  if (const Result<void> valid = identify::check_input(runs, options); !valid) {
    estimate.message = valid.error().message;
    return estimate;
  }
  identify::OutputErrorSearch search(runs, options);
  identify::OutputErrorAttempt attempt = search.best();
  estimate.iterations = search.iterations();
  if (!std::isfinite(attempt.score)) {
    estimate.message =
        "the model cannot follow the runs from any start: its simulation diverges under their torque";
  } else {
    const identify::Variances variances = search.noise_at(attempt).variances;
    identify::conclude(search.fit_at(attempt), attempt.unknowns, variances, attempt.settled, options,
                       estimate);
  }
  estimate.wall_s = stopwatch.seconds();
  return estimate;
}

}  // namespace clampd
