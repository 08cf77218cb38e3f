#pragma once

#include <compare>

namespace clampd::drive {

/// How the torque falls behind its reading where a torque constant saturates: by `loss` of the reading `most`
/// there, in proportion to a power of the reading, of more than 1. Where a reading of ten would add less than
/// one to the torque the law ends, and goes on as a straight line. No loss: torque and reading are the same.
struct SaturationLaw {
  double loss = 0.0, most = 1.0, exponent = 3.0;
  auto operator<=>(const SaturationLaw&) const = default;

  double torque(double reading) const;
  double slope(double reading) const;   ///< of torque() at this reading
  double reading(double torque) const;  ///< the inverse of torque()

 private:
  double last_reading() const;  ///< where the straight line begins
};

}  // namespace clampd::drive
