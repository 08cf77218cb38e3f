#include "clampd/views/check_report.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/views/page.hpp"

namespace clampd {
namespace {

using report::Cell;
using report::Colour;
using report::Curve;
using report::Figure;
using report::Marker;
using report::Page;
using report::Panel;
using report::Points;
using report::Stroke;
using report::Table;
using report::Tone;

constexpr std::size_t kHistoryRows = 20;

std::string number(double value, int digits) {
  if (!std::isfinite(value)) return "–";
  return report::typographic(fmt::format("{:.{}g}", value, digits));
}

Tone tone_of(Verdict verdict) {
  switch (verdict) {
    case Verdict::Pass:
      return Tone::Good;
    case Verdict::Fail:
      return Tone::Bad;
    case Verdict::Error:
    case Verdict::Timeout:
    case Verdict::Aborted:
      return Tone::Mixed;
  }
  return Tone::Plain;
}

Tone tone_of(ParameterVerdict verdict) {
  return verdict == ParameterVerdict::Pass       ? Tone::Good
         : verdict == ParameterVerdict::Marginal ? Tone::Mixed
                                                 : Tone::Bad;
}

/// 2026-11-20T23:41:07.123Z as "2026-11-20 23:41:07 UTC"
std::string readable(const std::string& utc) {
  return utc.size() < 19 ? utc : fmt::format("{} {} UTC", utc.substr(0, 10), utc.substr(11, 8));
}

std::string or_dash(const std::string& text) {
  return text.empty() ? "–" : text;
}

void write_parameters(Page& page, const CheckRecord& check) {
  Table table{"Identified parameters, one standard deviation, and the limits they were judged by.",
              {{"parameter", false},
               {"value", true},
               {"± sd", true},
               {"lower limit", true},
               {"upper limit", true},
               {"unit", false},
               {"verdict", false}},
              {}};
  for (const ParameterRecord& p : check.parameters)
    table.rows.push_back({p.name, number(p.value, 5), number(p.sd, 2), number(p.lower, 5), number(p.upper, 5),
                          p.unit, Cell(std::string(to_string(p.verdict)), tone_of(p.verdict))});
  page.table(table);
}

/// "800 … 1500", "… 0.14", "0 …": a limit that is not there leaves its side empty.
std::string limits_of(const CharacteristicRecord& line) {
  if (!line.has_limits()) return "–";
  return fmt::format("{}…{}", std::isfinite(line.lower) ? number(line.lower, 5) + " " : "",
                     std::isfinite(line.upper) ? " " + number(line.upper, 5) : "");
}

void write_sheet(Page& page, const SheetRecord& sheet) {
  if (sheet.characteristics.empty()) return;
  page.section("Sheet");
  if (sheet.misfit_marked)
    page.paragraph(
        "The model does not explain all of this brake's motion. The intervals below count that as far as it "
        "shows.");
  Table table{"What the requirement sheet asks for, from the identified parameters and their uncertainty.",
              {{"characteristic", false},
               {"value", true},
               {"95 % interval", true},
               {"limits", true},
               {"unit", false},
               {"verdict", false}},
              {}};
  std::vector<std::pair<std::string, std::string>> circumstances;
  for (const CharacteristicRecord& line : sheet.characteristics) {
    const auto [low, high] = interval_95(line);
    const Cell known = line.verdict ? Cell(std::string(to_string(*line.verdict)), tone_of(*line.verdict))
                                    : Cell("no limits");
    const Cell unknown =
        line.verdict ? Cell("not reached", Tone::Bad) : Cell("not known: " + line.why, Tone::Mixed);
    table.rows.push_back({line.name, number(line.value, 5),
                          line.is_known() ? number(low, 5) + " … " + number(high, 5) : "–", limits_of(line),
                          line.unit, line.is_known() ? known : unknown});
    // The contact point has none.
    circumstances.emplace_back(line.name, line.circumstances.empty()
                                              ? line.kind
                                              : fmt::format("{}: {}", line.kind, line.circumstances));
  }
  page.table(table);
  page.paragraph("Asked for, in full:");
  page.definitions(circumstances);
}

/// Every parameter on a scale from its lower (0) to its upper limit (1).
Figure limits_figure(const CheckRecord& check, double guard_band_k) {
  Panel panel;
  panel.x.label = "position between the limits";
  panel.x.ticks = {{0.0, "lower"}, {0.5, "middle"}, {1.0, "upper"}};
  report::Bars tolerance{"limits", {}, {}, {}, Colour::Green, 0.62};
  report::Bars guard{fmt::format("guard band, {:.3g} sd", guard_band_k), {}, {}, {}, Colour::Orange, 0.62};
  report::Bars uncertainty{"± 2 sd", {}, {}, {}, Colour::Blue, 0.16};
  Points value{"value", {}, {}, Colour::Black, Marker::Dot, 0.7};
  double least = -0.1, most = 1.1;
  for (std::size_t i = 0; i < check.parameters.size(); ++i) {
    const ParameterRecord& p = check.parameters[i];
    const double width = p.upper - p.lower;
    if (!(width > 0.0) || !std::isfinite(width) || !std::isfinite(p.value)) continue;
    const double y = static_cast<double>(check.parameters.size() - i);
    const double at = (p.value - p.lower) / width, sd = std::isfinite(p.sd) ? p.sd / width : 0.0;
    panel.y.ticks.push_back({y, p.name});
    tolerance.y.push_back(y);
    tolerance.from.push_back(0.0);
    tolerance.to.push_back(1.0);
    const double band = std::min(guard_band_k * sd, 0.5);
    for (const double limit : {0.0, 1.0}) {
      guard.y.push_back(y);
      guard.from.push_back(limit - band);
      guard.to.push_back(limit + band);
    }
    uncertainty.y.push_back(y);
    uncertainty.from.push_back(at - 2.0 * sd);
    uncertainty.to.push_back(at + 2.0 * sd);
    value.x.push_back(at);
    value.y.push_back(y);
    least = std::min(least, at - 2.0 * sd - 0.05);
    most = std::max(most, at + 2.0 * sd + 0.05);
  }
  panel.x.lower = least;
  panel.x.upper = most;
  panel.y.lower = 0.4;
  panel.y.upper = static_cast<double>(check.parameters.size()) + 0.6;
  panel.layers = {tolerance, guard, uncertainty, value};
  Figure figure;
  figure.panels = {panel};
  figure.panel_height_px = 90 + 34 * static_cast<int>(check.parameters.size());
  return figure;
}

/// The repeat of the check's own trajectory whose tracking is the median one.
const RunRecord* typical_run(const CheckRecord& check) {
  std::vector<const RunRecord*> runs;
  for (const RunRecord& run : check.runs)
    if (run.run.size() > 1 && run.trajectory == 0) runs.push_back(&run);
  if (runs.empty()) return nullptr;
  std::sort(runs.begin(), runs.end(),
            [](const RunRecord* a, const RunRecord* b) { return a->tracking_rms_N < b->tracking_rms_N; });
  return runs[runs.size() / 2];
}

Figure run_figure(const Run& run, const Reference* reference) {
  std::vector<double> force_kN;
  for (const double force_N : run.force_N) force_kN.push_back(force_N / 1000.0);
  Panel force, velocity, torque;
  force.y.label = "force, kN";
  velocity.y.label = "velocity, rad/s";
  torque.y.label = "torque, N m";
  torque.x.label = "time, s";
  force.layers.emplace_back(Curve{"measured", run.time_s, force_kN, Colour::Blue, Stroke::Solid, 1.8, false});
  velocity.layers.emplace_back(
      Curve{"", run.time_s, run.velocity_rad_s, Colour::Blue, Stroke::Solid, 1.8, false});
  torque.layers.emplace_back(Curve{"", run.time_s, run.torque_Nm, Colour::Blue, Stroke::Solid, 1.8, true});
  if (reference != nullptr) {
    const std::size_t rows = std::min(run.size(), reference->rows.size());
    Curve wanted_force{"reference", {}, {}, Colour::Vermilion, Stroke::Dashed, 1.4, false};
    Curve wanted_velocity = wanted_force, wanted_torque = wanted_force;
    wanted_velocity.label.clear();
    wanted_torque.label.clear();
    wanted_torque.held = true;
    for (std::size_t k = 0; k < rows; ++k) {
      for (Curve* curve : {&wanted_force, &wanted_velocity, &wanted_torque})
        curve->x.push_back(run.time_s[k]);
      wanted_force.y.push_back(reference->rows[k].force_N / 1000.0);
      wanted_velocity.y.push_back(reference->rows[k].velocity_rad_s);
      wanted_torque.y.push_back(reference->rows[k].torque_Nm);
    }
    force.layers.emplace_back(wanted_force);
    velocity.layers.emplace_back(wanted_velocity);
    torque.layers.emplace_back(wanted_torque);
  }
  Figure figure;
  figure.panels = {force, velocity, torque};
  figure.panel_height_px = 210;
  return figure;
}

/// Numbered values in percent, with a band.
Panel scatter_panel(const std::string& title, const std::vector<double>& percents, double low, double high,
                    Colour band) {
  Panel panel;
  panel.title = title;
  panel.y.label = "%";
  const std::size_t n = percents.size();
  const std::size_t step = n / 11 + 1;
  for (std::size_t i = 1; i <= n; i += step)
    panel.x.ticks.push_back({static_cast<double>(i), std::to_string(i)});
  panel.x.lower = 0.5;
  panel.x.upper = static_cast<double>(n) + 0.5;
  panel.layers.emplace_back(report::Band{"", {panel.x.lower, panel.x.upper}, {low, low}, {high, high}, band});
  Points points{"", {}, {}, Colour::Blue, Marker::Dot, 0.55};
  for (std::size_t i = 0; i < n; ++i) {
    points.x.push_back(static_cast<double>(i + 1));
    points.y.push_back(percents[i]);
  }
  panel.layers.emplace_back(points);
  return panel;
}

/// The last samples before the fault; its instant is 0.
Result<void> write_flight_recorder(Page& page, const CheckRecord& check) {
  page.section("The last samples before the fault");
  Curve force{"measured", {}, {}, Colour::Blue, Stroke::Solid, 1.6, false};
  Curve wanted{"reference", {}, {}, Colour::Vermilion, Stroke::Dashed, 1.2, false};
  Curve velocity{"", {}, {}, Colour::Blue, Stroke::Solid, 1.6, false};
  Curve torque{"measured", {}, {}, Colour::Blue, Stroke::Solid, 1.6, true};
  Curve command{"command", {}, {}, Colour::Vermilion, Stroke::Dashed, 1.2, true};
  const std::int64_t end_ns = check.flight_recorder.back().brake_time_ns;
  for (const Sample& sample : check.flight_recorder) {
    const double time_s = static_cast<double>(sample.brake_time_ns - end_ns) * 1e-9;
    for (Curve* curve : {&force, &wanted, &velocity, &torque, &command}) curve->x.push_back(time_s);
    force.y.push_back(sample.force_N / 1000.0);
    wanted.y.push_back(sample.force_reference_N / 1000.0);
    velocity.y.push_back(sample.velocity_rad_s);
    torque.y.push_back(sample.torque_Nm);
    command.y.push_back(sample.torque_command_Nm);
  }
  Panel forces, velocities, torques;
  forces.y.label = "force, kN";
  velocities.y.label = "velocity, rad/s";
  torques.y.label = "torque, N m";
  torques.x.label = "time before the fault was seen, s";
  forces.layers = {force, wanted};
  velocities.layers = {velocity};
  torques.layers = {torque, command};
  Figure figure;
  figure.panels = {forces, velocities, torques};
  figure.panel_height_px = 190;
  return page.figure(
      figure,
      fmt::format("The flight recorder: {} samples up to the fault {}, as they were read and answered. "
                  "`clampctl results {} --flight FILE.csv` writes them all.",
                  check.flight_recorder.size(), to_string(check.fault), check.id));
}

Figure grid(std::vector<Panel> panels) {
  Figure figure;
  figure.panels = std::move(panels);
  figure.columns = 2;
  figure.width_px = 1000;
  figure.panel_height_px = 200;
  return figure;
}

Result<void> write_repeats(Page& page, const CheckRecord& check) {
  std::vector<Panel> panels;
  for (std::size_t i = 0; i < check.parameters.size(); ++i) {
    const ParameterRecord& p = check.parameters[i];
    std::vector<double> values;
    bool any = false;
    for (const RunRecord& run : check.runs) {
      const bool usable = run.converged && i < run.estimate.size() && std::isfinite(run.estimate[i]);
      values.push_back(usable ? 100.0 * (run.estimate[i] / p.value - 1.0)
                              : std::numeric_limits<double>::quiet_NaN());
      any = any || usable;
    }
    const double band = 200.0 * p.sd / std::abs(p.value);
    if (any) panels.push_back(scatter_panel(p.name, values, -band, band, Colour::Sky));
  }
  if (!panels.empty()) {
    page.section("Repeats");
    if (const Result<void> drawn = page.figure(grid(std::move(panels)),
                                               "Each repeat identified on its own, by repeat: percent off "
                                               "the joint estimate of all. The band is its ± 2 sd; "
                                               "single repeats scatter more.");
        !drawn)
      return drawn;
  }
  Table table{"Tracking and fit of each repeat.",
              {{"repeat", false},
               {"tracking rms, N", true},
               {"largest, N", true},
               {"fit force rms, N", true},
               {"fit velocity rms, rad/s", true},
               {"SHA-256", false}},
              {}};
  for (const RunRecord& run : check.runs)
    table.rows.push_back(
        {run.run.name, fmt::format("{:.0f}", run.tracking_rms_N), fmt::format("{:.0f}", run.tracking_max_N),
         fmt::format("{:.1f}", run.fit_force_rms_N), fmt::format("{:.3f}", run.fit_velocity_rms_rad_s),
         run.checksum_sha256.substr(0, 16) + (run.removed.empty() ? "" : " (data removed)")});
  page.table(table);
  return {};
}

Result<void> write_timing(Page& page, const TimingRecord& timing) {
  page.section("Timing");
  std::string words = fmt::format(
      "{} ticks of a millisecond, {} skipped, {} samples lost; wake-ups late by min {:.0f}, "
      "avg {:.1f}, max {:.0f} µs.",
      timing.ticks, timing.skipped, timing.lost_samples, timing.lateness_min_us, timing.lateness_avg_us,
      timing.lateness_max_us);
  if (timing.bus_load > 0.0)
    words += fmt::format(" The CAN bus was loaded by {:.0f} %.", 100.0 * timing.bus_load);
  page.paragraph(words);
  Panel panel;
  panel.x = {"lateness, µs", false, 0.0, 0.0, {}};
  panel.y = {"ticks", true, 0.0, 0.0, {}};
  Curve counts{"", {}, {}, Colour::Blue, Stroke::Solid, 1.6, true};
  double last = 0.0, most = 1.0;
  for (std::size_t i = 0; i < timing.lateness_histogram.size(); ++i)
    if (timing.lateness_histogram[i] > 0) {
      last = static_cast<double>(i);
      most = std::max(most, static_cast<double>(timing.lateness_histogram[i]));
    }
  if (timing.lateness_max_us <= 0.0 || last == 0.0) {
    page.paragraph("In virtual time no wake-up is late, so that there is no histogram.");
    return {};
  }
  for (std::size_t i = 0; i <= static_cast<std::size_t>(last) + 1; ++i) {
    const std::uint64_t ticks = i < timing.lateness_histogram.size() ? timing.lateness_histogram[i] : 0;
    counts.x.push_back(static_cast<double>(i));
    counts.y.push_back(ticks > 0 ? static_cast<double>(ticks) : 0.5);
  }
  panel.x.upper = last + 1.0;
  panel.y.lower = 0.5;
  panel.y.upper = 2.0 * most;
  panel.layers = {counts};
  Figure figure;
  figure.panels = {panel};
  figure.panel_height_px = 240;
  return page.figure(figure,
                     "How late the loop woke up, in ticks per microsecond; the last bin holds the rest.");
}

void write_traceability(Page& page, const CheckRecord& check) {
  page.section("Traceability");
  std::string instruments;
  const nlohmann::json list = nlohmann::json::parse(check.instruments, nullptr, false);
  if (list.is_array())
    for (const nlohmann::json& instrument : list)
      if (instrument.is_object())
        instruments += fmt::format("{}{} {}, calibrated {}", instruments.empty() ? "" : "; ",
                                   instrument.value("name", ""), instrument.value("serial", ""),
                                   or_dash(instrument.value("calibrated", "")));
  Table table{"", {{"", false}, {"", false}}, {}};
  const std::vector<std::pair<std::string, std::string>> rows{
      {"Serial number", check.serial},
      {"Part number", or_dash(check.part_number)},
      {"Recipe", check.recipe ? fmt::format("version {} ({})", check.recipe->version, check.recipe->file) : "–"},
      {"Recipe SHA-256", check.recipe ? check.recipe->sha256 : "–"},
      {"Batch", or_dash(check.batch)},
      {"Station", or_dash(check.station)},
      {"Fixture", or_dash(check.fixture)},
      {"Operator", or_dash(check.operator_name)},
      {"Instruments", or_dash(instruments)},
      {"Started", readable(check.started)},
      {"Stopped", readable(check.stopped)},
      {"Software", check.software_version},
      {"Method", or_dash(check.method)},
      {"Repeats", check.stopping
                      ? fmt::format("{}: {}; guard band of {:.2f} standard deviations", check.repeats,
                                    check.stopping->reason, check.stopping->coverage_factor)
                      : fmt::format("{}, a fixed number", check.repeats)},
      {"Limits", fmt::format("revision {} ({})", check.limits_revision, check.limits_file)},
      {"Limits SHA-256", check.limits_sha256},
      {"Sheet",
       check.sheet ? fmt::format("revision {} ({})", check.sheet->revision, check.sheet->file) : "–"},
      {"Sheet SHA-256", check.sheet ? check.sheet->sha256 : "–"},
      {"Trajectory SHA-256", check.trajectory_sha256},
      {"Record", check.id}};
  for (const auto& [term, text] : rows) table.rows.push_back({term, text});
  page.table(table);
}

Result<void> write_history(Page& page, const CheckReportContents& contents) {
  std::vector<CheckRecord> history = contents.history;
  if (history.size() < 2) return {};
  page.section("History of this brake");
  Table table{history.size() > kHistoryRows
                  ? fmt::format("The newest {} of {} checks.", kHistoryRows, history.size())
                  : "",
              {{"started", false}, {"verdict", false}, {"operator", false}, {"reason", false}},
              {}};
  for (std::size_t i = 0; i < std::min(history.size(), kHistoryRows); ++i) {
    const CheckRecord& check = history[i];
    table.rows.push_back({readable(check.started) + (check.id == contents.check.id ? " (this one)" : ""),
                          Cell(fmt::format("{}{}{}", to_string(check.verdict),
                                           check.marginal ? " (marginal)" : "", check.voided ? ", void" : ""),
                               check.voided ? Tone::Plain : tone_of(check.verdict)),
                          or_dash(check.operator_name), check.voided ? check.voided->reason : check.reason});
  }
  page.table(table);
  std::reverse(history.begin(), history.end());
  std::vector<Panel> panels;
  for (const ParameterRecord& p : contents.check.parameters) {
    std::vector<double> values;
    for (const CheckRecord& check : history) {
      const auto found = std::find_if(check.parameters.begin(), check.parameters.end(),
                                      [&](const ParameterRecord& other) { return other.name == p.name; });
      values.push_back(found == check.parameters.end()
                           ? std::numeric_limits<double>::quiet_NaN()
                           : 100.0 * (found->value - p.lower) / (p.upper - p.lower));
    }
    panels.push_back(scatter_panel(p.name, values, 0.0, 100.0, Colour::Green));
  }
  if (panels.empty()) return {};
  return page.figure(
      grid(std::move(panels)),
      "Parameters by check, the oldest first, from this check's lower (0 %) to its upper limit (100 %).");
}

}  // namespace

Result<std::string> check_report(const CheckReportContents& contents) {
  const CheckRecord& check = contents.check;
  Page page("Brake " + check.serial,
            fmt::format("Checked {} on {}{}{}", readable(check.started), or_dash(check.station),
                        check.operator_name.empty() ? "" : " by " + check.operator_name,
                        check.simulated ? ". SIMULATED BRAKE: it says nothing about hardware" : ""));
  page.banner(std::string(to_string(check.verdict)), tone_of(check.verdict),
              check.marginal ? "Marginal. " + check.reason : check.reason);
  if (check.voided)
    page.paragraph(fmt::format("This record is void since {}, as {} said: {} It counts in no statistics.",
                               readable(check.voided->when), check.voided->by, check.voided->reason));
  if (check.cause) {
    const bool explains = check.cause->verdict != "unexplained";
    page.section(explains ? "Cause" : "What the model does not explain");
    std::vector<std::pair<std::string, std::string>> entries{{"Diagnosis", check.cause->summary}};
    if (!check.cause->effects.empty())
      entries.emplace_back(explains ? "Effects" : "Tried, and not enough",
                           fmt::format("{}", fmt::join(check.cause->effects, ", ")));
    if (!check.cause->location.empty()) entries.emplace_back("Where", check.cause->location);
    for (const auto& rivals : check.cause->rivals)
      entries.emplace_back("These runs cannot tell apart", fmt::format("{}", fmt::join(rivals, ", ")));
    page.definitions(entries);
  }
  if (!check.parameters.empty()) {
    page.section("Parameters and limits");
    if (!is_about_the_brake(check.verdict))
      page.paragraph("The check was invalid: what follows says nothing about the brake.");
    const double guard_band_k = check.stopping ? check.stopping->coverage_factor : contents.guard_band_k;
    if (const auto drawn = page.figure(
            limits_figure(check, guard_band_k),
            fmt::format(
                "Each parameter between its limits, with twice its standard deviation. Inside the guard "
                "band, {:.3g} standard deviations to either side of a limit, a value is marginal: decided "
                "by the value alone.",
                guard_band_k));
        !drawn)
      return tl::unexpected(drawn.error());
    write_parameters(page, check);
    if (check.sheet) write_sheet(page, *check.sheet);
  }
  if (!check.flight_recorder.empty())
    if (const auto written = write_flight_recorder(page, check); !written)
      return tl::unexpected(written.error());
  if (const RunRecord* run = typical_run(check)) {
    page.section("A repeat against its reference");
    if (const auto drawn = page.figure(
            run_figure(run->run, contents.reference),
            fmt::format("{}, the one of median tracking: {:.0f} N rms off the reference.{}", run->run.name,
                        run->tracking_rms_N,
                        contents.reference == nullptr
                            ? " The reference is not shown: the station's trajectory is another one by now."
                            : ""));
        !drawn)
      return tl::unexpected(drawn.error());
  } else if (!check.runs.empty()) {
    page.paragraph(
        fmt::format("The raw runs were removed on {}, as the station's retention says; their checksums, "
                    "estimates and results are kept.",
                    readable(check.runs.front().removed)));
  }
  if (!check.runs.empty())
    if (const auto written = write_repeats(page, check); !written) return tl::unexpected(written.error());
  if (const auto written = write_timing(page, check.timing); !written) return tl::unexpected(written.error());
  if (const auto written = write_history(page, contents); !written) return tl::unexpected(written.error());
  write_traceability(page, check);
  return page.html();
}

}  // namespace clampd
