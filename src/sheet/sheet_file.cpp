#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/base/table_reader.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/record/file.hpp"
#include "clampd/sheet/sheet.hpp"

namespace clampd {
namespace {

constexpr double kNoLimit = std::numeric_limits<double>::infinity();

const CharacteristicKind* kind_named(std::string_view name) {
  for (const CharacteristicKind& kind : characteristic_kinds())
    if (kind.name == name) return &kind;
  return nullptr;
}

/// "apply-time at force_N 20000, share 0.9, clearance_rad 6": what was written, in the file's own words.
std::string name_of(const Characteristic& line, const toml::table& table) {
  std::string name(line.kind->name);
  bool first = true;
  for (const CircumstanceInfo& info : line.kind->circumstances) {
    if (!table.contains(info.key)) continue;
    name += fmt::format("{}{} {:g}", first ? " at " : ", ", info.key, line.circumstances.*info.member);
    first = false;
  }
  return name;
}

/// Kind and unit, by which everything else is read; nothing after an error.
const CharacteristicKind* read_kind(TableReader& reader, const toml::table& table) {
  std::string name, unit;
  reader.text("kind", name);
  reader.text("unit", unit);
  const CharacteristicKind* kind = kind_named(name);
  if (kind == nullptr) {
    std::vector<std::string_view> known;
    for (const CharacteristicKind& each : characteristic_kinds()) known.push_back(each.name);
    const toml::node* node = table.get("kind");
    reader.refuse(node ? node->source() : table.source(),
                  fmt::format("{}; known are {}",
                              node ? fmt::format("unknown kind {}", name) : "a characteristic needs a kind",
                              fmt::join(known, ", ")));
    return nullptr;
  }
  if (unit == kind->unit) return kind;
  const toml::node* node = table.get("unit");
  reader.refuse(node ? node->source() : table.source(),
                node ? fmt::format("{} is in {}, not in {}: convert its limits and write unit = \"{}\"",
                                   kind->name, kind->unit, unit, kind->unit)
                     : fmt::format("{} needs unit = \"{}\", so that its limits are meant in that", kind->name,
                                   kind->unit));
  return nullptr;
}

void read_limits_of(TableReader& reader, const toml::table& table, Characteristic& line) {
  const auto limit = [&](std::string_view key, double& target) {
    reader.number(key, target, -kNoLimit, kNoLimit);
    if (!std::isfinite(target) || (target >= line.kind->least && target <= line.kind->most)) return;
    reader.refuse(
        table.get(key)->source(),
        fmt::format("{} = {} {} cannot be meant: a {} is between {} and {} {}", key, target, line.kind->unit,
                    line.kind->name, line.kind->least, line.kind->most, line.kind->unit));
  };
  limit("lower", line.lower);
  limit("upper", line.upper);
  if (!(line.lower < line.upper))
    reader.refuse(table.source(),
                  fmt::format("lower {} must be below upper {}: exchange them, or leave one out", line.lower,
                              line.upper));
}

void read_characteristic(const toml::table& table, const std::string& path, std::optional<Error>& error,
                         std::vector<Characteristic>& lines) {
  TableReader reader(table, "characteristic", path, error);
  Characteristic line{
      .name = {}, .kind = nullptr, .circumstances = {}, .lower = -kNoLimit, .upper = kNoLimit};
  reader.text("name", line.name, 80);
  line.kind = read_kind(reader, table);
  if (line.kind == nullptr || error) return;
  for (const CircumstanceInfo& info : line.kind->circumstances) {
    reader.number(info.key, line.circumstances.*info.member, info.lower, info.upper);
    if (info.required && !reader.has(info.key))
      reader.refuse(table.source(), fmt::format("{} needs {}, between {} and {}", line.kind->name, info.key,
                                                info.lower, info.upper));
  }
  read_limits_of(reader, table, line);
  reader.finish();
  if (error) return;
  if (line.name.empty()) line.name = name_of(line, table);
  if (std::any_of(lines.begin(), lines.end(),
                  [&](const Characteristic& other) { return other.name == line.name; }))
    reader.refuse(table.source(), fmt::format("{} is there twice: give one of them another name", line.name));
  lines.push_back(std::move(line));
}

/// The inverse of circumstances_text(). False: these are no circumstances of the line's kind.
bool read_circumstances(std::string_view text, Characteristic& line) {
  for (const CircumstanceInfo& info : line.kind->circumstances) {
    const std::string key = fmt::format("{} ", info.key);
    if (text.substr(0, key.size()) != key) {
      if (info.required) return false;
      continue;  // of a version that did not have it yet
    }
    text.remove_prefix(key.size());
    double& value = line.circumstances.*info.member;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || !(value >= info.lower && value <= info.upper)) return false;
    text.remove_prefix(static_cast<std::size_t>(end - text.data()));
    if (text.substr(0, 2) == ", ") text.remove_prefix(2);
  }
  return text.empty();
}

Result<Characteristic> characteristic_of(const CharacteristicRecord& recorded) {
  const CharacteristicKind* kind = kind_named(recorded.kind);
  if (kind == nullptr || kind->unit != recorded.unit)
    return failure(fmt::format("line {} of the sheet: this version knows no kind {} in {}", recorded.name,
                               recorded.kind, recorded.unit));
  Characteristic line{recorded.name, kind, {}, recorded.lower, recorded.upper};
  if (!read_circumstances(recorded.circumstances, line))
    return failure(fmt::format("line {} of the sheet: its circumstances on record ('{}') are not those of a {}",
                               recorded.name, recorded.circumstances, recorded.kind));
  return line;
}

}  // namespace

bool Characteristic::has_limits() const {
  return std::isfinite(lower) || std::isfinite(upper);
}

std::string circumstances_text(const Characteristic& characteristic) {
  std::string text;
  for (const CircumstanceInfo& info : characteristic.kind->circumstances)
    text += fmt::format("{}{} {}", text.empty() ? "" : ", ", info.key,
                        characteristic.circumstances.*info.member);
  return text;
}

Result<Sheet> parse_sheet(const std::string& text, const std::string& path) {
  const Result<toml::table> parsed = parse_toml(text, path);
  if (!parsed) return tl::unexpected(parsed.error());
  std::optional<Error> error;
  TableReader document(*parsed, "", path, error);
  Sheet sheet;
  sheet.file = path;
  sheet.sha256 = sha256_hex(text);
  sheet.contents = text;
  document.text("revision", sheet.revision);
  document.text("author", sheet.author);
  document.date("changed", sheet.changed);
  if (const toml::array* tables = document.array_of_tables("characteristic"))
    for (const toml::node& node : *tables)
      if (!error) read_characteristic(*node.as_table(), path, error, sheet.characteristics);
  document.finish();
  if (error) return tl::unexpected(*error);
  if (sheet.revision.empty()) return failure(fmt::format("{}: no revision; every record names it", path));
  if (sheet.characteristics.empty())
    return failure(fmt::format("{}: asks for nothing; add a [[characteristic]]", path));
  return sheet;
}

Result<Sheet> read_sheet(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_sheet(text, path); });
}

Result<Sheet> sheet_of(const SheetRecord& record) {
  Sheet sheet;
  sheet.file = record.file;
  sheet.revision = record.revision;
  sheet.sha256 = record.sha256;
  for (const CharacteristicRecord& recorded : record.characteristics) {
    Result<Characteristic> line = characteristic_of(recorded);
    if (!line) return tl::unexpected(line.error());
    sheet.characteristics.push_back(std::move(*line));
  }
  return sheet;
}

}  // namespace clampd
