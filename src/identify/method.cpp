#include "clampd/identify/method.hpp"

#include "clampd/identify/output_error.hpp"
#include "clampd/identify/prediction_error.hpp"

namespace clampd {

std::string_view to_string(Method method) noexcept {
  return method == Method::OutputError ? "oem" : "pem";
}

std::optional<Method> parse_method(std::string_view name) noexcept {
  for (const Method method : {Method::OutputError, Method::PredictionError})
    if (name == to_string(method)) return method;
  return std::nullopt;
}

Estimate identify_brake(Method method, std::span<const Run> runs, const EstimatorOptions& options) {
  return method == Method::OutputError ? identify_output_error(runs, options)
                                       : identify_prediction_error(runs, options);
}

}  // namespace clampd
