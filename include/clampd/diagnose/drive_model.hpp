#pragma once

#include <array>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// What a diagnosis does with a part of the torque balance.
enum class PartUse {
  Estimate,   ///< part of the base model
  Fixed,      ///< part of the base model with a known value
  Candidate,  ///< joins the model if the runs ask for it
  Off,        ///< never
};

struct DrivePart {
  PartUse use = PartUse::Off;
  double value = 0.0;  ///< if fixed
};

/// The parts that a model file can switch by these names. The first three are the base model by default and
/// may be estimated, fixed or off; the others are candidates by default and may be estimated or off.
enum class DriveTerm {
  Inertia,
  Viscous,
  Coulomb,
  TorqueOffset,
  FrictionAsymmetry,
  QuadraticDrag,
  FrictionShape,
  Presliding,
  Cogging,
  FrictionPosition,
  LoadPosition,
  FrictionDrift,
};
inline constexpr std::array<std::string_view, 12> kDriveTermNames{
    "inertia",        "viscous",    "coulomb", "torque-offset",     "friction-asymmetry", "quadratic-drag",
    "friction-shape", "presliding", "cogging", "friction-position", "load-position",      "friction-drift"};
inline constexpr std::size_t kDriveTermCount = kDriveTermNames.size();

/// A bare drive: torque and motion, no clamp force. Its model file says which columns its runs have, in which
/// units, and which parts of the torque balance
///   T = J a + Tv v + TC sign(v) + effects
/// are estimated.
struct DriveModel {
  std::string file;
  std::string name;
  bool linear = false;  ///< position in m and J in kg instead of rad and kg m^2
  /// "N m", "N" or "A": what `torque` is in. With A, every parameter is that per torque constant.
  std::string torque_unit = "N m";
  ColumnMap columns;
  /// The torque is a command that acts from its row until the next one, not a reading at its row's time.
  bool torque_held = false;
  /// Every run goes at one steady speed and counts as one point of a friction map, its medians.
  bool steady = false;
  /// Both sides of the torque balance are filtered at this; NaN: chosen from the torque's own spectrum.
  double cut_off_Hz = std::numeric_limits<double>::quiet_NaN();
  std::array<DrivePart, kDriveTermCount> parts{};

  const DrivePart& part(DriveTerm term) const { return parts[static_cast<std::size_t>(term)]; }
  std::string_view position_unit() const { return linear ? "m" : "rad"; }
};

/// Reads a model file:
///
///   [drive]
///   name = "ball screw axis"
///   kind = "linear"                      # or "rotary": metres and kilograms, or radians and kg m^2
///   unit = "N"                           # of the torque column once scaled: "N m", "N" or "A"
///   [columns]
///   time = "time_s"
///   torque = "motor_force_N"
///   position = {column = "count", scale = 7.67e-4, wrap = 8192}   # position, velocity or both
///   [model]                              # "estimate", "off" or a known value; the base model by default:
///   inertia = "estimate"
///   torque-offset = "candidate"          # effects: "candidate" (default), "estimate", "off"
///   [data]
///   steady = true                        # each file one steady speed
///   torque_held = true                   # a command that acts until the next row, not a reading
///   cut_off_Hz = 40.0
///
/// Errors name file, line, column and key.
Result<DriveModel> read_drive_model(const std::string& path);
Result<DriveModel> parse_drive_model(const std::string& text, const std::string& path);

}  // namespace clampd
