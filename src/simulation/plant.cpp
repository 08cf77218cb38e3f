#include "clampd/simulation/plant.hpp"

#include <cmath>
#include <utility>

namespace clampd::plant {
namespace {

constexpr std::pair<sim::FaultKind, can::WireFault> kWireFaults[]{
    {sim::FaultKind::Silent, can::WireFault::Silent},
    {sim::FaultKind::CorruptCrc, can::WireFault::CorruptCrc},
    {sim::FaultKind::FrozenCounter, can::WireFault::FrozenCounter},
    {sim::FaultKind::ImpossibleValues, can::WireFault::ImpossibleValues},
};

/// The first of the scripted faults that is active; one frame can be wrong in one way only.
can::WireFault wire_fault(const sim::PlantConfiguration& configuration, double time_s) noexcept {
  for (const auto& [kind, fault] : kWireFaults) {
    if (configuration.fault_active(kind, time_s)) return fault;
  }
  return can::WireFault::None;
}

}  // namespace

Plant::Plant(can::FrameBus& bus, const can::ProtocolCodec& codec,
             const sim::PlantConfiguration& configuration, Trace* trace)
    : brake_{configuration, codec.feedback_cycle_ns()},
      node_{bus, codec, brake_},
      trace_{trace},
      cycle_s_{1e-9 * static_cast<double>(codec.feedback_cycle_ns())} {}

void Plant::tick(std::int64_t now_ns, std::int64_t /*lateness_ns*/,
                 std::uint64_t /*skipped_periods*/) noexcept {
  const double time_s = static_cast<double>(samples_) * cycle_s_;
  const std::int64_t sampled_ns = now_ns + std::llround(brake_.lateness_s() * 1e9);
  const BrakeFeedback reading = node_.tick(sampled_ns, wire_fault(brake_.configuration(), time_s));
  if (trace_ != nullptr) {
    const sim::Truth& truth = brake_.truth();
    trace_->put({now_ns, samples_, truth.torque_Nm, truth.force_N, truth.velocity_rad_s, truth.position_rad,
                 truth.drive_enabled, truth.watchdog_tripped, reading.brake_fault});
  }
  ++samples_;
}

void Plant::shutdown(std::int64_t /*now_ns*/) noexcept {}

}  // namespace clampd::plant
