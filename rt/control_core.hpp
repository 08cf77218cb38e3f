#pragma once

// The tick: everything that happens once a millisecond, with time as an argument and the link behind BrakePort, so
// that the very code of the bench runs in the tests in virtual time. (Interface fixed; see rt/check_sequence.hpp.)

#include <atomic>
#include <cstdint>

#include "clampd/base/realtime.hpp"
#include "clampd/record/brake_port.hpp"
#include "clampd/record/sample.hpp"
#include "rt/check_sequence.hpp"
#include "rt/ring.hpp"
#include "rt/supervisor.hpp"

namespace clampd::rt {

/// What other threads may read at any time. Every field is atomic on its own; the ring carries the consistent data.
struct StatusBoard {
  std::atomic<StationState> state{StationState::Init};
  std::atomic<FaultCause> fault{FaultCause::None};
  std::atomic<CheckPhase> phase{CheckPhase::None};
  std::atomic<std::uint16_t> repeat{0};
  std::atomic<std::uint64_t> ticks{0};
  std::atomic<std::uint64_t> skipped{0};
  std::atomic<std::uint64_t> ring_drops{0};
  std::atomic<std::uint64_t> checks_finished{0};  ///< sequences that reached Done or were ended by a fault
  std::atomic<double> force_N{0.0};
  std::atomic<double> velocity_rad_s{0.0};
  std::atomic<double> torque_Nm{0.0};
};

/// Requests from other threads; the tick takes them. Lock-free, one slot each.
struct RequestBoard {
  std::atomic<const CheckPlan*> plan{nullptr};  ///< a check to start; taken (set to null) when ARMED
  std::atomic<bool> stop{false};                ///< operator stop
  std::atomic<bool> emergency_stop{false};      ///< level, not edge: FAULT persists while true
  std::atomic<bool> clear{false};               ///< operator clears the fault
};

}  // namespace clampd::rt
