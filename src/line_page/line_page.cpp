#include "clampd/line_page/line_page.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <string_view>
#include <unordered_set>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/attribution/attribution.hpp"
#include "clampd/base/json.hpp"
#include "clampd/line/capability.hpp"
#include "clampd/record/utc.hpp"
#include "clampd/views/attribution_view.hpp"

namespace clampd::line_page {
namespace {

using nlohmann::ordered_json;
using reanalysis::LastCheck;
using reanalysis::LineRows;
using reanalysis::ListedCheck;
using reanalysis::MeasuredCheck;

constexpr double kDay_s = 86'400.0;
constexpr std::size_t kFewestForAttribution = 10;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

std::string time_text(double seconds) {
  return format_utc(static_cast<std::int64_t>(std::llround(seconds * 1e3)) * 1'000'000);
}

/// The span's periods. A check whose clock is ahead counts in the last one.
class Periods {
 public:
  explicit Periods(const LineRows& rows)
      : since_s_(rows.span.since_s(rows.now_s)),
        length_s_(rows.span.period_s),
        count_(static_cast<std::size_t>(rows.span.periods)) {}

  double since_s() const { return since_s_; }
  std::size_t count() const { return count_; }
  std::size_t of(double started_s) const {
    const double period = std::max(0.0, (started_s - since_s_) / length_s_);
    return std::min(count_ - 1, static_cast<std::size_t>(period));
  }

 private:
  double since_s_;
  double length_s_;
  std::size_t count_;
};

/// PASS, FAIL and whatever says nothing about the brake: ERROR, TIMEOUT, ABORTED.
using Counts = std::array<std::int64_t, 3>;

void count(Verdict verdict, Counts& counts) {
  ++counts[verdict == Verdict::Pass ? 0 : verdict == Verdict::Fail ? 1 : 2];
}

ordered_json counts_json(const Counts& counts) {
  return {{"passed", counts[0]}, {"failed", counts[1]}, {"invalid", counts[2]}};
}

/// So many checks the station would have made since its last one; NaN: it cannot be told.
double missed_checks(const LastCheck& last, const std::vector<ListedCheck>& checks) {
  double own = 0.0, others_before = 0.0, others_since = 0.0;
  for (const ListedCheck& check : checks)
    ++(check.station == last.station ? own : check.started_s > last.started_s ? others_since : others_before);
  return own > 0.0 && others_before > 0.0 ? own / others_before * others_since : kNone;
}

ordered_json station_json(const LastCheck& last, const LineRows& rows, const Periods& periods) {
  Counts span{}, day{};
  std::int64_t simulated = 0;
  std::vector<Counts> by_period(periods.count());
  for (const ListedCheck& check : rows.checks) {
    if (check.station != last.station) continue;
    count(check.verdict, span);
    if (check.started_s > rows.now_s - kDay_s) count(check.verdict, day);
    count(check.verdict, by_period[periods.of(check.started_s)]);
    simulated += check.simulated ? 1 : 0;
  }
  // One that was not at work in the span has no share of the line that could be missed.
  const bool rests = span == Counts{};
  const double missed = missed_checks(last, rows.checks);
  return {{"station", last.station},
          {"last",
           {{"started", time_text(last.started_s)},
            {"age_s", std::max(0.0, std::round(rows.now_s - last.started_s))},
            {"serial", last.serial},
            {"part_number", last.part_number},
            {"verdict", to_string(last.verdict)},
            {"reason", last.reason}}},
          {"span", counts_json(span)},
          {"day", counts_json(day)},
          {"periods", by_period},
          {"simulated", simulated},
          {"missed", number_or_null(missed)},
          {"silent", rests ? !rows.checks.empty() : missed >= kMissedChecks}};
}

ordered_json part_numbers_json(const std::vector<ListedCheck>& checks) {
  std::map<std::string, std::int64_t> counts;
  for (const ListedCheck& check : checks) ++counts[check.part_number];
  ordered_json parts = ordered_json::array();
  for (const auto& [part, number] : counts) parts.push_back({{"part_number", part}, {"checks", number}});
  return parts;
}

using Measured = std::vector<const MeasuredCheck*>;

/// Without simulated brakes where there are others, the first one first.
Measured that_count(const std::vector<MeasuredCheck>& newest_first) {
  const bool real = std::any_of(newest_first.begin(), newest_first.end(),
                                [](const MeasuredCheck& check) { return !check.simulated; });
  Measured counted;
  for (const MeasuredCheck& check : newest_first)
    if (!real || !check.simulated) counted.push_back(&check);
  std::reverse(counted.begin(), counted.end());
  return counted;
}

/// The last check of each brake at this station, the first one first.
Measured brakes_at(const std::string& station, const Measured& checks) {
  std::unordered_set<std::string_view> seen;
  Measured brakes;
  for (auto check = checks.rbegin(); check != checks.rend(); ++check)
    if ((*check)->station == station && seen.insert((*check)->serial).second) brakes.push_back(*check);
  std::reverse(brakes.begin(), brakes.end());
  return brakes;
}

/// Means of the periods. Their standard deviations are of the spread within all periods together, which a
/// period of few checks tells too little of.
ordered_json periods_json(const Measured& brakes, const std::vector<double>& values, const Periods& periods) {
  std::vector<double> sums(periods.count()), means(periods.count(), kNone);
  std::vector<std::size_t> numbers(periods.count());
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::size_t period = periods.of(brakes[i]->started_s);
    sums[period] += values[i];
    ++numbers[period];
  }
  double squares = 0.0, freedom = static_cast<double>(values.size());
  for (std::size_t period = 0; period < periods.count(); ++period) {
    if (numbers[period] == 0) continue;
    means[period] = sums[period] / static_cast<double>(numbers[period]);
    freedom -= 1.0;
  }
  for (std::size_t i = 0; i < values.size(); ++i)
    squares += std::pow(values[i] - means[periods.of(brakes[i]->started_s)], 2);
  ordered_json mean = ordered_json::array(), sd = ordered_json::array();
  for (std::size_t period = 0; period < periods.count(); ++period) {
    const double variance = freedom > 0.0 ? squares / freedom : kNone;
    mean.push_back(number_or_null(means[period]));
    sd.push_back(numbers[period] == 0
                     ? ordered_json()
                     : number_or_null(std::sqrt(variance / static_cast<double>(numbers[period]))));
  }
  return {{"brakes", numbers}, {"mean", std::move(mean)}, {"sd", std::move(sd)}};
}

ordered_json index_json(const quality::CapabilityIndex& index) {
  return {{"value", number_or_null(index.value)},
          {"lower", number_or_null(index.lower)},
          {"upper", number_or_null(index.upper)}};
}

ordered_json parameter_at_station_json(const std::string& station, const Measured& brakes,
                                       std::size_t parameter, const std::pair<double, double>& limits,
                                       const Periods& periods) {
  std::vector<double> values;
  for (const MeasuredCheck* check : brakes) values.push_back(check->readings[parameter].first);
  ordered_json result{{"station", station}, {"brakes", values.size()}};
  if (values.size() >= 2) {
    const quality::Capability found = quality::capability(values, limits.first, limits.second);
    result.update({{"mean", found.mean}, {"sd", found.sd_overall}, {"cpk", index_json(found.cpk)}});
  } else {
    result.update({{"mean", values.empty() ? ordered_json() : ordered_json(values.front())},
                   {"sd", nullptr},
                   {"cpk", index_json({kNone, kNone, kNone})}});
  }
  result["periods"] = periods_json(brakes, values, periods);
  return result;
}

/// Of the seven parameters, each station's brakes beside each other. Stations without any are left out.
ordered_json parameters_json(const LineRows& rows, const Measured& checks, const Periods& periods) {
  ordered_json parameters = ordered_json::array();
  if (checks.empty()) return parameters;
  std::map<std::string, Measured> stations;
  for (const LastCheck& last : rows.stations)
    if (Measured brakes = brakes_at(last.station, checks); !brakes.empty())
      stations.emplace(last.station, std::move(brakes));
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const std::pair<double, double>& limits = checks.back()->limits[i];
    double sum = 0.0, brakes_in_all = 0.0;
    ordered_json at_stations = ordered_json::array();
    for (const auto& [station, brakes] : stations) {
      for (const MeasuredCheck* check : brakes) sum += check->readings[i].first;
      brakes_in_all += static_cast<double>(brakes.size());
      at_stations.push_back(parameter_at_station_json(station, brakes, i, limits, periods));
    }
    parameters.push_back(
        {{"name", kParameterTable[i].name},
         {"unit", kParameterTable[i].unit},
         {"lower", number_or_null(limits.first)},
         {"upper", number_or_null(limits.second)},
         {"limits_changed", std::any_of(checks.begin(), checks.end(),
                                        [&](const auto* check) { return check->limits[i] != limits; })},
         {"mean", number_or_null(sum / brakes_in_all)},
         {"stations", std::move(at_stations)}});
  }
  return parameters;
}

ordered_json claims_json(const LineRows& rows) {
  ordered_json claims = ordered_json::array();
  for (const reanalysis::HeldClaim& claim : rows.claims)
    claims.push_back({{"worker", claim.worker},
                      {"job", claim.job},
                      {"job_name", claim.job_name},
                      {"check", claim.check},
                      {"serial", claim.serial},
                      {"claimed", time_text(claim.claimed_s)},
                      {"age_s", std::max(0.0, std::round(rows.now_s - claim.claimed_s))},
                      {"attempts", claim.attempts},
                      {"alive", claim.alive}});
  return claims;
}

}  // namespace

ordered_json attribution_of(const LineRows& rows) {
  attribution::LineTableBuilder builder;
  for (const ParameterInfo& parameter : kParameterTable)
    builder.add_parameter(std::string(parameter.name), std::string(parameter.unit));
  for (const MeasuredCheck* check : that_count(rows.measured)) {
    attribution::LineCheck row;
    row.serial = check->serial;
    row.batch = check->batch;
    row.station = check->station;
    row.fixture = check->fixture;
    row.started_s = check->started_s;
    row.simulated = check->simulated;
    row.readings = check->readings;
    builder.add(row);
  }
  const Result<attribution::LineTable> table = builder.finish(rows.part_number, kFewestForAttribution);
  if (!table) return nullptr;
  attribution::AttributionOptions options;
  options.threads = 1;  // the worker's other thread has its checks to identify
  return attribution_json(*table, attribution::attribute(*table, options), options.false_alarms);
}

ordered_json document(const LineRows& rows, ordered_json attribution) {
  const Periods periods(rows);
  const Measured checks = that_count(rows.measured);
  ordered_json stations = ordered_json::array();
  for (const LastCheck& last : rows.stations) stations.push_back(station_json(last, rows, periods));
  std::sort(stations.begin(), stations.end(),
            [](const auto& a, const auto& b) { return a["station"] < b["station"]; });
  ordered_json jobs = ordered_json::array();
  for (const reanalysis::JobStatus& job : rows.jobs) jobs.push_back(reanalysis::job_json(job));
  return {{"schema", "clampd.line_page/1"},
          {"archive", rows.where},
          {"made", time_text(rows.now_s)},
          {"days", rows.span.days},
          {"since", time_text(periods.since_s())},
          {"period_s", rows.span.period_s},
          {"periods", periods.count()},
          {"checks", rows.checks.size()},
          // What is older was not read.
          {"read_since",
           rows.more_checks ? ordered_json(time_text(rows.checks.back().started_s)) : ordered_json()},
          {"stations", std::move(stations)},
          {"more_stations", rows.more_stations},
          {"part_numbers", part_numbers_json(rows.checks)},
          {"part_number", rows.part_number},
          {"measured", checks.size()},
          {"measured_since",
           rows.more_measured ? ordered_json(time_text(rows.measured.back().started_s)) : ordered_json()},
          {"simulated_left_out", rows.measured.size() - checks.size()},
          {"parameters", parameters_json(rows, checks, periods)},
          {"attribution", std::move(attribution)},
          {"claims", claims_json(rows)},
          {"jobs", std::move(jobs)}};
}

}  // namespace clampd::line_page
