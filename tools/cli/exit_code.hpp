#pragma once

namespace clampd::cli {

/// Exit codes of every program, as promised in README.md.
enum ExitCode : int {
  kSuccess = 0,     ///< passed, or the work was done
  kBrakeFails = 1,  ///< the brake is outside of its limits
  kBadInput = 2,    ///< wrong usage or bad input
  kStation = 3,     ///< timing, bus or sensors made the result invalid
  kAborted = 4,     ///< operator or emergency stop
  kTimedOut = 5,
};

}  // namespace clampd::cli
