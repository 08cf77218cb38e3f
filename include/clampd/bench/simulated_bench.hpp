#pragma once

#include <cstdint>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/simulation/plant.hpp"
#include "drivers/can/embedded_bus.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "rt/control_core.hpp"

namespace clampd::bench {

/// A simulated brake on an in-process bus beside the station's loop, in the loop's own thread. Its clock is
/// the loop's count of ticks: where the machine is late, brake and station are late together, so that no
/// result depends on how busy it is.
class SimulatedBench {
 public:
  /// `station` must outlive this.
  SimulatedBench(const PreparedStation& station, const sim::PlantConfiguration& plant);

  can::FrameBus& bus() noexcept { return bus_.end(can::EmbeddedBus::End::Station); }

  /// The work of a cyclic thread: the brake's sampling instant, and half a period later the tick of `core`.
  class Loop {
   public:
    Loop(SimulatedBench& bench, rt::ControlCore& core) : bench_(bench), core_(core) {}
    CLAMPD_REALTIME void tick(std::int64_t now_ns, std::int64_t lateness_ns,
                              std::uint64_t /*skipped_periods*/) noexcept {
      bench_.clock_ns_ = bench_.clock_ns_ == 0 ? now_ns : bench_.clock_ns_ + kPeriod_ns;
      bench_.brake_.tick(bench_.clock_ns_ - kPeriod_ns / 2, 0, 0);
      core_.tick(bench_.clock_ns_, lateness_ns, 0);
    }
    CLAMPD_REALTIME void shutdown(std::int64_t /*now_ns*/) noexcept { core_.shutdown(bench_.clock_ns_); }

   private:
    SimulatedBench& bench_;
    rt::ControlCore& core_;
  };

 private:
  can::EmbeddedBus bus_;
  plant::Plant brake_;
  std::int64_t clock_ns_ = 0;
};

}  // namespace clampd::bench
