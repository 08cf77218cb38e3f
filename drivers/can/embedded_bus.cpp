#include "drivers/can/embedded_bus.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"

namespace clampd::can {

EmbeddedBus::EmbeddedBus(double bitrate_bit_s, const BusFormat& format)
    : bit_ns_{1e9 / bitrate_bit_s}, format_{format} {
  CLAMPD_ASSERT(bitrate_bit_s > 0.0);
  for (std::size_t i = 0; i < ends_.size(); ++i) {
    ends_[i].bus_ = this;
    ends_[i].peer_ = &ends_[1 - i];
  }
}

void EmbeddedBus::set_link(LinkState link) noexcept {
  for (Port& port : ends_) {
    if (link == LinkState::BusOff && port.health_.link != LinkState::BusOff) {
      ++port.health_.bus_off_events;
      ++port.health_.error_frames;
    }
    port.health_.link = link;
    if (link != LinkState::Up && link != LinkState::ErrorPassive) port.queued_ = 0;
  }
}

void EmbeddedBus::Port::push(const TimedFrame& frame) noexcept {
  if (queued_ == queue_.size()) {
    ++health_.receive_overflows;
    return;
  }
  queue_[(head_ + queued_) % queue_.size()] = frame;
  ++queued_;
}

std::size_t EmbeddedBus::Port::receive(std::span<TimedFrame> out, std::int64_t now_ns) noexcept {
  std::size_t taken = 0;
  while (taken < out.size() && queued_ > 0 && queue_[head_].arrival_ns <= now_ns) {
    out[taken++] = queue_[head_];
    health_.bus_bits += static_cast<std::uint64_t>(worst_case_bits(queue_[head_].frame, bus_->format_));
    ++health_.frames_received;
    head_ = (head_ + 1) % queue_.size();
    --queued_;
  }
  return taken;
}

bool EmbeddedBus::Port::send(const Frame& frame, std::int64_t now_ns) noexcept {
  const bool carried = frame.format == FrameFormat::Classic || bus_->format_.flexible_data_rate;
  if (!carried || (health_.link != LinkState::Up && health_.link != LinkState::ErrorPassive)) {
    ++health_.send_failures;
    return false;
  }
  const int bits = worst_case_bits(frame, bus_->format_);
  const std::int64_t start_ns = std::max(now_ns, bus_->wire_free_ns_);
  bus_->wire_free_ns_ = start_ns + std::llround(bits * bus_->bit_ns_);
  ++health_.frames_sent;
  health_.bus_bits += static_cast<std::uint64_t>(bits);
  if (drops_ > 0) {
    --drops_;
    return true;
  }
  TimedFrame arriving{frame, bus_->wire_free_ns_};
  if (corruptions_ > 0) {
    --corruptions_;
    arriving.frame.data[0] ^= 1U;
  }
  peer_->push(arriving);
  return true;
}

}  // namespace clampd::can
