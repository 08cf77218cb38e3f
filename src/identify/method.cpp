#include "clampd/identify/method.hpp"

#include <cmath>
#include <string>
#include <utility>

#include <fmt/format.h>

#include "clampd/identify/output_error.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "src/identify/conclusion.hpp"
#include "src/identify/output_error_search.hpp"

namespace clampd {

std::string_view to_string(Method method) noexcept {
  return method == Method::OutputError ? "oem" : "pem";
}

std::optional<Method> parse_method(std::string_view name) noexcept {
  for (const Method method : {Method::OutputError, Method::PredictionError})
    if (name == to_string(method)) return method;
  return std::nullopt;
}

namespace {

/// In words, what is wrong with an output error estimate.
std::string fault_of(std::span<const Run> runs, const Estimate& output) {
  if (!std::isfinite(output.force_rms_N)) return "its simulation diverges";
  const ResidualLevel level = identify::level_of(runs, output);
  if (level.far_above_noise) return "its simulation misses " + level.words;
  return fmt::format("{}, and its simulation misses {}", output.message, level.words);
}

Estimate by_output_errors(std::span<const Run> runs, const EstimatorOptions& options) {
  const identify::Stopwatch stopwatch;
  if (!identify::check_input(runs, options)) return identify_output_error(runs, options);
  identify::OutputErrorSearch search(runs, options);
  identify::OutputErrorAttempt& first = search.first();
  Estimate output = identify::output_error_estimate(search, first, options);
  output.wall_s = stopwatch.seconds();
  if (std::isfinite(first.score) && !search.doubtful(first)) return output;
  const auto is_result = [&](const Estimate& estimate) {
    return estimate.converged() && !identify::level_of(runs, estimate).far_above_noise;
  };
  Estimate prediction = identify::prediction_error_estimate(search, runs, options);
  int iterations = output.iterations + prediction.iterations;
  const auto end = [&](Estimate estimate) {
    estimate.iterations = iterations;
    estimate.wall_s = stopwatch.seconds();
    return estimate;
  };
  if (is_result(prediction)) {
    EstimatorOptions nearby = options;
    nearby.start.theta = prediction.parameters.theta;
    identify::OutputErrorSearch near(runs, nearby);
    Estimate again = identify::output_error_estimate(near, near.first(), nearby);
    iterations += again.iterations;
    if (is_result(again)) return end(std::move(again));
  }
  const int before = search.iterations();
  output = identify::output_error_estimate(search, search.best(), options);
  iterations += search.iterations() - before;
  if (is_result(output)) return end(std::move(output));
  const std::string why = fault_of(runs, output);
  if (is_result(prediction)) {
    prediction.message = fmt::format(
        "the output error method does not explain these runs ({}); the prediction error method does, and "
        "this is its estimate",
        why);
    return end(std::move(prediction));
  }
  if (std::isfinite(output.force_rms_N) && identify::level_of(runs, output).far_above_noise)
    identify::withdraw(
        fmt::format(
            "neither method explains these runs, so that there is no result (by the output error method, {})",
            why),
        output);
  return end(std::move(output));
}

}  // namespace

Estimate identify_brake(Method method, std::span<const Run> runs, const EstimatorOptions& options) {
  if (method == Method::OutputError) return by_output_errors(runs, options);
  Estimate estimate = identify_prediction_error(runs, options);
  identify::withdraw_unexplained(runs, estimate);
  return estimate;
}

}  // namespace clampd
