#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// Under which circumstances a characteristic is asked for. A kind uses those that its conditions name.
struct Circumstances {
  double force_N = 0.0;              ///< the set point
  double share = 0.0;                ///< of the set point, at which the time is taken
  double speed_rad_s = 0.0;          ///< of the motor
  double clearance_rad = 0.0;        ///< from where the motor starts, or to where it opens; from contact
  double torque_limit_Nm = 3.0;      ///< of the drive: less for a low supply
  double speed_limit_rad_s = 270.0;  ///< of the drive
};

/// One circumstance as the file names it.
struct CircumstanceInfo {
  std::string_view key;
  double Circumstances::*member;
  double lower;  ///< must lie within
  double upper;
  bool required;
};

class MeasuredBrake;

/// A figure that a requirement sheet asks of a brake, in closed form or by simulation, or as its
/// encoder reads it.
struct CharacteristicKind {
  std::string_view name;  ///< as in the file
  std::string_view unit;
  std::string_view description;
  std::vector<CircumstanceInfo> circumstances;
  std::vector<Parameter> needs;  ///< parameters that it depends on
  double least;                  ///< limits beyond these cannot be meant
  double most;
  /// Of a brake with known parameters; nothing: this brake never gets there. `drive`: what the station's
  /// control law has been made for. nullptr: parameters alone do not tell, it is the contact point as the
  /// encoder reads it.
  std::optional<double> (*value)(const BrakeParameters& brake, const Circumstances& circumstances,
                                 const NominalDrive& drive);
  bool from_where_found =
      false;  ///< the contact point less the encoder's reading when the check found the brake
  /// The same as `value` of a brake with effects beside the base model, which is put on a test bench for it.
  std::optional<double> (*measured)(const MeasuredBrake& brake, const Circumstances& circumstances,
                                    const NominalDrive& drive) = nullptr;
};

/// THE table of kinds.
std::span<const CharacteristicKind> characteristic_kinds();

/// Error: a model has an effect with which the brake's own figures depend on its past, its place or its run,
/// so that the circumstances of a characteristic do not say what is meant.
Result<void> check_countable(std::span<const EffectValues> effects);

/// One line of the sheet.
struct Characteristic {
  std::string name;  ///< as given, or made from kind and circumstances; unique in its sheet
  const CharacteristicKind* kind = nullptr;
  Circumstances circumstances;
  double lower;  ///< in the kind's unit; -infinity: no lower limit
  double upper;  ///< infinity: no upper limit

  bool has_limits() const;
};

/// All circumstances that its kind has, those that the file leaves out included: "force_N 20000, share 0.9".
/// Numbers read back as the same ones.
std::string circumstances_text(const Characteristic& characteristic);

/// What a line asks of its brakes beside their parameters.
struct Sheet {
  std::string file;
  std::string revision;
  std::string author;
  std::string changed;   ///< date, YYYY-MM-DD
  std::string sha256;    ///< of the file's text
  std::string contents;  ///< the file's text; empty: it comes from a record
  std::vector<Characteristic> characteristics;
};

/// Sheet file (TOML, docs/sheet.md): revision, author, changed, and one [[characteristic]] for each line:
/// kind, unit, its circumstances, and if wanted name, lower and upper. Errors with file, line, column and
/// what to do: unknown keys, kinds and circumstances that a kind does not have, another unit than the kind's,
/// a lower limit that is not below the upper one, limits and circumstances that cannot be meant (20 for 20
/// kN), a name or a line that is there twice.
Result<Sheet> read_sheet(const std::string& path);
Result<Sheet> parse_sheet(const std::string& text, const std::string& path);

/// What a check was asked, as its record has it: the lines with their circumstances and limits, but not what
/// they came to. Errors name the line: a kind, a unit or circumstances that this version does not know.
Result<Sheet> sheet_of(const SheetRecord& record);

}  // namespace clampd
