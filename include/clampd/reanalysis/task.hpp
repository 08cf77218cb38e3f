#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"

namespace clampd::reanalysis {

/// What is to be done with archived runs, and how.
struct Task {
  enum class Kind {
    Identify,      ///< the parameters, and the verdict on them
    Diagnose,      ///< what the base model gets wrong: its causes by name
    ScoreEffects,  ///< what each brake says about each effect, to be summed over many
  };
  Kind kind = Kind::Identify;
  BrakeParameters nominal;  ///< where the search starts; J and N
  // What follows is of Identify alone, but for the samples of the tare.
  Method method = Method::OutputError;
  std::optional<ExtendedParameters> model;  ///< its effects are estimated too, by the prediction error method
  LimitSet limits;
  std::optional<Sheet> sheet;  ///< for all checks; nothing: that of each record, if it has one
  ValiditySettings validity;
  /// Of the checks' tare: a record has the deviation of the tare's mean, and this gives that of one sample.
  std::uint64_t tare_samples = 500;
};

/// As in a task's document: identify, diagnose, score-effects.
std::string_view to_string(Task::Kind kind) noexcept;

/// Whether model, limits and sheet go together. Errors: those of check_limits(); a sheet beside a model.
Result<void> check_task(const Task& task);

/// The task as a document of its own (JSON, clampd.task/2), which needs no other file: models, limits and
/// sheet stand in it as the text of their files. Equal tasks give equal texts.
std::string format_task(const Task& task);

/// The same back, also from clampd.task/1, which had no sheet. Errors name what is missing, of another type,
/// or wrong in the limits, models or sheet within.
Result<Task> parse_task(const std::string& document);

}  // namespace clampd::reanalysis
