// False alarms of the line's monitor against its promise, and the delay of its alarms beside EWMA and CUSUM.
//
//   monitor_campaign [lines of 10,000 station-days] [lines for each delay] [seed]

#include <cstdlib>

#include <fmt/format.h>

#include "attribution/monitor_campaign.hpp"

int main(int argc, char** argv) {
  using namespace clampd::attribution;
  const int lines = argc > 1 ? std::atoi(argv[1]) : 10;
  const int delays = argc > 2 ? std::atoi(argv[2]) : 40;
  const std::uint64_t seed = argc > 3 ? std::strtoull(argv[3], nullptr, 10) : 1;
  fmt::print("{:<14}{:>14}{:>14}{:>10}{:>12}\n", "brakes", "a day about", "station-days", "alarms",
             "promised");
  for (const Noise noise : {Noise::Normal, Noise::StudentFive})
    for (const double checks : {3.0, 12.0}) {
      FalseAlarms sum;
      for (int i = 0; i < lines; ++i) {
        MonitoredLine line;
        line.noise = noise;
        line.checks_a_day = checks;
        line.wander = i % 2 == 0 ? 0.1 : 0.3;
        const FalseAlarms found = count_false_alarms(line, seed + 1000 + static_cast<std::uint64_t>(i), 10.0);
        sum.alarms += found.alarms;
        sum.promised += found.promised;
        sum.station_days += found.station_days;
      }
      fmt::print("{:<14}{:>14}{:>14}{:>10}{:>12.0f}\n", noise == Noise::Normal ? "normal" : "t, 5 degrees",
                 checks, sum.station_days, sum.alarms, sum.promised);
    }
  fmt::print("\nMean delay in days (found of {}; alarms before the change)\n{:<14}{:<12}", delays, "brakes",
             "change");
  for (const char* method : kMethods) fmt::print("{:>20}", method);
  fmt::print("\n");
  for (const Noise noise : {Noise::Normal, Noise::StudentFive})
    for (const auto& [name, step, drift] :
         {std::tuple("0.25 sd", 0.25, 0.0), std::tuple("0.5 sd", 0.5, 0.0), std::tuple("1 sd", 1.0, 0.0),
          std::tuple("2 sd", 2.0, 0.0), std::tuple("0.02 sd/day", 0.0, 0.02)}) {
      MonitoredLine line;
      line.noise = noise;
      line.days = 420;
      line.step = step;
      line.drift = drift;
      const Delay delay = measure_delay(line, seed + 5000, delays, 10 * 365.25);
      fmt::print("{:<14}{:<12}", noise == Noise::Normal ? "normal" : "t, 5 degrees", name);
      for (std::size_t m = 0; m < kMethods.size(); ++m)
        fmt::print("{:>20}", fmt::format("{:.0f} ({}; {})", delay.mean[m], delay.found[m], delay.early[m]));
      fmt::print("\n");
    }
  return 0;
}
