#include "clampd/reanalysis/task.hpp"

#include <array>
#include <filesystem>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/identify/method.hpp"

namespace clampd::reanalysis {
namespace {

using nlohmann::ordered_json;

constexpr const char* kSchema = "clampd.task/2";
constexpr const char* kWithoutSheet = "clampd.task/1";
constexpr std::array kKinds{Task::Kind::Identify, Task::Kind::Diagnose, Task::Kind::ScoreEffects};

std::optional<Task::Kind> parse_kind(const std::string& name) {
  for (const Task::Kind kind : kKinds)
    if (to_string(kind) == name) return kind;
  return std::nullopt;
}

/// The folder of a file says nothing about what is to be done.
ordered_json file_json(const std::string& file, const std::string& text) {
  return {{"file", std::filesystem::path(file).filename().string()}, {"text", text}};
}

ordered_json validity_json(const ValiditySettings& validity) {
  return {{"skipped_ticks_max", validity.skipped_ticks_max},
          {"lost_samples_max", validity.lost_samples_max},
          {"tracking_rms_max_N", validity.tracking_rms_max_N},
          {"torque_noise_Nm", validity.torque_noise_Nm},
          {"misfit_max", validity.misfit_max}};
}

ValiditySettings validity_of(const ordered_json& document) {
  ValiditySettings validity;
  document.at("skipped_ticks_max").get_to(validity.skipped_ticks_max);
  document.at("lost_samples_max").get_to(validity.lost_samples_max);
  document.at("tracking_rms_max_N").get_to(validity.tracking_rms_max_N);
  document.at("torque_noise_Nm").get_to(validity.torque_noise_Nm);
  document.at("misfit_max").get_to(validity.misfit_max);
  return validity;
}

/// Throws what nlohmann::json throws.
Result<Task> task_of(const ordered_json& document) {
  const std::string schema = document.at("schema");
  const std::string kind = document.at("kind");
  const std::optional<Task::Kind> known = parse_kind(kind);
  if ((schema != kSchema && schema != kWithoutSheet) || !known)
    return failure(
        fmt::format("the task is a {} of the kind {}; this version knows {} of the kinds identify, diagnose and "
                    "score-effects: use a newer version",
                    schema, kind, kSchema));
  Task task;
  task.kind = *known;
  const Result<ExtendedParameters> nominal =
      parse_extended_parameters(document.at("nominal").get<std::string>(), "the task's nominal brake");
  if (!nominal) return tl::unexpected(nominal.error());
  task.nominal = nominal->base;
  document.at("tare_samples").get_to(task.tare_samples);
  if (task.kind != Task::Kind::Identify) return task;
  const std::string name = document.at("method");
  const std::optional<Method> method = parse_method(name);
  if (!method) return failure(fmt::format("the task's method is '{}'; known are oem and pem", name));
  task.method = *method;
  if (!document.at("model").is_null()) {
    Result<ExtendedParameters> model =
        parse_extended_parameters(document.at("model").get<std::string>(), "the task's model");
    if (!model) return tl::unexpected(model.error());
    task.model = std::move(*model);
  }
  Result<LimitSet> limits =
      parse_limits(document.at("limits").at("text").get<std::string>(), document.at("limits").at("file"));
  if (!limits) return tl::unexpected(limits.error());
  task.limits = std::move(*limits);
  task.validity = validity_of(document.at("validity"));
  if (schema != kWithoutSheet && !document.at("sheet").is_null()) {
    Result<Sheet> sheet =
        parse_sheet(document.at("sheet").at("text").get<std::string>(), document.at("sheet").at("file"));
    if (!sheet) return tl::unexpected(sheet.error());
    task.sheet = std::move(*sheet);
  }
  return check_task(task).map([&] { return std::move(task); });
}

}  // namespace

std::string_view to_string(Task::Kind kind) noexcept {
  switch (kind) {
    case Task::Kind::Identify:
      return "identify";
    case Task::Kind::Diagnose:
      return "diagnose";
    case Task::Kind::ScoreEffects:
      return "score-effects";
  }
  return "unknown";
}

Result<void> check_task(const Task& task) {
  if (task.model && task.sheet)
    if (const Result<void> countable = check_countable(task.model->effects); !countable)
      return failure(
          fmt::format("{}: {}: leave out sheet or model", task.sheet->file, countable.error().message));
  return check_limits(task.limits, task.model.value_or(ExtendedParameters{}));
}

std::string format_task(const Task& task) {
  ordered_json document{{"schema", kSchema},
                        {"kind", to_string(task.kind)},
                        {"nominal", format_extended_parameters({task.nominal, {}})},
                        {"tare_samples", task.tare_samples}};
  if (task.kind == Task::Kind::Identify) {
    document["method"] = to_string(task.method);
    document["model"] =
        task.model ? ordered_json(format_extended_parameters(*task.model)) : ordered_json(nullptr);
    document["limits"] = file_json(task.limits.file, task.limits.contents);
    document["sheet"] =
        task.sheet ? file_json(task.sheet->file, task.sheet->contents) : ordered_json(nullptr);
    document["validity"] = validity_json(task.validity);
  }
  return document.dump(1, ' ', false, ordered_json::error_handler_t::replace);
}

Result<Task> parse_task(const std::string& document) {
  try {
    return task_of(ordered_json::parse(document));
  } catch (const nlohmann::json::exception& wrong) {
    return failure(fmt::format("the task's document cannot be read: {}: submit the job again", wrong.what()));
  }
}

}  // namespace clampd::reanalysis
