#include "tools/factory/plan.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <random>

#include <fmt/format.h>

#include "clampd/record/utc.hpp"

namespace clampd::factory {
namespace {

constexpr const char* kMaster = "MASTER-1";
constexpr std::int64_t kFirstDay_ns = 1'767'571'200'000'000'000;  // 2026-01-05, a Monday
constexpr double kDay_ns = 86'400e9;
constexpr double kOpens_ns = 6.0 * 3'600e9;
constexpr double kOpen_ns = 16.0 * 3'600e9;

/// Times nominal: between the nominal brake and the one that the paper measured (its Table II), with spreads
/// that keep nearly all good brakes within the limits that ship.
constexpr std::array<double, kParameterCount> kCentre{0.9, 0.95, 1.33, 0.965, 1.6, 1.025, 0.715};
constexpr std::array<double, kParameterCount> kOfBrakes{0.05, 0.025, 0.12, 0.02, 0.2, 0.0125, 0.08};
constexpr double kOfBatches = 0.4;  ///< times those of the brakes
/// Of stations that have nothing to hide.
constexpr double kForceGains = 0.001, kTorqueGains = 0.0003;

class Draws {
 public:
  /// Each purpose has numbers of its own, so that what one draws changes nothing in another.
  Draws(std::uint64_t seed, std::uint32_t purpose) {
    std::seed_seq all{static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32U), purpose};
    random_.seed(all);
  }
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  double either_sign(double low, double high) { return (chance(0.5) ? 1.0 : -1.0) * uniform(low, high); }
  bool chance(double probability) { return uniform(0.0, 1.0) < probability; }
  int below(int count) { return std::uniform_int_distribution<int>(0, count - 1)(random_); }
  /// Within three standard deviations.
  double normal(double deviation) {
    return deviation * std::clamp(std::normal_distribution<double>()(random_), -3.0, 3.0);
  }
  std::uint64_t seed() { return random_(); }

 private:
  std::mt19937_64 random_;
};

int batches_of(const Settings& settings) {
  return std::clamp(settings.checks / 20, 4, 120);
}

std::string batch_name(int number) {
  return fmt::format("B-{:03}", number + 1);
}

std::int64_t instant(const Settings& settings, double share) {
  const double days = share * settings.days;
  const double day = std::floor(days);
  return kFirstDay_ns + static_cast<std::int64_t>(day * kDay_ns + kOpens_ns + (days - day) * kOpen_ns);
}

/// Another number below `count` than `number`, if there is one.
int another(Draws& draws, int number, int count) {
  return count < 2 ? number : (number + 1 + draws.below(count - 1)) % count;
}

struct Brake {
  std::string serial;
  int batch = -1;  ///< -1: none, as the master brake
  sim::PlantConfiguration plant;
};

/// How a station reads.
struct Readings {
  double force_gain = 0.0;
  double torque_gain = 0.0;
};

void add_of_batch(const std::vector<Hidden>& hidden, Brake& brake) {
  for (const Hidden& one : hidden) {
    if (one.course != Course::Whole || one.number != brake.batch) continue;
    ParameterVector& theta = brake.plant.brake.theta;
    if (one.cause == Cause::Stiffness) theta[k1] *= 1.0 + one.size, theta[k2] *= 1.0 + one.size;
    if (one.cause == Cause::CoulombFriction) theta[TC] *= 1.0 + one.size;
    if (one.cause == Cause::Backlash) brake.plant.effects.backlash_rad = one.size;
  }
}

/// The brake behind this station's instruments, at this share of the time.
void add_of_station(const std::vector<Hidden>& hidden, int station, double share, Readings readings,
                    sim::PlantConfiguration& plant) {
  for (const Hidden& one : hidden) {
    if (one.course == Course::Whole || one.number != station) continue;
    if (one.course == Course::Step && share < one.from) continue;
    const double size = one.course == Course::Drift ? share * one.size : one.size;
    if (one.cause == Cause::ForceGain) readings.force_gain += size;
    if (one.cause == Cause::TorqueGain) readings.torque_gain += size;
    if (one.cause == Cause::ForceLag) plant.effects.force_lag_s = size;
  }
  plant.effects.torque_gain = readings.torque_gain;
  plant.spoiled.push_back({sim::Reading::Force, sim::Spoil::Scaled, 1.0 + readings.force_gain, 0.0});
}

/// Brakes as they come off the line, the batches one after another, two at a time.
class Line {
 public:
  Line(const Settings& settings, const std::vector<Hidden>& hidden, const sim::PlantConfiguration& shipped)
      : hidden_(hidden), shipped_(shipped), draws_(settings.seed, 2) {
    for (int batch = 0; batch < batches_of(settings); ++batch)
      for (const double deviation : kOfBrakes) of_batches_.push_back(draws_.normal(kOfBatches * deviation));
    master_ = make(kMaster, -1);
  }

  const Brake& master() const { return master_; }
  Brake next(double share) {
    const int batches = static_cast<int>(of_batches_.size() / kParameterCount);
    const double at = share * batches + draws_.uniform(-0.75, 0.75);
    const int batch = std::clamp(static_cast<int>(std::floor(at)), 0, batches - 1);
    return make(fmt::format("EMB-{:06}", ++made_), batch);
  }

 private:
  Brake make(std::string serial, int batch) {
    Brake brake{std::move(serial), batch, shipped_};
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      double factor = kCentre[i];
      if (batch >= 0)
        factor +=
            draws_.normal(kOfBrakes[i]) + of_batches_[static_cast<std::size_t>(batch) * kParameterCount + i];
      brake.plant.brake.theta[static_cast<Eigen::Index>(i)] = kParameterTable[i].nominal * factor;
    }
    add_of_batch(hidden_, brake);
    return brake;
  }

  const std::vector<Hidden>& hidden_;
  const sim::PlantConfiguration& shipped_;
  Draws draws_;
  std::vector<double> of_batches_;  ///< each batch's parameters, times nominal
  Brake master_;
  int made_ = 0;
};

}  // namespace

std::string station_name(int number) {
  return fmt::format("station-{}", number + 1);
}

std::vector<Hidden> hide(const Settings& settings) {
  Draws draws(settings.seed, 1);
  const int station = draws.below(settings.stations);
  const int batch = draws.below(batches_of(settings));
  const bool force = draws.chance(0.5);
  const Course course = draws.chance(0.5) ? Course::Step : Course::Drift;
  Hidden reading{force ? Cause::ForceGain : Cause::TorqueGain, course, station};
  reading.from = course == Course::Step ? draws.uniform(0.3, 0.7) : 0.0;
  reading.size = force ? draws.either_sign(0.012, 0.025) : draws.either_sign(0.002, 0.004);
  Hidden material{Cause::Stiffness, Course::Whole, batch};
  material.size = draws.either_sign(0.06, 0.1);
  if (draws.chance(0.5)) {
    material.cause = Cause::CoulombFriction;
    material.size = draws.uniform(0.3, 0.5);
  }
  Hidden effect{Cause::ForceLag, Course::Step, another(draws, station, settings.stations)};
  effect.from = draws.uniform(0.3, 0.7);
  effect.size = draws.uniform(0.0003, 0.001);
  if (draws.chance(0.5)) {
    effect = {Cause::Backlash, Course::Whole, another(draws, batch, batches_of(settings))};
    effect.size = draws.uniform(0.08, 0.25);
  }
  return {reading, material, effect};
}

std::string describe(const Hidden& hidden, const Settings& settings) {
  const double percent = 100.0 * std::abs(hidden.size);
  const bool more = hidden.size > 0.0;
  const std::string when =
      hidden.course == Course::Step
          ? fmt::format("from {} on", format_utc(instant(settings, hidden.from)).substr(0, 16))
          : "at the end, by a drift over the whole time";
  const std::string where =
      hidden.course == Course::Whole ? "batch " + batch_name(hidden.number) : station_name(hidden.number);
  switch (hidden.cause) {
    case Cause::ForceGain:
      return fmt::format("{}: the force reading is {:.2f} % too {} {}", where, percent,
                         more ? "large" : "small", when);
    case Cause::TorqueGain:
      return fmt::format("{}: the torque reading is {:.2f} % too {} {}", where, percent,
                         more ? "large" : "small", when);
    case Cause::ForceLag:
      return fmt::format("{}: the force reading lags by {:.2f} ms {}", where, 1e3 * hidden.size, when);
    case Cause::Stiffness:
      return fmt::format("{}: k1 and k2 are {:.1f} % {}", where, percent, more ? "larger" : "smaller");
    case Cause::CoulombFriction:
      return fmt::format("{}: TC is {:.0f} % larger", where, percent);
    case Cause::Backlash:
      return fmt::format("{}: {:.2f} rad of lost motion at each reversal", where, hidden.size);
  }
  return "";
}

std::vector<PlannedCheck> plan(const Settings& settings, const std::vector<Hidden>& hidden,
                               const sim::PlantConfiguration& shipped) {
  constexpr int kMasterEvery = 20;
  Line line(settings, hidden, shipped);
  Draws draws(settings.seed, 3);
  std::vector<Readings> readings;
  for (int station = 0; station < settings.stations; ++station)
    readings.push_back({draws.normal(kForceGains), draws.normal(kTorqueGains)});

  struct Again {
    int check;  ///< the number of the check from which on it is due
    int station;
    Brake brake;
  };
  std::deque<Again> again;
  std::vector<PlannedCheck> checks;
  for (int number = 0; number < settings.checks; ++number) {
    const double share = static_cast<double>(number) / settings.checks;
    PlannedCheck& check = checks.emplace_back();
    Brake brake;
    if (number % kMasterEvery == 0) {
      check.station = number / kMasterEvery % settings.stations;
      brake = line.master();
    } else if (!again.empty() && again.front().check <= number) {
      check.station = again.front().station;
      brake = std::move(again.front().brake);
      again.pop_front();
    } else {
      check.station = draws.below(settings.stations);
      brake = line.next(share);
      if (draws.chance(0.1))
        again.push_back({number + 5, another(draws, check.station, settings.stations), brake});
    }
    check.started_utc_ns = instant(settings, share);
    // As others are, but for its end, which is the check's number and no chance.
    const std::string id = make_record_id(check.started_utc_ns);
    check.id = fmt::format("{}{:08x}", id.substr(0, id.rfind('-') + 1), number + 1);
    check.request.serial = brake.serial;
    check.request.batch = brake.batch < 0 ? "" : batch_name(brake.batch);
    check.request.repeats = static_cast<std::uint32_t>(settings.repeats);
    check.brake = std::move(brake.plant);
    check.brake.seed = draws.seed();
    check.brake.clearance_rad = draws.uniform(5.0, 7.0);
    check.brake.encoder_zero_rad = draws.uniform(-100.0, 100.0);
    add_of_station(hidden, check.station, share, readings[static_cast<std::size_t>(check.station)],
                   check.brake);
  }
  return checks;
}

}  // namespace clampd::factory
