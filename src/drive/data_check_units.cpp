#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

/// A unit that the name of a column may end in, and what one of it is in the model's units.
struct NamedUnit {
  std::string_view word;
  double scale;
};
constexpr double kDegree = M_PI / 180.0, kTurn = 2.0 * M_PI;
constexpr std::array<NamedUnit, 6> kTimes{
    {{"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}, {"min", 60.0}, {"msec", 1e-3}, {"usec", 1e-6}}};
constexpr std::array<NamedUnit, 7> kAngles{{{"deg", kDegree},
                                            {"degree", kDegree},
                                            {"degrees", kDegree},
                                            {"rev", kTurn},
                                            {"turn", kTurn},
                                            {"turns", kTurn},
                                            {"mrad", 1e-3}}};
constexpr std::array<NamedUnit, 3> kAngularRates{{{"rpm", kTurn / 60.0}, {"rps", kTurn}, {"dps", kDegree}}};
constexpr std::array<NamedUnit, 3> kLengths{{{"mm", 1e-3}, {"cm", 1e-2}, {"um", 1e-6}}};
constexpr std::array<NamedUnit, 5> kTorques{
    {{"mNm", 1e-3}, {"uNm", 1e-6}, {"kNm", 1e3}, {"Ncm", 1e-2}, {"cNm", 1e-2}}};
constexpr std::array<NamedUnit, 3> kForces{{{"kN", 1e3}, {"mN", 1e-3}, {"kgf", 9.80665}}};
constexpr std::array<NamedUnit, 1> kCurrents{{{"mA", 1e-3}}};
constexpr std::array<std::string_view, 8> kCounts{"count", "counts", "cnt",        "ticks",
                                                  "tick",  "inc",    "increments", "pulses"};

/// The words of a column's name: "position_deg", "speed [rpm]" and "angle(deg)" end in their units.
std::vector<std::string> words_of(std::string_view name) {
  std::vector<std::string> words(1);
  for (const char c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)))
      words.back() += c;
    else if (!words.back().empty())
      words.emplace_back();
  }
  if (words.back().empty()) words.pop_back();
  return words;
}

bool has_word(std::string_view column, std::string_view word) {
  const std::vector<std::string> words = words_of(column);
  const auto found = std::ranges::find(words, word);
  // "torque_N_m" is in N m.
  return found != words.end() && (word != "N" || std::next(found) == words.end() || *std::next(found) != "m");
}

void mend_scale(RunCheck& check, std::vector<double>& values, const ColumnSource& source,
                const NamedUnit& unit) {
  for (double& value : values) value *= unit.scale;
  check.mended = true;
  check.add("unit", source.column, unit.scale, "1", DataSeverity::Mended,
            fmt::format("by its name, column {} is in {}, and the model file gives no scale for it; it was "
                        "multiplied by {:.6g}. "
                        "If that is right, write scale = {:.10g} into the model file; if not, write scale = "
                        "1 with another name "
                        "of the column",
                        source.column, unit.word, unit.scale, unit.scale));
}

template <std::size_t count>
void check_named(RunCheck& check, std::vector<double>& values, const ColumnSource& source,
                 const std::array<NamedUnit, count>& units) {
  if (values.empty() || source.scale != 1.0) return;  // whoever gives a scale knows the unit
  for (const NamedUnit& unit : units)
    if (has_word(source.column, unit.word)) return mend_scale(check, values, source, unit);
}

bool all_whole(std::span<const double> values) {
  return std::ranges::all_of(values, [](double value) { return value == std::round(value); });
}

/// Whole numbers over a range of hundreds are counts of an encoder, and only the user knows how many a turn
/// has.
void check_counts(RunCheck& check, const ColumnSource& source) {
  const std::vector<double>& position = check.run.position_rad;
  if (position.empty() || source.scale != 1.0) return;
  const auto [least, most] = std::ranges::minmax(position);
  const bool by_name =
      std::ranges::any_of(kCounts, [&](std::string_view word) { return has_word(source.column, word); });
  constexpr double kFewestCounts = 300.0;  // that many radians or metres in whole numbers: no measured motion
  if (!by_name && !(all_whole(position) && most - least > kFewestCounts)) return;
  check.add(
      "unit", source.column, most - least, "counts", DataSeverity::Stop,
      fmt::format(
          "column {} counts the steps of an encoder ({}), and the model file gives no scale for it. Write "
          "position = {{column = \"{}\", scale = {}}} into its [columns]",
          source.column, by_name ? "by its name" : "whole numbers only", source.column,
          check.model.linear ? "METRES_A_COUNT" : "6.283185307 / COUNTS_A_TURN, worked out"));
}

/// A torque column that is named after another kind of quantity than the model file says.
void check_torque_kind(RunCheck& check) {
  const ColumnSource& source = *check.model.columns.torque;
  if (source.scale != 1.0) return;
  for (const std::string_view unit : {"A", "N", "Nm", "V"}) {
    const std::string_view said =
        check.model.torque_unit == "N m" ? "Nm" : std::string_view(check.model.torque_unit);
    if (!has_word(source.column, unit) || said == unit) continue;
    check.add("unit", source.column, 1.0, "1", DataSeverity::Note,
              fmt::format("by its name, column {} is in {}, and the model file says unit = \"{}\". Every "
                          "parameter is then in {} "
                          "without saying so: give the unit of the column, or its scale",
                          source.column, unit, check.model.torque_unit, unit));
  }
}

/// Faster than any drive: the column is in another unit, whatever its name.
void check_plausible_speed(RunCheck& check) {
  const std::vector<double> velocity = velocity_of(check.run);
  std::vector<double> speeds;
  for (const double v : velocity) speeds.push_back(std::abs(v));
  const double fast = quantile(std::move(speeds), 0.9);
  // The fastest spindles turn at 400,000 rpm, the fastest linear motors move at some 20 m/s.
  const double fastest = check.model.linear ? 50.0 : 5e4;
  if (!(fast > fastest)) return;
  const bool by_position = !check.run.position_rad.empty();
  const std::string& column =
      by_position ? check.model.columns.position->column : check.model.columns.velocity->column;
  check.add("unit", column, fast, std::string(velocity_unit(check.model)), DataSeverity::Stop,
            fmt::format("by column {} and the times in {} the drive moves at {:.3g} {}: one of them is in "
                        "another unit (ms for s, "
                        "mm or counts for {}). Give its scale in [columns] of the model file",
                        column, check.model.columns.time.column, fast, velocity_unit(check.model),
                        check.model.position_unit()));
}

}  // namespace

std::string_view torque_unit(const DriveModel& model) {
  return model.torque_unit;
}
std::string_view velocity_unit(const DriveModel& model) {
  return model.linear ? "m/s" : "rad/s";
}

void RunCheck::add(std::string name, std::string column, double size, std::string unit, DataSeverity severity,
                   std::string words) {
  findings.push_back({.name = std::move(name),
                      .column = std::move(column),
                      .run = run.name,
                      .size = size,
                      .unit = std::move(unit),
                      .severity = severity,
                      .words = std::move(words)});
}

std::vector<Channel> channels_of(RunCheck& check) {
  using Kind = Channel::Kind;
  const ColumnMap& columns = check.model.columns;
  std::vector<Channel> channels;
  channels.push_back({&check.run.torque_Nm, columns.torque->column, torque_unit(check.model), Kind::Torque});
  if (!check.run.velocity_rad_s.empty())
    channels.push_back({&check.run.velocity_rad_s,
                        columns.velocity ? columns.velocity->column : "velocity_rad_s",
                        velocity_unit(check.model), Kind::Velocity});
  if (!check.run.position_rad.empty())
    channels.push_back({&check.run.position_rad, columns.position ? columns.position->column : "position_rad",
                        check.model.position_unit(), Kind::Position});
  return channels;
}

bool check_finite(RunCheck& check) {
  bool finite = true;
  std::vector<Channel> channels = channels_of(check);
  channels.push_back({&check.run.time_s, check.model.columns.time.column, "s", Channel::Kind::Position});
  for (const Channel& channel : channels) {
    const auto bad = [](double value) { return !std::isfinite(value); };
    const auto count = std::ranges::count_if(*channel.values, bad);
    if (count == 0) continue;
    finite = false;
    const auto first = std::ranges::find_if(*channel.values, bad) - channel.values->begin();
    check.add("not-finite", channel.column, static_cast<double>(count), "rows", DataSeverity::Stop,
              fmt::format("column {} holds {} that {} no finite number, the first in row {}: leave those "
                          "rows out of the file",
                          channel.column, count == 1 ? "a reading" : fmt::format("{} readings", count),
                          count == 1 ? "is" : "are", first + 1));
  }
  return finite;
}

void check_units(RunCheck& check) {
  const ColumnMap& columns = check.model.columns;
  Run& run = check.run;
  check_named(check, run.time_s, columns.time, kTimes);
  if (columns.position && !run.position_rad.empty()) {
    check_counts(check, *columns.position);
    if (check.model.linear)
      check_named(check, run.position_rad, *columns.position, kLengths);
    else
      check_named(check, run.position_rad, *columns.position, kAngles);
  }
  if (columns.velocity && !run.velocity_rad_s.empty()) {
    const bool scaled = check.mended;
    if (check.model.linear) check_named(check, run.velocity_rad_s, *columns.velocity, kLengths);
    if (!check.model.linear) check_named(check, run.velocity_rad_s, *columns.velocity, kAngularRates);
    if (!check.model.linear && check.mended == scaled)
      check_named(check, run.velocity_rad_s, *columns.velocity, kAngles);
  }
  if (check.model.torque_unit == "N m") check_named(check, run.torque_Nm, *columns.torque, kTorques);
  if (check.model.torque_unit == "N") check_named(check, run.torque_Nm, *columns.torque, kForces);
  if (check.model.torque_unit == "A") check_named(check, run.torque_Nm, *columns.torque, kCurrents);
  check_torque_kind(check);
  if (std::ranges::none_of(check.findings,
                           [](const DataFinding& each) { return each.severity == DataSeverity::Stop; }))
    check_plausible_speed(check);
}

}  // namespace clampd::data_check
