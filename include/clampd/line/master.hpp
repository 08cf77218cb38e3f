#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/archive/store.hpp"
#include "clampd/line/control_chart.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"

namespace clampd {

/// What the master brake says about the station.
enum class MasterState : std::uint8_t {
  None,      ///< no master brake is configured
  Good,      ///< checked in time, all parameters certified
  Due,       ///< its last good check is too old, or there is none
  Drifting,  ///< within its tolerance, but moving
  Off,       ///< a parameter is outside of its certified tolerance: no result can be trusted
};
std::string_view to_string(MasterState state) noexcept;  ///< "none", "good", "due", "drifting", "off"

/// One certified parameter over the checks of the master brake.
struct MasterParameter {
  std::string name;
  std::string unit;
  double value = 0.0;  ///< of the newest check
  double sd = 0.0;
  double lower = 0.0;  ///< certified
  double upper = 0.0;
  ParameterVerdict verdict = ParameterVerdict::Fail;
  std::vector<double> values;           ///< of all checks, the oldest first
  std::vector<std::string> drift = {};  ///< what the newest point breaks of the control chart's rules
};

struct MasterReport {
  MasterState state = MasterState::None;
  std::string serial;
  std::string text;          ///< one sentence for the technician
  std::string last_checked;  ///< start of the newest valid check, RFC 3339; empty if there is none
  std::string record;        ///< its id
  double age_h = 0.0;        ///< of that check
  std::string limits_revision;
  std::vector<MasterParameter> parameters;  ///< empty without a valid check
};

/// Whether somebody has to do something before brakes are checked.
bool asks_for_something(const MasterReport& report) noexcept;

/// Judges the newest valid checks (PASS or FAIL, at most 50) of the master brake against its certified
/// limits, by their guard band, and against each other: Nelson's rules 1 to 3 on an individuals chart, from
/// the eighth check on.
MasterReport master_report(const MasterSettings& settings, const LimitSet& certified,
                           const std::vector<CheckRecord>& newest_first, std::int64_t now_utc_ns);

/// The same from files and the archive. Errors: the certified limits cannot be read, or the archive.
Result<MasterReport> master_report(const MasterSettings& settings, const CheckStore& store,
                                   std::int64_t now_utc_ns);

}  // namespace clampd
