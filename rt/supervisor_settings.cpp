#include "rt/supervisor.hpp"

#include <cmath>
#include <string>

namespace clampd::rt {

Result<void> ReadingTolerances::validate() const {
  const struct {
    const char* name;
    double value;
  } tolerances[] = {{"torque_Nm", torque_Nm},
                    {"velocity_rad_s", velocity_rad_s},
                    {"position_rad", position_rad},
                    {"force_N", force_N}};
  for (const auto& tolerance : tolerances)
    if (!std::isfinite(tolerance.value) || tolerance.value <= 0.0)
      return failure(std::string("supervisor settings: the tolerance of readings ") + tolerance.name +
                     " must be positive; correct it in the station's configuration");
  return {};
}

Result<void> SupervisorSettings::validate() const {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  const struct {
    const char* name;
    bool valid;
  } checks[] = {
      {"drive.period_s", positive(drive.period_s)},
      {"startup_timeout_ns", startup_timeout_ns > 0},
      {"good_samples_to_idle", good_samples_to_idle > 0 && good_samples_to_idle <= GoodRow::kMax},
      {"good_samples_to_run", good_samples_to_run > 0 && good_samples_to_run <= GoodRow::kMax},
      {"armed_timeout_ns", armed_timeout_ns > 0},
      {"stale_ns (more than one period)", static_cast<double>(stale_ns) > 1e9 * drive.period_s},
      {"event_window_ns", event_window_ns > 0},
      {"clock_tolerance_ns", clock_tolerance_ns > 0},
      {"force_limit_N", positive(force_limit_N)},
      {"force_ceiling_N (not below force_limit_N)",
       positive(force_ceiling_N) && force_ceiling_N >= force_limit_N},
      {"speed_limit_rad_s", positive(speed_limit_rad_s)},
      {"torque_limit_Nm", positive(torque_limit_Nm)},
      {"travel_limit_rad", positive(travel_limit_rad)},
      {"opening_velocity_rad_s", positive(opening_velocity_rad_s)},
      {"plausible_force_N (more than force_limit_N)",
       positive(plausible_force_N) && plausible_force_N > force_limit_N},
      {"plausible_velocity_rad_s (more than speed_limit_rad_s)",
       positive(plausible_velocity_rad_s) && plausible_velocity_rad_s > speed_limit_rad_s},
      {"plausible_torque_Nm (more than torque_limit_Nm)",
       positive(plausible_torque_Nm) && plausible_torque_Nm > torque_limit_Nm},
      {"plausible_jump_rad", positive(plausible_jump_rad)},
      {"clear_quiet_ns (more than stale_ns)", clear_quiet_ns > stale_ns},
  };
  for (const auto& check : checks) {
    if (!check.valid) {
      return failure(std::string("supervisor settings: ") + check.name +
                     " must be positive and consistent; correct it in the station's configuration");
    }
  }
  return readings.validate();
}

}  // namespace clampd::rt
