#pragma once

#include <optional>
#include <span>
#include <string_view>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// How runs become parameters.
enum class Method {
  OutputError,      ///< identify_output_error(): the torque taken as exact while fitting
  PredictionError,  ///< identify_prediction_error(): torque noise modelled
};

/// "oem" and "pem", as on the command line and in files.
std::string_view to_string(Method method) noexcept;
std::optional<Method> parse_method(std::string_view name) noexcept;

Estimate identify_brake(Method method, std::span<const Run> runs, const EstimatorOptions& options);

}  // namespace clampd
