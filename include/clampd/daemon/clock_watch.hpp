#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "clampd/bench/check_conductor.hpp"

namespace clampd::daemon {

/// Sees that somebody set the wall clock, which records are stamped with.
class ClockWatch {
 public:
  /// In words if it was set since the last call, by more than corrections that a time service makes all the
  /// time; empty otherwise.
  std::string look(bench::Instant now);

 private:
  std::optional<std::int64_t> offset_ns_;  ///< from the steady clock to the wall clock
};

}  // namespace clampd::daemon
