#pragma once

#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "src/drive/design.hpp"

namespace clampd::drive {

/// What the positions of motor and load say of the gear between them: play, which switches with the sign of
/// the torque that it transmits, compliance, which goes with its size, a load reading that is late, a ratio
/// that is another one. Nothing where the load's position is not recorded.
///
/// `actuation` is how the torque follows from its reading. The gear transmits what the motor's own inertia
/// and friction leave of it; their share of the drive's is not known and found with the rest.
std::vector<DataFinding> gear_findings(const Design& design, const FittedDrive& fitted,
                                       const Actuation& actuation);

}  // namespace clampd::drive
