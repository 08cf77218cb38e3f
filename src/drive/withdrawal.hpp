#pragma once

#include <functional>
#include <string>
#include <vector>

#include "src/drive/selection.hpp"

namespace clampd::drive {

/// The effects that the rows ask for, less those whose names do not hold; each that is withdrawn is said in
/// `notices`. What took the inertia's torque is not tried again, and the search begins anew without it: it
/// may have stood in the place of the right one.
Selection selected_effects(Selector& selector, const Design& design, const DriveRange& range,
                           const DriveModel& model, std::vector<std::string>& notices,
                           const std::function<void(double)>& progress);

/// Parts of the best model that are not of the base model.
std::vector<Variant> effects_of(const Selection& selection);

}  // namespace clampd::drive
