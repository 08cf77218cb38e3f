#include "clampd/views/diagnosis_json.hpp"

#include <nlohmann/json.hpp>

#include "clampd/base/json.hpp"
#include "clampd/views/diagnosis_words.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;

template <class Items, class ToJson>
ordered_json list_of(const Items& items, const ToJson& to_json) {
  ordered_json list = ordered_json::array();
  for (const auto& item : items) list.push_back(to_json(item));
  return list;
}

ordered_json numbers(const std::vector<double>& values) {
  return list_of(values, number_or_null);
}

/// An unexplained result names no cause: its effects were tried and are not enough.
ordered_json effect_json(const NamedEffect& effect, bool explains) {
  return {{"name", effect.name},
          {"location", to_string(effect.location)},
          {"cause", explains ? ordered_json(words::cause(effect)) : ordered_json(nullptr)},
          {"parameters", parameters_json(effect.parameters)},
          {"evidence",
           {{"log_likelihood_gain", number_or_null(effect.log_likelihood_gain)},
            {"p_value", number_or_null(effect.p_value)}}}};
}

ordered_json tests_json(const std::vector<MisfitTest>& tests) {
  return list_of(tests, [](const MisfitTest& test) -> ordered_json {
    return {{"name", test.name},
            {"statistic", number_or_null(test.statistic)},
            {"p_value", number_or_null(test.p_value)},
            {"words", test.words}};
  });
}

ordered_json misfit_json(const Misfit& misfit) {
  const auto dependence_json = [](const Dependence& dependence) -> ordered_json {
    return {{"variable", dependence.variable},
            {"location", to_string(dependence.location)},
            {"gain", number_or_null(dependence.gain)},
            {"p_value", number_or_null(dependence.p_value)}};
  };
  return {{"location", misfit.location ? ordered_json(to_string(*misfit.location)) : ordered_json(nullptr)},
          {"depends_on", words::depends_on(misfit)},
          {"dependences", list_of(misfit.dependences, dependence_json)},
          {"tests_before", tests_json(misfit.tests_before)},
          {"tests_after", tests_json(misfit.tests_after)},
          {"explained_nats", misfit.explained_nats},
          {"left_nats", misfit.left_nats}};
}

ordered_json ladder_json(const std::vector<CandidateSummary>& candidates) {
  return list_of(candidates, [](const CandidateSummary& summary) -> ordered_json {
    return {{"stage", summary.stage},
            {"name", summary.name},
            {"location", to_string(summary.location)},
            {"predicted_gain", number_or_null(summary.predicted_gain)},
            {"gain", number_or_null(summary.gain)},
            {"parameter_count", summary.parameters},
            {"evidence", number_or_null(summary.significance_nats)},
            {"p_value", number_or_null(summary.p_value)},
            {"parameters", parameters_json(summary.values)},
            {"chosen", summary.chosen},
            {"rival", summary.rival}};
  });
}

ordered_json noise_json(const NoiseLevels& noise) {
  return {{"force_N", number_or_null(noise.sensors.force_N)},
          {"velocity_rad_s", number_or_null(noise.sensors.velocity_rad_s)},
          {"torque_Nm", number_or_null(noise.torque_Nm)}};
}

ordered_json next_json(const std::optional<NextExperiment>& next) {
  if (!next) return nullptr;
  const Run& run = next->trajectory;
  return {{"manoeuvre", next->manoeuvre},
          {"why", next->why},
          {"repeats", next->repeats},
          {"expected_evidence_nats", number_or_null(next->expected_evidence_nats)},
          {"duration_s", run.time_s.empty() ? 0.0 : run.time_s.back() - run.time_s.front()},
          {"rows", run.size()},
          {"time_s", numbers(run.time_s)},
          {"torque_Nm", numbers(run.torque_Nm)},
          {"velocity_rad_s", numbers(run.velocity_rad_s)},
          {"force_N", numbers(run.force_N)},
          {"drive_off", !is_driven(run)}};
}

ordered_json torque_while_off_json(const std::optional<TorqueWhileOff>& torque) {
  if (!torque) return nullptr;
  return {{"mean_Nm", torque->mean_Nm}, {"sd_Nm", torque->sd_Nm}, {"rows", torque->rows}};
}

ordered_json rows_json(const RowCount& rows) {
  return {{"read", rows.read},
          {"used", rows.used},
          {"left_out", list_of(rows.left_out, [](const RowCount::LeftOut& left) -> ordered_json {
             return {{"reason", left.reason}, {"rows", left.rows}};
           })}};
}

ordered_json finding_json(const DataFinding& finding) {
  return {{"name", finding.name},
          {"column", finding.column},
          {"run", finding.run},
          {"size", number_or_null(finding.size)},
          {"sd", number_or_null(finding.sd)},
          {"unit", finding.unit},
          {"severity", to_string(finding.severity)},
          {"words", finding.words}};
}

/// Null everywhere if nothing was held out, so that a reader finds the same keys in every document.
ordered_json gain_json(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const std::optional<HeldOutGain>& gain = diagnosis.gain;
  const bool known = words::has_gain(diagnosis, subject);
  const auto figure = [&](double GainFigures::*of) -> ordered_json {
    return {{"before", known ? number_or_null(gain->before.*of) : ordered_json(nullptr)},
            {"after", known ? number_or_null(gain->after.*of) : ordered_json(nullptr)}};
  };
  return {{"heldout_rms_force_N", figure(&GainFigures::rms_force_N)},
          {"heldout_rms_velocity_rad_s", figure(&GainFigures::rms_velocity_rad_s)},
          {"heldout_log_likelihood_per_sample", figure(&GainFigures::log_likelihood_per_sample)},
          {"heldout_simulated_rms_force_N", figure(&GainFigures::simulated_rms_force_N)},
          {"heldout_simulated_rms_velocity_rad_s", figure(&GainFigures::simulated_rms_velocity_rad_s)},
          {"heldout_rms_torque_Nm", figure(&GainFigures::rms_torque_Nm)},
          {"heldout_torque_error_relative", figure(&GainFigures::torque_error_relative)},
          {"heldout_whiteness_p_value", figure(&GainFigures::whiteness_p_value)},
          {"heldout_misfit", figure(&GainFigures::misfit)},
          {"heldout_runs", known ? gain->runs.size() : 0},
          {"heldout_names", known ? gain->runs : std::vector<std::string>{}}};
}

}  // namespace

ordered_json parameters_json(const std::vector<EstimatedParameter>& parameters) {
  return list_of(parameters, [](const EstimatedParameter& parameter) -> ordered_json {
    ordered_json json{{"name", parameter.name},
                      {"unit", parameter.unit},
                      {"value", number_or_null(parameter.value)},
                      {"sd", number_or_null(parameter.sd)}};
    if (!parameter.choice.empty()) json["choice"] = parameter.choice;
    return json;
  });
}

ordered_json findings_json(const std::vector<DataFinding>& findings) {
  return list_of(findings, finding_json);
}

ordered_json diagnosis_json(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  return {{"schema", "clampd.diagnosis/1"},
          {"verdict", to_string(diagnosis.verdict)},
          {"summary", diagnosis.summary},
          {"runs", subject.runs},
          {"units", {{"position", subject.position_unit}, {"torque", subject.torque_unit}}},
          {"effects", list_of(diagnosis.effects,
                              [&](const NamedEffect& effect) {
                                return effect_json(effect, words::explains(diagnosis));
                              })},
          {"rivals", diagnosis.rivals},
          {"unseen", list_of(diagnosis.unseen, [](const UnseenEffect& effect) { return effect.name; })},
          {"unseen_reasons", list_of(diagnosis.unseen,
                                     [](const UnseenEffect& effect) -> ordered_json {
                                       return {{"name", effect.name}, {"reason", effect.reason}};
                                     })},
          {"misfit", misfit_json(diagnosis.misfit)},
          {"next_experiment", next_json(diagnosis.next_experiment)},
          {"torque_while_off", torque_while_off_json(diagnosis.torque_while_off)},
          {"gain", gain_json(diagnosis, subject)},
          {"parameters_before", parameters_json(diagnosis.parameters_before)},
          {"parameters_after", parameters_json(diagnosis.parameters_after)},
          {"noise", subject.drive ? ordered_json(nullptr)
                                  : ordered_json{{"before", noise_json(diagnosis.noise_before)},
                                                 {"after", noise_json(diagnosis.noise_after)}}},
          {"ladder", ladder_json(diagnosis.candidates)},
          {"alarm_evidence", number_or_null(diagnosis.alarm_evidence)},
          {"share_left", number_or_null(diagnosis.share_left)},
          {"share_explainable", number_or_null(diagnosis.share_explainable)},
          {"rows", rows_json(diagnosis.rows)},
          {"data", findings_json(diagnosis.data)},
          {"notices", diagnosis.notices},
          {"wall_s", diagnosis.wall_s}};
}

}  // namespace clampd
