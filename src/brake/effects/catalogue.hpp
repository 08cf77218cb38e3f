#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "src/brake/effects/effect_equations.hpp"

namespace clampd {

// One file each, of the same name.
const Effect& torque_offset();
const Effect& torque_gain();
const Effect& torque_lag();
const Effect& coulomb_load();
const Effect& friction_asymmetry();
const Effect& quadratic_drag();
const Effect& cogging();
const Effect& inertia_error();
const Effect& ratio_error();
const Effect& presliding();
const Effect& friction_drift();
const Effect& stiffness_hysteresis();
const Effect& pad_damping();
const Effect& pad_relaxation();
const Effect& backlash();
const Effect& stiffness_shape();
const Effect& force_offset();
const Effect& force_lag();
const Effect& force_saturation();
const Effect& force_hum();
const Effect& velocity_lag();
const Effect& velocity_offset();
const Effect& channel_skew();
const Effect& outliers();

}  // namespace clampd
