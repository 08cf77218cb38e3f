#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "clampd/identify/estimate.hpp"
#include "clampd/identify/information.hpp"
#include "rt/control_core.hpp"
#include "src/identify/linear_run.hpp"

namespace clampd::bench {

/// Sensor levels of the studies; the second with the paper's torque noise.
inline constexpr NoiseLevels kQuietTorque{.sensors = {.force_N = 75.0, .velocity_rad_s = 1.5}};
inline constexpr NoiseLevels kNoisyTorque{.sensors = {.force_N = 30.0, .velocity_rad_s = 0.3},
                                          .torque_Nm = 0.0142};

/// The 300 torques (N m) of the robust design: what a check replays.
std::vector<double> check_torque();

/// A brake away from nominal, so that a fit from nominal has its usual way to go.
BrakeParameters true_brake();

/// Noisy runs of 300 samples of the true brake, as an integrator sees them that no estimator here shares.
std::vector<Run> simulated_runs(std::size_t count, const NoiseLevels& noise, std::uint64_t seed);

/// With the noise as known.
EstimatorOptions knowing(const NoiseLevels& noise);

/// One evaluation of the output error method: the simulation with its derivatives, and the normal equations.
class OutputErrorIteration {
 public:
  explicit OutputErrorIteration(Run run);
  double operator()() noexcept;

 private:
  Run run_;
  identify::LinearRun linear_;
};

/// The control loop's ticks of a whole check, from a recording: nothing but the tick is at work.
class ReplayedCheck {
 public:
  /// Records the check of a simulated brake. Aborts if it fails.
  ReplayedCheck();
  ~ReplayedCheck();

  std::size_t ticks() const;
  void restart();
  /// The next of ticks().
  void tick() noexcept;

 private:
  class Player;

  rt::CheckPlan plan_;
  std::unique_ptr<Player> player_;
  std::unique_ptr<rt::ControlCore> core_;
};

}  // namespace clampd::bench
