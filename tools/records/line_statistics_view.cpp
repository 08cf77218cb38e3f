#include <cmath>
#include <iterator>

#include <fmt/format.h>

#include "tools/records/line_statistics.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;

ordered_json number(double value) {
  return std::isfinite(value) ? ordered_json(value) : ordered_json(nullptr);
}

ordered_json index_json(const quality::CapabilityIndex& index) {
  return {{"value", number(index.value)}, {"lower", number(index.lower)}, {"upper", number(index.upper)}};
}

ordered_json chart_json(const quality::ControlChart& chart) {
  ordered_json signals = ordered_json::array();
  for (const quality::Signal& signal : chart.signals)
    signals.push_back({{"at", signal.at},
                       {"rule", quality::name(signal.rule)},
                       {"description", quality::description(signal.rule)}});
  return {{"centre", number(chart.centre)},
          {"lower", number(chart.lower)},
          {"upper", number(chart.upper)},
          {"points", chart.points},
          {"signals", std::move(signals)}};
}

std::string index_text(const quality::CapabilityIndex& index) {
  return std::isfinite(index.value)
             ? fmt::format("{:.2f} ({:.2f}-{:.2f})", index.value, index.lower, index.upper)
             : "-";
}

}  // namespace

ordered_json statistics_json(const LineStatistics& statistics) {
  ordered_json parameters = ordered_json::array();
  for (const ParameterStatistics& p : statistics.parameters)
    parameters.push_back({{"name", p.name},
                          {"unit", p.unit},
                          {"lower", number(p.lower)},
                          {"upper", number(p.upper)},
                          {"limits_changed", p.limits_changed},
                          {"n", p.capability.n},
                          {"mean", number(p.capability.mean)},
                          {"sd_within", number(p.capability.sd_within)},
                          {"sd_overall", number(p.capability.sd_overall)},
                          {"cp", index_json(p.capability.cp)},
                          {"cpk", index_json(p.capability.cpk)},
                          {"pp", index_json(p.capability.pp)},
                          {"ppk", index_json(p.capability.ppk)},
                          {"individuals", chart_json(p.charts.location)},
                          {"moving_range", chart_json(p.charts.spread)}});
  return {{"schema", "clampd.statistics/1"},
          {"checks", statistics.checks},
          {"passed", statistics.passed},
          {"failed", statistics.failed},
          {"invalid", statistics.invalid},
          {"simulated", statistics.simulated},
          {"first", statistics.first},
          {"last", statistics.last},
          {"confidence", 0.95},
          {"serials", statistics.serials},
          {"parameters", std::move(parameters)}};
}

std::string format_statistics(const LineStatistics& statistics) {
  if (statistics.checks == 0) return "No checks.\n";
  std::string text = fmt::format("{} checks from {} to {}: {} passed, {} failed, {} invalid",
                                 statistics.checks, statistics.first, statistics.last, statistics.passed,
                                 statistics.failed, statistics.invalid);
  if (const std::size_t judged = statistics.passed + statistics.failed; judged > 0)
    text += fmt::format("; yield {:.1f} %",
                        100.0 * static_cast<double>(statistics.passed) / static_cast<double>(judged));
  if (statistics.simulated > 0) text += fmt::format("; {} SIMULATED", statistics.simulated);
  text += fmt::format("\n{} brakes, the last valid check of each\n\n", statistics.serials.size());
  if (statistics.parameters.empty())
    return text + "Capability needs at least two brakes with a valid check.\n";

  text += fmt::format("{:<16}{:>12}{:>11}{:>11}  {:<19}{:<19}{:<19}{}\n", "parameter", "mean", "sd within",
                      "sd", "Cp (95 %)", "Cpk (95 %)", "Ppk (95 %)", "unit");
  for (const ParameterStatistics& p : statistics.parameters)
    text +=
        fmt::format("{:<16}{:>12.5g}{:>11.3g}{:>11.3g}  {:<19}{:<19}{:<19}{}{}\n", p.name, p.capability.mean,
                    p.capability.sd_within, p.capability.sd_overall, index_text(p.capability.cp),
                    index_text(p.capability.cpk), index_text(p.capability.ppk), p.unit,
                    p.limits_changed ? "  (limits changed: the newest count)" : "");
  text += "\nControl charts (individuals, moving ranges):\n";
  bool quiet = true;
  for (const ParameterStatistics& p : statistics.parameters) {
    for (const quality::Signal& signal : p.charts.location.signals)
      text += fmt::format("  {:<8} {:<24} {}: {}\n", p.name, statistics.serials.at(signal.at),
                          quality::name(signal.rule), quality::description(signal.rule));
    for (const quality::Signal& signal : p.charts.spread.signals)
      text += fmt::format("  {:<8} {:<24} moving range beyond its limit: a step\n", p.name,
                          statistics.serials.at(signal.at + 1));
    quiet = quiet && p.charts.location.signals.empty() && p.charts.spread.signals.empty();
  }
  if (quiet) text += "  nothing that chance does not explain\n";
  return text;
}

}  // namespace clampd
