#pragma once

#include <cstddef>
#include <vector>

namespace clampd {

/// One row of the trajectory that the loop replays, with the feedback gains that belong to it.
/// Positions count from the contact point.
struct ReferenceRow {
  double force_N = 0.0;
  double position_rad = 0.0;
  double velocity_rad_s = 0.0;
  double torque_Nm = 0.0;  ///< feed-forward acting from this row until the next
  double stiffness_N_rad =
      0.0;                     ///< dF/dx of the nominal brake here: turns a force error into a position error
  double gain_position = 0.0;  ///< N m per rad
  double gain_velocity = 0.0;  ///< N m per rad/s
};

/// The trajectory as built before a check, read-only for the loop: one row per sample period.
struct Reference {
  std::vector<ReferenceRow> rows;
};

}  // namespace clampd
