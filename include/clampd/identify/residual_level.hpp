#pragma once

#include <optional>
#include <span>
#include <string>

#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// What a model leaves of runs, against what no model is needed for: THE rule for a fit that got lost.
///
/// The noise of a reading is taken from the reading itself: from the median of its third differences, which
/// no smooth motion survives and no fit knows of. What is left is far above it if it is more than ten times
/// as large and more than a twentieth of what the reading does (rms about its mean). The median of 300
/// differences is within a quarter of the true noise, so that noise alone is never ten times itself; the
/// second bound is for models that are right but for something small (a late reading, a force that lags by
/// half a millisecond), whose misfit is many times the noise of a good sensor and yet a few percent of the
/// motion: that is for a diagnosis, not for this rule.
struct ResidualLevel {
  double force = 0.0;     ///< residual over noise
  double velocity = 0.0;  ///< the same
  bool far_above_noise = false;
  std::string words;  ///< the worse channel, as "the force by 2223 N rms, 74 times the noise of its reading"
};

/// `left`: standard deviations of what is left of force and velocity; and the torque noise that is needed for
/// that, which is far above any noise where it exceeds the torque itself (rms).
ResidualLevel residual_level(std::span<const Run> runs, const NoiseLevels& left);

}  // namespace clampd
