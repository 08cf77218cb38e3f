#include "clampd/line/line_statistics.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <unordered_map>
#include <utility>

namespace clampd {
namespace {

void take(std::vector<ParameterStatistics>& parameters, const ParameterRecord& parameter) {
  if (!std::isfinite(parameter.value)) return;
  auto found = std::find_if(parameters.begin(), parameters.end(),
                            [&](const auto& known) { return known.name == parameter.name; });
  if (found == parameters.end())
    found = parameters.insert(
        found, {parameter.name, parameter.unit, parameter.lower, parameter.upper, false, {}, {}, {}});
  found->limits_changed =
      found->limits_changed || found->lower != parameter.lower || found->upper != parameter.upper;
  found->lower = parameter.lower;
  found->upper = parameter.upper;
  found->values.push_back(parameter.value);
}

bool is_of_a_real_brake(const CheckRecord& check) {
  return !check.simulated && is_about_the_brake(check.verdict);
}

void count(const CheckRecord& check, LineStatistics& statistics) {
  statistics.passed += check.verdict == Verdict::Pass ? 1 : 0;
  statistics.failed += check.verdict == Verdict::Fail ? 1 : 0;
  statistics.marked +=
      is_about_the_brake(check.verdict) && check.systematic && check.systematic->marked ? 1 : 0;
  statistics.invalid += is_about_the_brake(check.verdict) ? 0 : 1;
}

bool same_limits(const CheckRecord& a, const CheckRecord& b) {
  return std::equal(a.parameters.begin(), a.parameters.end(), b.parameters.begin(), b.parameters.end(),
                    [](const ParameterRecord& x, const ParameterRecord& y) {
                      return x.name == y.name && x.lower == y.lower && x.upper == y.upper;
                    });
}

/// Capability and charts of checks of one part, the first one first.
void take_parameters(const std::vector<CheckRecord>& checks, LineStatistics& statistics) {
  std::unordered_map<std::string, const CheckRecord*> counted;  // of each brake its last valid check
  const CheckRecord* newest = nullptr;
  for (const CheckRecord& check : checks)
    if (is_about_the_brake(check.verdict)) counted[check.serial] = newest = &check;
  for (const CheckRecord& check : checks) {
    if (const auto last = counted.find(check.serial); last == counted.end() || last->second != &check)
      continue;
    if (newest->recipe && !same_limits(check, *newest)) {
      ++statistics.other_limits;
      continue;
    }
    statistics.serials.push_back(check.serial);
    for (const ParameterRecord& parameter : check.parameters) take(statistics.parameters, parameter);
  }
  std::erase_if(statistics.parameters, [](const auto& parameter) { return parameter.values.size() < 2; });
  for (ParameterStatistics& parameter : statistics.parameters) {
    parameter.capability = quality::capability(parameter.values, parameter.lower, parameter.upper);
    parameter.charts = quality::individuals_chart(parameter.values);
  }
}

/// In alphabetical order.
std::vector<std::string> part_numbers(const std::vector<CheckRecord>& checks) {
  std::set<std::string> parts;
  for (const CheckRecord& check : checks) parts.insert(check.part_number);
  return {parts.begin(), parts.end()};
}

LineStatistics of_part(const std::vector<CheckRecord>& checks, std::string part_number) {
  LineStatistics statistics;
  std::vector<CheckRecord> of_it;
  for (const CheckRecord& check : checks)
    if (check.part_number == part_number) of_it.push_back(check);
  statistics.part_number = std::move(part_number);
  statistics.checks = of_it.size();
  statistics.first = of_it.front().started;
  statistics.last = of_it.back().started;
  for (const CheckRecord& check : of_it) {
    count(check, statistics);
    statistics.simulated += check.simulated ? 1 : 0;
  }
  take_parameters(of_it, statistics);
  return statistics;
}

}  // namespace

LineStatistics line_statistics(std::vector<CheckRecord> newest_first, const std::string& master_serial) {
  std::vector<CheckRecord> checks = std::move(newest_first);
  std::erase_if(checks, [&](const CheckRecord& check) {
    return !master_serial.empty() && check.serial == master_serial;
  });
  LineStatistics statistics;
  statistics.voided =
      std::erase_if(checks, [](const CheckRecord& check) { return check.voided.has_value(); });
  statistics.simulated = static_cast<std::size_t>(
      std::count_if(checks.begin(), checks.end(), [](const auto& check) { return check.simulated; }));
  if (statistics.simulated > 0 && std::any_of(checks.begin(), checks.end(), is_of_a_real_brake)) {
    statistics.simulated_left_out = true;
    std::erase_if(checks, [](const CheckRecord& check) { return check.simulated; });
  }
  std::reverse(checks.begin(), checks.end());
  statistics.checks = checks.size();
  if (checks.empty()) return statistics;
  statistics.first = checks.front().started;
  statistics.last = checks.back().started;
  for (const CheckRecord& check : checks) count(check, statistics);
  if (std::vector<std::string> parts = part_numbers(checks); parts.size() > 1) {
    for (std::string& part : parts) statistics.parts.push_back(of_part(checks, std::move(part)));
    return statistics;
  }
  statistics.part_number = checks.front().part_number;
  take_parameters(checks, statistics);
  return statistics;
}

}  // namespace clampd
