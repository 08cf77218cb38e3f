#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <optional>
#include <sstream>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/drive/model.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"

namespace clampd {
namespace {

enum class Quantity { None, Time, Position, Velocity, Torque, Enabled };

struct Unit {
  std::string_view name;
  Quantity quantity;
  double scale;             ///< to the model's unit
  std::string_view effort;  ///< of a torque: its unit in the model file
  bool linear = false;      ///< of a length or a force
};

constexpr double kTurn = 2.0 * M_PI;
constexpr std::array<Unit, 43> kUnits{{
    {"s", Quantity::Time, 1.0, ""},
    {"sec", Quantity::Time, 1.0, ""},
    {"ms", Quantity::Time, 1e-3, ""},
    {"us", Quantity::Time, 1e-6, ""},
    {"rad", Quantity::Position, 1.0, ""},
    {"deg", Quantity::Position, kTurn / 360.0, ""},
    {"mrad", Quantity::Position, 1e-3, ""},
    {"rev", Quantity::Position, kTurn, ""},
    {"turn", Quantity::Position, kTurn, ""},
    {"turns", Quantity::Position, kTurn, ""},
    {"m", Quantity::Position, 1.0, "", true},
    {"mm", Quantity::Position, 1e-3, "", true},
    {"um", Quantity::Position, 1e-6, "", true},
    {"count", Quantity::Position, 0.0, ""},
    {"counts", Quantity::Position, 0.0, ""},
    {"inc", Quantity::Position, 0.0, ""},
    {"ticks", Quantity::Position, 0.0, ""},
    {"rad_s", Quantity::Velocity, 1.0, ""},
    {"rads", Quantity::Velocity, 1.0, ""},
    {"deg_s", Quantity::Velocity, kTurn / 360.0, ""},
    {"rpm", Quantity::Velocity, kTurn / 60.0, ""},
    {"rev_s", Quantity::Velocity, kTurn, ""},
    {"m_s", Quantity::Velocity, 1.0, "", true},
    {"mm_s", Quantity::Velocity, 1e-3, "", true},
    {"um_s", Quantity::Velocity, 1e-6, "", true},
    {"m_min", Quantity::Velocity, 1.0 / 60.0, "", true},
    {"mm_min", Quantity::Velocity, 1e-3 / 60.0, "", true},
    {"nm", Quantity::Torque, 1.0, "N m"},
    {"n_m", Quantity::Torque, 1.0, "N m"},
    {"mnm", Quantity::Torque, 1e-3, "N m"},
    {"knm", Quantity::Torque, 1e3, "N m"},
    {"ncm", Quantity::Torque, 1e-2, "N m"},
    {"n", Quantity::Torque, 1.0, "N", true},
    {"kn", Quantity::Torque, 1e3, "N", true},
    {"mn", Quantity::Torque, 1e-3, "N", true},
    {"a", Quantity::Torque, 1.0, "A"},
    {"ma", Quantity::Torque, 1e-3, "A"},
    {"v", Quantity::Torque, 1.0, "V"},
    {"mv", Quantity::Torque, 1e-3, "V"},
    {"pct", Quantity::Torque, 1.0, "%"},
    {"percent", Quantity::Torque, 1.0, "%"},
    {"%", Quantity::Torque, 1.0, "%"},
    {"duty", Quantity::Torque, 1.0, "%"},
}};

struct Word {
  std::string_view name;
  Quantity quantity;
  std::string_view effort = {};  ///< of a torque without a unit
};
constexpr std::array<Word, 37> kWords{{
    {"time", Quantity::Time},           {"t", Quantity::Time},
    {"timestamp", Quantity::Time},      {"zeit", Quantity::Time},
    {"position", Quantity::Position},   {"pos", Quantity::Position},
    {"angle", Quantity::Position},      {"theta", Quantity::Position},
    {"phi", Quantity::Position},        {"q", Quantity::Position},
    {"x", Quantity::Position},          {"encoder", Quantity::Position},
    {"winkel", Quantity::Position},     {"weg", Quantity::Position},
    {"velocity", Quantity::Velocity},   {"vel", Quantity::Velocity},
    {"speed", Quantity::Velocity},      {"omega", Quantity::Velocity},
    {"qd", Quantity::Velocity},         {"dq", Quantity::Velocity},
    {"drehzahl", Quantity::Velocity},   {"geschwindigkeit", Quantity::Velocity},
    {"torque", Quantity::Torque},       {"tau", Quantity::Torque},
    {"moment", Quantity::Torque},       {"drehmoment", Quantity::Torque},
    {"trq", Quantity::Torque},          {"force", Quantity::Torque, "N"},
    {"kraft", Quantity::Torque, "N"},   {"current", Quantity::Torque, "A"},
    {"iq", Quantity::Torque, "A"},      {"strom", Quantity::Torque, "A"},
    {"voltage", Quantity::Torque, "V"}, {"spannung", Quantity::Torque, "V"},
    {"pwm", Quantity::Torque, "%"},     {"enabled", Quantity::Enabled},
    {"enable", Quantity::Enabled},
}};

/// What names a column of another than the drive's own motion and torque.
constexpr std::array<std::string_view, 16> kElsewhere{
    "ref", "reference", "set",     "setpoint",    "soll", "target", "desired", "command",
    "cmd", "error",     "gravity", "temperature", "temp", "load",   "output",  "id"};

/// Lower case, in parts: "Motor Torque [Nm]" is motor, torque, nm.
std::vector<std::string> parts_of(std::string_view name) {
  std::vector<std::string> parts{""};
  for (const char c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '%')
      parts.back() += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    else if (!parts.back().empty())
      parts.emplace_back();
  }
  if (parts.back().empty()) parts.pop_back();
  return parts;
}

struct NamedColumn {
  std::string name;
  Quantity quantity = Quantity::None;
  double scale = 1.0;  ///< 0: not told by the name
  std::string_view effort = {};
  bool linear = false, has_unit = false, elsewhere = false;
};

NamedColumn told_by_name(const std::string& name) {
  NamedColumn column{name};
  std::vector<std::string> parts = parts_of(name);
  // The unit stands at the end, in one part or two: "rad_s".
  for (const std::size_t count : {2, 1}) {
    if (parts.size() < count || column.has_unit) continue;
    const std::string last = count == 2 ? parts[parts.size() - 2] + "_" + parts.back() : parts.back();
    const auto unit = std::ranges::find(kUnits, last, &Unit::name);
    if (unit == kUnits.end()) continue;
    column = {name, unit->quantity, unit->scale, unit->effort, unit->linear, true};
    parts.resize(parts.size() - count);
  }
  for (const std::string& part : parts) {
    if (std::ranges::find(kElsewhere, part) != kElsewhere.end()) column.elsewhere = true;
    const auto word = std::ranges::find(kWords, part, &Word::name);
    if (word == kWords.end() || (column.has_unit && word->quantity != column.quantity)) continue;
    if (column.quantity == Quantity::None) column.quantity = word->quantity;
    if (column.effort.empty() && column.quantity == Quantity::Torque) {
      column.effort = word->effort;
      column.linear = column.linear || word->effort == "N";
    }
  }
  return column;
}

/// The nearer to the torque, the better: a torque, a force, a current, a voltage, a duty cycle.
int rank(const NamedColumn& column) {
  constexpr std::array<std::string_view, 5> kOrder{"N m", "N", "A", "V", "%"};
  const auto place = std::ranges::find(kOrder, column.effort) - kOrder.begin();
  return 10 * static_cast<int>(column.elsewhere) + static_cast<int>(place % std::ssize(kOrder));
}

const NamedColumn* best(const std::vector<NamedColumn>& columns, Quantity quantity) {
  const NamedColumn* found = nullptr;
  for (const NamedColumn& each : columns)
    if (each.quantity == quantity && (found == nullptr || rank(each) < rank(*found))) found = &each;
  return found;
}

std::string in_quotes(const std::string& text) {
  std::ostringstream quoted;
  quoted << toml::toml_formatter{toml::value<std::string>(text), toml::format_flags::none};
  return quoted.str();
}

std::string line_of(std::string_view key, const NamedColumn& column) {
  if (column.scale == 0.0)
    return fmt::format("{} = {{column = {}, scale = 1.0}}  # scale: {} in one count\n", key,
                       in_quotes(column.name), "rad (or m)");
  if (column.scale == 1.0) return fmt::format("{} = {}\n", key, in_quotes(column.name));
  return fmt::format("{} = {{column = {}, scale = {:.9g}}}\n", key, in_quotes(column.name), column.scale);
}

struct Chosen {
  const NamedColumn *time, *torque, *position, *velocity, *enabled;

  bool linear() const {
    for (const NamedColumn* motion : {position, velocity})
      if (motion != nullptr && motion->has_unit && motion->scale != 0.0) return motion->linear;
    return torque->linear;
  }
  bool is_any(const NamedColumn& column) const {
    return &column == time || &column == torque || &column == position || &column == velocity ||
           &column == enabled;
  }
};

std::vector<std::string> doubts(const Chosen& chosen) {
  std::vector<std::string> words;
  for (const auto& [what, column] :
       {std::pair{"time", chosen.time}, std::pair{"torque", chosen.torque},
        std::pair{"position", chosen.position}, std::pair{"velocity", chosen.velocity}}) {
    if (column == nullptr) continue;
    if (column->scale == 0.0)
      words.push_back(
          fmt::format("column \"{}\" counts steps: write into its scale how far one is", column->name));
    else if (!column->has_unit)
      words.push_back(
          fmt::format("the name of column \"{}\", taken for the {}, tells no unit: SI units are assumed",
                      column->name, what));
    if (column->elsewhere)
      words.push_back(fmt::format(
          "column \"{}\" is taken for the {}, since no other is; see whether it is one", column->name, what));
  }
  return words;
}

}  // namespace

Result<ProposedDriveModel> propose_drive_model(const std::string& path) {
  const Result<std::string> text = read_file(path);
  if (!text) return tl::unexpected(text.error());
  const Result<TableHeader> header = find_header(*text, path);
  if (!header) return tl::unexpected(header.error());
  std::vector<NamedColumn> columns;
  for (const std::string& name : header->names) columns.push_back(told_by_name(name));
  const Chosen chosen{best(columns, Quantity::Time), best(columns, Quantity::Torque),
                      best(columns, Quantity::Position), best(columns, Quantity::Velocity),
                      best(columns, Quantity::Enabled)};
  const char* missing = chosen.time == nullptr                                     ? "the time"
                        : chosen.torque == nullptr                                 ? "the torque"
                        : chosen.position == nullptr && chosen.velocity == nullptr ? "the motion"
                                                                                   : nullptr;
  if (missing != nullptr)
    return failure(fmt::format(
        "{}: no column's name tells that it is {}; there are \"{}\". Write the model file by hand "
        "(docs/drives.md), or name columns like time_s, torque_Nm, position_rad",
        path, missing, fmt::join(header->names, "\", \"")));
  ProposedDriveModel proposed;
  const bool linear = chosen.linear();
  std::string_view effort = chosen.torque->effort;
  if (effort.empty()) effort = linear ? "N" : "N m";
  proposed.text = fmt::format(
      "# Told by the names of the columns of {}. See that it is true, then\n"
      "#   clampctl diagnose RUN.csv... --model THIS.toml\n"
      "[drive]\nname = \"drive\"\nkind = \"{}\"\nunit = \"{}\"\n\n[columns]\n",
      in_quotes(path), linear ? "linear" : "rotary", effort);
  for (const auto& [key, column] :
       {std::pair{"time", chosen.time}, std::pair{"torque", chosen.torque},
        std::pair{"position", chosen.position}, std::pair{"velocity", chosen.velocity},
        std::pair{"drive_enabled", chosen.enabled}})
    if (column != nullptr) proposed.text += line_of(key, *column);
  std::string others;
  for (const NamedColumn& each : columns)
    if (!chosen.is_any(each)) others += fmt::format("# {0} = {0}\n", in_quotes(each.name));
  if (!others.empty())
    proposed.text +=
        "\n# What may be a part of the torque, or change friction: take the mark off.\n[regressors]\n" +
        others;
  proposed.text += "\n[data]\n";
  if (header->skip_lines > 0) proposed.text += fmt::format("skip_lines = {}\n", header->skip_lines);
  proposed.text +=
      "torque_held = false  # true: the torque is a command that acts until the next row\n"
      "good_enough = 0.05  # share of the torque's variation that may be left\n";
  proposed.notices = doubts(chosen);
  return proposed;
}

}  // namespace clampd
