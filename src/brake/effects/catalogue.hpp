#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "src/brake/effects/effect_equations.hpp"

namespace clampd {

// One file each, of the same name.
#define CLAMPD_EFFECT(name) const Effect& name();
#include "src/brake/effects/catalogue.inc"
#undef CLAMPD_EFFECT

}  // namespace clampd
