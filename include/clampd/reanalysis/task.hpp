#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"

namespace clampd::reanalysis {

/// How archived runs are to be identified and judged.
struct Task {
  Method method = Method::OutputError;
  BrakeParameters nominal;                  ///< where the search starts; J and N
  std::optional<ExtendedParameters> model;  ///< its effects are estimated too, by the prediction error method
  LimitSet limits;
  ValiditySettings validity;
  /// Of the checks' tare: a record has the deviation of the tare's mean, and this gives that of one sample.
  std::uint64_t tare_samples = 500;
};

/// The task as a document of its own (JSON, clampd.task/1), which needs no other file: models and limits
/// stand in it as the text of their files. Equal tasks give equal texts.
std::string format_task(const Task& task);

/// The same back. Errors name what is missing, of another type, or wrong in the limits or models within.
Result<Task> parse_task(const std::string& document);

}  // namespace clampd::reanalysis
