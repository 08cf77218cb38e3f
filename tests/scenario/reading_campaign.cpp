#include "tests/scenario/reading_campaign.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <ostream>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "rt/control_core.hpp"
#include "tests/bench/embedded_check.hpp"
#include "tests/scenario/scenario.hpp"

namespace clampd::scenario {
namespace {

using sim::Reading;
using sim::Spoil;

constexpr double kAfter_s = 0.3;
constexpr int kLongest = 100'000;           // samples
constexpr double kHarmlessDeviation = 0.1;  // of the noise, rms over a run
constexpr double kFar_sd =
    5.0;  // beyond the guard band (2 sd) and beyond what chance does in 100,000 parameters

/// The simulated brake as the station's port: what a bus would carry, without the bus.
class DirectPort final : public BrakePort {
 public:
  DirectPort(const sim::PlantConfiguration& plant, std::int64_t period_ns) : brake(plant, period_ns) {}
  std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept override {
    last = brake.sample();
    out[0] = last;
    out[0].arrival_time_ns = now_ns;
    return 1;
  }
  bool send(const DriveCommand& command, std::int64_t) noexcept override {
    brake.command(command);
    return true;
  }
  PortHealth health() const noexcept override { return {}; }

  sim::SimulatedBrake brake;
  BrakeFeedback last;
};

double difference(Reading reading, const BrakeFeedback& spoiled, const BrakeFeedback& healthy) {
  switch (reading) {
    case Reading::Force:
      return spoiled.force_N - healthy.force_N;
    case Reading::Velocity:
      return spoiled.velocity_rad_s - healthy.velocity_rad_s;
    case Reading::Torque:
      return spoiled.torque_Nm - healthy.torque_Nm;
    case Reading::Position:
    case Reading::Encoder:
      return spoiled.position_rad - healthy.position_rad;
  }
  return 0.0;
}

double noise(Reading reading, const sim::SensorSettings& sensors) {
  switch (reading) {
    case Reading::Force:
      return sensors.force_noise_N;
    case Reading::Velocity:
      return sensors.velocity_noise_rad_s;
    case Reading::Torque:
      return sensors.torque_noise_Nm;
    case Reading::Position:
    case Reading::Encoder:
      return 10.0 * sensors.position_quantum_rad;  // no estimate is made of it
  }
  return 1.0;
}

/// How far the runs' readings are from what they would have been.
class Deviation {
 public:
  void add(Reading reading, const Sample& sample, const BrakeFeedback& spoiled,
           const BrakeFeedback& healthy) {
    const double error = difference(reading, spoiled, healthy);
    if (sample.phase == CheckPhase::Tare) {
      tare_ += error;
      ++tares_;
    }
    if (sample.trajectory_index == 0) finish_run();
    if (sample.trajectory_index < 0) return;
    const double tared = error - (tares_ > 0 ? tare_ / tares_ : 0.0);
    squares_ += tared * tared;
    ++rows_;
  }
  double worst_rms() {
    finish_run();
    return worst_;
  }

 private:
  void finish_run() {
    if (rows_ > 0) worst_ = std::max(worst_, std::sqrt(squares_ / rows_));
    squares_ = 0.0;
    rows_ = 0;
  }
  double tare_ = 0.0, squares_ = 0.0, worst_ = 0.0;
  int tares_ = 0, rows_ = 0;
};

std::string describe(const sim::SpoiledReading& spoiled, const CheckOutcome& outcome) {
  return fmt::format(
      "{} {} {:.3g} at {:.3f} s: {} in {} after {:.0f} ms; to {:.0f} rad/s, {:.0f} N; runs off by {:.2g} sd",
      to_string(spoiled.reading), to_string(spoiled.spoil), spoiled.amount, spoiled.when.at_s,
      to_string(outcome.fault), to_string(outcome.phase), 1e3 * (outcome.fault_s - spoiled.when.at_s),
      outcome.speed_max_rad_s, outcome.force_max_N, outcome.deviation);
}

void count(SpoilTally& tally, const sim::SpoiledReading& spoiled, const CheckOutcome& outcome,
           const rt::SupervisorSettings& limits) {
  ++tally.checks;
  tally.speed_max_rad_s = std::max(tally.speed_max_rad_s, outcome.speed_max_rad_s);
  tally.force_max_N = std::max(tally.force_max_N, outcome.force_max_N);
  tally.torque_after_fault_s = std::max(tally.torque_after_fault_s, outcome.torque_after_fault_s);
  if (outcome.speed_max_rad_s > 1.2 * limits.speed_limit_rad_s ||
      outcome.force_max_N > 1.1 * limits.force_limit_N)
    ++tally.unsafe;
  if (outcome.fault != FaultCause::None) {
    ++tally.faults;
    if (names(outcome.fault, spoiled.reading)) ++tally.named;
    tally.latencies_s.push_back(outcome.fault_s - spoiled.when.at_s);
  } else if (outcome.deviation < kHarmlessDeviation) {
    ++tally.harmless;
  } else {
    ++tally.undetected;
  }
}

/// What the supervisor lets pass, the estimate has to notice: the same brake in a whole check.
std::string judge(SpoilTally& tally, const sim::PlantConfiguration& plant, const Told& told) {
  const Result<CheckRecord> checked = bench::try_check(plant, 20, nullptr, told);
  if (!checked) {
    ++tally.errors;
    return "refused: " + checked.error().message;
  }
  const CheckRecord& record = *checked;
  tally.errors += record.verdict == Verdict::Error ? 1 : 0;
  if (record.verdict == Verdict::Pass || record.verdict == Verdict::Fail)
    for (std::size_t k = 0; k < kParameterCount; ++k) {
      const ParameterRecord& p = record.parameters[k];
      const double true_value = plant.brake.theta[static_cast<Eigen::Index>(k)];
      if (std::abs(p.value - true_value) <= kFar_sd * p.sd) continue;
      ++tally.wrong;
      return fmt::format("{}, {} is {:.3g} instead of {:.3g}, sd {:.2g} ({})", to_string(record.verdict),
                         p.name, p.value, true_value, p.sd, record.reason);
    }
  return std::string(to_string(record.verdict));
}

double uniform(std::mt19937_64& random, double lower, double upper) {
  return lower + (upper - lower) * std::generate_canonical<double, 53>(random);
}

double either_sign(std::mt19937_64& random, double lower, double upper) {
  const double size = uniform(random, lower, upper);
  return random() % 2 == 0 ? size : -size;
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

}  // namespace

CheckOutcome drive_check(const sim::PlantConfiguration& plant, const Reference& reference,
                         std::uint16_t repeats, const Told& told) {
  const std::int64_t period_ns = std::llround(1e9 * told.period_s);
  DirectPort port(plant, period_ns);
  const auto supervised = rt::SupervisorSettings::of(nominal_drive(BrakeParameters{}, told.period_s));
  rt::ControlCore core(port, supervised, 16);
  rt::CheckPlan plan;
  plan.commanded = told.commanded;
  plan.reference = reference;
  plan.drive = supervised.drive;
  plan.repeats = repeats;
  const Reading reading = plant.spoiled.empty() ? Reading::Force : plant.spoiled.front().reading;
  CheckOutcome outcome;
  Deviation deviation;
  std::int64_t now_ns = 1'000'000'000;
  double end_s = 0.0;
  bool asked = false;
  Sample sample;
  for (int k = 0; k < kLongest && (end_s == 0.0 || k * told.period_s < end_s); ++k) {
    now_ns += period_ns;
    core.tick(now_ns, 0, 0);
    const rt::StatusBoard& status = core.status();
    if (!asked && status.state == StationState::Idle) {
      core.requests().start(plan, core.ticket());
      asked = true;
    }
    const sim::Truth& truth = port.brake.truth();
    outcome.speed_max_rad_s = std::max(outcome.speed_max_rad_s, std::abs(truth.velocity_rad_s));
    outcome.force_max_N = std::max(outcome.force_max_N, truth.force_N);
    while (core.ring().pop(sample)) {
    }
    if (sample.phase != CheckPhase::None) outcome.phase = sample.phase;
    deviation.add(reading, sample, port.last, port.brake.unspoiled());
    if (end_s == 0.0 && status.checks_finished > 0) {
      outcome.fault = status.fault;
      outcome.fault_s = truth.time_s;
      outcome.duration_s = truth.time_s;
      end_s = k * told.period_s + kAfter_s;
    }
    if (end_s > 0.0 && truth.torque_Nm != 0.0)
      outcome.torque_after_fault_s = truth.time_s + told.period_s - outcome.fault_s;
  }
  outcome.deviation = deviation.worst_rms() / noise(reading, plant.sensors);
  return outcome;
}

sim::PlantConfiguration table_ii_brake(std::mt19937_64& random) {
  constexpr double lower[] = {0.80, 0.89, 1.0, 0.92, 1.0, 0.875, 0.38};
  constexpr double upper[] = {1.0, 1.0, 1.67, 1.0, 2.45, 1.05, 1.0};
  sim::PlantConfiguration plant = noisy_plant();
  plant.seed = random();
  for (int i = 0; i < 7; ++i) plant.brake.theta[i] *= uniform(random, lower[i], upper[i]);
  plant.encoder_zero_rad = uniform(random, -200.0, 200.0);
  return plant;
}

sim::SpoiledReading gross_spoil(Reading reading, Spoil spoil, double duration_s, std::mt19937_64& random) {
  sim::SpoiledReading spoiled{reading, spoil, 0.0, uniform(random, 0.0, duration_s)};
  const auto one_of = [&](double force, double velocity, double position, double torque) {
    return reading == Reading::Force      ? force
           : reading == Reading::Velocity ? velocity
           : reading == Reading::Torque   ? torque
                                          : position;
  };
  switch (spoil) {
    case Spoil::Scaled:
      spoiled.amount = random() % 2 == 0 ? uniform(random, 0.0, 0.7) : uniform(random, 1.4, 3.0);
      break;
    case Spoil::Offset:
      spoiled.amount =
          one_of(1.0, 1.0, 1.0, 1.0) * either_sign(random, 0.25, 1.0) * one_of(16e3, 150.0, 30.0, 2.0);
      break;
    case Spoil::Late:
      spoiled.amount = std::floor(uniform(random, 15.0, 100.0));
      break;
    case Spoil::Noisy:
      spoiled.amount = uniform(random, 0.25, 1.0) * one_of(12e3, 100.0, 4.0, 1.5);
      break;
    case Spoil::Frozen:
    case Spoil::Negated:
    case Spoil::Silent:
      break;
  }
  return spoiled;
}

bool names(FaultCause cause, Reading reading) {
  switch (reading) {
    case Reading::Force:
      return cause == FaultCause::ForceReading;
    case Reading::Velocity:
      return cause == FaultCause::VelocityReading;
    case Reading::Position:
      return cause == FaultCause::PositionReading;
    case Reading::Torque:
      return cause == FaultCause::TorqueReading;
    case Reading::Encoder:
      return cause == FaultCause::TorqueAgainstMotion || cause == FaultCause::SpeedNotFollowed ||
             cause == FaultCause::VelocityReading || cause == FaultCause::PositionReading;
  }
  return false;
}

SpoilCampaign run_spoil_campaign(int checks, std::uint64_t seed, int judged, const Told& told) {
  const Reference reference = shipped_reference(told.period_s);
  const rt::SupervisorSettings limits;
  constexpr std::uint16_t kRepeats = 3;
  const double duration_s = drive_check(noisy_plant(), reference, kRepeats, told).duration_s;
  std::mt19937_64 random(seed);
  SpoilCampaign campaign;
  for (int i = 0; i < checks; ++i) {
    const auto reading = static_cast<Reading>(static_cast<std::size_t>(i) % sim::kReadingCount);
    const auto spoil =
        static_cast<Spoil>(static_cast<std::size_t>(i) / sim::kReadingCount % sim::kSpoilCount);
    sim::PlantConfiguration plant = i % 3 == 0 ? shipped_plant() : table_ii_brake(random);
    plant.seed = random();
    const sim::SpoiledReading spoiled = gross_spoil(reading, spoil, duration_s, random);
    plant.spoiled = {spoiled};
    plant.speed_loop_is_spoiled = i % 2 == 0;
    const CheckOutcome outcome = drive_check(plant, reference, kRepeats, told);
    SpoilTally& each = campaign.each[static_cast<std::size_t>(reading)][static_cast<std::size_t>(spoil)];
    const int before =
        campaign.all.unsafe + campaign.all.undetected + campaign.all.faults - campaign.all.named;
    count(each, spoiled, outcome, limits);
    count(campaign.all, spoiled, outcome, limits);
    if (campaign.all.unsafe + campaign.all.undetected + campaign.all.faults - campaign.all.named != before)
      campaign.remarks.push_back(describe(spoiled, outcome));
    if (outcome.fault != FaultCause::None || judged-- <= 0) continue;
    const int errors = each.errors, wrong = each.wrong;
    const std::string verdict = judge(each, plant, told);
    campaign.all.errors += each.errors - errors;
    campaign.all.wrong += each.wrong - wrong;
    campaign.remarks.push_back(describe(spoiled, outcome) + ": " + verdict);
  }
  return campaign;
}

HealthyCampaign run_healthy_campaign(int checks, std::uint64_t seed, const Told& told) {
  const Run trajectory = shipped_trajectory();
  std::vector<std::pair<std::string, Reference>> references{{"shipped", shipped_reference(told.period_s)}};
  for (const ManoeuvreInfo& info : manoeuvres()) {
    const Run run = make_manoeuvre(info.name, BrakeParameters{}, trajectory).value();
    const Result<Reference> reference = build_reference(run, BrakeParameters{}, {.period_s = told.period_s});
    if (reference) references.emplace_back(info.name, *reference);
  }
  constexpr double lower[] = {0.80, 0.89, 1.0, 0.92, 1.0, 0.875, 0.38};
  constexpr double upper[] = {1.0, 1.0, 1.67, 1.0, 2.45, 1.05, 1.0};
  const std::pair<const char*, double> effects[] = {
      {"torque-offset", 0.05},   {"torque-gain", -0.1},        {"torque-lag", 1e-3},
      {"coulomb-load", 1e-5},    {"friction-asymmetry", 0.03}, {"quadratic-drag", 3e-6},
      {"cogging", 0.05},         {"inertia-error", 0.2},       {"ratio-error", 0.2},
      {"presliding", 0.1},       {"friction-drift", 0.05},     {"stiffness-hysteresis", 0.1},
      {"pad-damping", 5.0},      {"pad-relaxation", 0.1},      {"backlash", 1.0},
      {"stiffness-shape", 2e-3}, {"force-offset", 300.0},      {"force-lag", 5e-3},
      {"force-hum", 200.0},      {"velocity-lag", 3e-3},       {"channel-skew", 3.0},
      {"outliers", 0.02}};
  std::mt19937_64 random(seed);
  HealthyCampaign campaign;
  for (int i = 0; i < checks; ++i) {
    sim::PlantConfiguration plant = table_ii_brake(random);
    std::string what = "a brake of Table II";
    const int kind = i % 8;
    if (kind == 1) {
      const int corner = i / 8 % 128;
      plant = noisy_plant();
      plant.seed = random();
      for (int p = 0; p < 7; ++p) plant.brake.theta[p] *= (corner >> p & 1) != 0 ? upper[p] : lower[p];
      what = fmt::format("corner {}", corner);
    } else if (kind == 2) {
      constexpr const char* files[] = {"plant.toml", "brakes/used.toml", "brakes/soft-pad.toml",
                                       "brakes/noisy-bench.toml"};
      what = files[i / 8 % 4];
      plant = sim::read_plant_configuration(config(what)).value();
      plant.seed = random();
    } else if (kind == 3 || kind == 4) {
      const auto& [name, value] = effects[static_cast<std::size_t>(i / 8) % std::size(effects)];
      if (kind == 3) plant = shipped_plant();
      plant.seed = random();
      (void)sim::set_effect(plant.effects, name, value);
      what = name;
    } else if (kind == 5) {
      plant.clearance_rad = uniform(random, -33.0, 26.0);
      what = fmt::format("found at {:.1f} rad", -plant.clearance_rad);
    }
    const auto& [name, reference] =
        kind >= 6 ? references[static_cast<std::size_t>(i / 8) % references.size()] : references.front();
    const CheckOutcome outcome = drive_check(plant, reference, kind >= 6 ? 1 : 2, told);
    ++campaign.checks;
    if (outcome.fault != FaultCause::None)
      campaign.faults.push_back(fmt::format("{} ({}): {} in {} at {:.3f} s", what, name,
                                            to_string(outcome.fault), to_string(outcome.phase),
                                            outcome.fault_s));
  }
  return campaign;
}

void print(std::ostream& out, const SpoilCampaign& campaign) {
  out << fmt::format(
      "{:9} {:8} {:>7} {:>7} {:>7} {:>9} {:>11} {:>6} {:>6} {:>7} {:>9} {:>8} {:>10} {:>10} {:>10}\n",
      "reading", "kind", "checks", "faults", "named", "harmless", "undetected", "ERROR", "wrong", "unsafe",
      "max rad/s", "max N", "median ms", "95 % ms", "torque ms");
  const auto row = [&](std::string_view reading, std::string_view kind, const SpoilTally& t) {
    out << fmt::format(
        "{:9} {:8} {:7} {:7} {:7} {:9} {:11} {:6} {:6} {:7} {:9.0f} {:8.0f} {:10.0f} {:10.0f} {:10.0f}\n",
        reading, kind, t.checks, t.faults, t.named, t.harmless, t.undetected, t.errors, t.wrong, t.unsafe,
        t.speed_max_rad_s, t.force_max_N, 1e3 * quantile(t.latencies_s, 0.5),
        1e3 * quantile(t.latencies_s, 0.95), 1e3 * t.torque_after_fault_s);
  };
  for (std::size_t r = 0; r < sim::kReadingCount; ++r)
    for (std::size_t s = 0; s < sim::kSpoilCount; ++s)
      if (campaign.each[r][s].checks > 0)
        row(to_string(static_cast<Reading>(r)), to_string(static_cast<Spoil>(s)), campaign.each[r][s]);
  row("all", "", campaign.all);
}

}  // namespace clampd::scenario
