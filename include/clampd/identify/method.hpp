#pragma once

#include <optional>
#include <span>
#include <string_view>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// "oem" and "pem", as on the command line and in files.
std::string_view to_string(Method method) noexcept;
std::optional<Method> parse_method(std::string_view name) noexcept;

/// The estimate by a method, if it explains the runs. Where the output error method leaves more than the
/// readings' noise, its search is begun again at the prediction error method's estimate: of several minima
/// the likelihood with torque noise tells the right one. Is it still far above the noise (ResidualLevel)
/// there, as in slow motion under load, the estimate is the prediction error method's, and method and message
/// say so. If that does not explain the runs either, the estimate is Unexplained and without numbers.
Estimate identify_brake(Method method, std::span<const Run> runs, const EstimatorOptions& options);

}  // namespace clampd
