#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/experiment/optimal_design.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/identify/kalman.hpp"
#include "clampd/record/run.hpp"
#include "clampd/simulation/simulate.hpp"

namespace clampd::reproduce {

/// The paper states neither; for the design, what its criteria are usually computed for ...
inline constexpr SensorNoise kDesignNoise{.force_N = 75.0, .velocity_rad_s = 1.5};
/// ... and on the simulated bench, good sensors and the torque noise that the paper estimated.
inline constexpr NoiseLevels kBenchNoise{.sensors = {.force_N = 30.0, .velocity_rad_s = 0.3},
                                         .torque_Nm = 0.0142};
inline constexpr std::size_t kBlock_samples = 20;
inline constexpr std::size_t kDesignLength_samples = 300;
/// The experiment for the bench uses this share of the limits, and lets a torque that is
/// off by 1 mN m all along move the velocity by 3 rad/s at most.
inline constexpr double kHeadroom = 0.9;
inline constexpr double kBenchAmplification_rad_s_Nm = 3e3;

struct StudyOptions {
  std::uint64_t seed = 1;
  std::uint16_t repeats = 20;  ///< of each experiment; at least 3
  int starts = 300;            ///< local searches for a design of 0.3 s; others in proportion to their length
  /// Called from the calling thread: share of the work done, and what is being done.
  std::function<void(double fraction, std::string_view stage)> progress;

  Result<void> validate() const;
};

/// The brake on the simulated bench: the means of Table II (PEM, optimal experiment).
BrakeParameters true_brake();

/// A certified design and the nominal brake's response to it.
struct Design {
  std::size_t samples = 0;
  DesignSummary summary;
  Run response;

  double duration_s() const { return static_cast<double>(samples) * kMaxStep_s; }
};

/// The simulated bench's repeats of one trajectory, tracked by the station's own controller.
struct Experiment {
  std::vector<SimulatedRun> runs;
  double bench_s = 0.0;      ///< all of it: opening, tare, approaches, repeats, release
  double force_max_N = 0.0;  ///< what the brake really did
  double speed_max_rad_s = 0.0;
};

/// One column of Table II: every repeat estimated alone.
struct Column {
  std::string name;
  std::vector<Estimate> estimates;  ///< that converged; of the sinusoids, all that gave numbers
  std::size_t failed = 0;
  ParameterVector mean;         ///< of theta / theta_nom over the repeats
  ParameterMatrix covariance;   ///< the same
  ParameterMatrix bound;        ///< Cramer-Rao, initial state unknown, torque noise counted
  ParameterMatrix bound_exact;  ///< the same as if the torque reading were exact, as the paper has it
  double median_wall_s = 0.0;   ///< of one estimate
};

/// An open-loop simulation under a recorded torque, from where the run started.
struct Prediction {
  std::string name;
  Simulation simulation;
  double force_rms_N = 0.0;  ///< of reading minus simulation
  double velocity_rms_rad_s = 0.0;
};

/// The same of every repeat.
struct Replay {
  std::string name;
  std::vector<Prediction> repeats;
};

struct Study {
  StudyOptions options;
  std::vector<Design>
      d_designs;  ///< by length, 0.1 ... 0.4 s; lengths without a certified design are left out
  std::vector<Design> a_designs;
  Design tracked;  ///< 0.3 s, with headroom for a brake that is not the nominal one
  Experiment optimal;
  Experiment step;  ///< the paper's non-optimal experiment
  Column oem_optimal;
  Column pem_optimal;
  Column oem_step;
  Estimate pooled;  ///< PEM over all optimal repeats at once
  SimulatedRun validation;
  std::vector<Prediction> validation_predictions;  ///< nominal, OEM, PEM, OEM of the step
  Experiment sinusoid;
  std::vector<Replay> sinusoid_replays;  ///< OEM's and PEM's means, the true parameters
  std::size_t shown_repeat = 0;          ///< that in which OEM's simulation errs most
  KalmanViews kalman;                    ///< of that repeat, with PEM's parameters
  Column oem_sinusoid;                   ///< no bounds
  Column pem_sinusoid;
  double wall_s = 0.0;
};

/// Everything but the drawing. Errors: an option, a design that could not be found, a simulated brake that
/// could not be driven.
Result<Study> compute_study(const StudyOptions& options);

}  // namespace clampd::reproduce
