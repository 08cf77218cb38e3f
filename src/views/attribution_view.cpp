#include "clampd/views/attribution_view.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include "clampd/base/json.hpp"

namespace clampd {
namespace {

using attribution::Components;
using attribution::Deviations;
using attribution::Finding;
using attribution::LineAttribution;
using attribution::LineTable;
using attribution::ParameterAttribution;
using nlohmann::ordered_json;

struct NamedDeviation {
  const char* key;
  const char* name;
  double Deviations::*deviation;
  bool Components::*there;  ///< nothing: always
};

constexpr std::array<NamedDeviation, 7> kDeviations{{
    {"brakes", "brakes", &Deviations::brake, nullptr},
    {"batches", "batches", &Deviations::batch, &Components::batch},
    {"stations", "stations", &Deviations::station, &Components::station},
    {"fixtures", "fixtures", &Deviations::fixture, &Components::fixture},
    {"time", "time", &Deviations::period, &Components::period},
    {"station_time", "station x time", &Deviations::wander, &Components::wander},
    {"repeats", "repeats", &Deviations::repeat, &Components::repeat},
}};

bool is_there(const NamedDeviation& named, const Components& components) {
  return named.there == nullptr || components.*named.there;
}

std::string time_text(double seconds) {
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(static_cast<std::time_t>(seconds)));
}

struct KindWords {
  const char* key;
  bool of_station;
};

KindWords words(Finding::Kind kind) {
  switch (kind) {
    case Finding::Kind::StationStep:
      return {"station-step", true};
    case Finding::Kind::StationDrift:
      return {"station-drift", true};
    case Finding::Kind::StationApart:
      return {"station-apart", true};
    case Finding::Kind::BatchApart:
      return {"batch-apart", false};
  }
  return {"", true};
}

const std::string& name_of(const Finding& finding, const LineTable& table) {
  const auto number = static_cast<std::size_t>(finding.number);
  return words(finding.kind).of_station ? table.stations[number] : table.batches[number];
}

std::string sentence(const Finding& finding, const ParameterAttribution& parameter, const LineTable& table) {
  const std::string size = fmt::format("{:+.3g} ± {:.2g} {} ({:+.1f} %)", finding.size, 1.96 * finding.sd,
                                       parameter.unit, 100.0 * finding.size / std::abs(parameter.mean));
  const std::string& name = name_of(finding, table);
  switch (finding.kind) {
    case Finding::Kind::StationStep:
      return fmt::format("station {}: {} changed by {} about {}", name, parameter.name, size,
                         time_text(table.begin_of_period_s(finding.period)));
    case Finding::Kind::StationDrift:
      return fmt::format("station {}: {} drifts, by {} from {} to {}", name, parameter.name, size,
                         time_text(table.first_s), time_text(table.last_s));
    case Finding::Kind::StationApart:
      return fmt::format("station {}: {} differs by {} from what the spread of the stations allows", name,
                         parameter.name, size);
    case Finding::Kind::BatchApart:
      return fmt::format("batch {}: {} differs by {}, more than batches do", name, parameter.name, size);
  }
  return {};
}

std::vector<std::string> unknown_stations(const LineTable& table, const LineAttribution& found) {
  std::vector<std::string> names;
  for (std::size_t s = 0; s < found.separable.size(); ++s)
    if (!found.separable[s]) names.push_back(table.stations[s]);
  return names;
}

int brakes_needed(const LineAttribution& found) {
  int most = 0;
  for (const ParameterAttribution& parameter : found.parameters)
    most = std::max(most, parameter.brakes_needed);
  return most;
}

/// Empty where the data tell all stations apart.
std::string what_cannot_be_told(const LineTable& table, const LineAttribution& found) {
  const std::vector<std::string> unknown = unknown_stations(table, found);
  if (unknown.empty()) return {};
  return fmt::format(
      "The data do not tell {} apart from the brakes and batches that {} checked: {}. Check about {} brakes "
      "there and at another station as well.",
      unknown.size() == 1 ? "one station" : fmt::format("{} stations", unknown.size()),
      unknown.size() == 1 ? "it" : "they", fmt::join(unknown, ", "), std::max(2, brakes_needed(found)));
}

std::string format_spread(const LineAttribution& found) {
  std::string text = fmt::format("{:<10}{:>12}", "parameter", "mean");
  for (const NamedDeviation& named : kDeviations) text += fmt::format("{:>16}", named.name);
  text += fmt::format("{:>16}\n", "identification");
  for (const ParameterAttribution& parameter : found.parameters) {
    text += fmt::format("{:<10}{:>12.5g}", parameter.name, parameter.mean);
    for (const NamedDeviation& named : kDeviations)
      text += is_there(named, parameter.components)
                  ? fmt::format("{:>16.3g}", parameter.deviations.*named.deviation)
                  : fmt::format("{:>16}", "-");
    text += fmt::format("{:>16.3g}  {}{}\n", parameter.identification, parameter.unit,
                        parameter.converged ? "" : "  (no convergence: do not rely on it)");
  }
  return text;
}

}  // namespace

std::string format_attribution(const LineTable& table, const LineAttribution& found, double false_alarms) {
  std::string text = fmt::format("{} checks of {} brakes from {} batches at {} stations, {} to {}\n",
                                 table.checks(), table.layout.brakes, table.layout.batches,
                                 table.layout.stations, time_text(table.first_s), time_text(table.last_s));
  text += fmt::format("{} rows read", table.rows);
  for (const auto& [count, what] :
       {std::pair(table.invalid, "neither PASS nor FAIL"), std::pair(table.voided, "void"),
        std::pair(table.simulated, "simulated"), std::pair(table.incomplete, "incomplete"),
        std::pair(table.doubled, "there twice")})
    if (count > 0) text += fmt::format(", {} {}", count, what);
  text += "\n\n";
  bool any = false;
  for (const ParameterAttribution& parameter : found.parameters)
    for (const Finding& finding : parameter.findings) {
      text += sentence(finding, parameter, table) + "\n";
      any = true;
    }
  text +=
      any ? fmt::format("(On a line without any of this, something is found with a probability of {:g} %.)\n",
                        100.0 * false_alarms)
          : "No station and no batch differs or changes by more than the others do.\n";
  text += "\nStandard deviations by cause:\n" + format_spread(found);
  if (!found.parameters.empty() && !found.parameters.front().components.repeat)
    text += "No brakes were checked twice: what repeats differ by is a part of the brakes' figure.\n";
  if (const std::string unknown = what_cannot_be_told(table, found); !unknown.empty())
    text += "\n" + unknown + "\n";
  return text;
}

ordered_json attribution_json(const LineTable& table, const LineAttribution& found, double false_alarms) {
  ordered_json result{{"schema", "clampd.line/1"},
                      {"checks", table.checks()},
                      {"brakes", table.layout.brakes},
                      {"batches", table.layout.batches},
                      {"stations", table.stations},
                      {"first", time_text(table.first_s)},
                      {"last", time_text(table.last_s)},
                      {"rows",
                       {{"read", table.rows},
                        {"invalid", table.invalid},
                        {"void", table.voided},
                        {"simulated", table.simulated},
                        {"incomplete", table.incomplete},
                        {"doubled", table.doubled}}},
                      {"false_alarms", false_alarms},
                      {"parameters", ordered_json::array()},
                      {"unknown_stations", unknown_stations(table, found)},
                      {"brakes_needed", brakes_needed(found)},
                      {"cannot_tell", what_cannot_be_told(table, found)}};
  for (const ParameterAttribution& parameter : found.parameters) {
    ordered_json deviations = ordered_json::object();
    for (const NamedDeviation& named : kDeviations)
      deviations[named.key] = is_there(named, parameter.components)
                                  ? ordered_json(parameter.deviations.*named.deviation)
                                  : ordered_json();
    deviations["identification"] = parameter.identification;
    ordered_json stations = ordered_json::array();
    for (std::size_t s = 0; s < parameter.stations.size(); ++s)
      stations.push_back({{"station", table.stations[s]},
                          {"level", parameter.stations[s].level},
                          {"sd", parameter.stations[s].sd},
                          {"reliability", parameter.stations[s].reliability}});
    ordered_json findings = ordered_json::array();
    for (const Finding& finding : parameter.findings) {
      ordered_json entry{{"kind", words(finding.kind).key},
                         {words(finding.kind).of_station ? "station" : "batch", name_of(finding, table)},
                         {"size", finding.size},
                         {"sd", finding.sd},
                         {"p", finding.p},
                         {"words", sentence(finding, parameter, table)}};
      if (finding.kind == Finding::Kind::StationStep)
        entry["about"] = time_text(table.begin_of_period_s(finding.period));
      findings.push_back(std::move(entry));
    }
    result["parameters"].push_back({{"name", parameter.name},
                                    {"unit", parameter.unit},
                                    {"mean", parameter.mean},
                                    {"converged", parameter.converged},
                                    {"sd", std::move(deviations)},
                                    {"stations", std::move(stations)},
                                    {"findings", std::move(findings)}});
  }
  return result;
}

}  // namespace clampd
