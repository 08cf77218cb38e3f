#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/experiment/optimal_design.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// The brakes that a robust design is made for: every parameter on its own, its logarithm uniform from a
/// quarter of the way beyond nominal to a quarter beyond the means of the paper's Table II (0.8, 0.9, 1.66,
/// 0.93, 2.2, 1.05, 0.43 of nominal); inertia and ratio as nominal. Half of the draws in each parameter lie
/// between the two; all keep the shape of a brake, which a normal distribution of that width would not.
inline constexpr double kTableII[kParameterCount] = {0.8, 0.9, 1.66, 0.93, 2.2, 1.05, 0.43};
inline constexpr double kBeyondTableII = 0.25;

/// `count` brakes of the prior around `nominal`, a Latin hypercube: every parameter's range evenly filled.
std::vector<BrakeParameters> draw_prior(const BrakeParameters& nominal, std::size_t count,
                                        std::uint64_t seed);

/// The best robust design known for the paper's brake at 0.3 s, at the default noise: where every search
/// starts as well.
inline constexpr std::size_t kKnownRobustBlockSamples = 20;
inline constexpr std::array<double, 15> kKnownRobustBlocks_Nm = {0.0649, 2.5257, 0.9925,  0.7091,  0.2206,
                                                                 0.3639, 0.2696, -0.2709, 0.1169,  0.1359,
                                                                 0.4983, 1.2707, -0.3300, -0.4806, 0.1712};

/// A design for some of the parameters, to be driven beside runs of a trajectory that serves all of them.
struct RobustTarget {
  std::vector<Parameter> parameters;
  Run beside;         ///< of the nominal brake, all columns
  double runs = 4.0;  ///< of it, and as many of the design
};

struct RobustOptions {
  BrakeParameters nominal;
  /// Nothing: all parameters, from runs of the design alone.
  std::optional<RobustTarget> target;
  std::size_t samples = 300;
  std::size_t block_samples = 20;
  NoiseLevels noise{.sensors = {}, .torque_Nm = 0.0142};
  /// For every brake of the prior under feedback, without the loop's own limits of force and speed, which no
  /// design shall count on; the torque is clamped by the loop. Closer than what the brake bears: for brakes
  /// and noise that no sample shows.
  DesignLimits limits{
      .torque_Nm = 3.0, .force_N = 29.5e3, .velocity_rad_s = 295.0, .end_velocity_rad_s = 20.0};
  std::size_t search_brakes = 16;   ///< of the prior, for the search
  std::size_t verify_brakes = 200;  ///< others, for the figures that are reported
  std::uint64_t seed = 1;
  int starts = 48;  ///< local optimisations
  int threads = 0;  ///< 0: as many as the machine has. The result does not depend on it.
  /// Called from the calling thread: share of the work done, best expected log det so far (infinite before).
  std::function<void(double fraction, double best)> progress;

  Result<void> validate() const;
};

/// A trajectory before the prior. Log dets are of the covariance of the normalised parameters with the
/// initial state unknown, -log det M; infinite for a brake that the run does not identify. Of a design for some of
/// them it is the mean of the logarithms of their variances in their place, over both methods
/// (expected_covariance()).
struct RobustEvaluation {
  std::vector<double> logdet;  ///< per brake
  double expected_logdet = std::numeric_limits<double>::infinity();
  double worst_decile_logdet = std::numeric_limits<double>::infinity();  ///< nine of ten brakes are better
  double torque_max_Nm = std::numeric_limits<double>::infinity();
  double force_max_N = std::numeric_limits<double>::infinity();
  double stop_force_max_N = std::numeric_limits<double>::infinity();
  double velocity_max_rad_s = std::numeric_limits<double>::infinity();
  double tracking_rms_N = std::numeric_limits<double>::infinity();  ///< over all brakes
};

/// Every brake tracks `trajectory` (of the nominal brake, all columns) in the closed loop; the torque that
/// results, after all of the loop's limits, is its excitation. The largest force and speed are those without
/// the loop's limits of force and speed. Errors: those of build_reference().
Result<RobustEvaluation> evaluate_robust(const Run& trajectory, const BrakeParameters& nominal,
                                         std::span<const BrakeParameters> brakes, const NoiseLevels& noise,
                                         double torque_limit_Nm = 3.0,
                                         const std::optional<RobustTarget>& target = {});

/// How many times smaller the variance of a parameter is (geometric mean over those that the design is for).
struct RobustGain {
  double mean = 0.0;          ///< over the prior, of the logarithm
  double worst_decile = 0.0;  ///< of the variance that nine of ten brakes stay below
};
RobustGain gain_over(const RobustEvaluation& baseline, const RobustEvaluation& design,
                     const std::optional<RobustTarget>& target = {});

/// What a technician would do: a step of the clamp force in the same loop, held to the end.
struct PlainStep {
  double force_N = 0.0;
  double rise_s = 0.0;
  Run trajectory;
};
/// Of the steps to 1 kN, 2 kN ..., each as fast as the limits allow all of `brakes` and held for at least a
/// third of the length, the one that tells most. Fails if none is possible.
Result<PlainStep> best_step(const RobustOptions& options, std::span<const BrakeParameters> brakes);

/// The response of a brake to block torques, all columns, from contact and rest: what --out writes and the
/// loop tracks.
Run response_to(const std::vector<double>& block_torque_Nm, std::size_t block_samples,
                const BrakeParameters& brake, const BrakeState& initial = BrakeState::Zero());

struct RobustSummary {
  bool found = false;
  std::string message;
  std::vector<double> block_torque_Nm;
  Run trajectory;               ///< of the nominal brake
  RobustEvaluation evaluation;  ///< over brakes that the search did not see
  PlainStep step;                   ///< empty of a design with a target
  RobustEvaluation step_evaluation;  ///< of the step; with a target, of as many runs more of its trajectory
  RobustGain gain;                   ///< over that
  DesignEvaluation nominal;  ///< as the other objectives see it: open loop, initial state and torque known
  std::int64_t evaluations = 0;  ///< trajectories scored by the search
  double wall_s = 0.0;
};

/// Block torques of the nominal brake whose trajectory, tracked in closed loop, gives the least expected log
/// det of the parameters' covariance over the prior, within the limits for every brake. Sequential quadratic
/// programming from the known design, from cautious D-optimal ones and from variations of the best so far.
/// Repeats exactly for a given seed on one machine.
RobustSummary design_robust_experiment(const RobustOptions& options);

}  // namespace clampd
