#pragma once

#include <string>
#include <vector>

#include "tests/drive_bench/drive_case.hpp"

namespace clampd::drive_bench {

/// What a model could do at best on the runs of a case, by least squares on the exact means of the truth over
/// each row: torque without noise, against acceleration, speed and direction of the dry friction. No estimate
/// of the product enters, nor its filters. Rows in which the drive sticks are left out: the torque there lies
/// anywhere within the friction.
struct Fit {
  double share_left = 0.0;  ///< rms of what is left over rms of the torque, both within the case's band
  /// Half the sum of squares of what is left, over the noise within the band that the torque reading and the
  /// encoder leave to anybody: the expected log likelihood ratio.
  double nats = 0.0;
  std::size_t rows = 0;
};

/// The base model: inertia, viscous and Coulomb friction.
Fit fit_base(const Case& drawn, const std::vector<Recording>& runs);

/// The base model and the most general form of each effect of these names (unknown names add nothing): a
/// lower bound of what is left by any model that goes by them.
Fit fit_named(const Case& drawn, const std::vector<Recording>& runs, const std::vector<std::string>& names);

/// Noise of the torque within the band, as a share of the torque: reading, and encoder through the inertia.
double noise_share(const Case& drawn, const std::vector<Recording>& runs);

/// The case with one of its hidden effects only.
Case only(const Case& drawn, std::size_t effect);

constexpr double kDetectable_nats = 50.0;
/// Times what the model file calls good enough.
constexpr double kDetectableShare = 1.5;

/// Whether each hidden effect, by itself, leaves so much that somebody who looks has to see it.
bool is_detectable(const Case& drawn, const Fit& base);

}  // namespace clampd::drive_bench
