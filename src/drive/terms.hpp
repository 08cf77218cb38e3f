#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/drive/model.hpp"
#include "src/drive/design.hpp"

namespace clampd::drive {

/// What the fitted runs cover.
struct DriveRange {
  double lowest = 0.0, highest = 0.0;  ///< position
  double slow = 0.0, fast = 0.0;       ///< 5 % and 98 % of the absolute speed
  double acceleration = 0.0;           ///< root mean square
  double duration_s = 0.0;             ///< of the longest run
  int runs = 0;
  int reversals = 0;
  double forward = 0.0;  ///< share of the rows
  double torque = 0.0;   ///< root mean square
  double most_torque = 0.0;
  double sinusoidal = 0.0;  ///< 1: one sinusoid; the squared correlation of position and acceleration

  double centre() const { return 0.5 * (lowest + highest); }
  double half() const { return 0.5 * (highest - lowest); }
  bool both_directions() const { return forward > 0.05 && forward < 0.95; }
};
DriveRange range_of(const DriveData& data);

/// One way in which a term may act: linear in its coefficients once its shape is given.
struct Variant {
  DriveTerm term = DriveTerm::Inertia;
  std::string name;
  std::vector<BasisFunction> functions;
  double alternatives = 1.0;      ///< shapes that were tried for it
  bool replaces_viscous = false;  ///< a power law in the viscous friction's place
  double lag_s = 0.0;             ///< of torque-lag
  double settling_s = 0.0;        ///< the same as a time constant
  double shape_sd = 0.0;          ///< of the shape's continuous number, relative; 0: it has none
  std::vector<int> columns = {};  ///< of the Design
  /// Columns that depend on the rest of the model, as it was last fitted; empty: the functions' own.
  std::vector<int> frozen = {};
  /// Of torque-saturation: its coefficient. Its function is no column but is taken from the reading.
  double saturation = 0.0;

  bool operator==(const Variant& other) const {
    return name == other.name && functions == other.functions && replaces_viscous == other.replaces_viscous &&
           lag_s == other.lag_s && settling_s == other.settling_s && saturation == other.saturation;
  }
};

/// All variants of a term that do not depend on the model beside it.
std::vector<Variant> variants_of(DriveTerm term, const DriveRange& range, const DriveData& data,
                                 const DriveModel& model);

/// The user's own column as it is, which a known torque is.
inline BasisFunction known_torque_function(std::size_t regressor) {
  return {BasisFunction::Carrier::One, BasisFunction::Factor::Column, 0.0, 1.0, static_cast<int>(regressor)};
}

/// Whether a regressor is the same in all fitted rows: whatever goes with it is then a part of the constant
/// torque, of friction or of inertia.
bool is_constant(const DriveData& data, std::size_t regressor);

/// Changes the torque that the columns explain instead of adding one.
inline bool changes_torque(const Variant& variant) {
  return variant.lag_s != 0.0 || variant.settling_s != 0.0 || variant.saturation != 0.0;
}

/// Why these runs cannot show the term, and what motion would; nothing if they can.
struct Unidentifiable {
  std::string reason;
  std::string motion;  ///< to record next
};
std::optional<Unidentifiable> unidentifiable(DriveTerm term, const DriveRange& range, const DriveData& data,
                                             const DriveModel& model);

/// Numbers that a variant brings: coefficients and a free shape.
int complexity(const Variant& variant);

/// The number of a variant's shape that may be anything: a speed, a length, a power, an order. Null: none.
const double* free_shape(const Variant& variant);
Variant with_shape(const Variant& variant, double shape);

/// Why no drive can be like this, at most one reason a term: "friction would push the drive at 3 rad/s
/// forward", which is one of dry friction.
struct Impossibility {
  DriveTerm term = DriveTerm::Inertia;
  std::string words;
};
std::vector<Impossibility> impossibilities(const std::vector<FittedTerm>& terms, const DriveRange& range,
                                           const DriveModel& model);

}  // namespace clampd::drive
