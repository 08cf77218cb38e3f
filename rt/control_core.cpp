#include "rt/control_core.hpp"

namespace clampd::rt {

template class BasicControlCore<CheckSequence>;

}  // namespace clampd::rt
