#pragma once

#include <span>
#include <string_view>

#include "clampd/base/result.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// One stretch of a manoeuvre, from where the one before ended (the first: from contact), at rest at both
/// ends.
struct ManoeuvreSegment {
  double duration_s = 0.0;
  double force_N =
      0.0;  ///< goes to where the nominal brake has this force (a hold if it is there already) ...
  double opening_rad = 0.0;  ///< ... or, with force_N = 0, opens the clearance by this much
  int cycles = 0;            ///< of a sinusoid in force, to force_N and back, in place of a move
  double swing_rad = 0.0;    ///< opens by up to this much and back as often as can be, in place of a move ...
  double torque_Nm = 0.0;    ///< ... with this torque in either direction
};

struct ManoeuvreInfo {
  std::string_view name;
  std::string_view description;
  std::span<const ManoeuvreSegment> segments;  ///< empty: the shipped optimal trajectory
};

/// THE table of manoeuvres.
std::span<const ManoeuvreInfo> manoeuvres();

/// Segments as a trajectory of the nominal brake, as make_manoeuvre() does its own. `name` is for messages.
/// Errors: also a swing that is too long for its segment.
Result<Run> follow_segments(std::string_view name, std::span<const ManoeuvreSegment> segments,
                            const BrakeParameters& nominal);

/// A manoeuvre as a trajectory of the nominal brake, 1 ms a row, all columns, position from contact. Moves
/// are polynomials of least jerk in position; the torques come from inverse dynamics, held over each row, so
/// that each row follows from the one before exactly. `optimal` is what the manoeuvre of that name gives
/// back. Errors: an unknown name (the message lists the known ones); a nominal brake that cannot do it within
/// 3 N m.
Result<Run> make_manoeuvre(std::string_view name, const BrakeParameters& nominal, const Run& optimal);

}  // namespace clampd
