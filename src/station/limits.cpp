#include "clampd/station/limits.hpp"

#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "clampd/record/checksum.hpp"
#include "clampd/record/file.hpp"
#include "src/station/table_reader.hpp"

namespace clampd {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

LimitInterval times_nominal(const LimitInterval& normalised, double nominal) {
  const double a = normalised.lower * nominal;
  const double b = normalised.upper * nominal;
  return a < b ? LimitInterval{a, b} : LimitInterval{b, a};  // k1 is negative
}

}  // namespace

Result<LimitSet> parse_limits(const std::string& text, const std::string& path) {
  const Result<toml::table> parsed = parse_toml(text, path);
  if (!parsed) return tl::unexpected(parsed.error());
  std::optional<Error> error;
  TableReader document(*parsed, "", path, error);
  LimitSet limits;
  limits.file = path;
  limits.sha256 = sha256_hex(text);
  document.text("revision", limits.revision);
  document.text("author", limits.author);
  document.date("changed", limits.changed);
  document.number("guard_band_k", limits.guard_band_k, 0.0, 10.0);

  std::array<bool, kParameterCount> given{};
  for (const bool normalised : {false, true}) {
    const std::string section = normalised ? "parameters_normalised" : "parameters";
    const toml::table* table = document.table(section);
    if (table == nullptr || error) continue;
    TableReader parameters(*table, section, path, error);
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const toml::table* entry = parameters.table(kParameterTable[i].name);
      if (entry == nullptr || error) continue;
      TableReader reader(*entry, fmt::format("{}.{}", section, kParameterTable[i].name), path, error);
      LimitInterval interval;
      reader.number("lower", interval.lower, -kInfinity, kInfinity);
      reader.number("upper", interval.upper, -kInfinity, kInfinity);
      reader.finish();
      if (!reader.has("lower") || !reader.has("upper"))
        reader.refuse(entry->source(), fmt::format("{} needs both lower and upper", kParameterTable[i].name));
      if (!(interval.lower < interval.upper))
        reader.refuse(entry->source(), fmt::format("{}: lower {} must be below upper {}",
                                                   kParameterTable[i].name, interval.lower, interval.upper));
      if (given[i])
        reader.refuse(entry->source(), fmt::format("{} has limits twice, in [parameters] and in "
                                                   "[parameters_normalised]",
                                                   kParameterTable[i].name));
      given[i] = true;
      limits.intervals[i] = normalised ? times_nominal(interval, kParameterTable[i].nominal) : interval;
    }
    parameters.finish();
  }
  document.finish();
  if (error) return tl::unexpected(*error);
  for (std::size_t i = 0; i < kParameterCount; ++i)
    if (!given[i])
      return failure(
          fmt::format("{}: no limits for {}; add `{} = {{lower = ..., upper = ...}}` to [parameters] or "
                      "[parameters_normalised]",
                      path, kParameterTable[i].name, kParameterTable[i].name));
  if (limits.revision.empty()) return failure(fmt::format("{}: no revision; every record names it", path));
  return limits;
}

Result<LimitSet> read_limits(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_limits(text, path); });
}

}  // namespace clampd
