#include "tools/reproduce/json.hpp"

#include <string>

#include <nlohmann/json.hpp>

#include "tools/reproduce/claims.hpp"
#include "tools/reproduce/findings.hpp"

namespace clampd::reproduce {
namespace {

using nlohmann::ordered_json;

ordered_json designs_json(const std::vector<Design>& designs) {
  ordered_json list = ordered_json::array();
  for (const Design& design : designs)
    list.push_back({{"duration_s", design.duration_s()},
                    {"logdet", design.summary.criterion.logdet},
                    {"trace_inverse", design.summary.criterion.trace_inverse},
                    {"force_max_N", design.summary.certification.force_max_N},
                    {"velocity_max_rad_s", design.summary.certification.velocity_max_rad_s},
                    {"torque_Nm", design.summary.block_torque_Nm}});
  return list;
}

ordered_json column_json(const Column& column, const ColumnFigures& figures) {
  ordered_json parameters = ordered_json::array();
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto index = static_cast<Eigen::Index>(i);
    parameters.push_back({{"name", kParameterTable[i].name},
                          {"mean_normalised", column.mean[index]},
                          {"variance_normalised", column.covariance(index, index)},
                          {"bound", column.bound(index, index)},
                          {"bound_exact_torque", column.bound_exact(index, index)}});
  }
  return {{"name", column.name},
          {"repeats", column.estimates.size()},
          {"failed", column.failed},
          {"parameters", std::move(parameters)},
          {"sum_of_variances", figures.sum_of_variances},
          {"efficiency", figures.efficiency},
          {"far_off", figures.far_off},
          {"largest_bias_standard_errors", figures.largest_bias_sd},
          {"median_wall_s", column.median_wall_s}};
}

ordered_json predictions_json(const std::vector<Prediction>& predictions) {
  ordered_json list = ordered_json::array();
  for (const Prediction& prediction : predictions)
    list.push_back({{"name", prediction.name},
                    {"force_rms_N", prediction.force_rms_N},
                    {"velocity_rms_rad_s", prediction.velocity_rms_rad_s}});
  return list;
}

ordered_json replays_json(const Study& study, const Findings& findings) {
  ordered_json list = ordered_json::array();
  for (std::size_t i = 0; i < study.sinusoid_replays.size(); ++i) {
    const ReplayFigures& figures = findings.replays[i];
    list.push_back({{"name", study.sinusoid_replays[i].name},
                    {"repeats_with_lock_up", figures.locked},
                    {"longest_rest_s", figures.longest_s},
                    {"median_force_rms_N", figures.median_force_rms_N},
                    {"worst_force_rms_N", figures.worst_force_rms_N}});
  }
  return list;
}

}  // namespace

ordered_json study_json(const Study& study) {
  const Findings findings = findings_of(study);
  ordered_json claims = ordered_json::array();
  for (const Claim& claim : claims_of(study, findings))
    claims.push_back(
        {{"where", claim.where}, {"paper", claim.paper}, {"here", claim.here}, {"verdict", claim.verdict}});
  return {{"schema", "clampd.reproduction/1"},
          {"seed", study.options.seed},
          {"repeats", study.options.repeats},
          {"starts", study.options.starts},
          {"wall_s", study.wall_s},
          {"claims", std::move(claims)},
          {"d_designs", designs_json(study.d_designs)},
          {"a_designs", designs_json(study.a_designs)},
          {"bench_design", designs_json({study.tracked})},
          {"table",
           {column_json(study.oem_optimal, findings.oem_optimal),
            column_json(study.pem_optimal, findings.pem_optimal),
            column_json(study.oem_step, findings.oem_step)}},
          {"torque_noise_Nm",
           {{"true", kBenchNoise.torque_Nm},
            {"pooled", study.pooled.noise_torque_Nm},
            {"mean_of_repeats", findings.mean_torque_noise_Nm}}},
          {"validation", predictions_json(study.validation_predictions)},
          {"sinusoid",
           {{"replays", replays_json(study, findings)},
            {"longest_rest_s", findings.brake_longest_rest_s},
            {"filter_force_rms_N", findings.filter_force_error_N},
            {"filter_velocity_rms_rad_s", findings.filter_velocity_error_rad_s},
            {"oem_error_over_pem", findings.sinusoid_error_ratio}}},
          {"time_ratio", findings.time_ratio}};
}

}  // namespace clampd::reproduce
