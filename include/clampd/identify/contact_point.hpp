#pragma once

#include <span>
#include <string>

#include "clampd/base/nan.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Where the pads begin to touch (x = 0 of the model), as the motor's encoder reads it. Its error has two
/// parts: what the errors of k1 and k2 do to it, and its own.
struct ContactPoint {
  double position_rad = kNaN;
  double variance_rad2 = 0.0;                               ///< of its own error
  ParameterVector by_parameters = ParameterVector::Zero();  ///< d position_rad / d (theta / theta_nom)
  double by_force_offset = 0.0;  ///< by an error common to all force readings (rad/N), with these parameters
  double reading_sd_rad = 0.0;   ///< of one position reading: its noise and its rounding
  std::string why = "no runs were looked at for it";  ///< why it is not known; empty if it is
};

/// In each run, the contact point with which k1 and k2 of the estimate come nearest to the force readings at
/// the positions that the encoder reads (least squares); of all runs the mean, weighted by what their force
/// readings tell of it. Torque, velocity and friction have no part in it, so that their errors have none
/// either.
///
/// Its own error is taken from the scatter of the runs, so that a contact point that moves from run to run
/// counts, wider as Student's 95 % interval asks for; of a single run, from what is left of its force
/// readings. What the runs share of the encoder's rounding counts beside it.
///
/// Not known: a run without position readings, an estimate without k1 or k2, no run that presses the pads.
ContactPoint contact_point(std::span<const Run> runs, const Estimate& estimate);

}  // namespace clampd
