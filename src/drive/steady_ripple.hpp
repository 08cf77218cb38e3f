#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"

namespace clampd::drive {

/// Torque that ripples with the motor's angle within runs at steady speeds. Each run has its own phase, since
/// its angle is integrated from its speed.
struct SteadyRipple {
  struct Order {
    double order = 0.0;  ///< per revolution
    /// Mean amplitude over the runs of each direction and its standard deviation; NaN without runs.
    double forward = 0.0, forward_sd = 0.0, backward = 0.0, backward_sd = 0.0;
    double share = 0.0;  ///< of the torque's variance within the runs
  };
  std::vector<Order> orders;       ///< the strongest first; empty if there are none
  double gain = 0.0;               ///< nats
  double significance_nats = 0.0;  ///< -ln p of the strongest order, those tried counted
  bool tested = false;
  std::string reason;  ///< why not
};

/// `alarm`: the evidence that an order needs.
SteadyRipple steady_ripple(std::span<const Run> runs, const DriveModel& model, double alarm);

}  // namespace clampd::drive
