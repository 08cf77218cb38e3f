#pragma once

#include <cstdint>

#include "clampd/base/realtime.hpp"
#include "clampd/simulation/trace.hpp"
#include "drivers/can/brake_node.hpp"
#include "drivers/sim/simulated_brake.hpp"

namespace clampd::plant {

/// The simulated brake on a bus, as the work of a cyclic thread: one tick is one sampling instant.
///
/// When the thread misses a deadline, the brake's clock stands still with it: late samples stay consistent
/// among themselves, and the program reports how many periods it skipped.
class Plant {
 public:
  /// All must outlive this; `trace` may be null. `configuration` must be valid.
  Plant(can::FrameBus& bus, const can::ProtocolCodec& codec, const sim::PlantConfiguration& configuration,
        Trace* trace);

  CLAMPD_REALTIME void tick(std::int64_t now_ns, std::int64_t lateness_ns,
                            std::uint64_t skipped_periods) noexcept;
  CLAMPD_REALTIME void shutdown(std::int64_t now_ns) noexcept;

  std::int64_t samples() const noexcept { return samples_; }
  const can::ProtocolCounts& counts() const noexcept { return node_.counts(); }

 private:
  sim::SimulatedBrake brake_;
  can::BrakeNode<sim::SimulatedBrake> node_;
  Trace* trace_;
  double cycle_s_;
  std::int64_t samples_ = 0;
};

}  // namespace clampd::plant
