#include "clampd/station/cause.hpp"

#include <algorithm>

namespace clampd {

std::vector<Run> runs_of(const std::vector<RunRecord>& records) {
  std::vector<Run> runs;
  runs.reserve(records.size());
  for (const RunRecord& record : records) runs.push_back(record.run);
  return runs;
}

std::vector<Run> runs_of(const CheckRecord& record) {
  return runs_of(record.runs);
}

DiagnoseOptions diagnose_options(const CheckRecord& record, const BrakeParameters& nominal) {
  DiagnoseOptions options;
  options.nominal = nominal;
  options.torque_while_off = record.torque_while_off;
  options.tare_sd = SensorNoise{record.tare_force_sd_N, record.tare_velocity_sd_rad_s};
  return options;
}

std::optional<CauseRecord> cause_of(const Diagnosis& diagnosis) {
  if (diagnosis.verdict == DiagnosisVerdict::Adequate) return std::nullopt;
  CauseRecord cause;
  cause.verdict = to_string(diagnosis.verdict);
  for (const NamedEffect& effect : diagnosis.effects) cause.effects.push_back(effect.name);
  if (!diagnosis.effects.empty())
    cause.location = to_string(diagnosis.effects.front().location);
  else if (diagnosis.misfit.location)
    cause.location = to_string(*diagnosis.misfit.location);
  cause.rivals = diagnosis.rivals;
  cause.summary = diagnosis.summary;
  return cause;
}

bool is_in_the_readings(const Diagnosis& diagnosis) {
  if (diagnosis.verdict != DiagnosisVerdict::Explained && diagnosis.verdict != DiagnosisVerdict::Ambiguous)
    return false;
  const auto of_the_brake = [](std::string_view name) {
    const Effect* effect = find_effect(name);
    return effect == nullptr || changes_brake(info_of(*effect));
  };
  return std::none_of(diagnosis.effects.begin(), diagnosis.effects.end(),
                      [&](const NamedEffect& effect) { return of_the_brake(effect.name); }) &&
         std::none_of(diagnosis.rivals.begin(), diagnosis.rivals.end(), [&](const auto& group) {
           return std::any_of(group.begin(), group.end(), of_the_brake);
         });
}

bool may_be_the_scale_of_force(const Diagnosis& diagnosis) {
  const auto like_a_scale = [](std::string_view name) {
    const Effect* effect = find_effect(name);
    return effect != nullptr && info_of(*effect).is_like_a_scale_of_force;
  };
  return std::any_of(diagnosis.effects.begin(), diagnosis.effects.end(),
                     [&](const NamedEffect& effect) { return like_a_scale(effect.name); }) ||
         std::any_of(diagnosis.rivals.begin(), diagnosis.rivals.end(), [&](const auto& group) {
           return std::any_of(group.begin(), group.end(), like_a_scale);
         });
}

}  // namespace clampd
