#include "clampd/station/limits.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/table_reader.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/record/file.hpp"
#include "src/station/configuration_tables.hpp"

namespace clampd {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

LimitInterval times_nominal(const LimitInterval& normalised, double nominal) {
  const double a = normalised.lower * nominal;
  const double b = normalised.upper * nominal;
  return a < b ? LimitInterval{a, b} : LimitInterval{b, a};  // k1 is negative
}

/// Whether somebody seems to have written multiples of the nominal value where SI units are meant: the
/// interval holds 1, and the nominal value is several times smaller or larger than all of it, or negative.
bool looks_normalised(const LimitInterval& interval, double nominal) {
  constexpr double kFar = 3.0;
  return interval.lower > 0.0 && interval.lower <= 1.0 && interval.upper >= 1.0 &&
         (nominal < interval.lower / kFar || nominal > interval.upper * kFar);
}

/// Both ends of one interval; what is wrong with it is refused.
LimitInterval read_interval(const toml::table& entry, const std::string& section, std::string_view name,
                            const std::string& path, std::optional<Error>& error) {
  TableReader reader(entry, fmt::format("{}.{}", section, name), path, error);
  LimitInterval interval;
  reader.number("lower", interval.lower, -kInfinity, kInfinity);
  reader.number("upper", interval.upper, -kInfinity, kInfinity);
  reader.finish();
  if (!reader.has("lower") || !reader.has("upper"))
    reader.refuse(entry.source(), fmt::format("{} needs both lower and upper", name));
  if (!(interval.lower < interval.upper))
    reader.refuse(entry.source(),
                  fmt::format("{}: lower {} must be below upper {}", name, interval.lower, interval.upper));
  return interval;
}

void read_effects(TableReader& document, const std::string& path, std::optional<Error>& error,
                  std::vector<EffectLimit>& limits) {
  const toml::table* tables = document.table("effects");
  if (tables == nullptr || error) return;
  TableReader of_effects(*tables, "effects", path, error);
  for (const Effect* effect : effects()) {
    const EffectInfo& info = info_of(*effect);
    const toml::table* table = of_effects.table(info.name);
    if (table == nullptr || error) continue;
    const std::string section = fmt::format("effects.{}", info.name);
    TableReader parameters(*table, section, path, error);
    for (const EffectParameter& parameter : info.parameters) {
      if (!is_estimated(parameter)) {
        if (parameters.has(parameter.name))
          parameters.refuse(table->get(parameter.name)->source(),
                            fmt::format("{} of {} is chosen, not estimated: it cannot have limits",
                                        parameter.name, info.name));
        continue;
      }
      const toml::table* entry = parameters.table(parameter.name);
      if (entry == nullptr || error) continue;
      limits.push_back({std::string(info.name), std::string(parameter.name),
                        read_interval(*entry, section, parameter.name, path, error)});
    }
    parameters.finish();
  }
  of_effects.finish();
}

/// All that a limits file has, from the document (no `section`) or from a table in another file.
/// `text`: the same as a limits file, which records keep.
Result<LimitSet> limits_in(const toml::table& table, const std::string& section, const std::string& text,
                           const std::string& path) {
  const std::string within = section.empty() ? "" : section + ".";
  std::optional<Error> error;
  TableReader document(table, section, path, error);
  LimitSet limits;
  limits.file = path;
  limits.sha256 = sha256_hex(text);
  limits.contents = text;
  document.text("revision", limits.revision);
  document.text("author", limits.author);
  document.date("changed", limits.changed);
  document.number("guard_band_k", limits.guard_band_k, 0.0, 10.0);

  std::array<bool, kParameterCount> given{};
  for (const bool normalised : {false, true}) {
    const std::string key = normalised ? "parameters_normalised" : "parameters";
    const toml::table* in_unit = document.table(key);
    if (in_unit == nullptr || error) continue;
    const std::string of_parameters = within + key;
    TableReader parameters(*in_unit, of_parameters, path, error);
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const toml::table* entry = parameters.table(kParameterTable[i].name);
      if (entry == nullptr || error) continue;
      const LimitInterval interval = read_interval(*entry, of_parameters, kParameterTable[i].name, path, error);
      if (given[i])
        parameters.refuse(entry->source(), fmt::format("{} has limits twice, in [parameters] and in "
                                                       "[parameters_normalised]",
                                                       kParameterTable[i].name));
      given[i] = true;
      if (!normalised && looks_normalised(interval, kParameterTable[i].nominal))
        parameters.refuse(
            entry->source(),
            fmt::format(
                "{0}: {1} to {2} {3} cannot be meant, the nominal value is {4} {3}; multiples of the nominal "
                "value belong into [parameters_normalised]",
                kParameterTable[i].name, interval.lower, interval.upper, kParameterTable[i].unit,
                kParameterTable[i].nominal));
      limits.intervals[i] = normalised ? times_nominal(interval, kParameterTable[i].nominal) : interval;
    }
    parameters.finish();
  }
  read_effects(document, path, error, limits.effects);
  document.finish();
  if (error) return tl::unexpected(*error);
  const std::string where =
      section.empty() ? path : fmt::format("{}:{}: [{}]", path, table.source().begin.line, section);
  for (std::size_t i = 0; i < kParameterCount; ++i)
    if (!given[i])
      return failure(
          fmt::format("{}: no limits for {}; add `{} = {{lower = ..., upper = ...}}` to [{}parameters] or "
                      "[{}parameters_normalised]",
                      where, kParameterTable[i].name, kParameterTable[i].name, within, within));
  if (limits.revision.empty()) return failure(fmt::format("{}: no revision; every record names it", where));
  return limits;
}

}  // namespace

Result<LimitSet> parse_limits(const std::string& text, const std::string& path) {
  return parse_toml(text, path).and_then(
      [&](const toml::table& document) { return limits_in(document, "", text, path); });
}

Result<LimitSet> inline_limits(const toml::table& table, const std::string& path) {
  std::ostringstream text;
  text << toml::toml_formatter{table} << '\n';
  return limits_in(table, "limits", text.str(), path);
}

Result<void> check_limits(const LimitSet& limits, const ExtendedParameters& model) {
  for (const EffectLimit& limit : limits.effects) {
    const auto count = std::count_if(
        model.effects.begin(), model.effects.end(),
        [&](const EffectValues& values) { return info_of(*values.effect).name == limit.effect; });
    if (count == 0)
      return failure(
          fmt::format("{}: [effects.{}] has limits, but a check does not estimate this effect: name a model "
                      "with it in [check] model, or remove the limits",
                      limits.file, limit.effect));
    if (count > 1)
      return failure(
          fmt::format("{}: [effects.{}] has limits, but the model of [check] has this effect {} "
                      "times: it cannot be told which one is meant",
                      limits.file, limit.effect, count));
  }
  return {};
}

Result<LimitSet> read_limits(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_limits(text, path); });
}

}  // namespace clampd
