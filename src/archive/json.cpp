#include "clampd/archive/json.hpp"

#include <cmath>

#include "clampd/base/json.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;

ordered_json numbers(const std::vector<double>& values) {
  ordered_json array = ordered_json::array();
  for (const double value : values) array.push_back(number_or_null(value));
  return array;
}

ordered_json parameter_json(const ParameterRecord& parameter) {
  return {{"name", parameter.name},
          {"unit", parameter.unit},
          {"value", number_or_null(parameter.value)},
          {"sd", number_or_null(parameter.sd)},
          {"lower", number_or_null(parameter.lower)},
          {"upper", number_or_null(parameter.upper)},
          {"verdict", to_string(parameter.verdict)}};
}

ordered_json timing_json(const TimingRecord& timing) {
  ordered_json histogram = ordered_json::array();  // [microseconds, ticks], bins without ticks left out
  for (std::size_t i = 0; i < timing.lateness_histogram.size(); ++i)
    if (timing.lateness_histogram[i] > 0) histogram.push_back({i, timing.lateness_histogram[i]});
  return {{"ticks", timing.ticks},
          {"skipped", timing.skipped},
          {"lost_samples", timing.lost_samples},
          {"lateness_us",
           {{"min", number_or_null(timing.lateness_min_us)},
            {"avg", number_or_null(timing.lateness_avg_us)},
            {"max", number_or_null(timing.lateness_max_us)}}},
          {"lateness_histogram_us", std::move(histogram)},
          {"bus_load", number_or_null(timing.bus_load)}};
}

ordered_json run_json(const RunRecord& run) {
  return {{"name", run.run.name},
          {"rows", run.run.size()},
          {"tracking_rms_N", number_or_null(run.tracking_rms_N)},
          {"tracking_max_N", number_or_null(run.tracking_max_N)},
          {"converged", run.converged},
          {"estimate", numbers(run.estimate)},
          {"fit",
           {{"force_rms_N", number_or_null(run.fit_force_rms_N)},
            {"velocity_rms_rad_s", number_or_null(run.fit_velocity_rms_rad_s)}}},
          {"sha256", run.checksum_sha256},
          {"removed", run.removed.empty() ? ordered_json(nullptr) : ordered_json(run.removed)}};
}

ordered_json matrix_json(const std::vector<double>& row_major) {
  ordered_json matrix = ordered_json::array();
  const auto size = static_cast<std::size_t>(std::lround(std::sqrt(static_cast<double>(row_major.size()))));
  for (std::size_t row = 0; row < size; ++row) {
    const auto begin = row_major.begin() + static_cast<std::ptrdiff_t>(row * size);
    matrix.push_back(numbers({begin, begin + static_cast<std::ptrdiff_t>(size)}));
  }
  return matrix;
}

/// Null where it cannot be told.
ordered_json systematic_json(const std::optional<SystematicRecord>& systematic) {
  if (!systematic) return nullptr;
  return {{"marked", systematic->marked},
          {"p_value", number_or_null(systematic->p_value)},
          {"over_noise", number_or_null(systematic->over_noise)},
          {"moved_sd", number_or_null(systematic->moved_sd)}};
}

/// Null where the number of repeats was fixed.
ordered_json stopping_json(const std::optional<StoppingRecord>& stopping) {
  if (!stopping) return nullptr;
  return {{"rule", "auto"},
          {"most", stopping->most},
          {"coverage_factor", number_or_null(stopping->coverage_factor)},
          {"reason", stopping->reason},
          {"trajectories", stopping->trajectories},
          {"followed", stopping->followed}};
}

/// Null where the station had no recipes.
ordered_json recipe_json(const std::optional<RecipeRecord>& recipe) {
  if (!recipe) return nullptr;
  return {{"file", recipe->file}, {"version", recipe->version}, {"sha256", recipe->sha256}};
}

}  // namespace

ordered_json characteristic_json(const CharacteristicRecord& line, bool misfit_marked) {
  const auto [low, high] = interval_95(line);
  return {{"name", line.name},
          {"kind", line.kind},
          {"circumstances", line.circumstances},
          {"unit", line.unit},
          {"value", number_or_null(line.value)},
          {"sd", number_or_null(line.sd)},
          {"interval_95", {number_or_null(low), number_or_null(high)}},
          {"lower", number_or_null(line.lower)},
          {"upper", number_or_null(line.upper)},
          {"verdict", line.verdict ? ordered_json(to_string(*line.verdict)) : ordered_json(nullptr)},
          {"misfit_marked", misfit_marked},
          {"why", line.why.empty() ? ordered_json(nullptr) : ordered_json(line.why)}};
}

ordered_json sheet_json(const std::optional<SheetRecord>& sheet) {
  if (!sheet) return nullptr;
  ordered_json lines = ordered_json::array();
  for (const CharacteristicRecord& line : sheet->characteristics)
    lines.push_back(characteristic_json(line, sheet->misfit_marked));
  return {{"file", sheet->file},
          {"revision", sheet->revision},
          {"sha256", sheet->sha256},
          {"characteristics", std::move(lines)}};
}

ordered_json cause_json(const CauseRecord& cause) {
  // "effect" is a name only where the runs leave no choice.
  const bool certain = cause.verdict == "explained" && !cause.effects.empty();
  return {{"effect", certain ? ordered_json(cause.effects.front()) : ordered_json(nullptr)},
          {"location", cause.location.empty() ? ordered_json(nullptr) : ordered_json(cause.location)},
          {"rivals", cause.rivals},
          {"summary", cause.summary},
          {"verdict", cause.verdict},
          {"effects", cause.effects}};
}

ordered_json check_json(const CheckRecord& record) {
  ordered_json parameters = ordered_json::array();
  for (const ParameterRecord& parameter : record.parameters) parameters.push_back(parameter_json(parameter));
  ordered_json runs = ordered_json::array();
  for (const RunRecord& run : record.runs) runs.push_back(run_json(run));
  ordered_json instruments = ordered_json::parse(record.instruments, nullptr, false);
  if (instruments.is_discarded()) instruments = ordered_json::array();

  return {{"schema", "clampd.check/1"},
          {"serial", record.serial},
          {"verdict", to_string(record.verdict)},
          {"marginal", record.marginal},
          {"reason", record.reason},
          {"repeats", record.repeats},
          {"parameters", std::move(parameters)},
          {"timing", timing_json(record.timing)},
          {"tracking_rms_N", number_or_null(record.tracking_rms_N)},
          {"started", record.started},
          {"duration_s", number_or_null(record.duration_s)},
          {"cause", record.cause ? cause_json(*record.cause) : ordered_json(nullptr)},
          {"systematic_misfit", systematic_json(record.systematic)},
          {"stopping", stopping_json(record.stopping)},
          {"sheet", sheet_json(record.sheet)},
          {"record", record.id},
          {"stopped", record.stopped},
          {"simulated", record.simulated},
          {"part_number", record.part_number},
          {"recipe", recipe_json(record.recipe)},
          {"batch", record.batch},
          {"station", record.station},
          {"fixture", record.fixture},
          {"operator", record.operator_name},
          {"software_version", record.software_version},
          {"limits",
           {{"file", record.limits_file},
            {"revision", record.limits_revision},
            {"sha256", record.limits_sha256}}},
          {"trajectory_sha256", record.trajectory_sha256},
          {"instruments", std::move(instruments)},
          {"fault", to_string(record.fault)},
          {"noise",
           {{"force_N", number_or_null(record.noise_force_N)},
            {"velocity_rad_s", number_or_null(record.noise_velocity_rad_s)},
            {"torque_Nm", number_or_null(record.noise_torque_Nm)}}},
          {"tare",
           {{"force_N", number_or_null(record.tare_force_N)},
            {"force_sd_N", number_or_null(record.tare_force_sd_N)},
            {"velocity_rad_s", number_or_null(record.tare_velocity_rad_s)},
            {"velocity_sd_rad_s", number_or_null(record.tare_velocity_sd_rad_s)}}},
          {"torque_while_off", record.torque_while_off
                                   ? ordered_json{{"mean_Nm", record.torque_while_off->mean_Nm},
                                                  {"sd_Nm", record.torque_while_off->sd_Nm},
                                                  {"rows", record.torque_while_off->rows}}
                                   : ordered_json(nullptr)},
          {"found_rad", record.found_rad ? number_or_null(*record.found_rad) : ordered_json(nullptr)},
          {"method", record.method},
          {"covariance_normalised", matrix_json(record.covariance_normalised)},
          {"void", record.voided ? ordered_json{{"reason", record.voided->reason},
                                                {"by", record.voided->by},
                                                {"when", record.voided->when}}
                                 : ordered_json(nullptr)},
          {"runs", std::move(runs)}};
}

nlohmann::ordered_json summaries_json(const std::vector<CheckSummary>& checks) {
  ordered_json list = ordered_json::array();
  for (const CheckSummary& check : checks)
    list.push_back({{"record", check.id},
                    {"serial", check.serial},
                    {"part_number", check.part_number},
                    {"started", check.started},
                    {"verdict", to_string(check.verdict)},
                    {"marginal", check.marginal},
                    {"simulated", check.simulated},
                    {"repeats", check.repeats},
                    {"duration_s", number_or_null(check.duration_s)},
                    {"reason", check.reason},
                    {"void", check.is_void}});
  return {{"schema", "clampd.checks/1"}, {"checks", std::move(list)}};
}

}  // namespace clampd
