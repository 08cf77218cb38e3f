#pragma once

#include <cstdint>
#include <numeric>

#include "clampd/base/realtime.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/simulation/plant.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/can/embedded_bus.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "rt/control_core.hpp"

namespace clampd::bench {

/// One period of a simulated brake and a station in virtual time: the brake samples from `begin_ns` on, the
/// station's tick comes half a period later, and either as often as `codec` says.
template <class Brake, class Core>
CLAMPD_REALTIME void simulate_period(Brake& brake, Core& core, const can::ProtocolCodec& codec,
                                     std::int64_t begin_ns, std::int64_t lateness_ns) noexcept {
  const int parts = 2 * std::lcm(codec.samples_per_period, codec.commands_per_period);
  const int between_samples = parts / codec.samples_per_period;
  const int between_commands = parts / codec.commands_per_period;
  for (int part = 0; part < parts; ++part) {
    const std::int64_t now_ns = begin_ns + part * codec.period_ns / parts;
    if (part % between_samples == 0) brake.tick(now_ns, 0, 0);
    if (part == parts / 2)
      core.tick(now_ns, lateness_ns, 0);
    else if ((part + parts / 2) % between_commands == 0)
      core.between(now_ns);
  }
}

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
      bench_.clock_ns_ = bench_.clock_ns_ == 0 ? now_ns : bench_.clock_ns_ + bench_.codec_.period_ns;
      simulate_period(bench_.brake_, core_, bench_.codec_, bench_.clock_ns_ - bench_.codec_.period_ns / 2,
                      lateness_ns);
    }
    CLAMPD_REALTIME void shutdown(std::int64_t /*now_ns*/) noexcept { core_.shutdown(bench_.clock_ns_); }

   private:
    SimulatedBench& bench_;
    rt::ControlCore& core_;
  };

 private:
  const can::ProtocolCodec& codec_;
  can::EmbeddedBus bus_;
  plant::Plant brake_;
  std::int64_t clock_ns_ = 0;
};

}  // namespace clampd::bench
