#include "tests/benchmarks/workloads.hpp"

#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/experiment/robust_design.hpp"
#include "support/excitation.hpp"
#include "support/reference_brake.hpp"
#include "tests/scenario/scenario.hpp"

namespace clampd::bench {

std::vector<double> check_torque() {
  return expand_blocks({kKnownRobustBlocks_Nm.begin(), kKnownRobustBlocks_Nm.end()},
                       kKnownRobustBlockSamples);
}

BrakeParameters true_brake() {
  BrakeParameters brake;
  brake.theta =
      brake.theta.cwiseProduct((ParameterVector() << 0.9, 0.95, 1.2, 0.95, 1.3, 1.03, 0.8).finished());
  return brake;
}

std::vector<Run> simulated_runs(std::size_t count, const NoiseLevels& noise, std::uint64_t seed) {
  const std::vector<double> torque_Nm = check_torque();
  std::mt19937_64 generator(seed);
  std::normal_distribution<double> normal;
  std::vector<Run> runs;
  for (std::size_t r = 0; r < count; ++r) {
    std::vector<double> acting_Nm = torque_Nm;
    for (double& value : acting_Nm) value += noise.torque_Nm * normal(generator);
    const support::ReferenceTrace trace =
        support::simulate_reference(true_brake(), 0.0, 0.0, acting_Nm, 2e-5);
    runs.push_back(support::noisy_run(torque_Nm, trace.force_N, trace.velocity_rad_s, noise.sensors.force_N,
                                      noise.sensors.velocity_rad_s, generator));
  }
  return runs;
}

EstimatorOptions knowing(const NoiseLevels& noise) {
  EstimatorOptions options;
  options.noise_force_N = noise.sensors.force_N;
  options.noise_velocity_rad_s = noise.sensors.velocity_rad_s;
  options.noise_torque_Nm = noise.torque_Nm;
  return options;
}

OutputErrorIteration::OutputErrorIteration(Run run) : run_(std::move(run)) {
  linear_.resize(run_.size());
  identify::ignore_torque_noise(identify::variances_of(kQuietTorque), {}, linear_);
}

double OutputErrorIteration::operator()() noexcept {
  CLAMPD_ASSERT(identify::linearise(run_, {}, BrakeState::Zero(), linear_));
  return identify::normal_equations(linear_)(0, 0);
}

namespace {

struct Exchange {
  BrakeFeedback feedback;
  std::int64_t now_ns;
};

/// The simulated brake, its every answer kept.
class Recorder final : public BrakePort {
 public:
  Recorder() : brake_(scenario::shipped_plant()) {}

  std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept override {
    out[0] = brake_.sample();
    out[0].arrival_time_ns = now_ns;
    tape.push_back({out[0], now_ns});
    return 1;
  }
  bool send(const DriveCommand& command, std::int64_t) noexcept override {
    brake_.command(command);
    return true;
  }
  PortHealth health() const noexcept override { return {}; }

  std::vector<Exchange> tape;

 private:
  sim::SimulatedBrake brake_;
};

}  // namespace

class ReplayedCheck::Player final : public BrakePort {
 public:
  explicit Player(std::vector<Exchange> recorded) : tape(std::move(recorded)) {}

  std::size_t receive(std::span<BrakeFeedback> out, std::int64_t) noexcept override {
    out[0] = tape[next++].feedback;
    return 1;
  }
  bool send(const DriveCommand&, std::int64_t) noexcept override { return true; }
  PortHealth health() const noexcept override { return {}; }

  const std::vector<Exchange> tape;
  std::size_t next = 0;
};

ReplayedCheck::ReplayedCheck() {
  const BrakeParameters nominal;
  plan_.reference = scenario::shipped_reference();
  plan_.drive = nominal_drive(nominal);
  plan_.repeats = 3;
  Recorder recorder;
  rt::ControlCore core(recorder);
  core.requests().start(plan_, core.ticket());
  for (std::int64_t now_ns = 0; core.status().checks_finished == 0; now_ns += kPeriod_ns)
    core.tick(now_ns, 0, 0);
  CLAMPD_ASSERT(core.status().fault == FaultCause::None);
  player_ = std::make_unique<Player>(std::move(recorder.tape));
  restart();
}

ReplayedCheck::~ReplayedCheck() = default;

std::size_t ReplayedCheck::ticks() const {
  return player_->tape.size();
}

void ReplayedCheck::restart() {
  player_->next = 0;
  core_ = std::make_unique<rt::ControlCore>(*player_);
  core_->requests().start(plan_, core_->ticket());
}

void ReplayedCheck::tick() noexcept {
  core_->tick(player_->tape[player_->next].now_ns, 0, 0);
}

}  // namespace clampd::bench
