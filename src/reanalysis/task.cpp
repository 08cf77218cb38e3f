#include "clampd/reanalysis/task.hpp"

#include <filesystem>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/identify/method.hpp"

namespace clampd::reanalysis {
namespace {

using nlohmann::ordered_json;

constexpr const char* kSchema = "clampd.task/1";
constexpr const char* kKind = "identify";

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
  if (schema != kSchema || kind != kKind)
    return failure(
        fmt::format("the task is a {} of the kind {}; this version knows {} of the kind {}: use a "
                    "newer version",
                    schema, kind, kSchema, kKind));
  Task task;
  const std::string name = document.at("method");
  const std::optional<Method> method = parse_method(name);
  if (!method) return failure(fmt::format("the task's method is '{}'; known are oem and pem", name));
  task.method = *method;
  const Result<ExtendedParameters> nominal =
      parse_extended_parameters(document.at("nominal").get<std::string>(), "the task's nominal brake");
  if (!nominal) return tl::unexpected(nominal.error());
  task.nominal = nominal->base;
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
  if (const Result<void> usable = check_limits(task.limits, task.model.value_or(ExtendedParameters{}));
      !usable)
    return tl::unexpected(usable.error());
  task.validity = validity_of(document.at("validity"));
  document.at("tare_samples").get_to(task.tare_samples);
  return task;
}

}  // namespace

std::string format_task(const Task& task) {
  // The folder of a limits file says nothing about what is to be done.
  const std::string file = std::filesystem::path(task.limits.file).filename();
  return ordered_json{
      {"schema", kSchema},
      {"kind", kKind},
      {"method", to_string(task.method)},
      {"nominal", format_extended_parameters({task.nominal, {}})},
      {"model", task.model ? ordered_json(format_extended_parameters(*task.model)) : ordered_json(nullptr)},
      {"limits", {{"file", file}, {"text", task.limits.contents}}},
      {"validity", validity_json(task.validity)},
      {"tare_samples", task.tare_samples}}
      .dump(1, ' ', false, ordered_json::error_handler_t::replace);
}

Result<Task> parse_task(const std::string& document) {
  try {
    return task_of(ordered_json::parse(document));
  } catch (const nlohmann::json::exception& wrong) {
    return failure(fmt::format("the task's document cannot be read: {}: submit the job again", wrong.what()));
  }
}

}  // namespace clampd::reanalysis
