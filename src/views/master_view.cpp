#include "clampd/views/master_view.hpp"

#include <cmath>

#include <fmt/format.h>

namespace clampd {

nlohmann::ordered_json master_json(const MasterReport& report) {
  using nlohmann::ordered_json;
  const auto text_or_null = [](const std::string& text) {
    return text.empty() ? ordered_json(nullptr) : ordered_json(text);
  };
  ordered_json parameters = ordered_json::array();
  for (const MasterParameter& p : report.parameters)
    parameters.push_back({{"name", p.name},
                          {"unit", p.unit},
                          {"value", p.value},
                          {"sd", p.sd},
                          {"lower", p.lower},
                          {"upper", p.upper},
                          {"verdict", to_string(p.verdict)},
                          {"drift", p.drift},
                          {"values", p.values}});
  return {{"schema", "clampd.master/1"},
          {"serial", text_or_null(report.serial)},
          {"state", to_string(report.state)},
          {"text", report.text},
          {"last_checked", text_or_null(report.last_checked)},
          {"age_h", report.last_checked.empty() ? ordered_json(nullptr) : ordered_json(report.age_h)},
          {"record", text_or_null(report.record)},
          {"limits_revision", report.limits_revision},
          {"parameters", std::move(parameters)}};
}

std::string format_master(const MasterReport& report) {
  if (report.state == MasterState::None)
    return "No master brake is configured ([master] serial and limits).\n";
  std::string text =
      fmt::format("Master brake {}: {}\n  {}\n", report.serial, to_string(report.state), report.text);
  if (report.parameters.empty()) return text;
  text +=
      fmt::format("  newest check {}, {:.1f} h ago; certified by revision {}; {} checks\n\n", report.record,
                  report.age_h, report.limits_revision, report.parameters.front().values.size());
  text += fmt::format("  {:<5}{:>12}{:>11}{:>13}{:>12}  {:<12}{}\n", "", "value", "± sd", "certified", "to",
                      "unit", "");
  for (const MasterParameter& p : report.parameters) {
    text += fmt::format("  {:<5}{:>12.5g}{:>11}{:>12.5g}{:>12.5g}  {:<12}{}\n", p.name, p.value,
                        fmt::format("± {:.2g}", p.sd), p.lower, p.upper, p.unit, to_string(p.verdict));
    for (const std::string& drift : p.drift) text += fmt::format("       {}\n", drift);
  }
  return text;
}

}  // namespace clampd
