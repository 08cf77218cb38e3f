#pragma once

#include <array>
#include <optional>

#include "clampd/ports/brake_port.hpp"
#include "drivers/can/bus.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd::can {

/// A brake on a CAN bus, as the loop sees it.
class CanBrake final : public BrakePort {
 public:
  /// `bus` must outlive this.
  CanBrake(FrameBus& bus, const ProtocolCodec& codec)
      : bus_{bus}, protocol_{codec}, startup_{codec.startup}, shutdown_{codec.shutdown} {}

  CLAMPD_REALTIME std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept override;
  /// Before the command, the next start-up frame if one is due. A brake that has sent no sample for a second
  /// is woken anew, from the first one on.
  CLAMPD_REALTIME bool send(const DriveCommand& command, std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME void repeat(std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME void end(std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME PortHealth health() const noexcept override;

 private:
  void wake(std::int64_t now_ns) noexcept;

  FrameBus& bus_;
  StationProtocol protocol_;
  FrameSequence startup_, shutdown_;
  DriveCommand last_;                    ///< sent
  std::optional<std::int64_t> begin_ns_;  ///< frames that came before are not looked at
  std::int64_t awake_ns_ = 0;             ///< when the latest sample came or the latest start-up frame went
};

}  // namespace clampd::can
