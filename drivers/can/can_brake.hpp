#pragma once

#include <array>

#include "clampd/ports/brake_port.hpp"
#include "drivers/can/bus.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd::can {

/// A brake on a CAN bus, as the loop sees it.
class CanBrake final : public BrakePort {
 public:
  /// `bus` must outlive this.
  CanBrake(FrameBus& bus, const ProtocolCodec& codec) : bus_{bus}, protocol_{codec} {}

  CLAMPD_REALTIME std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME bool send(const TorqueCommand& command, std::int64_t now_ns) noexcept override;
  CLAMPD_REALTIME PortHealth health() const noexcept override;

 private:
  FrameBus& bus_;
  StationProtocol protocol_;
};

}  // namespace clampd::can
