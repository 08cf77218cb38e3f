#include "clampd/views/line_statistics_view.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include "clampd/base/json.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;

ordered_json index_json(const quality::CapabilityIndex& index) {
  return {{"value", number_or_null(index.value)},
          {"lower", number_or_null(index.lower)},
          {"upper", number_or_null(index.upper)}};
}

ordered_json chart_json(const quality::ControlChart& chart) {
  ordered_json signals = ordered_json::array();
  for (const quality::Signal& signal : chart.signals)
    signals.push_back({{"at", signal.at},
                       {"rule", quality::name(signal.rule)},
                       {"description", quality::description(signal.rule)}});
  return {{"centre", number_or_null(chart.centre)},
          {"lower", number_or_null(chart.lower)},
          {"upper", number_or_null(chart.upper)},
          {"points", chart.points},
          {"signals", std::move(signals)}};
}

std::string index_text(const quality::CapabilityIndex& index) {
  return std::isfinite(index.value)
             ? fmt::format("{:.2f} ({:.2f}-{:.2f})", index.value, index.lower, index.upper)
             : "-";
}

/// Cells padded to their columns, with two blanks between: texts to the left, the numbers of columns 1 to 3
/// to the right.
std::string aligned(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths(rows.front().size(), 0);
  for (const auto& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  std::string text;
  for (const auto& row : rows) {
    std::string line;
    for (std::size_t i = 0; i < row.size(); ++i)
      line += i >= 1 && i <= 3 ? fmt::format("{:>{}}  ", row[i], widths[i])
                               : fmt::format("{:<{}}  ", row[i], widths[i]);
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + '\n';
  }
  return text;
}

std::string table_text(const LineStatistics& statistics) {
  std::vector<std::vector<std::string>> rows{
      {"parameter", "mean", "sd within", "sd", "Cp (95 %)", "Cpk (95 %)", "Ppk (95 %)", "unit"}};
  for (const ParameterStatistics& p : statistics.parameters)
    rows.push_back({p.name, fmt::format("{:.5g}", p.capability.mean),
                    fmt::format("{:.3g}", p.capability.sd_within),
                    fmt::format("{:.3g}", p.capability.sd_overall), index_text(p.capability.cp),
                    index_text(p.capability.cpk), index_text(p.capability.ppk),
                    p.unit + (p.limits_changed ? "  (limits changed: the newest count)" : "")});
  return aligned(rows);
}

/// One line a brake, with all that its point breaks in either chart.
std::string signals_text(const ParameterStatistics& parameter, const std::vector<std::string>& serials) {
  std::map<std::size_t, std::string> lines;
  const auto add = [&](std::size_t at, const std::string& words) {
    std::string& line = lines[at];
    line += (line.empty() ? "" : "; ") + words;
  };
  for (const quality::Signal& signal : parameter.charts.location.signals)
    add(signal.at, fmt::format("{}: {}", quality::name(signal.rule), quality::description(signal.rule)));
  for (const quality::Signal& signal : parameter.charts.spread.signals)
    add(signal.at + 1, "moving range beyond its limit: a step");
  std::string text;
  for (const auto& [at, words] : lines)
    text += fmt::format("  {:<8} {:<24} {}\n", parameter.name, serials.at(at), words);
  return text;
}

}  // namespace

ordered_json statistics_json(const LineStatistics& statistics) {
  ordered_json parts = ordered_json::array();
  for (const LineStatistics& part : statistics.parts) parts.push_back(statistics_json(part));
  ordered_json parameters = ordered_json::array();
  for (const ParameterStatistics& p : statistics.parameters)
    parameters.push_back({{"name", p.name},
                          {"unit", p.unit},
                          {"lower", number_or_null(p.lower)},
                          {"upper", number_or_null(p.upper)},
                          {"limits_changed", p.limits_changed},
                          {"n", p.capability.n},
                          {"mean", number_or_null(p.capability.mean)},
                          {"sd_within", number_or_null(p.capability.sd_within)},
                          {"sd_overall", number_or_null(p.capability.sd_overall)},
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
          {"misfit_marked", statistics.marked},
          {"simulated", statistics.simulated},
          {"void", statistics.voided},
          {"simulated_left_out", statistics.simulated_left_out},
          {"first", statistics.first},
          {"last", statistics.last},
          {"confidence", 0.95},
          {"serials", statistics.serials},
          {"parameters", std::move(parameters)},
          {"part_number", statistics.part_number},
          {"other_limits", statistics.other_limits},
          {"parts", std::move(parts)}};
}

std::string format_statistics(const LineStatistics& statistics) {
  if (statistics.checks == 0) return "No checks.\n";
  std::string text = fmt::format("{} checks from {} to {}: {} passed, {} failed, {} invalid",
                                 statistics.checks, statistics.first, statistics.last, statistics.passed,
                                 statistics.failed, statistics.invalid);
  if (const std::size_t judged = statistics.passed + statistics.failed; judged > 0)
    text += fmt::format("; yield {:.1f} %",
                        100.0 * static_cast<double>(statistics.passed) / static_cast<double>(judged));
  if (statistics.simulated > 0)
    text += fmt::format("; {} SIMULATED{}", statistics.simulated,
                        statistics.simulated_left_out ? " are left out, since there are real ones" : "");
  if (statistics.voided > 0) text += fmt::format("; {} void are left out", statistics.voided);
  if (!statistics.parts.empty()) {
    text += fmt::format("\n{} part numbers, each by itself (--part-number chooses one)\n",
                        statistics.parts.size());
    for (const LineStatistics& part : statistics.parts)
      text += fmt::format("\nPart number {}\n{}", part.part_number.empty() ? "(none)" : part.part_number,
                          format_statistics(part));
    return text;
  }
  text += fmt::format("\n{} brakes, the last valid check of each\n", statistics.serials.size());
  if (statistics.other_limits > 0)
    text += fmt::format(
        "{} more brakes are left out: the recipe had other limits for them than for the newest check\n",
        statistics.other_limits);
  text += '\n';
  if (statistics.marked > 0)
    text += fmt::format(
        "The model does not explain all of the motion in {} of these checks: what it lacks is part of the "
        "spread "
        "below, not only the brakes.\n\n",
        statistics.marked);
  if (statistics.parameters.empty())
    return text + "Capability needs at least two brakes with a valid check.\n";

  text += table_text(statistics);
  text += "\nControl charts (individuals, moving ranges):\n";
  std::string signals;
  for (const ParameterStatistics& parameter : statistics.parameters)
    signals += signals_text(parameter, statistics.serials);
  return text + (signals.empty() ? "  nothing that chance does not explain\n" : signals);
}

}  // namespace clampd
