#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// One of several explanations of the runs so far.
struct RivalModel {
  std::string name;
  ExtendedParameters parameters;
  /// Of ExtendedBrake's parameters, SI, as the runs so far leave it; rows that are not finite: undetermined.
  Eigen::MatrixXd covariance;
};

struct DiscriminationOptions {
  /// For every rival that tracks the trajectory.
  double torque_limit_Nm = 3.0;
  double force_limit_N = 25e3;
  double velocity_limit_rad_s = 250.0;
  double shortest_s = 0.3, longest_s = 1.2;
  /// Repeats are added until this is expected between the rivals hardest to tell apart: chance then hardly
  /// turns the decision, whatever the runs so far say.
  double wanted_nats = 30.0;
  double enough_nats = 12.0;  ///< below this, over the most repeats, nothing is settled
  int most_repeats = 40;
  double longest_off_s = 10.0;  ///< of a record of the torque reading with the drive off
  /// Number of the run, counted from the first that the rivals were fitted to: for what changes with it.
  double run_number = 0.0;
  int prototypes_kept = 6;          ///< that are refined, each of another kind or far apart
  int refinement_evaluations = 80;  ///< of each, shared by the pairs
  int threads = 0;                  ///< 0: as many as the machine has. The result does not depend on it.

  Result<void> validate() const;
};

/// What one trajectory tells between the rivals.
struct DiscriminationValue {
  bool feasible = false;   ///< every rival tracks it within the limits
  std::string infeasible;  ///< why not
  /// False: a rival is lost on another's readings, as a filter is that sticks where the brake slides. What it
  /// says then is no measure of what a fit would make of them.
  bool credible = false;
  double evidence_nats = 0.0;             ///< of one run, between the two hardest to tell apart
  double evidence_per_sample_nats = 0.0;  ///< over about three seconds of repeats
  std::size_t first = 0, second = 0;      ///< those two
};

/// Expected log-likelihood ratio of one rival against another after the trajectory of the nominal brake was
/// tracked, if the first is true; the less of both directions, of all pairs. Noise-free readings of one
/// rival under the tracking loop are filtered by the other, whose innovations count with the inverse of
/// their covariance, torque noise included; its parameters follow within their covariance first
/// (T-optimality, Hunter and Reiner 1965, after the readings; Box and Hill 1967 for the uncertainty).
/// Errors: those of build_reference(); fewer than two rivals; a covariance of another size.
Result<DiscriminationValue> evaluate_discrimination(const Run& trajectory, std::span<const RivalModel> rivals,
                                                    const NoiseLevels& noise, const BrakeParameters& nominal,
                                                    const DiscriminationOptions& options = {});

/// The manoeuvre that best separates rivals.
struct Discrimination {
  std::string name;
  std::string why;                         ///< in words; if it does not settle, that
  std::vector<ManoeuvreSegment> segments;  ///< empty: the drive is off
  Run trajectory;                          ///< of the nominal brake; with the drive off: that, and how long
  double evidence_nats = 0.0;              ///< of one run, between the two hardest to tell apart
  double evidence_per_sample_nats = 0.0;
  int repeats = 1;                      ///< that are needed, or the most there may be
  double expected_evidence_nats = 0.0;  ///< of all repeats
  /// False: no manoeuvre within the limits is expected to tell two of the rivals apart, as with exact twins.
  bool settles = false;
  std::size_t first = 0, second = 0;  ///< the two rivals hardest to tell apart
};

/// If the torque reading with the drive off tells the rivals apart, that: for so long as it takes. Otherwise,
/// of many kinds of manoeuvres at several forces, speeds and frequencies, the ones that tell most per sample
/// between the two rivals hardest to tell apart are refined (COBYLA) within the limits. Repeats exactly on
/// one machine. Errors: two or three rivals are wanted; a covariance of another size; options; no manoeuvre
/// that all of them can do.
Result<Discrimination> design_discrimination(std::span<const RivalModel> rivals, const NoiseLevels& noise,
                                             const BrakeParameters& nominal,
                                             const DiscriminationOptions& options = {});

}  // namespace clampd
