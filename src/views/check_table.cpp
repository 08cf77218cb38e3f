#include "clampd/views/check_table.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace clampd {
namespace {

constexpr std::size_t kWidth = 100;
constexpr std::string_view kBold = "\033[1m";
constexpr std::string_view kReset = "\033[0m";

std::string_view colour_of(Verdict verdict) {
  switch (verdict) {
    case Verdict::Pass:
      return "\033[1;30;42m";  // black on green
    case Verdict::Fail:
      return "\033[1;97;41m";  // white on red
    case Verdict::Error:
    case Verdict::Timeout:
    case Verdict::Aborted:
      return "\033[1;30;43m";  // black on yellow: nothing was found out about the brake
  }
  return "";
}

std::string_view colour_of(ParameterVerdict verdict) {
  switch (verdict) {
    case ParameterVerdict::Pass:
      return "\033[32m";
    case ParameterVerdict::Marginal:
      return "\033[33m";
    case ParameterVerdict::Fail:
      return "\033[1;31m";
  }
  return "";
}

std::string painted(std::string_view text, std::string_view with, bool colour) {
  return colour ? fmt::format("{}{}{}", with, text, kReset) : std::string(text);
}

/// Bytes that continue a UTF-8 character take no column.
std::size_t columns(std::string_view text) {
  return static_cast<std::size_t>(std::count_if(
      text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }));
}

std::string shortened(std::string text, std::size_t width) {
  if (columns(text) <= width) return text;
  while (columns(text) > width - 3) text.pop_back();
  // the loop may have stopped inside of a character
  while (!text.empty() && (static_cast<unsigned char>(text.back()) & 0xc0) == 0x80) text.pop_back();
  if (!text.empty() && static_cast<unsigned char>(text.back()) >= 0xc0) text.pop_back();
  return text + "...";
}

/// Breaks at blanks; a word longer than the line stays whole.
std::string wrapped(std::string_view text, std::string_view indent) {
  std::string result(indent);
  std::size_t used = indent.size();
  while (!text.empty()) {
    const std::size_t end = std::min(text.find(' '), text.size());
    const std::string_view word = text.substr(0, end);
    if (used > indent.size() && used + 1 + columns(word) > kWidth) {
      result += '\n';
      result += indent;
      used = indent.size();
    }
    if (used > indent.size()) {
      result += ' ';
      ++used;
    }
    result += word;
    used += columns(word);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return result + '\n';
}

/// Where a value lies between its limits: |----o----|, with the mark beside the bars if it is outside.
std::string gauge(const ParameterRecord& parameter) {
  constexpr int kSteps = 11;
  const double place = (parameter.value - parameter.lower) / (parameter.upper - parameter.lower);
  std::string bar(static_cast<std::size_t>(kSteps), '-');
  if (place < 0.0) return fmt::format("o|{}| ", bar);
  if (!(place <= 1.0)) return fmt::format(" |{}|o", bar);
  bar[static_cast<std::size_t>(std::min(kSteps - 1, static_cast<int>(place * kSteps)))] = 'o';
  return fmt::format(" |{}| ", bar);
}

std::string verdict_word(Verdict verdict, bool marginal) {
  return fmt::format("{}{}", to_string(verdict), marginal ? " (marginal)" : "");
}

void append_parameters(std::string& text, const CheckRecord& record, bool colour) {
  if (record.parameters.empty()) return;
  constexpr std::size_t kNameWidth = 5;
  text += painted(fmt::format("  {:<5}{:>12}{:>11}   {:<15}{:>11}{:>12}  {:<12}{}", "", "value", "± sd",
                              " between limits", "lower", "upper", "unit", "verdict"),
                  kBold, colour);
  text += '\n';
  for (const ParameterRecord& p : record.parameters) {
    // The name of an effect's parameter takes a line of its own.
    const bool is_long = p.name.size() >= kNameWidth;
    if (is_long) text += fmt::format("  {}\n", p.name);
    text += fmt::format("  {:<5}{:>12.5g}{:>11}   {:<15}{:>11.4g}{:>12.4g}  {:<12}", is_long ? "" : p.name,
                        p.value, fmt::format("± {:.2g}", p.sd), gauge(p), p.lower, p.upper, p.unit);
    text += painted(p.verdict == ParameterVerdict::Fail ? "FAIL" : to_string(p.verdict), colour_of(p.verdict),
                    colour);
    text += '\n';
  }
  text += '\n';
}

/// "… 0.140", "0.1 …", "0.1 … 0.2": the limits that there are.
std::string limits_text(const CharacteristicRecord& line) {
  const auto end = [](double limit) {
    return std::isfinite(limit) ? fmt::format("{:.4g}", limit) : std::string();
  };
  if (!line.has_limits()) return "";
  return fmt::format("{} … {}", end(line.lower), end(line.upper));
}

void append_runs(std::string& text, const CheckRecord& record) {
  if (record.runs.empty()) return;
  const auto worst =
      std::max_element(record.runs.begin(), record.runs.end(),
                       [](const auto& a, const auto& b) { return a.tracking_rms_N < b.tracking_rms_N; });
  double force_squares = 0.0;
  double velocity_squares = 0.0;
  for (const RunRecord& run : record.runs) {
    force_squares += run.fit_force_rms_N * run.fit_force_rms_N;
    velocity_squares += run.fit_velocity_rms_rad_s * run.fit_velocity_rms_rad_s;
  }
  const double n = static_cast<double>(record.runs.size());
  text += fmt::format(
      "  Tracking  {:.0f} N rms over {} of {} repeats; worst {:.0f} N rms in {} (at most {:.0f} N off)\n",
      record.tracking_rms_N, record.runs.size(), record.repeats, worst->tracking_rms_N, worst->run.name,
      worst->tracking_max_N);
  text +=
      fmt::format("  Fit       {:.1f} N rms in force, {:.3g} rad/s rms in velocity, each repeat on its own\n",
                  std::sqrt(force_squares / n), std::sqrt(velocity_squares / n));
}

void append_sheet(std::string& text, const CheckRecord& record, bool colour) {
  if (!record.sheet || record.sheet->characteristics.empty()) return;
  text += format_sheet(*record.sheet, colour) + '\n';
}

std::string bus_load_text(double bus_load) {
  return bus_load > 0.0 ? fmt::format("; bus load {:.0f} %", 100.0 * bus_load) : "";
}

}  // namespace

std::string format_sheet(const SheetRecord& sheet, bool colour) {
  std::string text = painted(fmt::format("  {:<40}{:>10}{:>11}  {:<7}{:<16}{}", "sheet", "value", "± sd",
                                         "unit", "limits", "verdict"),
                             kBold, colour);
  text += '\n';
  for (const CharacteristicRecord& line : sheet.characteristics) {
    constexpr std::size_t kNameWidth = 40;
    const bool is_long = columns(line.name) >= kNameWidth;
    if (is_long) text += fmt::format("  {}\n", line.name);
    text += fmt::format("  {:<40}", is_long ? "" : line.name);
    if (line.is_known())
      text += fmt::format("{:>10.5g}{:>11}  ", line.value, fmt::format("± {:.2g}", line.sd));
    else
      text += fmt::format("{:>21}  ", line.verdict ? "not reached" : "not known");
    text += fmt::format("{:<7}{:<16}", line.unit, limits_text(line));
    if (line.verdict)
      text += painted(*line.verdict == ParameterVerdict::Fail ? "FAIL" : to_string(*line.verdict),
                      colour_of(*line.verdict), colour);
    while (text.back() == ' ') text.pop_back();
    text += '\n';
    if (!line.why.empty()) text += wrapped(line.why, "    ");
  }
  if (sheet.misfit_marked)
    text += wrapped(
        "The model does not explain all of this brake's motion. The deviations above count that as far as it "
        "shows.",
        "  ");
  text += fmt::format("  Sheet     revision {} ({})\n", sheet.revision, sheet.file);
  return text;
}

std::string format_check(const CheckRecord& record, bool colour) {
  std::string text = "\n";
  std::string about = fmt::format("  Brake {}", record.serial);
  for (const auto& [label, value] :
       {std::pair<std::string_view, const std::string&>{"part", record.part_number},
        {"batch", record.batch},
        {"station", record.station},
        {"fixture", record.fixture},
        {"operator", record.operator_name}})
    if (!value.empty()) about += fmt::format(", {} {}", label, value);
  text += wrapped(about.substr(2), "  ");
  text += fmt::format("  {}, {:.1f} s on the bench{}\n\n", record.started, record.duration_s,
                      record.simulated ? ", SIMULATED BRAKE" : "");

  const std::string word = verdict_word(record.verdict, record.marginal);
  text += colour ? fmt::format("  {}   {}   {}\n", colour_of(record.verdict), word, kReset)
                 : fmt::format("  =====  {}  =====\n", word);
  text += wrapped(record.reason, "  ") + '\n';
  if (record.voided)
    text += wrapped(fmt::format("VOID since {}, by {}: {}", record.voided->when, record.voided->by,
                                record.voided->reason),
                    "  ") +
            '\n';

  append_parameters(text, record, colour);
  append_sheet(text, record, colour);
  if (record.stopping) text += wrapped(fmt::format("Repeats   {}", record.stopping->reason), "  ");
  append_runs(text, record);
  const TimingRecord& timing = record.timing;
  text += fmt::format(
      "  Timing    {} ticks, {} skipped, {} samples lost; late by min {:.0f}, avg {:.0f}, max {:.0f} µs{}\n",
      timing.ticks, timing.skipped, timing.lost_samples, timing.lateness_min_us, timing.lateness_avg_us,
      timing.lateness_max_us, bus_load_text(timing.bus_load));
  if (record.recipe)
    text += fmt::format("  Recipe    version {} ({})\n", record.recipe->version, record.recipe->file);
  text += fmt::format("  Limits    revision {} ({})\n", record.limits_revision, record.limits_file);
  text += fmt::format("  Record    {}\n", record.id);
  return text;
}

std::string format_checks(const std::vector<CheckSummary>& checks, bool colour) {
  if (checks.empty()) return "No checks.\n";
  std::string text =
      painted(fmt::format("{:<28} {:<16} {:<18} {}", "record", "serial", "verdict", "reason"), kBold, colour);
  text += '\n';
  for (const CheckSummary& check : checks) {
    const std::string word = verdict_word(check.verdict, check.marginal) + (check.is_void ? " VOID" : "");
    text += fmt::format("{:<28} {:<16} {} {}\n", check.id, shortened(check.serial, 16),
                        painted(fmt::format("{:<18}", word),
                                check.is_void                    ? "\033[2m"
                                : check.verdict == Verdict::Pass ? "\033[32m"
                                : check.verdict == Verdict::Fail ? "\033[1;31m"
                                                                 : "\033[33m",
                                colour),
                        shortened(check.reason, 34));
  }
  return text;
}

}  // namespace clampd
