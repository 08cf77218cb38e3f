#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "clampd/base/realtime.hpp"

namespace clampd {

/// One sample as the brake measured it, in SI units.
/// The brake defines the sampling instant: `sample_index` and `brake_time_ns` come from its own clock (of a
/// brake that sends none, from when its frames arrive) and are unwrapped by the protocol. Row k holds the readings at its instant; its torque acts until the next sample.
struct BrakeFeedback {
  std::int64_t sample_index = 0;     ///< +1 for every sample the brake took, also for those that got lost
  std::int64_t brake_time_ns = 0;    ///< the brake's sample clock
  std::int64_t arrival_time_ns = 0;  ///< the host's CLOCK_MONOTONIC (or virtual) time at reception
  double torque_Nm = 0.0;            ///< measured motor torque acting from this instant on
  double velocity_rad_s = 0.0;
  double force_N = 0.0;
  double position_rad = 0.0;      ///< motor encoder; its zero is arbitrary
  bool drive_enabled = false;     ///< the brake's drive stage is live
  bool watchdog_tripped = false;  ///< the brake zeroed its torque because valid commands stopped
  bool brake_fault = false;       ///< the brake reports an internal fault
};

/// What a brake is told of its motor.
enum class CommandedQuantity : std::uint8_t {
  Torque,
  Velocity,  ///< the brake's own loop then makes the torque
};

/// What the station asks of the brake for the brake's next sample period.
struct DriveCommand {
  double torque_Nm = 0.0;
  bool enable = false;          ///< false: the brake shall output zero torque, whatever else stands here
  double velocity_rad_s = 0.0;  ///< in place of the torque if `commanded` says so
  CommandedQuantity commanded = CommandedQuantity::Torque;
};

enum class LinkState : std::uint8_t {
  Up,            ///< frames flow
  ErrorPassive,  ///< the controller warns: still flowing, many errors
  BusOff,        ///< the controller left the bus
  Down,          ///< the interface exists and is administratively down
  Gone,          ///< the interface does not exist (unplugged, driver unbound)
};
std::string_view to_string(LinkState link) noexcept;  ///< "up", "error-passive", "bus-off", "down", "gone"

/// Cumulative counts since the port was opened, and the link's present state.
struct PortHealth {
  LinkState link = LinkState::Up;
  std::uint64_t frames_received = 0;
  std::uint64_t frames_sent = 0;
  std::uint64_t send_failures = 0;
  std::uint64_t crc_errors = 0;      ///< frames refused for a wrong CRC-8
  std::uint64_t counter_errors = 0;  ///< frames refused for an alive counter that repeated or jumped back
  std::uint64_t lost_samples = 0;    ///< samples missing in the brake's sample count
  std::uint64_t implausible = 0;     ///< frames refused since a signal decodes outside its DBC range
  std::uint64_t error_frames = 0;
  std::uint64_t bus_off_events = 0;  ///< bus-off reported by the controller, also when it recovered at once
  std::uint64_t receive_overflows = 0;  ///< frames the kernel dropped (SO_RXQ_OVFL) or we could not store
  std::uint64_t bus_bits = 0;           ///< bits seen on the wire, worst-case stuffing: for the bus load
  /// Of a brake without a sample clock: the standard deviation of its frames' arrivals about its instants.
  double arrival_jitter_ns = 0.0;
};

/// How the loop reaches a brake. Declared here, since both the loop (rt) and the drivers speak it and
/// neither may include the other.
class BrakePort {
 public:
  virtual ~BrakePort() = default;
  BrakePort() = default;
  BrakePort(const BrakePort&) = delete;
  BrakePort& operator=(const BrakePort&) = delete;

  /// Takes what arrived since the last call, oldest first; never blocks. Returns how many of `out` were
  /// filled. Refused frames (CRC, counter, range) do not appear; they are counted in health().
  CLAMPD_REALTIME virtual std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept = 0;

  /// Sends one command; never blocks. False if it could not be handed to the link.
  CLAMPD_REALTIME virtual bool send(const DriveCommand& command, std::int64_t now_ns) noexcept = 0;

  /// Sends the last command again, if there was one; for a brake that wants them more often than the loop
  /// decides.
  CLAMPD_REALTIME virtual void repeat(std::int64_t /*now_ns*/) noexcept {}

  /// The station ends: what the brake is told after the last command.
  CLAMPD_REALTIME virtual void end(std::int64_t /*now_ns*/) noexcept {}

  CLAMPD_REALTIME virtual PortHealth health() const noexcept = 0;
};

}  // namespace clampd
