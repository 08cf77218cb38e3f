#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "clampd/identify/contact_point.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/sheet/sheet.hpp"

namespace clampd {

/// What is known of a brake when its runs have been identified.
struct Posterior {
  BrakeParameters parameters;  ///< NaN: not identifiable
  /// Those of an extended model that change the brake itself.
  std::vector<EffectValues> effects = {};
  /// Of theta / theta_nom, then of all parameters of `effects`, each in its unit; empty without effects.
  Eigen::MatrixXd covariance_with_effects = {};
  /// Of theta / theta_nom: what the identification reports, and all that is added to it (tare, misfit). NaN
  /// where it is not known, zero of a parameter that was held.
  ParameterMatrix covariance_normalised = ParameterMatrix::Zero();
  std::string unknown = {};  ///< why nothing is known; empty: something is
  ContactPoint contact = {};
  /// Of theta / theta_nom with the contact point's own error: what the tare does to both.
  ParameterVector covariance_with_contact = ParameterVector::Zero();
  /// The encoder's reading when the check found the brake; nothing: it is not known.
  std::optional<double> found_rad = {};
};

/// Of an estimate; `added_normalised` counts beside its own covariance, and what a tare with these standard
/// deviations (N, rad/s) adds to that of effects. Nothing is known without convergence, unless single
/// parameters are not identifiable; and nothing with effects that check_countable() refuses.
Posterior posterior_of(const Estimate& estimate,
                       const ParameterMatrix& added_normalised = ParameterMatrix::Zero(),
                       const Eigen::Vector2d& tare_sd = Eigen::Vector2d::Zero());

struct CharacteristicEstimate {
  enum class State {
    Known,
    NotReached,  ///< this brake never gets there, whatever its parameters are within their uncertainty
    Unknown,
  };
  State state = State::Unknown;
  double value = 0.0;  ///< in the kind's unit; NaN unless known
  double sd = 0.0;
  std::string why;  ///< why it is not known; empty if it is
};

/// One for each characteristic, by propagation of the posterior: the value at the estimate, the standard
/// deviation from the second-order terms of the pairs of points one standard deviation to either side along
/// the principal axes of what the kind needs (Julier and Uhlmann's sigma points, in central differences:
/// Norgaard, Poulsen and Ravn, New developments in state estimation for nonlinear systems, 2000). Nothing is
/// drawn: the same posterior gives the same sheet. The 95 % interval is the value ± 1.96 sd. The contact
/// point is nearly linear in the parameters: by its derivatives. `drive`: as the station's loop knows it.
std::vector<CharacteristicEstimate> evaluate(std::span<const Characteristic> characteristics,
                                             const Posterior& posterior, const NominalDrive& drive);

}  // namespace clampd
