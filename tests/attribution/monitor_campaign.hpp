#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace clampd::attribution {

enum class Noise { Normal, StudentFive };

/// A line of which everything is known, day by day.
struct MonitoredLine {
  int stations = 10;
  int days = 1000;
  double checks_a_day = 12.0;  ///< of a usual station on average; stations differ threefold, and so do days
  double batch = 0.5;          ///< standard deviations, that of a brake is 1
  double station = 0.4;
  double time = 0.2;    ///< of days, the same at all stations
  double wander = 0.1;  ///< of a station's days
  int stations_of_a_batch = 4;
  double master_share = 0.05;  ///< of the checks are of the same master brake
  Noise noise = Noise::Normal;
  int changed_at = -1;  ///< station 0 changes from this day on,
  double step = 0.0;    ///< by this many standard deviations of its usual daily reading,
  double drift = 0.0;   ///< and by this many of them each day
};

struct FalseAlarms {
  double station_days = 0.0;
  int alarms = 0;
  double promised = 0.0;
};

/// Alarms of a line without a change, each acknowledged on its day.
FalseAlarms count_false_alarms(const MonitoredLine& line, std::uint64_t seed, double false_alarms_per_year);

/// Day on which a method first names station 0 after its change; -1: not within the days, -2: before the
/// change. The order of kMethods.
inline constexpr std::array<const char*, 3> kMethods{"monitor", "EWMA", "CUSUM"};
struct Delay {
  std::array<double, kMethods.size()>
      mean{};  ///< days; undetected ones count with all the days that there were
  std::array<int, kMethods.size()> found{}, early{};
  int lines = 0;
};
Delay measure_delay(const MonitoredLine& line, std::uint64_t seed, int lines, double average_run_length);

}  // namespace clampd::attribution
