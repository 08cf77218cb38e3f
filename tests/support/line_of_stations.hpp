#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/record/utc.hpp"
#include "support/shipped_limits.hpp"

namespace clampd::support {

/// A station of a line, and what is the matter with it.
struct LineStation {
  std::string name;
  double checks_per_day = 8.0;
  double silent_days = 0.0;  ///< it has made no check for so long
  Parameter drifts = k1;     ///< from the first day to the last, times nominal:
  double drift = 0.0;
  Parameter steps = k1;  ///< after two thirds of the time, times nominal:
  double step = 0.0;
};

/// Their checks of the last thirty days, the first one first, as the stations publish them, without runs.
/// Brakes come in batches of three days, which all stations share.
inline std::vector<CheckRecord> checks_of_a_line(const std::vector<LineStation>& stations,
                                                 std::uint64_t seed) {
  constexpr double kDays = 30.0;
  constexpr std::array<double, kParameterCount> kSpread{0.05, 0.03, 0.10, 0.12, 0.15, 0.04, 0.15};
  constexpr std::array<double, kParameterCount> kMean{1.0, 1.0, 1.1, 0.9, 1.4, 1.0, 0.9};
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const LimitSet limits = shipped_limits();
  std::vector<double> batches;
  for (int batch = 0; batch < 11; ++batch) batches.push_back(0.3 * normal(random));
  std::vector<CheckRecord> checks;
  const std::int64_t now_ns = utc_now_ns();
  for (const LineStation& station : stations) {
    std::array<double, kParameterCount> level;
    for (std::size_t i = 0; i < kParameterCount; ++i) level[i] = 0.25 * kSpread[i] * normal(random);
    for (double day = uniform(random) / station.checks_per_day; day < kDays - station.silent_days;
         day += (0.5 + uniform(random)) / station.checks_per_day) {
      CheckRecord& check = checks.emplace_back();
      const auto started_ns = now_ns - static_cast<std::int64_t>((kDays - day) * 86'400e9);
      check.started = format_utc(started_ns);
      check.stopped = check.started;
      check.station = station.name;
      check.serial = fmt::format("EMB-{:05}", checks.size());
      check.id = fmt::format("{}-{:08}", check.started, checks.size());
      check.part_number = uniform(random) < 0.1 ? "EMB-45/R" : "EMB-40/F";
      check.batch = fmt::format("B{}", static_cast<int>(day / 3.0));
      check.instruments = "[]";
      check.verdict = Verdict::Pass;
      check.repeats = 20;
      const double luck = uniform(random);
      if (luck < 0.02) check.verdict = Verdict::Error;
      for (std::size_t i = 0; i < kParameterCount && luck >= 0.02; ++i) {
        const double nominal = kParameterTable[i].nominal;
        double value = kMean[i] + level[i] +
                       kSpread[i] * (normal(random) + batches[static_cast<std::size_t>(day / 3.0)]);
        if (i == station.drifts) value += station.drift * day / kDays;
        if (i == station.steps && day > kDays * 2.0 / 3.0) value += station.step;
        ParameterRecord& parameter = check.parameters.emplace_back();
        parameter = {std::string(kParameterTable[i].name),
                     std::string(kParameterTable[i].unit),
                     nominal * value,
                     std::abs(nominal) * kSpread[i] / 20.0,
                     limits.intervals[i].lower,
                     limits.intervals[i].upper,
                     ParameterVerdict::Pass};
        if (parameter.value < parameter.lower || parameter.value > parameter.upper) {
          parameter.verdict = ParameterVerdict::Fail;
          check.verdict = Verdict::Fail;
        }
      }
    }
  }
  return checks;
}

}  // namespace clampd::support
