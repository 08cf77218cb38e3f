#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "drivers/can/bus.hpp"

struct can_frame;

namespace clampd::can {

/// What the kernel says about a CAN interface, for `clampctl doctor` and for error messages.
struct InterfaceInfo {
  std::string name;
  unsigned index = 0;
  std::string kind;                  ///< "can" (a controller), "vcan", "vxcan", ...; empty if unknown
  std::string driver;                ///< kernel driver of a controller; empty for virtual ones
  bool up = false;                   ///< administratively
  std::uint32_t bitrate = 0;         ///< bit/s; 0 where there is no wire
  std::uint32_t restart_ms = 0;      ///< automatic restart after bus-off; 0: never
  std::string controller_state;      ///< "error-active", ..., "bus-off", "stopped"; empty for virtual ones
  std::uint32_t transmit_queue = 0;  ///< frames
  std::uint32_t data_bitrate = 0;    ///< bit/s of the data of CAN FD frames; 0 where there is none
  bool flexible_data_rate = false;   ///< set up for CAN FD
};

/// Asks the kernel (rtnetlink, sysfs). Errors: no such interface, not a CAN interface; both say what to do.
Result<InterfaceInfo> inspect_interface(const std::string& name);

/// Whether this kernel gives raw CAN sockets.
bool kernel_has_can() noexcept;

/// Folds one of SocketCAN's error frames (CAN_ERR_FLAG set) into `health`.
CLAMPD_REALTIME void apply_error_frame(const can_frame& frame, BusHealth& health) noexcept;

/// A raw SocketCAN socket: kernel filters for the wanted identifiers, error frames, kernel time stamps, drop
/// count.
///
/// The link follows what the kernel tells: Down while the interface is down, and Up again by itself; Gone
/// when it vanished, until reopen() finds it again; BusOff until the controller reports its restart
/// or another frame arrives.
///
/// receive(), send() and health() belong to one thread, the loop's. link() and reopen() may be called
/// from another.
class SocketCanBus final : public FrameBus {
 public:
  /// Only data frames with these identifiers (kExtendedId set for 29 bits) and error frames will be received.
  /// Errors: no such interface, one that is not set up for CAN FD where `format` wants it, a kernel without
  /// CAN.
  static Result<std::unique_ptr<SocketCanBus>> open(const std::string& interface,
                                                    std::vector<std::uint32_t> wanted_ids,
                                                    const BusFormat& format = {});
  ~SocketCanBus() override;

  CLAMPD_REALTIME std::size_t receive(std::span<TimedFrame> out, std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME bool send(const Frame& frame, std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME BusHealth health() const noexcept override;

  CLAMPD_REALTIME LinkState link() const noexcept { return link_.load(std::memory_order_relaxed); }

  /// Not for the loop's thread. If the interface is Gone, opens it anew behind the same file descriptor,
  /// which the loop goes on using; an error while the interface is still missing. Does nothing to a socket
  /// that is not Gone.
  Result<void> reopen();

 private:
  SocketCanBus(std::string interface, std::vector<std::uint32_t> wanted_ids, const BusFormat& format,
               int descriptor);
  void note_error(int error) noexcept;
  void note_reopened() noexcept;

  const std::string interface_;
  const std::vector<std::uint32_t> wanted_ids_;
  const BusFormat format_;
  const int descriptor_;
  BusHealth health_;  ///< its link is the loop's copy of link_
  std::uint32_t kernel_drops_ = 0;
  std::atomic<LinkState> link_{LinkState::Up};
  std::atomic<bool> reopened_{false};
};

}  // namespace clampd::can
