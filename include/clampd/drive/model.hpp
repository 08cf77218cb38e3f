#pragma once

#include <array>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

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
  Gravity,
  FrictionPower,
  LoadFriction,
  TorqueSaturation,
  TorqueLag,
  InertiaPosition,
  Regressor,  ///< a column of the user's own; named column:NAME
};
inline constexpr std::array<std::string_view, 19> kDriveTermNames{
    "inertia",           "viscous",        "coulomb",          "torque-offset",  "friction-asymmetry",
    "quadratic-drag",    "friction-shape", "presliding",       "cogging",        "friction-position",
    "load-position",     "friction-drift", "gravity",          "friction-power", "load-friction",
    "torque-saturation", "torque-lag",     "inertia-position", "column"};
inline constexpr std::size_t kDriveTermCount = kDriveTermNames.size();
constexpr std::string_view name_of(DriveTerm term) {
  return kDriveTermNames[static_cast<std::size_t>(term)];
}

/// "torque ripples periodically with position"; of a linear drive, `effort` is its force.
std::string words_of(DriveTerm term, std::string_view effort);

/// A column of the user's own: a load cell, a temperature, a gravity torque that was computed elsewhere.
struct DriveRegressor {
  std::string name;  ///< as in "column:NAME"; the run's RunColumn has the same
  PartUse use = PartUse::Candidate;
  bool known_torque =
      false;  ///< it is a torque in the unit of the torque column and is counted with the factor 1
  bool per_file = false;  ///< no column: one number a file, as DriveModel::files says
};

/// What the model file knows of a run file: a payload, a temperature.
struct DriveFile {
  std::string name;            ///< of the file, with as many of its folders as tell it from others
  std::vector<double> values;  ///< of the regressors that are per file, in their order
};

/// A bare drive: torque and motion, no clamp force. Its model file says which columns its runs have, in which
/// units, and which parts of the torque balance
///   T = J a + Tv v + TC sign(v) + effects
/// are estimated.
struct DriveModel {
  std::string file;
  std::string name;
  bool linear = false;  ///< position in m and J in kg instead of rad and kg m^2
  /// "N m", "N", "A", "V" or "%": what `torque` is in. With A, V and %, every parameter is that per torque
  /// constant.
  std::string torque_unit = "N m";
  ColumnMap columns;
  std::vector<DriveRegressor> regressors;  ///< those that are columns stand in columns.others in this order
  std::vector<DriveFile> files;
  /// The last of columns.others and of Run::others is the position behind the gear, on the motor's side.
  bool load_position = false;
  /// The torque is a command that acts from its row until the next one, not a reading at its row's time.
  bool torque_held = false;
  /// Every run goes at one steady speed and counts as one point of a friction map, its medians.
  bool steady = false;
  /// Both sides of the torque balance are filtered at this; NaN: chosen from the runs.
  double cut_off_Hz = std::numeric_limits<double>::quiet_NaN();
  /// Share of the torque's variation that may be left without a word, rms over rms.
  double good_enough = 0.05;
  std::array<DrivePart, kDriveTermCount> parts{};

  const DrivePart& part(DriveTerm term) const { return parts[static_cast<std::size_t>(term)]; }
  std::string_view position_unit() const { return linear ? "m" : "rad"; }
  /// What `torque` is called: of a linear drive a force.
  std::string_view effort() const { return linear ? "force" : "torque"; }
};

/// What a drive is doing, as the torque balance sees it.
struct DriveState {
  double time_s = 0.0;  ///< since the run began
  int run = 0;          ///< 0, 1, ... in the order of the files
  double position = 0.0, velocity = 0.0, acceleration = 0.0;
  /// +1 or -1 while it slides, 0 at standstill. In between: how much of the friction acts, for a simulation
  /// that sticks.
  double direction = 0.0;
  double travel =
      std::numeric_limits<double>::infinity();  ///< since the last reversal; travel_after_reversal()
  std::span<const double> columns = {};         ///< in the order of DriveModel::regressors
};

/// One function of the state, whose multiple is a torque: carrier(state) times factor(state; first, second).
struct BasisFunction {
  enum class Carrier {
    One,
    Acceleration,  ///< with a factor of the place: and half of its slope times v^2
    Velocity,
    Direction,
    Sliding
  };  ///< 1, a, v, direction, abs(direction)
  enum class Factor {
    One,
    Power,         ///< (abs(v) / first)^second
    Stribeck,      ///< exp(-(abs(v) / first)^second)
    Reversal,      ///< -exp(-travel / first): what friction still lacks after a reversal
    Place,         ///< (position - first) / second
    PlaceSquared,  ///< Legendre's second polynomial of that
    PlaceCubed,    ///< its third power
    Cosine,        ///< cos(first * position)
    Sine,          ///< sin(first * position)
    Time,          ///< (time_s - first) / second
    TimeDecay,     ///< exp(-time_s / first)
    Run,           ///< run - first
    InRun,         ///< 1 in run number first, 0 in all others
    Column,        ///< columns[index] - first
    ColumnSize,    ///< abs(columns[index])
    StaticLoad,    ///< as Load, without inertia
    Load,          ///< abs(sum of the terms that load the drive: inertia, gravity, offset, springs, columns)
    Balance,       ///< sum of all other terms
    BalancePower,  ///< first (abs(T) / first)^second, with the sign of T, the torque with this term in it
  };
  Carrier carrier = Carrier::One;
  Factor factor = Factor::One;
  double first = 0.0, second = 1.0;
  int index = -1;  ///< of a column; of Place, Cosine, Sine, if >= 0, of the only run in which it acts
  bool operator==(const BasisFunction&) const = default;
};

/// Sums over other terms that some factors need.
struct TermSums {
  double load = 0.0, static_load = 0.0, balance = 0.0;
};
double value_of(const BasisFunction& function, const DriveState& state, const TermSums& sums = {});

/// Where friction builds up over `length`, the travel with which it begins after a reversal: 0 where it had
/// been complete, more where it had not.
double travel_after_reversal(double travel, double length);

/// Whether a term loads the drive, rather than rubs: friction that grows with load grows with it.
bool loads_drive(DriveTerm term);

struct FittedTerm {
  DriveTerm term = DriveTerm::Inertia;
  std::string name;                      ///< "inertia", "column:temperature"
  std::vector<BasisFunction> functions;  ///< as many as coefficients
  std::vector<double> coefficients;
};
bool accelerates(const FittedTerm& term);  ///< its torque goes with the acceleration

/// A model whose torque can be computed: what `diagnose --save` writes and a simulation needs.
struct FittedDrive {
  DriveModel model;
  std::vector<FittedTerm> terms;
  Eigen::MatrixXd covariance;  ///< of all coefficients, one term after the other; empty if unknown
  /// The torque that acts at t is the reading at t - lag_s.
  double lag_s = 0.0;
  double settling_s = 0.0;  ///< time constant with which it follows that reading (first order); 0: at once
  double cut_off_Hz = std::numeric_limits<double>::quiet_NaN();  ///< of the rows it was fitted to
  double slow_speed = 0.0;  ///< below this, a reading of speed was counted as standstill
  double error_rms =
      std::numeric_limits<double>::quiet_NaN();  ///< of the torque, on rows that were not fitted
};

/// Names of the terms that are of the runs of the fit, by their number: a simulation of other runs takes the
/// first for the first.
std::vector<std::string> terms_of_runs(const FittedDrive& drive);

/// What follows `values`, straight lines between their times, with a time constant.
std::vector<double> settled(std::span<const double> time_s, std::span<const double> values,
                            double settling_s);

/// The torque that the drive needs in this state, by the fitted terms. Linear in the acceleration, but for
/// load friction and saturation, with which it still grows with it.
double torque_of(const FittedDrive& drive, const DriveState& state);

/// Whether a model file is that of a drive, which says so in a section of its own, and not of a brake.
bool is_drive_model(const std::string& text);

/// Reads a model file; docs/drives.md lists all keys. Errors name file, line, column and key.
Result<DriveModel> read_drive_model(const std::string& path);
Result<DriveModel> parse_drive_model(const std::string& text, const std::string& path);

/// A model file for runs that have none yet.
struct ProposedDriveModel {
  std::string text;                  ///< reads as a model file
  std::vector<std::string> notices;  ///< what the names of the columns leave open
};

/// From the names of a run file's columns and the units in them. Errors: it is no table; no name tells of a
/// time, a torque or a motion; the message lists the names.
Result<ProposedDriveModel> propose_drive_model(const std::string& path);

/// Reads a run by the model's columns; Run::others then are the regressors, in their order. Errors as
/// read_run(), and where the model has no values for this file.
Result<LoadedRun> read_drive_run(const std::string& path, const DriveModel& model);

/// Reads a model file with a section [fitted], as format_fitted_drive() writes it. Errors as above, and where
/// it is missing.
Result<FittedDrive> read_fitted_drive(const std::string& path);
Result<FittedDrive> parse_fitted_drive(const std::string& text, const std::string& path);

/// A model file that has the fitted terms too.
std::string format_fitted_drive(const FittedDrive& drive);

}  // namespace clampd
