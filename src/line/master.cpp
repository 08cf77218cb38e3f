#include "clampd/line/master.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>

#include "clampd/record/utc.hpp"
#include "clampd/station/verdict.hpp"

namespace clampd {
namespace {

constexpr std::uint32_t kChecksMax = 50;
constexpr std::size_t kChecksForDrift = 8;  ///< fewer tell too little about the scatter

double hours_since(const std::string& started, std::int64_t now_utc_ns) {
  return static_cast<double>(now_utc_ns - parse_utc(started).value_or(now_utc_ns)) * 1e-9 / 3600.0;
}

std::vector<std::string> drift_of(const std::vector<double>& values) {
  std::vector<std::string> drift;
  if (values.size() < kChecksForDrift) return drift;
  for (const quality::Signal& signal : quality::individuals_chart(values).location.signals)
    if (signal.at + 1 == values.size() && signal.rule <= quality::Rule::SixTrending)
      drift.push_back(fmt::format("{}: {}", quality::name(signal.rule), quality::description(signal.rule)));
  return drift;
}

const ParameterRecord* find(const CheckRecord& check, std::string_view name) {
  const auto found = std::find_if(check.parameters.begin(), check.parameters.end(),
                                  [&](const ParameterRecord& parameter) { return parameter.name == name; });
  return found == check.parameters.end() ? nullptr : &*found;
}

std::string names(const std::vector<MasterParameter>& parameters, bool (*which)(const MasterParameter&)) {
  std::string text;
  for (const MasterParameter& parameter : parameters)
    if (which(parameter)) text += (text.empty() ? "" : ", ") + parameter.name;
  return text;
}

}  // namespace

std::string_view to_string(MasterState state) noexcept {
  switch (state) {
    case MasterState::None:
      return "none";
    case MasterState::Good:
      return "good";
    case MasterState::Due:
      return "due";
    case MasterState::Drifting:
      return "drifting";
    case MasterState::Off:
      return "off";
  }
  return "";
}

bool asks_for_something(const MasterReport& report) noexcept {
  return report.state != MasterState::None && report.state != MasterState::Good;
}

MasterReport master_report(const MasterSettings& settings, const LimitSet& certified,
                           const std::vector<CheckRecord>& newest_first, std::int64_t now_utc_ns) {
  MasterReport report;
  report.serial = settings.serial;
  report.limits_revision = certified.revision;
  if (settings.serial.empty()) return report;
  std::vector<const CheckRecord*> checks;  // the oldest first
  for (auto check = newest_first.rbegin(); check != newest_first.rend(); ++check)
    if (is_about_the_brake(check->verdict) && !check->voided) checks.push_back(&*check);
  if (checks.empty()) {
    report.state = MasterState::Due;
    report.text = fmt::format(
        "master check due: the master brake {} has no valid check yet; run `clampctl run --master`",
        settings.serial);
    return report;
  }
  const CheckRecord& newest = *checks.back();
  report.last_checked = newest.started;
  report.record = newest.id;
  report.age_h = hours_since(newest.started, now_utc_ns);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    MasterParameter& parameter = report.parameters.emplace_back();
    parameter.name = kParameterTable[i].name;
    parameter.unit = kParameterTable[i].unit;
    parameter.lower = certified.intervals[i].lower;
    parameter.upper = certified.intervals[i].upper;
    for (const CheckRecord* check : checks)
      if (const ParameterRecord* found = find(*check, parameter.name)) {
        parameter.values.push_back(found->value);
        parameter.value = found->value;
        parameter.sd = found->sd;
      }
    parameter.verdict =
        judge_parameter(parameter.value, parameter.sd, certified.intervals[i], certified.guard_band_k);
    parameter.drift = drift_of(parameter.values);
  }

  const std::string off =
      names(report.parameters, [](const auto& p) { return p.verdict == ParameterVerdict::Fail; });
  const std::string drifting = names(report.parameters, [](const auto& p) { return !p.drift.empty(); });
  if (!off.empty()) {
    report.state = MasterState::Off;
    report.text = fmt::format(
        "the station does not find the certified values of the master brake {} ({}): do not check brakes; "
        "look at load cell, encoder and fixture, and check the master brake again",
        settings.serial, off);
  } else if (report.age_h > settings.due_h) {
    report.state = MasterState::Due;
    report.text = fmt::format(
        "master check due: the master brake {} was last checked {:.0f} h ago, {:g} h are allowed; run "
        "`clampctl run --master`",
        settings.serial, report.age_h, settings.due_h);
  } else if (!drifting.empty()) {
    report.state = MasterState::Drifting;
    report.text = fmt::format(
        "{} of the master brake {} drifted, though within its tolerance: check it again, and have the "
        "station "
        "looked after if that stays",
        drifting, settings.serial);
  } else {
    report.state = MasterState::Good;
    report.text =
        fmt::format("the station finds the certified values of the master brake {}", settings.serial);
  }
  return report;
}

Result<MasterReport> master_report(const MasterSettings& settings, const CheckStore& store,
                                   std::int64_t now_utc_ns) {
  if (settings.serial.empty()) return MasterReport{};
  const Result<LimitSet> certified = read_limits(settings.limits);
  if (!certified) return tl::unexpected(certified.error());
  CheckFilter filter;
  filter.serial = settings.serial;
  filter.limit = kChecksMax;
  return store.load_results(filter).map([&](const std::vector<CheckRecord>& checks) {
    return master_report(settings, *certified, checks, now_utc_ns);
  });
}

}  // namespace clampd
