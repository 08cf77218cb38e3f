#pragma once

#include <limits>
#include <span>
#include <string>

#include "clampd/brake/integrator.hpp"
#include "clampd/experiment/criterion.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

struct DesignLimits {
  double torque_Nm = 3.0;
  double force_N = 30e3;
  double velocity_rad_s = 300.0;  ///< of the speed, in both directions
  /// Of the change of velocity at any sample, per N m that the torque is off all along. The loaded brake is
  /// unstable in slow motion, at about 62 /s, and much information sits there: designs of 1e6 exist, which a
  /// torque error of a fraction of a millinewton metre turns into others.
  double amplification_rad_s_Nm = std::numeric_limits<double>::infinity();
  /// Of the speed at the last sample.
  double end_velocity_rad_s = std::numeric_limits<double>::infinity();
};

/// An experiment as seen by an integrator that shares no code with advance().
struct Certification {
  Criterion criterion{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  double force_max_N = std::numeric_limits<double>::quiet_NaN();  ///< also between the samples
  double velocity_max_rad_s = std::numeric_limits<double>::quiet_NaN();
  double end_velocity_rad_s = std::numeric_limits<double>::quiet_NaN();
  double amplification_rad_s_Nm = std::numeric_limits<double>::quiet_NaN();
  /// -log det M by central differences over changes of kFragilityStep of nominal, where a good design keeps
  /// its figure: M as parameter errors of that size meet it.
  double coarse_logdet = std::numeric_limits<double>::quiet_NaN();
  /// Largest difference from the outputs of simulate().
  double force_difference_N = std::numeric_limits<double>::quiet_NaN();
  double velocity_difference_rad_s = std::numeric_limits<double>::quiet_NaN();
  std::string objection;  ///< why the experiment is refused; empty: it is not

  bool granted() const { return objection.empty(); }
};

/// What certify() lets pass as agreement of the two integrators.
inline constexpr double kCertifiedLogdet = 0.1;
inline constexpr double kCertifiedLogdetWider = 0.3;
inline constexpr double kCertifiedForce_N = 10.0;
inline constexpr double kCertifiedVelocity_rad_s = 1.0;

/// Share of nominal at which Certification::coarse_logdet looks.
inline constexpr double kFragilityStep = 1e-4;

/// Simulates torque_Nm (one per kMaxStep_s) with small implicit steps, takes M (14) from central
/// differences of those simulations, and compares: limits kept at every small step, outputs and -log det M
/// equal to those of simulate() and `claimed_logdet`. The differences are taken over two steps of the
/// parameters: a millionth of nominal, which is the derivative that M is made of also where the brake creeps
/// under load, and, with the wider tolerance, a hundred-thousandth, over which an experiment on the verge of
/// a lock-up fails.
Certification certify(const BrakeParameters& brake, const BrakeState& initial,
                      std::span<const double> torque_Nm, const SensorNoise& noise, const DesignLimits& limits,
                      double claimed_logdet);

}  // namespace clampd
