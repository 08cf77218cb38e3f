#pragma once

#include "clampd/base/clock.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/ports/brake_port.hpp"

namespace clampd {

/// What a test's brake is told, and how often; and how it is estimated.
struct Told {
  CommandedQuantity commanded = CommandedQuantity::Torque;
  double period_s = kPeriod_s;
  Method method = Method::OutputError;
};

}  // namespace clampd
